"""Who is blamed for a frame: the station that sent it, and not the name that it carries; and reports of that node."""

from __future__ import annotations

import math

import msgspec
import pytest
from dcp_conformance.model.verdict import Verdict

from dcp_codec.values import VarSumm, VarUpdate

from ..air import MS, SECOND, Script, case_of, findings, judged

A, B, C = 1, 2, 3


def observed(run, identifier: str) -> list[str]:
    """What a rule observes without judging it."""
    return [each.observed for each in case_of(run, identifier).checks if each.verdict is Verdict.INFO]


def failed(run, identifier: str) -> dict[str, tuple[str, ...]]:
    """What a rule finds, with the requirements."""
    return {
        each.observed: each.requirements for each in case_of(run, identifier).checks if each.verdict is Verdict.FAIL
    }


class TestSenderIdentifier:
    def test_a_wrong_identifier_in_one_beacon_is_the_stations_fault(self):
        air = Script()
        air.idle(5)
        number = air.say(9, VarSumm(201, 0), source=A, seqno=air.seqno[A])
        air.seqno[A] += 1
        air.idle(5)
        run = judged(air.frames, "dcp-2.0")
        (text,) = failed(run, "CK_BP_SENDER")
        assert text.startswith("02:00:00:00:00:01 sends a beacon as 02:00:00:00:00:09")
        assert failed(run, "CK_BP_SENDER")[text] == ("BP-HDR-03",)
        assert {case.id for case in run.cases if case.verdict is Verdict.FAIL} == {"CK_BP_SENDER"}
        marks = {mark.frame for check in case_of(run, "CK_BP_SENDER").checks for mark in check.frames}
        assert marks == {1, number}

    def test_a_forged_beacon_is_the_forgers_fault_and_nobody_elses(self):
        air = Script()
        air.idle(5)
        for _ in range(8):
            # A forger that has no numbers of its own, goes back in those of A, and denies what A says.
            air.seqno[A], numbers = 4000, air.seqno[A]
            air.say(A, VarSumm(201, 200), source=C, report=air.report(A, seqno=77))
            air.seqno[A] = numbers
            air.idle(1)
        run = judged(air.frames, "dcp-2.0")
        (text,) = failed(run, "CK_BP_SENDER")
        assert text.startswith("02:00:00:00:00:03 sends beacons as 02:00:00:00:00:01")
        assert not [each for each in findings(run) if f"{air.node(A).hex(':')}:" in each and " as 02" not in each]
        assert not observed(run, "CK_BP_SEQNO")
        assert not observed(run, "CK_SRP_SEQNO")

    def test_a_gateway_that_carries_the_beacons_of_others_is_reported(self):
        air = Script()
        air.idle(5)
        for _ in range(5):
            air.say(A, VarSumm(201, 0), source=C)
            air.say(C, VarSumm(203, 0))
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert observed(run, "CK_BP_SENDER")

    def test_numbers_of_a_life_before_are_not_out_of_order(self):
        air = Script()
        for each in [*range(20), *range(24, 30), 0, 1, 2, *range(3, 30)]:
            air.say(A, VarSumm(1, 0), seqno=each)
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert not [each for each in observed(run, "CK_BP_SEQNO") if " after " in each and "0 after" not in each]
        assert "02:00:00:00:00:01: 4" in observed(run, "CK_BP_SEQNO")


class TestReports:
    def test_a_report_under_another_name_shows_nothing_of_the_node_that_has_it(self):
        air = Script()
        for number in range(100, 110):
            air.say(A, report=air.report(A, seqno=number))
            air.say(C, report=air.report(C, about=A, seqno=2 * number))
        run = judged(air.frames, "dcp-2.0")
        assert {case.id for case in run.cases if case.verdict is Verdict.FAIL} == {"CK_SRP_OWN"}
        assert observed(run, "CK_SRP_SEQNO") == []

    def test_one_odd_number_is_no_restart(self):
        air = Script()
        for number in (64, 65, 0, 67, 68):
            air.say(A, report=air.report(A, seqno=number))
        run = judged(air.frames, "dcp-2.0")
        assert failed(run, "CK_SRP_SEQNO") == {"02:00:00:00:00:01: 0 between 65 and 67": ("SRP-SEQ-01",)}
        assert observed(run, "CK_SRP_SEQNO") == []

    @pytest.mark.parametrize("rest", [(), (1, 2, 3)])
    def test_numbers_that_start_again_are_reported(self, rest: tuple[int, ...]):
        air = Script()
        for number in (64, 65, 0, *rest):
            air.say(A, report=air.report(A, seqno=number))
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert observed(run, "CK_SRP_SEQNO") == ["02:00:00:00:00:01"]

    def test_numbers_that_leap_are_reported(self):
        air = Script()
        for number in (64, 65, 70_000, 70_001, 70_002):
            air.say(A, report=air.report(A, seqno=number))
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert observed(run, "CK_SRP_SEQNO") == ["02:00:00:00:00:01: 70000 after 65"]

    @pytest.mark.parametrize("value", [math.nan, math.inf])
    def test_what_is_no_number_is_reported(self, value: float):
        air = Script()
        air.say(A, report=air.report(A))
        report = air.report(A)
        data = msgspec.structs.replace(report.s_data, x=value)
        number = air.say(A, report=msgspec.structs.replace(report, s_data=data))
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert observed(run, "CK_SRP_VALUES") == [f"02:00:00:00:00:01: x is {value}"]
        assert [mark.frame for check in case_of(run, "CK_SRP_VALUES").checks for mark in check.frames] == [number]

    def test_a_time_stamp_that_leaps_is_reported_with_both_frames(self):
        air = Script()
        for late in (0, 0, 30 * 86_400 * SECOND, 0):
            air.say(A, report=air.report(A, late=late))
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert len(observed(run, "CK_SRP_VALUES")) == 1
        frames = [mark.frame for check in case_of(run, "CK_SRP_VALUES").checks for mark in check.frames]
        assert frames == [2, 3, 3, 4]


class TestCreations:
    @pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.3"])
    def test_another_producer_in_a_forwarded_creation(self, profile: str):
        air = Script(profile)
        create = air.create(1, A)
        first = air.say(A, create, VarSumm(1, 0))
        other = msgspec.structs.replace(create, spec=msgspec.structs.replace(create.spec, prod_id=air.node(9)))
        second = air.say(B, other, VarSumm(1, 0))
        air.idle(40)
        run = judged(air.frames, profile)
        found = failed(run, "CK_VD_SPEC")
        assert [each.partition(" passes on")[0] for each in found] == ["variable 1: 02:00:00:00:00:02"]
        marks = {mark.frame for check in case_of(run, "CK_VD_SPEC").checks for mark in check.frames}
        assert marks == {first, second}

    @pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.3"])
    def test_two_producers_of_one_identifier_are_no_fault_of_who_passes_on(self, profile: str):
        air = Script(profile)
        air.say(A, air.create(1, A, age=5), VarSumm(1, 0))
        air.say(B, air.create(1, B), VarSumm(1, 0))
        air.idle(3)
        air.say(C, air.create(1, B), VarSumm(1, 0), VarUpdate(9, 1, b"x"))
        air.idle(40)
        assert not failed(judged(air.frames, profile), "CK_VD_SPEC")

    def test_creations_that_were_forgotten_accuse_nobody(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr("dcp_conformance.check.rules.variables.MOST_VARIABLES", 40)
        air = Script()
        early = [air.create(var_id, A, age=-var_id) for var_id in range(60)]
        air.say(A, air.create(1, A, age=10), VarSumm(1, 0))
        for create in early:
            air.say(A, create)
        for create in early:
            air.say(B, create)
        air.time += 5000 * MS
        air.idle(40)
        assert not failed(judged(air.frames, "dcp-2.0"), "CK_VD_SPEC")
