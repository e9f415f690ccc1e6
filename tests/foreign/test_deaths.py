"""Deaths of real processes: several under one start script, and an adapter that goes down with them."""

from __future__ import annotations

import pytest

from .rig import foreign

SANITY = "TC_DCP_SANITY_BV_01"
#: It crashes in the first case, which is unrelated to the second.
LETHAL, NEXT = "TC_BP_RX_BI_24", "TC_BP_FMT_BV_02"
#: Exit status of ``dcp-conformance run``.
UNDECIDED = 3


@pytest.mark.parametrize(
    ("launcher", "adapter_after"),
    [("ends", -0.5), ("ends", 0.0), ("stays", 0.5), ("stays", None), ("detaches", -0.5), ("detaches", 1.0)],
)
def test_only_the_deadly_case_is_blamed(launcher: str, adapter_after: float | None):
    with foreign(
        faults=["crashes-on-short-frame"], launcher=launcher, adapter_after=adapter_after, reset=False
    ) as target:
        for _ in range(3):
            run = target.run(LETHAL, NEXT)
            # On a busy machine cases may be undecided; they never fail.
            assert run.failed_requirements() <= {"BP-RX-16"}, run.text
            if run.status != UNDECIDED and all(each["verdict"] != "inconclusive" for each in run.cases):
                break
        assert run.status == 1, run.text
        assert {each["id"] for each in run.cases} == {SANITY, LETHAL, NEXT}
        assert run.verdict(LETHAL) == "fail", run.text
        assert run.failed_requirements() == {"BP-RX-16"}
        assert run.verdict(NEXT) == "pass", run.text
