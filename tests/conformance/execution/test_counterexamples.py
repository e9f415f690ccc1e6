"""Sequences of the model as cases: how often they are executed, and what they leave to later cases."""

from __future__ import annotations

from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.stateful import judged
from dcp_conformance.test_system.bench import Session
from dcp_selftest.mutants import all_mutants
from dcp_selftest.variants import all_variants
from dcp_selftest.variants.campaign import judge

from ..rig import codec_of, known_cases

#: Two sequences that show the same wrong status of a mutant.
MUTANT = "M-BP-TXP-02-no-limit"
ONE, TWO = (f"TC_DCP_MODEL_BV_01-registrations-{number}" for number in (11, 15))

AFFECTED = "TC_VD_STATE_BV_03-deleted-consumer.app-create"


def test_only_the_first_of_equal_counterexamples_is_made_shorter_and_none_that_does_not_count(monkeypatch) -> None:
    executed: list[int] = []

    def execute(bench, steps, *, alone):
        executed.append(len(steps))
        return plain(bench, steps, alone=alone)

    plain = judged.execute
    monkeypatch.setattr(judged, "execute", execute)
    sut = InProcess(reference_config(codec_of("dcp-2.0")), make=all_mutants()[MUTANT].make)
    runner = Runner(Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()

    assert runner.attempt(known_cases()[ONE]) is None
    assert len(executed) == 1
    executed.clear()
    first = runner.run(known_cases()[ONE])
    assert 3 < len(executed) <= 3 + judged.ATTEMPTS
    assert min(executed) < executed[0]
    executed.clear()
    second = runner.run(known_cases()[TWO])
    assert len(executed) == 3
    assert first.verdict is second.verdict is Verdict.FAIL


def test_later_cases_have_creation_times_of_now_after_a_sequence_with_later_ones() -> None:
    # A variant with the second alternative of all readings compares the times of its own variables with them.
    cases = [known_cases()[name] for name in ("TC_DCP_MODEL_BV_01-limits-05", AFFECTED)]
    assert judge(all_variants()["V-X-every-other"], "dcp-2.0", cases).fails == ()
