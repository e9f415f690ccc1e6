"""Grave faults cost little more time than none, in virtual time."""

from __future__ import annotations

from functools import cache

import pytest
from dcp_conformance.model.case import SANITY, all_cases
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.stateful import judged
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite, cases

from ..conformance.rig import codec_of

PROFILE = "dcp-2.0"
#: Maximum number of concurrent cases of a run.
WIDTH = 16
HEADER, MUTE = "M-BP-HDR-06-with-header", "M-SRP-SRV-03-mute"


def seconds(make: MakeNode) -> float:
    """Return the virtual seconds of a whole run."""
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.model.pics import Pics
    from dcp_conformance.test_system.bench import Session

    sut = InProcess(reference_config(codec_of(PROFILE)), make=make)
    runner = Runner(Session(codec_of(PROFILE), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    Suite(PROFILE, runner=runner).run_side_by_side(cases(), WIDTH)
    return sut.now / 1e9


@cache
def clean() -> float:
    return seconds(plain_node)


@pytest.mark.part("suite")
@pytest.mark.parametrize("name", [HEADER, MUTE])
def test_a_run_takes_at_most_twice_that_of_a_node_without_faults(name: str) -> None:
    assert seconds(all_mutants()[name].make) <= 2 * clean()


def test_a_sequence_that_beacons_leave_undecided_is_executed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    executed = []
    execute = judged.execute
    monkeypatch.setattr(judged, "execute", lambda *some, **more: executed.append(some) or execute(*some, **more))
    chosen = [all_cases()[name] for name in (SANITY, "TC_DCP_MODEL_BV_01-limits-03")]
    *_, result = Suite(PROFILE, all_mutants()[HEADER].make).run(chosen)
    assert (result.verdict, len(executed)) == ("inconclusive", 1)
