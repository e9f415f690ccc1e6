"""The basic interconnection test against real processes: what is set up wrongly is named, and what is broken."""

from __future__ import annotations

import pytest

from .rig import foreign

SANITY = "TC_DCP_SANITY_BV_01"
ONE = "TC_VD_UPD_BV_01"
#: It checks the answer of a service, which needs no beacon.
SERVICE = "TC_VD_REA_BI_01"


def test_another_ether_type_is_named():
    with foreign(link="ethernet", ether_type=0x88B5, adapter=False) as target, target.started():
        run = target.run(SANITY, start=False)
        assert run.status == 3, run.text
        assert "the tester listens to 0x4953: give --ether-type 0x88b5" in run.text
        again = target.run(SANITY, "--ether-type", "0x88b5", start=False)
        assert again.status == 0, again.text


@pytest.mark.parametrize("own_variable", [None, 7])
def test_another_network_identifier_is_named(own_variable: int | None):
    # An upper tester would tell the number.
    with foreign(network_id=3, own_variable=own_variable, adapter=False) as target, target.started():
        run = target.run("TC_BP_RX_BI_01-00", start=False)
        assert run.status == 3, run.text
        assert "its beacons carry networkId 3, the tester uses 4369: give [pixit] network_id = 3" in run.text
        assert {case["verdict"] for case in run.cases} == {"inconclusive"}


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


def test_an_implementation_that_opened_the_link_and_never_answers_is_not_waited_for_long():
    """It has opened the link: what has not come some seconds later will not come."""
    with foreign(faults=["never-answers"], adapter=False) as target:
        run = target.run(ONE)
        assert run.status == 3, run.text
        assert "waiting for the implementation to start: it has opened the link, nothing heard on udp" in run.err
        assert "nothing was heard: is it running, on this link" in run.text


def test_a_slow_start_is_waited_for_and_named():
    with foreign(start_delay=6.0, adapter=False) as target:
        run = target.run(SANITY, "--start-timeout", "60")
        assert run.status == 0, run.text
        assert "waiting for the implementation to start: its process runs, nothing heard on udp" in run.err
