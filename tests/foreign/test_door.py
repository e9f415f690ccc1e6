"""The basic interconnection test against real processes: what is set up wrongly is named, and what is broken."""

from __future__ import annotations

import pytest

from .rig import foreign

SANITY = "TC_DCP_SANITY_BV_01"
ONE = "TC_VD_UPD_BV_01"
#: It checks the answer of a service, which needs no beacon.
SERVICE = "TC_VD_REA_BI_01"


@pytest.mark.parametrize(
    ("fault", "requirement"),
    [("magic-swapped", "BP-HDR-02"), ("length-with-header", "BP-HDR-06"), ("one-payload-more", "BP-HDR-07"),
     ("block-length-with-header", "BP-FMT-01")],
)  # fmt: skip
def test_typical_first_mistakes_are_named(fault: str, requirement: str):
    with foreign(faults=[fault]) as target:
        run = target.run(SANITY)
        assert run.status == 1
        assert run.failed_requirements() == {requirement}, run.text


def test_the_run_continues_with_a_wrong_header():
    with foreign(faults=["magic-swapped"]) as target:
        run = target.run(SERVICE)
        assert run.failed_requirements(SANITY) == {"BP-HDR-02"}, run.text
        assert run.verdict(SERVICE) == "pass"
        assert target.starts() == 1


def test_one_kind_of_stimulus_without_answer():
    with foreign(faults=["no-requests-for-summaries"]) as target:
        run = target.run("TC_BP_RX_BI_01-00", ONE)
        # On a busy machine the verdict is inconclusive, and the observation is the same.
        late = "but not a summary of an unknown variable; but the tester has lost something: it acted late by"
        assert run.failed_requirements() == {"VD-PS-01"} or late in " ".join(run.text.split()), run.text
        assert run.verdict(ONE) == "pass"


def test_the_run_continues_with_a_garbage_srp_block():
    with foreign(faults=["garbage-srp"]) as target:
        run = target.run(SANITY, ONE)
        assert not run.failed_requirements(SANITY), run.text
