"""``dcp-conformance run`` and ``list``: output, exit status, and remaining files and processes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from dcp_conformance.definitions.case import SANITY, all_cases
from dcp_conformance.definitions.outcome import (
    AS_EXPECTED,
    INCONCLUSIVE,
    INTERRUPTED,
    TESTER_ERROR,
    UNEXPECTED,
    USAGE,
    exit_status,
)
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.expected import ExpectedResults
from dcp_conformance.execution.run import ConformanceRun
from dcp_conformance.execution.selection import Selection, select
from dcp_conformance.execution.target import TargetOptions, open_target
from dcp_conformance.execution.workers.parallel import run_in_workers, workers_for
from dcp_conformance.pytest_plugin import run_with_pytest
from dcp_conformance.reporting import load_results

from dcp_codec.common.processes import started_at

from ...ports import own_port
from ...waiting import PATIENCE, eventually
from ..command import Command

#: Two cases against our own node, each in a worker of its own, that wait for something that must not come.
RUN = (
    *(sys.executable, "-c", "from dcp_conformance.cli import main; main()", "run", "-j", "2"),
    *("TC_VD_STATE_BV_03-deleted-producer.app-update", "TC_VD_STATE_BV_03-deleted-consumer.app-update"),
)
ONE = "TC_VD_UPD_BV_01"
#: Fails, in virtual time, where a PICS claims what our node does not do.
FAILS = "TC_BP_CLAIM_TI_01"


@pytest.fixture
def failing(tmp_path: Path) -> tuple[str, ...]:
    """Options by which ``FAILS`` fails."""
    pics = tmp_path / "claims.toml"
    pics.write_text("[pics]\ntriggered_beacons = true\n")
    return ("--in-process", "--pics", str(pics))


def expected_file(folder: Path, *entries: str) -> Path:
    path = folder / "expected.toml"
    path.write_text("\n".join(f"[[expected]]\n{entry}\n" for entry in entries))
    return path


def entry(case: str, verdict: str = "fail", reason: str = "known since May", **more: str) -> str:
    lines = {"case": f'"{case}"', "verdict": f'"{verdict}"', "reason": f'"{reason}"', **more}
    return "\n".join(f"{name} = {value}" for name, value in lines.items())


class TestExitStatus:
    def test_0_as_expected(self, dcp_conformance: Command):
        done = dcp_conformance("run", "--in-process", ONE)
        assert done.status == AS_EXPECTED == 0
        assert re.search(r"requirements: \d+ pass$", done.out, re.MULTILINE)
        assert "2 cases in" in done.out

    def test_1_unexpected_pass(self, dcp_conformance: Command, tmp_path: Path):
        done = dcp_conformance("run", "--in-process", ONE, "--expected", expected_file(tmp_path, entry(ONE)))
        assert done.status == UNEXPECTED == 1
        assert "unexpected pass: fail was expected (known since May)" in done.out

    def test_1_unexpected_fail(self, dcp_conformance: Command, failing: tuple[str, ...], tmp_path: Path):
        done = dcp_conformance("run", *failing, FAILS, "--report-dir", tmp_path)
        assert done.status == UNEXPECTED
        assert FAILS in done.out
        assert FAILS in [case.id for case in load_results(tmp_path).cases]

    def test_3_no_implementation_answers(self, dcp_conformance: Command, tmp_path: Path):
        """Silence is not a fault that a requirement could be named for."""
        link = f"udp:239.77.1.1:{own_port()}"
        done = dcp_conformance("run", "--link", link, "--beacon-period", "20", SANITY, "--report-dir", tmp_path)
        assert done.status == INCONCLUSIVE
        assert "nothing was heard: is it running, on this link" in done.out
        assert {case.verdict for case in load_results(tmp_path).cases} == {Verdict.INCONCLUSIVE}

    def test_2_usage(self, dcp_conformance: Command):
        assert dcp_conformance("run", "--no-such-option").status == USAGE == 2

    def test_3_inconclusive(self):
        assert exit_status([result_of(Verdict.PASS), result_of(Verdict.INCONCLUSIVE)]) == INCONCLUSIVE == 3
        assert exit_status([result_of(Verdict.FAIL), result_of(Verdict.INCONCLUSIVE)]) == UNEXPECTED

    def test_3_by_an_upper_tester_that_exits_during_the_run(self, dcp_conformance: Command, tmp_path: Path):
        """It answers a few requests and exits; the report records it."""
        upper = tmp_path / "upper.py"
        upper.write_text(_UPPER)
        link = f"udp:239.77.2.1:{own_port()}"
        done = dcp_conformance(
            "run", "--link", link, "--beacon-period", "20", "--ut", f"exec:{sys.executable} {upper}", SANITY,
            "--report-dir", tmp_path / "report",
        )  # fmt: skip
        assert done.status in (UNEXPECTED, INCONCLUSIVE, TESTER_ERROR)
        assert done.status != AS_EXPECTED
        assert (tmp_path / "report" / "report.html").exists()

    def test_4_no_listener_at_the_address_of_the_upper_tester(self, dcp_conformance: Command, tmp_path: Path):
        done = dcp_conformance("run", "--link", "udp", "--ut", f"unix:{tmp_path}/node.sock", "TC_DCP_SANITY_BV_01")
        assert done.status == TESTER_ERROR
        # The tester was not asked to start it, so it does not wait.
        assert f"unix:{tmp_path}/node.sock: there is no such socket; is the implementation running" in done.err

    @pytest.mark.part("links")
    def test_4_the_start_command_fails_later(
        self, dcp_conformance: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        """The last output of the command explains why there is no listener at the upper tester's address."""
        monkeypatch.setattr("dcp_conformance.execution.target.UPPER_PATIENCE", 1.5)
        script = tmp_path / "start.sh"
        script.write_text("sleep 0.7; echo config file missing >&2; exit 3\n")
        done = dcp_conformance(
            "run", "--link", f"udp:239.77.8.1:{own_port()}", "--start", f"sh {script}",
            "--ut", f"unix:{tmp_path}/ut.sock", SANITY,
        )  # fmt: skip
        assert done.status == TESTER_ERROR
        assert "--start: it ended with exit status 3; its output: config file missing" in done.err

    def test_4_an_error_of_the_tester(self, dcp_conformance: Command, tmp_path: Path):
        done = dcp_conformance(
            "run", "--link", "udp", "--ut", f"tcp:127.0.0.1:{own_port()}", ONE, "--report-dir", tmp_path
        )
        assert done.status == TESTER_ERROR == 4
        assert "127.0.0.1" in done.err
        assert any("127.0.0.1" in note for note in load_results(tmp_path).notes)


_UPPER = """
import json, sys
for number, line in enumerate(sys.stdin):
    if number >= 3:
        sys.exit(1)
    request = json.loads(line)
    if request["method"] == "UT-Hello":
        answer = {"result": {"status": "UT-STATUS-OK", "name": "frail", "version": "1", "specVersion": "2.0",
                             "methods": ["UT-Hello", "UT-Reset"], "nodeId": "02:00:00:00:00:01"}}
    elif request["method"] == "UT-Reset":
        answer = {"result": {"status": "UT-STATUS-OK"}}
    else:
        answer = {"error": {"code": -32601, "message": "no such method"}}
    print(json.dumps({"jsonrpc": "2.0", "id": request.get("id"), **answer}), flush=True)
"""


def result_of(verdict: Verdict) -> CaseResult:
    return CaseResult(id="TC_X", purpose="", section="", kind="BV", requirements=(), verdict=verdict)


class TestWhatIsRun:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["TC_VD_UPD_BV_1"], "did you mean TC_VD_UPD_BV_01"),
            (["TC_NOTHING_LIKE_IT"], "no case is called 'TC_NOTHING_LIKE_IT'"),
            (["TC_VD_HAZ_BO_04"], "the case TC_VD_HAZ_BO_04 is retired: CHANGELOG.md names its replacement"),
            (["BP-HDR-1"], "did you mean BP-HDR-1"),
            (["-s", "no such heading"], "no section is called 'no such heading'"),
            (["-s", "dcp-wardis.md"], "did you mean dcp-vardis.md"),
            (["-x", "TC_*"], "no case is left to run"),
            (["--plan", "none"], "--plan"),
            (["--profile", "dcp-3.0"], "dcp-3.0"),
            (["--pics", "no-such.toml"], "no-such.toml"),
            (["--expected", "no-such.toml"], "no-such.toml"),
            (["--interface", "nosuch0"], "there is no such interface; there are lo"),
            (["--link", "udp:nowhere"], "nowhere"),
            (["--impair", "foo=1"], "foo: unknown key"),
            (["--in-process", "--link", "udp"], "--in-process tests the reference node"),
            (["--ether-type", "IP"], "'ip' is not an EtherType; write it in hex, as in 0x4953"),
            (["--ut", "unix:node.sock"], "--ut is for your own implementation: give its --interface or --link"),
            (["--in-process", "--restart", "true"], "--restart is for your own implementation"),
            (["--timing-scale", "0"], "0.0 is not in the range 0<x<=1000"),
            (["--timing-scale", "nan"], "'nan' is not a number"),
            (["--beacon-period", "inf"], "inf is not in the range"),
            (["--report-dir", __file__], f"{__file__}: cannot be written: exists and is not a folder"),
            (["--pytest", "-k nothing_at_all", "--in-process"], "no case is left to run"),
            (["--pytest", "--no-such-option", "--in-process"], "pytest could not begin"),
        ],
    )
    def test_contradictory_options_are_refused(self, dcp_conformance: Command, arguments: list[str], message: str):
        done = dcp_conformance("run", *arguments)
        assert done.status == USAGE, done.out
        assert message in done.err
        # Nothing was executed: a summary would hide the message.
        assert "requirement" not in done.out

    def test_similar_names_are_suggested_once(self):
        with pytest.raises(UsageError) as raised:
            select(all_cases(), Selection(patterns=("TC_VD_UPD_BV_1",)))
        near = re.findall(r"TC_\w+(?:-\w+)?", str(raised.value).partition("did you mean")[2])
        assert len(near) == len(set(near)) > 1

    def test_a_dry_run_runs_nothing(self, dcp_conformance: Command):
        done = dcp_conformance("run", "--dry-run", "VD-UPD-08", "--interface", "nosuch0")
        assert done.status == 0
        assert ONE in done.out
        assert all(line.startswith("TC_") for line in done.out.splitlines())

    def test_only_selected_cases_are_run(self, dcp_conformance: Command, tmp_path: Path):
        dcp_conformance("run", "--in-process", "VD-UPD-08", "-x", ONE, "--report-dir", tmp_path)
        ran = {case.id for case in load_results(tmp_path).cases}
        wanted = {case.id for case in all_cases().values() if "VD-UPD-08" in case.requirements} - {ONE}
        assert ran == wanted | {SANITY}

    def test_sanity_is_first_and_last_and_counted_once(self, dcp_conformance: Command, tmp_path: Path):
        destructive = [case.id for case in all_cases().values() if case.destructive][:2]
        done = dcp_conformance("run", "--in-process", ONE, *destructive, "--report-dir", tmp_path)
        result = load_results(tmp_path)
        assert [case.id for case in result.cases] == [SANITY, ONE, *destructive, SANITY]
        assert [case.counted for case in result.cases] == [True] * 4 + [False]
        assert sum(sum(verdicts.values()) for verdicts in result.summary.values()) == 4
        assert "4 cases in" in done.out

    def test_sanity_can_be_left_out(self, dcp_conformance: Command, tmp_path: Path):
        dcp_conformance("run", "--in-process", ONE, "-x", SANITY, "--report-dir", tmp_path)
        assert [case.id for case in load_results(tmp_path).cases] == [ONE]

    def test_the_sanity_case_alone_is_run_alone(self, dcp_conformance: Command, tmp_path: Path):
        done = dcp_conformance("run", "--in-process", SANITY, "--report-dir", tmp_path)
        assert done.status == 0
        assert [case.id for case in load_results(tmp_path).cases] == [SANITY]

    def test_arguments_need_not_be_valid_text(
        self, dcp_conformance: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        name = os.fsdecode(b"\xf6")
        monkeypatch.setattr(sys, "argv", ["dcp-conformance", "run", "--report-dir", name])
        assert dcp_conformance("run", "--in-process", SANITY, "--report-dir", tmp_path / name).status == 0
        assert load_results(tmp_path / name).command == r"dcp-conformance run --report-dir '\udcf6'"

    def test_a_report_that_cannot_be_written_loses_nothing(self, dcp_conformance: Command, tmp_path: Path):
        (tmp_path / "results.json").mkdir()
        done = dcp_conformance("run", "--in-process", SANITY, "--report-dir", tmp_path)
        assert done.status == USAGE
        assert "results.json: cannot be written: is not a regular file and will not be replaced" in done.err
        assert "1 case in" in done.out

    def test_everything_several_times(self, dcp_conformance: Command, tmp_path: Path):
        done = dcp_conformance("run", "--in-process", ONE, "--repeat", "3", "--report-dir", tmp_path)
        assert done.status == 0
        attempts = [case.attempt for case in load_results(tmp_path).cases if case.id == ONE]
        assert attempts == [1, 2, 3]

    def test_until_it_fails(self, dcp_conformance: Command, failing: tuple[str, ...], tmp_path: Path):
        done = dcp_conformance(
            "run", *failing, FAILS, ONE, "--max-fails", "1", "--repeat", "5", "--report-dir", tmp_path
        )  # fmt: skip
        assert done.status == UNEXPECTED
        assert [case.id for case in load_results(tmp_path).cases] == [SANITY, FAILS]

    def test_the_smoke_plan_has_something_of_everything(self):
        smoke = [case for case in all_cases().values() if case.smoke]
        assert 100 <= len(smoke) <= 300
        documents = {case.section.partition(":")[0] for case in smoke}
        assert documents >= {"dcp-bp.md", "dcp-srp.md", "dcp-vardis.md", "Networks"}
        assert not any(case.destructive for case in smoke)

    @pytest.mark.part("suite")
    def test_the_smoke_plan_passes_for_every_version(self, dcp_conformance: Command):
        for profile in ("dcp-1.0", "dcp-1.3", "dcp-2.0", "cpp-2.0"):
            done = dcp_conformance("run", "--in-process", "--plan", "smoke", "--profile", profile)
            assert done.status == 0, done.out

    def test_output_is_shown_in_a_separate_process(self, tmp_path: Path):
        """In one process pytest runs the cases: it must neither capture their output nor leave files."""
        command = [sys.executable, "-c", "from dcp_conformance.cli import main; main()", "run", "--in-process"]
        done = subprocess.run(
            [*command, "-v", ONE], capture_output=True, text=True, timeout=PATIENCE, check=True, cwd=tmp_path
        )
        assert f"pass     {ONE}" in done.stdout
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize("options", [["-v"], ["-q"], []])
    def test_output_of_a_run(self, dcp_conformance: Command, options: list[str]):
        done = dcp_conformance("run", "--in-process", ONE, *options)
        assert (f"pass     {ONE}" in done.out) == (options == ["-v"])
        assert "\x1b" not in done.out
        assert max(map(len, done.out.splitlines())) < 400


class TestExpectedResults:
    def test_an_expected_failure(self, dcp_conformance: Command, failing: tuple[str, ...], tmp_path: Path):
        known = expected_file(tmp_path, entry(FAILS, match='"half a period"'))
        done = dcp_conformance("run", *failing, FAILS, "--expected", known)
        assert done.status == AS_EXPECTED, done.out

    def test_a_failure_for_another_reason_than_expected(
        self, dcp_conformance: Command, failing: tuple[str, ...], tmp_path: Path
    ):
        known = expected_file(tmp_path, entry(FAILS, match='"quite another"'))
        done = dcp_conformance("run", *failing, FAILS, "--expected", known)
        assert done.status == UNEXPECTED
        assert "for another reason" in done.out

    def test_an_entry_that_nothing_matches_fails_the_run(self, dcp_conformance: Command, tmp_path: Path):
        known = expected_file(tmp_path, entry(ONE, verdict="pass"), entry("TC_VD_UPD_BV_0*"))
        done = dcp_conformance("run", "--in-process", ONE, "--expected", known)
        assert done.status == UNEXPECTED
        assert "no result matches this entry; remove it" in done.out

    def test_entries_about_cases_that_were_not_run_are_ignored(self, dcp_conformance: Command, tmp_path: Path):
        known = expected_file(tmp_path, entry("TC_BP_HDR_BV_01"))
        assert dcp_conformance("run", "--in-process", ONE, "--expected", known).status == AS_EXPECTED

    def test_an_expired_entry_fails_the_run(self, dcp_conformance: Command, tmp_path: Path):
        known = expected_file(tmp_path, entry(ONE, verdict="pass", expires="2020-01-31"))
        done = dcp_conformance("run", "--in-process", ONE, "--expected", known)
        assert done.status == UNEXPECTED
        assert "expired on 2020-01-31" in done.out

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('[[expected]]\ncase = "TC_NO"\nreason = "r"', "no case is called 'TC_NO'"),
            (f'[[expected]]\ncase = "{ONE}"', "reason"),
            (f'[[expected]]\ncase = "{ONE}"\nreason = " "', "`reason` is empty"),
            (f'[[expected]]\ncase = "{ONE}"\nreason = "r"\nmatch = "("', "expected.toml"),
            (f'[[expected]]\ncase = "{ONE}"\nreason = "r"\nverdict = "fine"', "verdict"),
            (f'[[expected]]\ncase = "{ONE}"\nreason = "r"\nwhen = 1', "when"),
            ("[[expected", "expected.toml"),
            ("\udcff", "expected.toml"),
        ],
    )
    def test_an_unreadable_file_is_reported(self, tmp_path: Path, text: str, message: str):
        path = tmp_path / "expected.toml"
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
        with pytest.raises(UsageError, match=re.escape(message)):
            ExpectedResults.load(path, all_cases().values())


class TestList:
    def test_cases_are_shown_with_their_requirements(self, dcp_conformance: Command):
        done = dcp_conformance("list", "VD-UPD-08")
        assert done.status == 0
        assert re.search(rf"{ONE} .*\[.*VD-UPD-08.*\]", done.out)

    def test_as_json(self, dcp_conformance: Command):
        entries = json.loads(dcp_conformance("list", "--json").out)
        assert {each["id"] for each in entries} == set(all_cases())

    def test_by_requirement(self, dcp_conformance: Command):
        done = dcp_conformance("list", "--requirements", "VD-UPD-08")
        assert re.search(rf"^VD-UPD-08  .*\n(    TC_.*\n)*    {ONE}$", done.out, re.MULTILINE)

    def test_unknown_names(self, dcp_conformance: Command):
        assert dcp_conformance("list", "TC_NOPE").status == USAGE


@pytest.mark.part("tools")
class TestPytest:
    def test_cases_are_pytest_items_anywhere(self, tmp_path: Path):
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "dcp_conformance.pytest_plugin",
             "--pyargs", "dcp_conformance.suite",
             "--dcp-in-process", "-k", "TC_VD_UPD_BV", "-q", "-p", "no:cacheprovider"],
            cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        assert re.search(r"\d+ pass", done.stdout)

    def test_pytest_options_work_in_a_run(self, tmp_path: Path):
        run = ConformanceRun(TargetOptions(in_process=True), Selection())
        run_with_pytest(run, ["-k", ONE, "-q"])
        assert {result.id for result in run.results} == {SANITY, ONE}
        assert run.exit_status() == AS_EXPECTED


@pytest.mark.part("links")
class TestLanes:
    """Our own node as a process; over UDP, so that no privilege is needed."""

    @pytest.fixture
    def options(self, tmp_path: Path) -> TargetOptions:
        """For a node that may be kept waiting by the machine: what is waited for comes, however late."""
        pics = tmp_path / "patient.toml"
        pics.write_text("[pixit]\nleast_patience_ms = 20000\n")
        return TargetOptions(beacon_period_ms=20.0, pics=pics)

    def test_the_upper_tester_has_the_timeout_of_the_pixit(self, options: TargetOptions, tmp_path: Path):
        upper = tmp_path / "upper.py"
        upper.write_text(_UPPER)
        link = f"udp:239.77.6.1:{own_port()}"
        foreign = replace(options, link=link, ut=f"exec:{sys.executable} {upper}")
        with open_target(foreign) as target:
            assert target.runner.session.upper is not None
            assert target.runner.session.upper._patience.seconds == 20

    def test_several_lanes_give_the_same_verdicts_as_one(self, options: TargetOptions):
        # Without those that wait all of that time for something that must not come.
        wanted = Selection(patterns=("VD-UPD-0*", "BP-HDR-01", "SRP-RX-06"), exclude=("*deleted*",))
        verdicts = []
        for workers in (1, 3):
            run = ConformanceRun(options, wanted)
            run_in_workers(run, workers)
            assert run.exit_status() == AS_EXPECTED, run.trouble
            verdicts.append({result.id: result.verdict for result in run.results if result.id != SANITY})
        assert verdicts[0] == verdicts[1]
        assert len(verdicts[0]) > 5

    @pytest.mark.parametrize(
        ("target", "patterns", "jobs", "workers"),
        [
            (TargetOptions(), ("BP-HDR-0*",), 3, 3),
            (TargetOptions(), ("BP-HDR-0*",), 1, 1),
            (TargetOptions(), (ONE,), 4, 1),
            (TargetOptions(in_process=True), (), 4, 1),
            (TargetOptions(link="udp"), (), None, 1),
        ],
    )
    def test_there_are_at_most_as_many_lanes_as_cases(self, target, patterns, jobs: int | None, workers: int):
        assert workers_for(ConformanceRun(target, Selection(patterns=patterns)), jobs) == workers

    def test_the_sanity_case_alone_stays_alone(self, options: TargetOptions):
        run = ConformanceRun(options, Selection(patterns=(SANITY,)))
        run_in_workers(run, 4)
        assert {result.id for result in run.results} == {SANITY}

    def test_a_killed_lane_is_an_error_of_the_tester(self, tmp_path: Path):
        command = self._for_ever(tmp_path)
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        ) as process:
            for worker in self._workers_of(process.pid):
                os.kill(worker, signal.SIGKILL)
            _, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == TESTER_ERROR, err
        assert "a worker of the tester has ended" in err
        # Each missing case has a reason.
        lost = {case.id: case for case in load_results(tmp_path).cases if case.verdict is Verdict.ERROR}
        assert set(lost) == set(RUN[-2:])
        assert all("a worker of the tester has ended" in case.reason for case in lost.values())
        assert any("a worker of the tester" in note for note in load_results(tmp_path).notes)

    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_an_interrupted_run_leaves_a_report_and_nothing_else(self, tmp_path: Path, number: signal.Signals):
        command = self._for_ever(tmp_path)
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        ) as process:
            workers = self._workers_of(process.pid)
            process.send_signal(number)
            out, err = process.communicate(timeout=PATIENCE)
        assert process.returncode == INTERRUPTED == 130, err
        assert "note: interrupted after" in out
        assert (tmp_path / "report.html").exists()
        eventually(lambda: all(started_at(worker) is None for worker in workers), "the workers end")

    def _for_ever(self, folder: Path) -> list[str]:
        """A run that is not over before it is ended, however long the machine takes to end it."""
        pics = folder / "patient.toml"
        pics.write_text("[pixit]\nleast_patience_ms = 3600000\n")
        return [*RUN, "--pics", str(pics), "--report-dir", str(folder)]

    def _workers_of(self, parent: int) -> list[int]:
        """The processes of both workers, once they have nodes of their own."""

        def workers() -> list[int]:
            found = [
                each
                for each in below(parent)
                if "dcp_stack" not in command_line(each)
                and any("dcp_stack" in command_line(child) for child in children(each))
            ]
            return found if len(found) == 2 else []

        return eventually(workers, "the workers start")


def children(pid: int) -> list[int]:
    try:
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def below(pid: int) -> list[int]:
    found = children(pid)
    return found + [each for child in found for each in below(child)]


def command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""
