"""Deaths of real processes that show late, or where the case expects silence."""

from __future__ import annotations

import pytest

from .rig import foreign


@pytest.mark.parametrize("delay", [0.3, 1.0])
def test_a_delayed_crash_is_not_attributed_to_the_next_case(delay: float):
    with foreign(faults=["crashes-on-empty-vardis"], death_delay=delay, adapter_after=0.5) as target:
        run = target.run("TC_BP_RX_BV_04-vardis", "TC_BP_RX_BI_12-1", "TC_VD_UPD_BV_01")
        assert run.failed_requirements() <= {"BP-RX-16", "VD-ROB-01"}, run.text
        assert run.verdict("TC_BP_RX_BV_04-vardis") == "fail", run.text
        assert run.verdict("TC_BP_RX_BI_12-1") == "pass", run.text
        assert run.verdict("TC_VD_UPD_BV_01") == "pass", run.text


def test_a_deadly_case_that_expects_silence():
    with foreign(faults=["crashes-on-clear-buffer"], adapter_after=0.0) as target:
        run = target.run("TC_BP_QM_BV_11", "TC_BP_RX_BI_01-00")
        assert run.verdict("TC_BP_QM_BV_11") == "fail", run.text
        assert run.verdict("TC_BP_RX_BI_01-00") == "pass", run.text
        # The crash was caused by the service, not by other stimuli of the case.
        assert run.failed_requirements() == {"BP-CLR-03"}
