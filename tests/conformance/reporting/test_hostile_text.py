"""Text from an implementation, an upper tester, a received frame or a file is shown, never interpreted."""

from __future__ import annotations

import re
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.cli.display import Display, data, print_summary
from dcp_conformance.definitions.outcome import assemble
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult, RunResult, Sut
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.workers.pytest_items import CaseVerdictError
from dcp_conformance.reporting import load_results, write_report
from dcp_conformance.reporting.junit import junit_xml
from dcp_conformance.reporting.page import render
from dcp_spec.catalogue.origins import REPOSITORY
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec.common.printable import plain

from ..command import Command
from ..rig import codec_of, known_cases
from .test_reporting import CHROMIUM, a_case, links_of

#: Colours, title, cursor (7 bit and 8 bit), the other direction of writing, markup of rich and of HTML, a link.
EVIL = (
    "[red]x[/red] [/] [link=javascript:alert(1)]y[/link] \x1b[31m \x1b]0;owned\x07 \x9b31m \r\x08 \u202e "
    "<script>document.title='owned'</script> <img src=x onerror=alert(1)> javascript:alert(1) '\"&]]>\x00 {{ 7*7 }}"
)
#: Control characters and direction marks, which no output may contain for any input.
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\u200e\u200f]")


def harmless(text: str) -> str:
    """A text without anything that a terminal obeys."""
    found = CONTROL.search(text)
    assert found is None, f"{found[0]!r} in {text[max(0, found.start() - 60) : found.end() + 20]!r}"
    return text


def evil_run(**more: object) -> RunResult:
    """Results that are full of it, wherever there is text."""
    cases = [
        msgspec.structs.replace(
            a_case(verdict, f"TC_VD_{number}_BV_01{EVIL}", EVIL, error_detail=EVIL),
            readings={"X02": EVIL, EVIL: EVIL},
            recording="javascript:alert(1)//",
            kind=EVIL,
            death=EVIL,
        )
        for number, verdict in enumerate(Verdict)
    ]
    killed = [msgspec.structs.replace(case, killed=True) for case in cases if case.verdict is Verdict.FAIL]
    sut = Sut(name=EVIL, version=EVIL, link=EVIL, node_id=EVIL, upper_tester=EVIL, methods=(EVIL,), spec_version=EVIL)
    run = assemble(codec_of("dcp-2.0").profile, Pics(), [*cases, *killed], sut=sut, command=EVIL, notes=[EVIL],
                   started=EVIL)  # fmt: skip
    invariants = tuple(msgspec.structs.replace(case, verdict=Verdict.PASS) for case in cases)
    return msgspec.structs.replace(
        run, tool=EVIL, profile_title=EVIL, spec_version=EVIL, invariants=invariants,
        requirements={**run.requirements, EVIL: Verdict.FAIL}, summary={EVIL: {EVIL: 3}}, **more,
    )  # fmt: skip


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results.json of theirs."""
    path = tmp_path / "results.json"
    path.write_bytes(msgspec.json.encode(evil_run(profile=EVIL)))
    return path


# -- the function ---------------------------------------------------------------------------------------------------


@given(st.text())
def test_plain_text_has_no_control_characters(text: str):
    assert plain(text).isprintable()
    assert plain(plain(text)) == plain(text)


@given(st.text(alphabet=st.characters(categories=["L", "N", "P", "S"])))
def test_printable_text_is_unchanged(text: str):
    assert plain(text) == text


def test_escapes_name_the_character():
    assert plain("a\x1b[31m\n\x9b\u202e\udcff") == r"a\x1b[31m\n\x9b\u202e\udcff"
    assert plain("a\nb\tc\r", keep="\n\t") == "a\nb\tc\\r"


# -- terminal -------------------------------------------------------------------------------------------------------


class TestTerminal:
    def test_the_summary(self, capsys: pytest.CaptureFixture[str]):
        print_summary(evil_run(), report=EVIL)
        out = harmless(capsys.readouterr().out)
        assert "[red]x[/red]" in out
        assert r"\x1b[31m \x1b]0;owned\x07 \x9b31m" in out

    def test_the_lines_of_a_run(self, capsys: pytest.CaptureFixture[str]):
        case = next(iter(known_cases().values()))
        with Display(verbose=True) as display:
            display.start(1)
            for result in evil_run().cases:
                display.result(case, result, EVIL)
        out = harmless(capsys.readouterr().out)
        assert out.count("[red]x[/red]") >= len(Verdict)

    @pytest.mark.parametrize("options", [(), ("-o", "page.html")])
    def test_report(self, dcp_conformance: Command, results: Path, tmp_path: Path, options: tuple[str, ...]):
        where = [str(tmp_path / each) if each.endswith("html") else each for each in options]
        done = dcp_conformance("report", results, *where)
        assert done.status == 0
        assert "[red]x[/red]" in harmless(done.out)
        harmless(done.err)

    def test_several_side_by_side(self, dcp_conformance: Command, results: Path, tmp_path: Path):
        done = dcp_conformance("report", results, results, "-o", tmp_path / "page.html")
        assert done.status == 0
        assert "[red]x[/red]" in harmless(done.out)

    @pytest.mark.parametrize("options", [(), ("--json",)])
    def test_compare(self, dcp_conformance: Command, results: Path, tmp_path: Path, options: tuple[str, ...]):
        other = tmp_path / "other.json"
        run = load_results(results)
        other.write_bytes(msgspec.json.encode(msgspec.structs.replace(run, cases=run.cases[:1])))
        done = dcp_conformance("compare", results, other, *options)
        assert "[red]x[/red]" in harmless(done.out)

    def test_names_of_files(self, dcp_conformance: Command, tmp_path: Path):
        name = "\x1b[31m[red]\u202e"
        for words in (("compare", name, name), ("report", name), ("check", name), ("run", "--in-process", name),
                      ("run", "--pics", name), ("run", f"--{name}"), (name,),
                      ("run", "--in-process", "--profile", name)):  # fmt: skip
            done = dcp_conformance(*words)
            assert done.status == 2
            harmless(done.out)
            assert r"\x1b[31m" in harmless(done.err)

    def test_pytest_escapes_hostile_text(self):
        for case in evil_run().cases:
            harmless(str(CaseVerdictError(case, EVIL)))

    def test_markup_of_our_own_still_works(self):
        assert data("[b]") == r"\[b]"


# -- pages and XML --------------------------------------------------------------------------------------------------


class TestFiles:
    def test_the_page_shows_hostile_text_without_links(self, results: Path):
        page = harmless(render(load_results(results), None))
        found = links_of(page)
        assert found.scripts == 1
        assert found.loads == []
        # Places in the specification are addresses of our own.
        assert all(link.startswith(("#", f"{REPOSITORY}/blob/")) for link in found.links)
        assert "&lt;script&gt;document.title" in page
        assert "{{ 7*7 }}" in page
        assert not re.search(r"<[^>]*\son\w+\s*=", page.replace("onerror=alert(1)&gt;", ""))

    def test_only_recordings_of_the_report_are_linked(self):
        run = evil_run()
        for recording, linked in (
            ("cases/TC_VD_X_BV_01", True), ("cases/TC.2", True), ("javascript:alert(1)//", False),
            ("cases/../../etc/passwd", False), ("//example.org/x", False), ("data:text/html,x", False),
            ("cases/..", False),
        ):  # fmt: skip
            cases = tuple(msgspec.structs.replace(case, recording=recording) for case in run.cases)
            links = links_of(render(msgspec.structs.replace(run, cases=cases), None)).links
            assert any(link.endswith(".mcap") for link in links) is linked, recording

    def test_only_its_own_script_may_run(self):
        page = render(evil_run(), None)
        [policy] = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)"', page)
        assert "default-src 'none'" in policy.replace("&#39;", "'")
        assert "unsafe-eval" not in policy
        assert not re.search(r"script-src[^;]*unsafe", policy)

    def test_invalid_frames(self):
        run = evil_run()
        for octets, start in (("zz", 0), ("ff", 99), ("ff" * 60, -5), ("", 14)):
            cases = tuple(
                msgspec.structs.replace(
                    case,
                    evidence=tuple(
                        msgspec.structs.replace(event, octets=octets, start=start, frame=1) for event in case.evidence
                    ),
                )
                for case in run.cases
            )
            harmless(render(msgspec.structs.replace(run, cases=cases), codec_of("dcp-2.0")))

    def test_a_profile_in_results_is_never_opened_as_a_path(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        from dcp_conformance.reporting.files import codec_of as codec_of_run

        path = tmp_path / "profile.toml"
        path.write_text('extends = "dcp-2.0"\nname = "mine"\n')
        assert codec_of_run(evil_run(profile=str(path))) is None
        assert codec_of_run(evil_run()) is not None

    def test_junit(self):
        octets = junit_xml(evil_run())
        root = ET.fromstring(octets)
        harmless(octets.decode())
        assert any("[red]x[/red]" in (element.get("message") or "") for element in root.iter())

    @pytest.mark.tool("chromium")
    def test_a_browser_executes_no_hostile_text(self, results: Path, tmp_path: Path):
        page = write_report(load_results(results), tmp_path / "report")
        done = subprocess.run(
            [*CHROMIUM, f"--user-data-dir={tmp_path / 'profile'}", "--enable-logging=stderr", "--dump-dom", f"file://{page}"],
            capture_output=True, text=True, timeout=600, check=True,
        )  # fmt: skip
        assert "<title>owned" not in done.stdout
        assert "CONSOLE" not in done.stderr


def test_one_number_of_cases_everywhere(capsys: pytest.CaptureFixture[str]):
    repeated = [msgspec.structs.replace(a_case(Verdict.PASS, "TC_DCP_SANITY_BV_01"), attempt=n, counted=n == 1)
                for n in (1, 2, 3)]  # fmt: skip
    run = assemble(codec_of("dcp-2.0").profile, Pics(), [*repeated, a_case(Verdict.FAIL)])
    print_summary(run)
    assert "\n2 cases in" in capsys.readouterr().out
    assert ET.fromstring(junit_xml(run)).get("tests") == "2"
    page = render(run, None)
    assert "for 2 cases" in page
    tiles = re.findall(r'<b class="[a-z-]+">(\d+)</b><span>', page)
    assert sum(map(int, tiles)) == 2
    assert sum(run.summary["conformance"].values()) == 2


def died(number: int, how: str) -> CaseResult:
    case = a_case(Verdict.FAIL, f"TC_VD_D_BV_{number:02}")
    check = msgspec.structs.replace(case.checks[0], expected="the implementation survives", observed=how)
    return msgspec.structs.replace(case, checks=(check,), killed=True, death=how)


def test_many_crashes_with_one_cause_are_one_finding(capsys: pytest.CaptureFixture[str]):
    alone = died(90, "died: another way")
    run = assemble(codec_of("dcp-2.0").profile, Pics(), [*(died(n, "died: status 1") for n in range(38)), alone])
    print_summary(run)
    out = capsys.readouterr().out
    assert out.count("died: status 1") == 1
    assert "fail 38 cases: the implementation died: status 1" in out
    assert "TC_VD_D_BV_90" in out
    page = render(run, None)
    [findings] = re.findall(r'id="findings".*?<h2', page, re.DOTALL)
    assert findings.count("<details") == 2 + 1
    assert "38 cases" in findings
    ids = links_of(page)
    assert {link[1:] for link in ids.links if link.startswith("#")} - {"findings"} <= set(ids.ids) | {"failing"}


def test_the_page_begins_with_the_sentence_that_matters():
    verdicts = {f"VD-TYP-0{number}": Verdict.PASS for number in range(1, 6)}
    run = assemble(codec_of("dcp-2.0").profile, Pics(), [a_case(Verdict.FAIL)])
    for more, sentence in (
        ({}, "5 requirements pass, none fails."),
        ({"BP-HDR-01": Verdict.FAIL}, "5 requirements pass, 1 fails."),
        ({"BP-HDR-01": Verdict.FAIL, "BP-HDR-02": Verdict.FAIL}, "5 requirements pass, 2 fail."),
        ({"BP-HDR-01": Verdict.INCONCLUSIVE}, "5 requirements pass, none fails; 1 is inconclusive."),
    ):
        page = render(msgspec.structs.replace(run, requirements={**verdicts, **more}), None)
        assert f'<p class="headline">{sentence}</p>' in page


def test_readings_that_differ_from_the_reference_are_marked(capsys: pytest.CaptureFixture[str]):
    case = msgspec.structs.replace(
        a_case(Verdict.PASS), readings={"X03": "increment-then-write", "X02": "length-field", "H1": "seen"}
    )
    run = assemble(codec_of("dcp-2.0").profile, Pics(), [case])
    print_summary(run)
    out = capsys.readouterr().out
    assert "\nreadings: X02 length-field\n" in out
    reference = "increment-then-write (reference: write-then-increment)"
    assert f"\nreadings that differ from the reference reading: X03 {reference}\n" in out
    page = render(run, None)
    assert re.findall(r'<b class="differs">([^<]*)</b>', page) == [reference]
    assert "<b>length-field</b>" in page
