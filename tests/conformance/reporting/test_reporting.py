"""Reports of a run: results as data, a page, a file for build servers, recordings."""

from __future__ import annotations

import html.parser
import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest
from dcp_conformance.cli.display import print_summary
from dcp_conformance.definitions.outcome import assemble
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult, Check, EventRecord, Mark, RunResult, Sut
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.reporting import load_results, write_report
from dcp_conformance.reporting import schema as schema_of_results
from dcp_conformance.reporting.junit import junit_xml
from dcp_conformance.reporting.merge import WORSE, compare, labels, matrix, render_matrix
from dcp_conformance.reporting.page import render
from dcp_conformance.test_system.bench import Session
from dcp_selftest.mutants import all_mutants
from dcp_spec.catalogue.origins import REPOSITORY

from dcp_codec import Beacon, BPHeader, Payload
from dcp_codec.capture import open_capture

from ...browser import Browser
from ..air import Script, judged
from ..check.test_check import deleted
from ..command import Command
from ..rig import codec_of, known_cases

EVIL = "<script>document.title='owned'</script>\"'&]]>\x00\x1b[31m"


def a_run(mutant: str = "", step: int = 40) -> RunResult:
    """Some cases against our node, or against a mutant."""
    codec = codec_of("dcp-2.0")
    options = {"make": all_mutants()[mutant].make} if mutant else {}
    sut = InProcess(reference_config(codec), **options)
    runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut, rerun="dcp-conformance run")
    runner.prepare()
    cases = list(known_cases().values())
    wanted = [case for case in cases if "VD-RC-03" in case.requirements][:3] + cases[::step]
    results = [runner.run(case) for case in dict.fromkeys(wanted)]
    return assemble(codec.profile, Pics(), results, sut=runner.about(), started="2026-11-21T12:00:00Z", duration=1.5,
                    command="dcp-conformance run", notes=["a note"])  # fmt: skip


@pytest.fixture(scope="module")
def failed() -> RunResult:
    """A run in which something failed."""
    run = a_run("M-VD-RC-03-consumer-silent")
    assert run.summary["conformance"]["fail"]
    assert run.summary["conformance"]["pass"]
    return run


@pytest.fixture(scope="module")
def passed() -> RunResult:
    """The same against a node without faults."""
    return a_run()


def a_case(verdict: Verdict, identifier: str = "TC_VD_EVIL_BV_01", text: str = "why", **more: Any) -> CaseResult:
    checks = (Check(verdict, ("VD-TYP-01",), text, text, (Mark(1, 14, 4),)),)
    event = EventRecord(10**18, "heard", text, 1, "", (b"\xff" * 6 + b"\2" * 6 + b"\x49\x53" + b"\1" * 30).hex(), 14)
    return CaseResult(id=identifier, purpose=text, section=text, kind="BV", requirements=("VD-TYP-01",),
                      verdict=verdict, reason=text, stimulus=text, expectation=text, checks=checks, rerun=text,
                      evidence=(event, EventRecord(10**18, "note", text=text)), **more)  # fmt: skip


def a_run_of(*cases: CaseResult, **more: Any) -> RunResult:
    return assemble(codec_of("dcp-2.0").profile, Pics(), cases, started="2026-11-21T12:00:00Z", **more)


EVERY = a_run_of(*(a_case(verdict, f"TC_VD_{number}_BV_01") for number, verdict in enumerate(Verdict)))


class TestResults:
    def test_results_survive_a_round_trip(self, failed: RunResult, tmp_path: Path):
        page = write_report(failed, tmp_path)
        assert page == tmp_path / "report.html"
        back = load_results(tmp_path)
        assert back == load_results(tmp_path / "results.json")
        assert back.requirements == failed.requirements
        assert back.summary == failed.summary
        assert [case.checks for case in back.cases] == [case.checks for case in failed.cases]
        assert [case.evidence for case in back.cases] == [case.evidence for case in failed.cases]

    def test_results_are_valid_by_the_schema(self, failed: RunResult, tmp_path: Path):
        validator = jsonschema.Draft202012Validator(schema_of_results.results_schema())
        validator.check_schema(validator.schema)
        for run in (failed, EVERY, a_run_of()):
            write_report(run, tmp_path)
            data = json.loads((tmp_path / "results.json").read_text())
            assert not list(validator.iter_errors(data))
        data["cases"] = [{"id": 1}]
        assert list(validator.iter_errors(data))

    def test_the_schema_in_the_package_is_up_to_date(self):
        assert schema_of_results.PATH.read_text(encoding="utf-8") == schema_of_results.text(), (
            "run: python -m dcp_conformance.reporting.schema"
        )

    def test_members_that_tools_rely_on_exist(self, failed: RunResult, tmp_path: Path):
        write_report(failed, tmp_path)
        data = json.loads((tmp_path / "results.json").read_text())
        assert data["schema"] == "dcp-conformance-results/1"
        assert {"cases", "requirements", "summary", "sut", "profile"} <= set(data)
        assert {"id", "requirements", "verdict", "reason", "duration", "evidence"} <= set(data["cases"][0])

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            (None, "cannot be read"),
            ("", "not a result file of dcp-conformance"),
            ("{}", "not a result file of dcp-conformance|follows ''"),
            ('{"cases": 3}', "not a result file of dcp-conformance"),
            ('{"schema": "dcp-conformance-results/9"}', "this version can read .* only"),
            ("\udcff", "not a result file of dcp-conformance"),
        ],
    )
    def test_an_invalid_result_file_is_refused(self, tmp_path: Path, content: str | None, message: str):
        path = tmp_path / "results.json"
        if content is not None:
            path.write_bytes(content.encode("utf-8", "surrogateescape"))
        if content == "{}":
            # Every member has a default; it is an empty run of this version.
            assert load_results(path).cases == ()
            return
        with pytest.raises(UsageError, match=message):
            load_results(path)

    def test_an_unwritable_folder_is_reported(self, tmp_path: Path):
        (tmp_path / "file").write_text("")
        with pytest.raises(UsageError, match="cannot be written"):
            write_report(EVERY, tmp_path / "file" / "below")

    def test_an_earlier_report_is_replaced(self, tmp_path: Path, failed: RunResult, passed: RunResult):
        write_report(failed, tmp_path)
        write_report(passed, tmp_path)
        assert load_results(tmp_path).requirements == passed.requirements
        assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


class TestJUnit:
    def test_outcomes_are_distinguished(self):
        root = ET.fromstring(junit_xml(EVERY))
        outcomes = {
            element.get("name"): [child.tag for child in element if child.tag != "properties"]
            for element in root.iter("testcase")
        }
        assert list(outcomes.values()) == [["skipped"], ["skipped"], [], [], ["skipped"], ["failure"], ["error"]]
        assert {name: root.get(name) for name in ("tests", "failures", "errors", "skipped")} == {
            "tests": "7", "failures": "1", "errors": "1", "skipped": "3",
        }  # fmt: skip

    def test_build_servers_can_read_the_file(self, failed: RunResult):
        """The members that Jenkins and GitLab read, in the order of the usual schema."""
        root = ET.fromstring(junit_xml(failed))
        assert root.tag == "testsuites"
        total = 0
        for suite in root:
            assert suite.tag == "testsuite"
            assert suite.get("name")
            assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", suite.get("timestamp") or "")
            cases = suite.findall("testcase")
            total += len(cases)
            assert int(suite.get("tests") or 0) == len(cases)
            for kind, name in (("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
                assert int(suite.get(name) or 0) == sum(case.find(kind) is not None for case in cases)
            for case in cases:
                assert case.get("name")
                assert case.get("classname")
                float(case.get("time") or "")
                assert case[0].tag == "properties"
                assert len(case) <= 2
                for bad in case.findall("failure") + case.findall("error"):
                    assert bad.get("message")
                    assert bad.get("type")
                    assert "again: dcp-conformance run" in (bad.text or "")
        assert total == len(failed.cases)
        names = [(case.get("classname"), case.get("name")) for case in root.iter("testcase")]
        assert len(set(names)) == len(names)

    def test_requirements_and_verdict_are_properties(self, failed: RunResult):
        root = ET.fromstring(junit_xml(failed))
        case = failed.cases[0]
        element = next(each for each in root.iter("testcase") if each.get("name") == case.id)
        properties = [(each.get("name"), each.get("value")) for each in element.iter("property")]
        assert [value for name, value in properties if name == "requirement"] == list(case.requirements)
        assert ("verdict", str(case.verdict)) in properties

    def test_hostile_text_is_text(self):
        octets = junit_xml(a_run_of(a_case(Verdict.FAIL, text=EVIL)))
        root = ET.fromstring(octets)
        failure = root.find(".//failure")
        assert failure is not None
        assert "<script>" in (failure.text or "")
        assert b"\x00" not in octets
        assert b"\x1b" not in octets
        assert r"\x00\x1b[31m" in (failure.text or "")


class _Links(html.parser.HTMLParser):
    """Collects the sources, links and ids of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.scripts = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.scripts += tag == "script"
        if tag in ("link", "script", "img", "iframe", "object", "embed", "video", "audio", "source"):
            self.loads += [each for each in (named.get("src"), named.get("href"), named.get("data")) if each]
        if tag == "a" and named.get("href"):
            self.links.append(named["href"] or "")
        if named.get("id"):
            self.ids.append(named["id"] or "")


def links_of(text: str) -> _Links:
    links = _Links()
    links.feed(text)
    return links


class TestPage:
    def test_the_page_loads_nothing_else(self, failed: RunResult):
        text = render(failed, codec_of("dcp-2.0"))
        links = links_of(text)
        assert links.loads == []
        # Nothing is loaded; the only addresses are those of places in the specification, for people to follow.
        without = text.replace(f'href="{REPOSITORY}/blob/', 'href="')
        assert not re.search(r"url\(|@import|https?://", re.sub(r"<(td|span|div|li|dd)[^>]*>[^<]*", "", without))
        assert all(link.startswith(("#", "cases/", f"{REPOSITORY}/blob/")) for link in links.links)
        assert len(set(links.ids)) == len(links.ids)
        assert {link[1:] for link in links.links if link.startswith("#")} <= set(links.ids)

    def test_a_requirement_that_only_a_check_names_has_its_row(self):
        case = a_case(Verdict.FAIL)
        check = msgspec.structs.replace(case.checks[0], requirements=("BP-PAR-07",))
        links = links_of(render(a_run_of(msgspec.structs.replace(case, checks=(check,))), None))
        assert "#r-BP-PAR-07" in links.links
        assert {"r-BP-PAR-07", "r-VD-TYP-01"} <= set(links.ids)

    def test_requirements_that_fail_come_first_with_their_cases(self):
        """One fault fails many cases: cases that fail with a requirement are shown together, largest group first."""
        cases = [a_case(Verdict.FAIL, f"TC_VD_X_BV_{number:02}") for number in range(3)]
        other = a_case(Verdict.FAIL, "TC_VD_Y_BV_01")
        check = msgspec.structs.replace(other.checks[0], requirements=("BP-RX-15",))
        other = msgspec.structs.replace(other, checks=(check,))
        text = render(a_run_of(other, *cases, a_case(Verdict.PASS, "TC_VD_X_BV_09")), None)
        [shown] = re.findall(r'id="failing".*?</table>', text, re.DOTALL)
        assert [*re.findall(r'href="#(r-[^"]*)"', shown)] == ["r-VD-TYP-01", "r-BP-RX-15"]
        assert [*re.findall(r'href="#(f-c\d+)"', shown)] == ["f-c1", "f-c2", "f-c3", "f-c0"]
        assert "derived: the specification does not state it" in shown[shown.index("BP-RX-15") :]
        assert "derived: the specification does not state it" not in shown[: shown.index("BP-RX-15")]
        assert 'id="failing"' in render(a_run_of(other), None)
        assert 'id="failing"' not in render(a_run_of(a_case(Verdict.PASS)), None)

    def test_the_summary_counts_their_cases(self, capsys: pytest.CaptureFixture[str]):
        cases = [a_case(Verdict.FAIL, f"TC_VD_X_BV_{number:02}") for number in range(3)]
        other = a_case(Verdict.FAIL, "TC_VD_Y_BV_01")
        other = msgspec.structs.replace(
            other, checks=(msgspec.structs.replace(other.checks[0], requirements=("BP-RX-15",)),)
        )
        print_summary(a_run_of(other, *cases))
        assert "\nfailing: VD-TYP-01 in 3 cases, BP-RX-15 in 1 case\n" in capsys.readouterr().out
        print_summary(a_run_of(a_case(Verdict.PASS)))
        assert "failing" not in capsys.readouterr().out

    def test_the_summary_comes_before_notes(self, capsys: pytest.CaptureFixture[str]):
        print_summary(a_run_of(a_case(Verdict.PASS), notes=[f"restarted in {number}" for number in range(30)]))
        lines = capsys.readouterr().out.splitlines()
        assert [line for line in lines if line.startswith("note: ")] == [f"note: restarted in {n}" for n in range(6)]
        assert lines[-2] == "      ... and 24 more, which the report shows"

    def test_only_the_first_findings_are_open(self):
        cases = [a_case(Verdict.FAIL, f"TC_VD_X_BV_{number:02}") for number in range(30)]
        cards = re.findall(r'<details class="card"( open)? id="f-c', render(a_run_of(*cases), None))
        assert cards == [" open"] * 10 + [""] * 20

    def test_repeated_beacons_are_collapsed(self):
        """Beacons that differ only in their sequence number are collapsed. Beacons marked by a check are shown."""
        beacons = [
            Beacon(BPHeader(b"\2\0\0\0\0\1", number, 0x1111), (Payload(0x7000, b"x" * (2 if number == 9 else 1)),))
            for number in range(20)
        ]
        codec = codec_of("dcp-2.0")
        octets = [codec.encode_envelope(each) for each in beacons]
        events = tuple(EventRecord(n * 10**8, "heard", "node", n + 1, "", each.hex()) for n, each in enumerate(octets))
        case = msgspec.structs.replace(a_case(Verdict.FAIL), evidence=events)
        marked = msgspec.structs.replace(case.checks[0], frames=(Mark(15, 0, 1),))
        text = render(a_run_of(msgspec.structs.replace(case, checks=(marked,))), codec)
        lines = re.findall(r'<tr class="(heard|note)"><td>([^<]*)</td><td>(\d*)</td>.*<td>([^<]*)</td></tr>', text)
        assert [(time, number) for _, time, number, _ in lines] == [
            *(("0.0 ms", "1"), ("100.0 ms", "2"), ("", ""), ("900.0 ms", "10"), ("1000.0 ms", "11")),
            *(("1100.0 ms", "12"), ("1200.0 ms", "13"), ("1300.0 ms", "14"), ("1400.0 ms", "15")),
            *(("1500.0 ms", "16"), ("1600.0 ms", "17"), ("", "")),
        ]
        assert lines[2][3] == "... 7 more like this, until 800.0 ms"

    def test_the_page_shows_the_observed_frame_with_octets_marked(self):
        air = Script()
        deleted(air, True)
        text = render(judged(air.frames, "dcp-2.0"), codec_of("dcp-2.0"))
        assert "deletes variable 1, and then sends SUMMARIES of it" in text
        assert re.search(r'<td class="bad">01</td>', text)
        assert re.search(r'<div class="bad">.*records\[0\]', text)
        # A recording has no implementation under test.
        assert "SUT" not in text

    def test_every_verdict_and_an_unknown_requirement(self):
        odd = msgspec.structs.replace(a_case(Verdict.FAIL, "TC_X_Y_BV_01"), requirements=("XX-01",))
        text = render(a_run_of(*EVERY.cases, odd, a_case(Verdict.PASS, "TC_X_Y_BV_01", attempt=2)), None)
        for verdict in Verdict:
            assert f'data-verdict="{verdict}"' in text
        assert "TC_X_Y_BV_01 (attempt 2)" in text

    def test_notes_about_a_recording_are_above_its_findings(self):
        run = a_run_of(a_case(Verdict.FAIL), notes=["the profile was guessed"])
        page = render(msgspec.structs.replace(run, kind="check"), None)
        assert page.count("the profile was guessed") == 1
        assert page.index("the profile was guessed") < page.index('id="findings"')

    def test_an_empty_run_has_a_page(self):
        assert "<h1>" in render(a_run_of(notes=["nothing could be run"]), None)

    def test_hostile_text_is_text(self):
        sut = Sut(name=EVIL, version=EVIL, link=EVIL, node_id=EVIL, upper_tester=EVIL)
        run = a_run_of(a_case(Verdict.FAIL, text=EVIL, error_detail=EVIL), sut=sut, command=EVIL, notes=[EVIL])
        for text in (render(run, codec_of("dcp-2.0")), render_matrix([run, run])):
            assert "<script>document" not in text
            assert links_of(text).scripts == 1

    def test_hostile_descriptions_in_beacons_are_text(self):
        air = Script()
        create = air.create(1, 1, descr=b"<script>alert(1)</script>", value=b"<img src=x>")
        air.say(1, create, air.create(1, 1, descr=b"<b>"))
        text = render(judged(air.frames, "dcp-2.0"), codec_of("dcp-2.0"))
        assert "&lt;script&gt;alert(1)" in text
        assert links_of(text).scripts == 1
        assert links_of(text).loads == []


CHROMIUM = (
    "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
)  # fmt: skip


#: Elements that end right of the screen, and are in no box that scrolls.
WIDER = (
    "[...document.querySelectorAll('main *')].filter((each) => each.getBoundingClientRect().right > innerWidth + 1"
    " && !each.closest('.wide, .tree, pre')).map((each) => each.outerHTML.slice(0, 100))"
)


@pytest.mark.tool("chromium")
class TestInABrowser:
    def show(self, page: Path, tmp_path: Path, *options: str, fragment: str = "") -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*CHROMIUM, f"--user-data-dir={tmp_path / 'profile'}", *options, f"file://{page}{fragment}"],
            capture_output=True, text=True, timeout=600, check=True,
        )  # fmt: skip

    def test_the_script_runs_without_errors(self, failed: RunResult, tmp_path: Path):
        page = write_report(failed, tmp_path / "report")
        number = next(n for n, case in enumerate(failed.cases) if case.verdict is Verdict.PASS)
        done = self.show(page, tmp_path, "--enable-logging=stderr", "--v=0", "--dump-dom", fragment=f"#c{number}")
        assert "CONSOLE" not in done.stderr
        # The case that the address names was opened by the script.
        assert re.search(rf'<details class="card" id="c{number}"[^>]* open', done.stdout)

    def test_the_filter_hides_rows_that_do_not_match(self, failed: RunResult, tmp_path: Path):
        page = write_report(failed, tmp_path / "report")
        probe = (
            "<script>document.querySelector('#search').value = 'vd-rc-03';"
            "document.querySelector('#search').dispatchEvent(new Event('input'));</script>"
        )
        # The policy of the page lets no script run but its own.
        text = re.sub(r"<meta http-equiv[^>]*>", "", page.read_text()).replace("</body>", probe + "</body>")
        page.write_text(text)
        dom = self.show(page, tmp_path, "--dump-dom").stdout
        cards = re.findall(r'<details class="card" id="(c\d+)"([^>]*)>', dom)
        hidden = [name for name, attributes in cards if " hidden" in attributes]
        fitting = [f"c{n}" for n, case in enumerate(failed.cases) if "VD-RC-03" not in case.requirements]
        assert hidden == fitting
        assert 0 < len(hidden) < len(cards)

    def test_hostile_text_is_not_executed(self, tmp_path: Path):
        run = a_run_of(a_case(Verdict.FAIL, text=EVIL), sut=Sut(name=EVIL))
        page = write_report(run, tmp_path / "report")
        dom = self.show(page, tmp_path, "--dump-dom").stdout
        assert "<title>DCP conformance: &lt;script&gt;" in dom

    def test_a_small_screen_shows_all_of_the_page(self, failed: RunResult, passed: RunResult, tmp_path: Path):
        """Nothing is wider than the screen, with all details open; only tables of numbers and frames scroll."""
        report = write_report(failed, tmp_path / "report")
        (tmp_path / "matrix.html").write_text(render_matrix([failed, passed]))
        with Browser(tmp_path / "profile") as browser:
            browser.look(390, 900, touch=True)
            for page in (report, tmp_path / "matrix.html"):
                browser.open(page)
                browser.run(
                    "document.querySelectorAll('details').forEach((each) => { each.hidden = false; each.open = true; })"
                )
                assert browser.run("document.documentElement.scrollWidth") == 390
                assert browser.run(WIDER) == []

    def test_the_page_can_be_printed(self, failed: RunResult, tmp_path: Path):
        page = write_report(failed, tmp_path / "report")
        self.show(page, tmp_path, f"--print-to-pdf={tmp_path / 'page.pdf'}")
        assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")


class TestRecordings:
    def test_each_case_has_its_traffic_in_two_formats(self, failed: RunResult, tmp_path: Path):
        write_report(failed, tmp_path)
        run = load_results(tmp_path)
        for case in run.cases:
            sent = [bytes.fromhex(event.octets) for event in case.evidence if event.octets]
            if not sent:
                assert case.recording == ""
                continue
            for suffix in (".mcap", ".pcapng"):
                with open_capture(tmp_path / (case.recording + suffix)) as reader:
                    assert [frame.data for frame in reader] == sent
                    assert not reader.problems

    @pytest.mark.tool("tshark")
    def test_wireshark_reads_the_recordings(self, failed: RunResult, tmp_path: Path):
        write_report(failed, tmp_path)
        run = load_results(tmp_path)
        case = next(case for case in run.cases if case.recording)
        tshark = shutil.which("tshark") or ""
        done = subprocess.run(
            [tshark, "-r", tmp_path / f"{case.recording}.pcapng", "-T", "fields", "-e", "eth.type"],
            capture_output=True, text=True, timeout=600, check=True,
        )  # fmt: skip
        assert len(done.stdout.split()) == sum(bool(event.octets) for event in case.evidence)

    def test_odd_names_become_file_names(self, tmp_path: Path):
        write_report(a_run_of(a_case(Verdict.FAIL, "TC_VD/../../x<>_BV_01")), tmp_path)
        (case,) = load_results(tmp_path).cases
        assert (tmp_path / f"{case.recording}.mcap").resolve().is_relative_to(tmp_path.resolve())


class TestSeveralRuns:
    def test_runs_are_distinguished(self, failed: RunResult, passed: RunResult):
        assert len(set(labels([failed, passed]))) == 2
        assert len(set(labels([failed, failed, passed]))) == 3

    def test_the_matrix_has_every_requirement_that_any_decides(self, failed: RunResult, passed: RunResult):
        rows = dict(matrix([failed, passed, a_run_of()]))
        assert rows["VD-RC-03"] == [Verdict.FAIL, Verdict.PASS, None]
        assert set(rows) == set(failed.requirements) | set(passed.requirements)
        assert links_of(render_matrix([failed, passed])).loads == []

    def test_regressions_come_first(self, failed: RunResult, passed: RunResult):
        changes = compare(passed, failed)
        assert changes[0].kind == "regression"
        # Results that the fault made inconclusive change without having failed.
        better = {(each.kind, each.old) for each in compare(failed, passed)}
        assert {("fixed", Verdict.FAIL)} <= better <= {("fixed", Verdict.FAIL), ("changed", Verdict.INCONCLUSIVE)}
        assert compare(failed, failed) == []
        assert {each.kind for each in compare(a_run_of(), failed)} == {"new"}
        # A result that is missing may be hiding a fail; that of a retired case is not.
        gone = compare(failed, a_run_of(a_case(Verdict.PASS)))
        assert gone[0].kind == "gone"
        assert gone[0].kind in WORSE
        retired = msgspec.structs.replace(a_case(Verdict.PASS), id="TC_VD_HAZ_BO_04")
        assert [each.kind for each in compare(a_run_of(retired), a_run_of())] == ["retired"]

    def test_the_worst_of_several_attempts_counts(self):
        once = a_run_of(a_case(Verdict.PASS))
        twice = a_run_of(a_case(Verdict.FAIL), a_case(Verdict.PASS, attempt=2))
        (change,) = compare(once, twice)
        assert (change.kind, change.new) == ("regression", Verdict.FAIL)


class TestCommands:
    def test_a_page_is_regenerated(self, dcp_conformance: Command, failed: RunResult, tmp_path: Path):
        write_report(failed, tmp_path / "one")
        page = tmp_path / "again.html"
        done = dcp_conformance("report", tmp_path / "one", "--out", page)
        assert done.status == 0
        assert "TC_" in page.read_text()
        assert str(page) in done.out
        assert not done.err

    def test_runs_side_by_side(self, dcp_conformance: Command, failed: RunResult, passed: RunResult, tmp_path: Path):
        write_report(failed, tmp_path / "one")
        write_report(passed, tmp_path / "two")
        done = dcp_conformance("report", tmp_path / "one", tmp_path / "two", "-o", tmp_path / "m.html")
        assert done.status == 0
        assert re.search(r"VD-RC-03 +fail +pass", done.out)
        assert "VD-RC-03" in (tmp_path / "m.html").read_text()

    def test_compare_fails_on_a_regression(
        self, dcp_conformance: Command, failed: RunResult, passed: RunResult, tmp_path: Path
    ):
        write_report(failed, tmp_path / "bad")
        write_report(passed, tmp_path / "good")
        worse = dcp_conformance("compare", tmp_path / "good", tmp_path / "bad")
        assert worse.status == 1
        assert "pass -> fail" in worse.out
        better = dcp_conformance("compare", tmp_path / "bad", tmp_path / "good", "--json")
        assert better.status == 0
        kinds = {(each["kind"], each["old"]) for each in json.loads(better.out)}
        assert {("fixed", "fail")} <= kinds <= {("fixed", "fail"), ("changed", "inconclusive")}
        same = dcp_conformance("compare", tmp_path / "bad", tmp_path / "bad")
        assert same.status == 0
        assert "no verdict differs" in same.out

    def test_results_of_different_profiles_are_not_compared(
        self, dcp_conformance: Command, passed: RunResult, tmp_path: Path
    ):
        write_report(passed, tmp_path / "one")
        write_report(msgspec.structs.replace(passed, profile="dcp-1.3"), tmp_path / "two")
        done = dcp_conformance("compare", tmp_path / "one", tmp_path / "two")
        assert done.status == 2
        assert "dcp-1.3" in done.err

    @pytest.mark.parametrize("command", ["report", "compare"])
    def test_a_missing_folder_is_reported(self, dcp_conformance: Command, command: str, tmp_path: Path):
        done = dcp_conformance(command, tmp_path / "no", tmp_path / "no")
        assert done.status == 2
        assert "cannot be read" in done.err
