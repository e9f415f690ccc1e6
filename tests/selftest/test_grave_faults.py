"""Grave faults cost little more time than none, in virtual time, and no verdict about anything else."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import pytest
from dcp_conformance.definitions.case import SANITY, all_cases
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.errors import CouldNotAskError
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node, reference_config
from dcp_conformance.stateful import judged
from dcp_conformance.upper_tester import Answer
from dcp_conformance.upper_tester.faults import Faults
from dcp_conformance.upper_tester.patience import Patience
from dcp_selftest.mutants import all_mutants
from dcp_selftest.mutants.combination import combined
from dcp_selftest.runner import Suite, cases

from ..conformance.rig import codec_of

PROFILE = "dcp-2.0"
#: Maximum number of concurrent cases of a run.
WIDTH = 16
HEADER, MUTE = "M-BP-HDR-06-with-header", "M-SRP-SRV-03-mute"
#: Together they end the node in 36 cases: by calls, valid frames and damaged frames.
LETHAL = ("M-BP-QM-01-dies-of-full", "M-BP-RX-15-dies", "M-BP-RX-16-dies-of-nothing", "M-BP-TX-04-dies-of-overflow")
#: A beacon may be due between its submissions beside other cases: then its queue is not full, and the node lives.
UNSTEADY = "TC_DCP_MODEL_BV_01-sizes-03"


class Unanswering(VirtualUpperTester):
    """An adapter that never answers one method; virtual time passes in the calls."""

    def __init__(self, sut: InProcess, method: str, *, executes: bool) -> None:
        """``executes``: whether the node executes the method all the same."""
        self.faults = Faults()
        self._patience = Patience(5)
        self._never, self._executes = method, executes
        super().__init__(sut)

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        patience = self._patience
        if why := patience.refused(method):
            raise CouldNotAskError(why)
        begun = time.monotonic()
        if method != self._never:
            patience.answered(method, begun)
            return super().call(method, params)
        if self._executes:
            super().call(method, params)
        waited = patience.of(method)
        self._sut.elapse(round(waited * 1e9))
        raise patience.unanswered(method, method, waited)


class Outcome(NamedTuple):
    """A whole run."""

    seconds: float
    """Virtual time."""
    results: Mapping[str, CaseResult]


def outcome(make: MakeNode, never: str = "", *, executes: bool = False, width: int = WIDTH) -> Outcome:
    """Execute a whole run; ``never``: a method that is never answered. ``width`` 1: in succession."""
    from dcp_conformance.definitions.pics import Pics
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.test_system.bench import Session

    sut = InProcess(reference_config(codec_of(PROFILE)), make=make)
    upper = Unanswering(sut, never, executes=executes) if never else sut.upper_tester()
    runner = Runner(Session(codec_of(PROFILE), sut.lower_tester(), upper, Pics()), sut)
    suite = Suite(PROFILE, runner=runner)
    results = suite.run(cases()) if width == 1 else suite.run_side_by_side(cases(), width)
    verdicts = {each.id: each for each in results}
    return Outcome(sut.now / 1e9, verdicts)


@cache
def clean() -> Outcome:
    return outcome(plain_node)


@pytest.mark.part("suite")
@pytest.mark.parametrize("name", [HEADER, MUTE])
def test_a_run_takes_at_most_twice_that_of_a_node_without_faults(name: str) -> None:
    assert outcome(all_mutants()[name].make).seconds <= 2 * clean().seconds


@pytest.mark.part("suite")
def test_deaths_cost_little_time_and_change_no_verdict() -> None:
    make = combined([all_mutants()[each] for each in LETHAL])
    found, alone = outcome(make), outcome(make, width=1)
    assert found.seconds <= 1.4 * clean().seconds
    beside, verdicts = (
        {name: (str(each.verdict), each.killed) for name, each in one.results.items()} for one in (found, alone)
    )
    assert sum(killed for _, killed in verdicts.values()) == 36
    del beside[UNSTEADY], verdicts[UNSTEADY]
    assert beside == verdicts


def calls(result: CaseResult) -> set[str]:
    return {each.text.split()[0] for each in result.evidence if each.direction == "call"}


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("method", "executes", "follow"),
    [
        ("RTDB-Read", False, ()),
        ("RTDB-Update", True, ()),
        ("BP-RegisterProtocol", True, ()),
        ("BP-DeregisterProtocol", False, ()),
        # The tester does not deactivate what it could not activate again.
        ("BP-MGMT-Activate", False, ("BP-MGMT-Deactivate",)),
    ],
)
def test_a_service_that_is_never_answered_costs_only_its_own_verdicts(
    method: str, executes: bool, follow: tuple[str, ...]
) -> None:
    found = outcome(plain_node, method, executes=executes)
    assert found.seconds <= 2 * clean().seconds
    other = {name: each for name, each in clean().results.items() if calls(each).isdisjoint({method, *follow})}
    changed = {name for name, each in other.items() if found.results[name].verdict is not each.verdict}
    assert changed == set()
    assert found.results.keys() == clean().results.keys()


@pytest.mark.part("suite")
def test_without_answers_to_ut_reset_a_run_does_without_it() -> None:
    found = outcome(plain_node, "UT-Reset")
    verdicts = {str(each.verdict) for each in found.results.values()}
    assert verdicts == {"pass", "info", "not-applicable"}


def test_a_sequence_that_beacons_leave_undecided_is_executed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    executed = []
    execute = judged.execute
    monkeypatch.setattr(judged, "execute", lambda *some, **more: executed.append(some) or execute(*some, **more))
    chosen = [all_cases()[name] for name in (SANITY, "TC_DCP_MODEL_BV_01-limits-03")]
    *_, result = Suite(PROFILE, all_mutants()[HEADER].make).run(chosen)
    assert (result.verdict, len(executed)) == ("inconclusive", 1)
