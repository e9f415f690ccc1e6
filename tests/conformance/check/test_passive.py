"""Passive testing: what a run finds in the beacons that it hears anyway, and whom it leaves alone."""

from __future__ import annotations

import inspect
import random
import re
from collections.abc import Callable, Iterable
from pathlib import Path

import msgspec
import pytest
from dcp_conformance import check, passive
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.run import ConformanceRun, WorkerEnd
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import Selection
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.passive import PassiveTester, joined
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.reporting import load_results, write_report
from dcp_conformance.reporting.merge import compare
from dcp_conformance.test_steps.bp_clients import ONCE, BPClient
from dcp_conformance.test_system.bench import Bench, Session
from dcp_selftest.mutants import all_mutants

from dcp_codec.values import VarSumm

from ...parts import also
from ..air import MS, SECOND, Script
from ..rig import PROFILES, codec_of, known_cases

SUT = 1
Feed = Callable[[Script, PassiveTester], None]


class Ear:
    """A passive tester with a script of beacons, which all come from the implementation."""

    def __init__(self, profile: str = "dcp-2.0", pics: Pics | None = None, *, overload: str = "") -> None:
        self.air = Script(profile)
        self.parameters: dict[str, int] = {}
        """Parameters that the implementation has reported."""
        self.air.step = 100 * MS
        self.tester = PassiveTester(self.air.codec, pics or Pics(), self.parameters, lambda: overload)
        self.tester.begin(-1, self)
        self._heard = 0

    def listen(self, case: str = "TC_BP_HDR_BV_01") -> None:
        """Receive the frames that were sent since the last call."""
        for frame in self.air.frames[self._heard :]:
            heard = ReceivedBeacon(
                self.air.codec, frame.number, frame.time_ns, frame.time_ns, frame.data[14:], frame.data[6:12]
            )
            self.tester.heard(heard, frame.data, 14, case, self)
        self._heard = len(self.air.frames)

    def failed(self) -> dict[str, CaseResult]:
        """Violated invariants, by rule."""
        self.listen()
        results = self.tester.results("dcp-conformance run --in-process")
        return {each.id: each for each in results if each.verdict not in (Verdict.PASS, Verdict.NOT_APPLICABLE)}


def named(result: CaseResult) -> set[str]:
    """The requirements that failed checks name."""
    return {each for found in result.checks for each in found.requirements}


def after(cases: Iterable[Case], profile: str = "dcp-2.0", mutant: str = "") -> dict[str, CaseResult]:
    """Results of the invariants after running these cases against our node, or a mutant."""
    codec = codec_of(profile)
    options = {"make": all_mutants()[mutant].make} if mutant else {}
    sut = InProcess(reference_config(codec), **options)
    runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    for case in cases:
        runner.run(case)
    results = runner.session.passive.results("dcp-conformance run")
    assert runner.session.passive.frames
    return {each.id: each for each in results if each.verdict not in (Verdict.PASS, Verdict.NOT_APPLICABLE)}


def some(*identifiers: str) -> list[Case]:
    return [known_cases()[each] for each in identifiers]


# -- whom it leaves alone -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["dcp-2.0", *also("suite", *(each for each in PROFILES if each != "dcp-2.0"))])
def test_our_node_has_no_finding(profile: str):
    cases = list(known_cases().values())
    assert not after(cases[::2] if profile == "dcp-2.0" else cases[::7], profile)


def test_payloads_submitted_by_the_tester_are_not_judged():
    def run(bench: Bench) -> None:
        bench.call("BP-DeregisterProtocol", protId=2)
        with BPClient(bench, ONCE, prot_id=2) as client:
            client.transmit(b"\xff\xff\xff")
            heard = bench.beacons(2)
        assert any(each.problem is not None for each in heard)

    assert not after([a_case(run)])


def test_changes_by_the_tester_are_not_changes_by_the_implementation():
    def run(bench: Bench) -> None:
        for number in range(6):
            bench.must("BP-SetParameter", name="BPPAR_NETWORK_ID", value=0x2000 + number)
            bench.probes.probe()

    assert not after([a_case(run)])


def a_case(run: Callable[[Bench], None]) -> Case:
    return Case(
        id="TC_DCP_TRY_BV_01", purpose="", requirements=("BP-HDR-08",), kind=Kind.VALID, stimulus="", expect="",
        window=1, section="x", module=__name__, run=run,
    )  # fmt: skip


def test_a_reset_after_255_beacons_is_not_a_narrow_counter():
    def run(bench: Bench) -> None:
        for _ in range(3):
            while not (bench.heard and bench.heard[-1].seqno == 255):
                bench.probes.probe()
            bench.call("UT-Reset")
            bench.probes.probe()
            assert bench.heard[-1].seqno is not None
            assert bench.heard[-1].seqno < 20

    assert not after([a_case(run)])


def test_a_restart_after_255_beacons_is_not_a_narrow_counter():
    def run(bench: Bench) -> None:
        while not (bench.heard and bench.heard[-1].seqno == 255):
            bench.probes.probe()
        bench.control.restart()
        bench.probes.probe()

    assert not after([a_case(run)])


def test_frames_from_before_a_reset_are_not_judged():
    ear = Ear()
    for number in range(250, 256):
        ear.air.say(SUT, VarSumm(1, 0), seqno=number)
    ear.listen()
    # These frames wait in the queue while the implementation is reset.
    ear.air.say(SUT, VarSumm(1, 0), seqno=256)
    ear.tester.interrupted(ear.air.frames[-1].time_ns)
    ear.air.say(SUT, VarSumm(1, 0), seqno=0)
    assert not ear.failed()


def test_stations_other_than_the_implementation_are_not_judged():
    def run(bench: Bench) -> None:
        bench.probes.probe()
        tester, count = bench.session.passive, bench.session.passive.frames
        beacon = bench.builder.beacon(bench.peer().node_id, 7, [])
        bench.session.lower._sut.arrivals.append(  # type: ignore[attr-defined]
            _arrival(bench, beacon[:1] + b"\0" + beacon[2:])
        )
        bench.wait(0.1)
        assert bench.receiver.others
        assert tester.frames == count

    assert not after([a_case(run)])


def _arrival(bench: Bench, octets: bytes) -> object:
    from dcp_conformance.lower_tester import Arrival

    frame = b"\xff" * 6 + b"\x02" * 6 + b"\x49\x53" + octets
    return Arrival(bench.now(), bench.lower.wall(), octets, frame, b"\x02" * 6)


def test_evidence_of_repeated_findings_is_bounded():
    ear = Ear()
    for number in range(3000):
        ear.air.say(SUT, VarSumm(1, number % 256), patch=lambda octets: octets[:1] + b"\0\0" + octets[3:])
    found = ear.failed()
    assert named(found["CK_BP_FORMAT"]) == {"BP-HDR-02"}
    assert len(found["CK_BP_FORMAT"].evidence) == 3
    assert "3000 times in all" in found["CK_BP_FORMAT"].reason


# -- what it finds --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mutant", "cases", "rule", "requirement"),
    [
        ("M-BP-HDR-02-swapped", ("TC_DCP_SANITY_BV_01",), "CK_BP_FORMAT", "BP-HDR-02"),
        ("M-BP-HDR-01-two", ("TC_DCP_SANITY_BV_01",), "CK_BP_FORMAT", "BP-HDR-01"),
        ("M-BP-HDR-07-one-more", ("TC_DCP_SANITY_BV_01",), "CK_BP_FORMAT", "BP-HDR-07"),
        ("M-BP-HDR-08-one-octet", ("TC_BP_HDR_BV_10",), "CK_BP_SEQNO", "BP-HDR-08"),
        ("M-BP-HDR-08-constant", ("TC_BP_TX_TI_01",), "CK_BP_SEQNO", "BP-HDR-08"),
        ("M-BP-HDR-08-by-two", ("TC_BP_TX_TI_01",), "CK_BP_SEQNO", "BP-HDR-08"),
        ("M-DATA-01-srp-swapped-time", ("TC_SRP_REC_BV_01",), "CK_DATA_ORDER", "DATA-01"),
        ("M-SRP-TYP-06-constant", ("TC_SRP_REC_BV_05",), "CK_SRP_SEQNO", "SRP-TYP-06"),
    ],
)
def test_a_fault_is_named_by_its_requirement(mutant: str, cases: tuple[str, ...], rule: str, requirement: str):
    found = after(some(*cases), mutant=mutant)
    assert set(found) == {rule}
    assert requirement in named(found[rule])
    assert set(named(found[rule])) <= set(all_mutants()[mutant].requirements) | {"SRP-SEQ-01"}
    assert found[rule].verdict is Verdict.FAIL
    assert found[rule].counted


def test_a_block_length_that_counts_its_header():
    ear = Ear()

    def patch(octets: bytes) -> bytes:
        at = len(octets) - 4
        return octets[: at - 2] + (int.from_bytes(octets[at - 2 : at], "big") + 4).to_bytes(2, "big") + octets[at:]

    for number in range(5):
        ear.air.say(SUT, VarSumm(1, number), patch=patch)
    assert named(ear.failed()["CK_BP_FORMAT"]) == {"BP-FMT-01"}


@pytest.mark.parametrize(
    ("about", "source", "requirements"),
    [(2, None, {"SRP-TYP-04", "SRP-RX-06"}), (2, 2, {"BP-HDR-03"}), (2, 3, {"SRP-TYP-04", "SRP-RX-06"})],
)
def test_a_report_under_another_name_than_the_header(about: int, source: int | None, requirements: set[str]):
    ear = Ear()
    ear.air.say(SUT, report=ear.air.report(SUT, about=about), source=source)
    assert named(ear.failed()["CK_SRP_OWN"]) == requirements


@pytest.mark.parametrize("bits", [8, 16])
def test_a_narrow_counter_of_reports(bits: int):
    ear = Ear()
    last = (1 << bits) - 1
    for step in range(-3, 3):
        ear.air.say(SUT, report=ear.air.report(SUT, seqno=(last + 1 + step) % (last + 1)))
    assert named(ear.failed()["CK_SRP_SEQNO"]) == {"SRP-SEQ-01", "SRP-TYP-01"}


def test_a_clock_of_reports_that_stands_still():
    ear = Ear()
    for number in range(60):
        ear.air.say(SUT, report=ear.air.report(SUT, seqno=number, t_stamp=5 * SECOND))
    assert named(ear.failed()["CK_SRP_SEQNO"]) == {"SRP-TYP-05"}


def test_a_period_that_is_not_the_stated_one():
    ear = Ear(pics=Pics(pixit=Testing(beacon_period_ms=150.0)))
    for number in range(200):
        ear.air.say(SUT, VarSumm(1, number % 256))
    found = ear.failed()["CK_BP_PERIOD"]
    assert named(found) == {"BP-TX-01"}
    assert "the period is 150 ms" in found.reason


@pytest.mark.parametrize(("stated", "verdict"), [(90.0, Verdict.INCONCLUSIVE), (150.0, Verdict.FAIL)])
def test_overload_excuses_long_periods_but_not_short_ones(stated: float, verdict: Verdict):
    ear = Ear(pics=Pics(pixit=Testing(beacon_period_ms=stated)), overload="the machine was overloaded")
    for number in range(200):
        ear.air.say(SUT, VarSumm(1, number % 256))
    found = ear.failed()["CK_BP_PERIOD"]
    assert found.verdict is verdict
    assert ("but the machine was overloaded" in found.reason) is (verdict is Verdict.INCONCLUSIVE)


def test_a_finding_about_all_beacons_is_repeated_by_the_cases_in_which_most_of_them_were_heard():
    ear = Ear(pics=Pics(pixit=Testing(beacon_period_ms=150.0)))
    for case, beacons in {"TC_A": 20, "TC_B": 200, "TC_C": 60, "TC_D": 50, "TC_E": 5}.items():
        for number in range(beacons):
            ear.air.say(SUT, VarSumm(1, number % 256))
        ear.listen(case)
    found = ear.failed()["CK_BP_PERIOD"]
    assert not any(each.frames for each in found.checks)
    assert found.rerun == "dcp-conformance run --in-process TC_B TC_C TC_D"


def test_frames_of_two_executions_of_a_case_are_distinguished():
    ear = Ear()
    for _ in range(2):
        ear.tester.begin(ear.air.time, ear, "TC_F")
        ear.air.say(SUT, report=ear.air.report(SUT, about=2))
        ear.listen("TC_F")
    found = ear.failed()["CK_SRP_OWN"]
    assert found.reason.endswith("; 2 times in all; frame 1 of execution 1 of TC_F")


def test_a_case_that_needs_an_option_is_repeated_with_it():
    ear = Ear()
    ear.air.say(SUT, report=ear.air.report(SUT, about=2))
    ear.listen("TC_F")
    results = ear.tester.results("dcp-conformance run", {"TC_F": ("--artefacts", "my finds")})
    found = next(each for each in results if each.id == "CK_SRP_OWN")
    assert found.rerun == "dcp-conformance run --artefacts 'my finds' TC_F"


def test_reported_parameters_take_precedence_over_assumed_ones():
    for told, wrong in ((100, False), (120, True)):
        ear = Ear(pics=Pics(pixit=Testing(beacon_period_ms=150.0)))
        ear.parameters["BPPAR_BEACON_PERIOD"] = told
        for number in range(200):
            ear.air.say(SUT, VarSumm(1, number))
        assert ("CK_BP_PERIOD" in ear.failed()) is wrong


@pytest.mark.parametrize(("told", "wrong"), [(8, False), (7, True)])
def test_more_summaries_than_the_reported_maximum(told: int, wrong: bool):
    ear = Ear()
    ear.parameters["VARDISPAR_MAX_SUMMARIES"] = told
    ear.air.say(SUT, *(VarSumm(number, 0) for number in range(8)))
    found = ear.failed()
    assert ("CK_VD_SUMMARIES" in found) is wrong
    assert not wrong or named(found["CK_VD_SUMMARIES"]) == {"VD-CMP-02"}


@pytest.mark.parametrize(("told", "wrong"), [(44, False), (43, False), (26, False), (25, True)])
def test_beacons_longer_than_the_reported_maximum(told: int, wrong: bool):
    ear = Ear()
    ear.parameters["BPPAR_MAXIMUM_PACKET_SIZE"] = told
    ear.air.say(SUT, *(VarSumm(number, 0) for number in range(10)))
    # Whether the 18 octets of the header count is open (X04).
    assert len(ear.air.frames[0].data) - 14 == 44
    assert ("CK_BP_SIZE" in ear.failed()) is wrong


def test_repeating_jitter_is_reported_but_is_not_a_failure():
    ear = Ear()
    for _ in range(2):
        ear.tester.interrupted(ear.air.frames[-1].time_ns if ear.air.frames else -1)
        for number in range(8):
            ear.air.time += (number * 37 % 20) * MS
            ear.air.say(SUT, VarSumm(1, number), seqno=number)
        ear.listen()
    found = ear.failed()
    assert found["CK_BP_JITTER"].verdict is Verdict.INFO
    assert not found["CK_BP_JITTER"].counted
    assert set(found) == {"CK_BP_JITTER"}


def test_intervals_of_a_coarse_clock_that_repeat_by_chance_are_not_repeating_jitter():
    ear = Ear()
    for _ in range(2):
        ear.tester.interrupted(ear.air.frames[-1].time_ns if ear.air.frames else -1)
        for number in range(8):
            ear.air.time += (number % 2) * 10 * MS
            ear.air.say(SUT, VarSumm(1, number), seqno=number)
        ear.listen()
    assert "CK_BP_JITTER" not in ear.failed()


def test_a_finding_names_the_case_in_which_its_frame_was_received():
    found = after(some("TC_VD_CRE_BV_01", "TC_VD_CRE_BV_02"), mutant="M-BP-HDR-07-one-more")["CK_BP_FORMAT"]
    assert ": bp.numPayloads" in found.reason
    assert "frame 1 of TC_VD_CRE_BV_01" in found.reason
    assert found.rerun == "dcp-conformance run TC_VD_CRE_BV_01"
    # The measurement of reaction times, before the first case, is in no recording: its frames are not judged.
    assert {each.text.partition(" of ")[2] for each in found.evidence} <= {"TC_VD_CRE_BV_01", "TC_VD_CRE_BV_02"}
    first = found.checks[0].frames[0]
    event = found.evidence[first.frame - 1]
    assert event.frame == first.frame
    assert bytes.fromhex(event.octets)[first.offset : first.offset + 1] == b"\2"


# -- in a run ---------------------------------------------------------------------------------------------------------


def a_run(*cases: str, **more: object) -> ConformanceRun:
    return ConformanceRun(TargetOptions(in_process=True), Selection(patterns=cases), **more)  # type: ignore[arg-type]


def a_finding(**more: object) -> CaseResult:
    found = after(some("TC_DCP_SANITY_BV_01"), mutant="M-BP-HDR-02-swapped")["CK_BP_FORMAT"]
    return msgspec.structs.replace(found, **more)


class TestRun:
    def test_each_invariant_has_a_result_without_being_a_case(self):
        run = a_run("TC_VD_CRE_BV_01")
        run.execute()
        result = run.result()
        assert [each.id for each in result.invariants] == [rule.id for rule in passive.RULES]
        assert {each.section for each in result.invariants} == {passive.SECTION}
        assert {each.section for each in result.cases} & {passive.SECTION} == set()
        assert run.exit_status() == 0

    def test_findings_are_among_the_cases(self):
        run = a_run("TC_VD_CRE_BV_01")
        run.execute()
        before = run.result()
        run.take_passive([a_finding()])
        result = run.result()
        assert len(result.invariants) == len(passive.RULES) - 1
        assert [each.id for each in result.cases if each.section == passive.SECTION] == ["CK_BP_FORMAT"]
        assert sum(each.counted for each in result.cases) == sum(each.counted for each in before.cases) + 1
        (change,) = compare(before, result)
        assert (change.id, change.kind) == ("CK_BP_FORMAT", "regression")
        (change,) = compare(result, before)
        assert (change.id, change.kind) == ("CK_BP_FORMAT", "fixed")

    def test_an_invariant_that_holds_decides_no_requirement(self):
        run = a_run("TC_BP_MGT_BV_01")
        run.execute()
        assert "UWB-01" not in run.result().requirements

    def test_a_finding_fails_the_run_and_its_requirement(self):
        run = a_run("TC_VD_CRE_BV_01")
        run.execute()
        run.take_passive([a_finding()])
        assert run.exit_status() == 1
        assert run.result().requirements["BP-HDR-02"] is Verdict.FAIL
        assert run.result().summary["conformance"]["fail"] == 1
        assert any("CK_BP_FORMAT" in each for each in run.complaints())

    def test_a_finding_can_be_expected(self, tmp_path: Path):
        expected = tmp_path / "expected.toml"
        expected.write_text('[[expected]]\ncase = "CK_BP_FORMAT"\nreason = "known"\n')
        run = a_run("TC_VD_CRE_BV_01", expected=expected)
        run.execute()
        # Nothing came out like this.
        assert any("CK_BP_FORMAT" in each for each in run.complaints())
        run.take_passive([a_finding()])
        assert run.exit_status() == 0

    def test_an_invariant_can_be_excluded(self):
        run = ConformanceRun(
            TargetOptions(in_process=True), Selection(patterns=("TC_VD_CRE_BV_01",), exclude=("CK_BP_*",))
        )
        run.execute()
        run.take_passive([a_finding()])
        result = run.result()
        assert not [each.id for each in (*result.cases, *result.invariants) if each.id.startswith("CK_BP_")]
        assert run.exit_status() == 0

    def test_results_of_lanes_are_joined(self):
        run = a_run("TC_VD_CRE_BV_01")
        ends = [WorkerEnd(None, (), "", usage=False, passive=(a_finding(),)) for _ in range(3)]
        run.close_workers(ends, 3, [])
        (found,) = run.passive
        assert len(found.checks) == 3
        frames = [mark.frame for each in found.checks for mark in each.frames]
        assert frames == list(range(1, len(found.evidence) + 1))

    def test_a_finding_in_one_lane_fails(self):
        holds = PassiveTester(codec_of("dcp-2.0"), Pics(), {}).results("x")
        found = joined([*holds, a_finding(), *holds])
        assert {each.id: each.verdict for each in found if each.verdict is Verdict.FAIL} == {
            "CK_BP_FORMAT": Verdict.FAIL
        }
        assert len(found) == len(passive.RULES)

    def test_frames_of_findings_are_in_the_report(self, tmp_path: Path):
        run = a_run("TC_VD_CRE_BV_01")
        run.execute()
        run.take_passive([a_finding()])
        page = write_report(run.result(), tmp_path).read_text()
        assert re.search(r"frame \d of TC_DCP_SANITY_BV_01", page)
        found = next(case for case in load_results(tmp_path).cases if case.id == "CK_BP_FORMAT")
        assert (tmp_path / f"{found.recording}.mcap").exists()


def test_each_rule_of_check_is_used_or_named_with_a_reason():
    text = inspect.getdoc(__import__("dcp_conformance.passive.rules", fromlist=["x"])) or ""
    used = {rule.id for rule in passive.RULES}
    unnamed = [rule.id for rule in check.RULES if rule.id not in used and f"``{rule.id}``" not in text]
    assert not unnamed


def test_each_rule_is_documented():
    document = (Path(__file__).resolve().parents[3] / "docs" / "dcp-conformance.md").read_text(encoding="utf-8")
    section = document.partition("## Passive testing")[2].partition("\n## ")[0]
    listed = re.findall(r"^\| `(CK_\w+)` \|", section, re.MULTILINE)
    assert sorted(listed) == sorted(rule.id for rule in passive.RULES)


@pytest.mark.parametrize(("true_ms", "wrong"), [(100, False), (130, True), (220, True)])
def test_pauses_do_not_make_the_period_long(true_ms: int, wrong: bool):
    ear = Ear(pics=Pics(pixit=Testing(beacon_period_ms=100.0)))
    rng = random.Random(1)
    for number in range(600):
        # Seven times in ten there is nothing to send for a period or two.
        steps = rng.choice((1, 1, 1, 2, 2, 2, 2, 3, 3, 3))
        ear.air.step = round(steps * true_ms * rng.uniform(0.95, 1.05) * MS)
        ear.air.say(SUT, VarSumm(1, number % 256))
    assert ("CK_BP_PERIOD" in ear.failed()) is wrong


@pytest.mark.parametrize(("true_ms", "wrong"), [(100, False), (140, True), (200, True)])
def test_much_jitter_does_not_change_the_period(true_ms: int, wrong: bool):
    ear = Ear(pics=Pics(pixit=Testing(beacon_period_ms=100.0)))
    rng = random.Random(1)
    for number in range(3000):
        ear.air.step = round(true_ms * rng.uniform(0.05, 1.95) * MS)
        ear.air.say(SUT, VarSumm(1, number % 256))
    assert ("CK_BP_PERIOD" in ear.failed()) is wrong
