"""A pass says that something was shown: with the number of occasions, and not from a handful of frames."""

from __future__ import annotations

import html
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner
from dcp_conformance.check.base import Invariant
from dcp_conformance.check.judge import LEAST_BEACONS, RULES, Judge
from dcp_conformance.check.wording import CONSEQUENCES, differences, moment, spec_text
from dcp_conformance.cli.check import command
from dcp_conformance.cli.display import print_summary
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reporting.page import render

from dcp_codec import Beacon, BPHeader, Container, Payload, VarSpec, VarSumm, get_codec
from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.framing.envelope import Envelope

from ..air import Script, case_of, judged

CAPTURES = Path(__file__).resolve().parents[3] / "captures"


def frames_of(name: str) -> list[Frame]:
    with open_capture(CAPTURES / name) as reader:
        return list(reader)


def test_a_cut_off_recording_passes_nothing():
    run = judged(frames_of("b_crud.mcap")[:12], "cpp-2.0", enough=None)
    assert Verdict.PASS not in run.requirements.values()
    assert Verdict.TOO_LITTLE in run.requirements.values()
    case = case_of(run, "CK_BP_SEQNO")
    assert case.verdict is Verdict.TOO_LITTLE
    assert "too few for a verdict: 9 to 11 occasions in 12 beacons" in case.reason


def test_a_whole_recording_passes_with_the_number_of_occasions():
    run = judged(frames_of("b_crud.mcap"), "cpp-2.0", enough=None)
    case = case_of(run, "CK_BP_SIZE")
    assert case.verdict is Verdict.PASS
    assert case.occasions == {"BP-FMT-02": 563}
    assert case.checks[-1].expected == "a bearer payload within the maximum packet size (563 occasions)"
    assert run.occasions["BP-FMT-02"] == 563
    # A failed requirement has occasions, too.
    assert run.requirements["VD-RU-04"] is Verdict.FAIL
    assert run.occasions["VD-RU-04"] > 90
    # Every requirement that passes was checked at least ``enough`` times.
    enough = {each: rule.enough for rule in RULES for each in rule.requirements}
    for identifier, verdict in run.requirements.items():
        if verdict is Verdict.PASS:
            assert run.occasions[identifier] >= min(enough[identifier], LEAST_BEACONS)


@pytest.mark.parametrize(
    ("frames", "verdict"), [(LEAST_BEACONS - 1, Verdict.TOO_LITTLE), (LEAST_BEACONS, Verdict.PASS)]
)
def test_a_verdict_depends_on_the_number_of_occasions(frames, verdict):
    run = judged(frames_of("b_crud.mcap")[:frames], "cpp-2.0", enough=None)
    assert run.requirements["BP-FMT-02"] is verdict


def test_a_pass_is_withheld_if_there_is_contrary_evidence():
    judge = Judge(get_codec("cpp-2.0"), Pics())
    for frame in frames_of("b_crud.mcap"):
        judge.feed(frame)
    judge._context.withhold("BP-FMT-02", "201 of 201 requests had no answer")
    judge._context.withhold("BP-FMT-02", "something else")
    run = judge.result()
    assert run.requirements["BP-FMT-02"] is Verdict.INCONCLUSIVE
    assert case_of(run, "CK_BP_SIZE").reason.endswith("201 of 201 requests had no answer")


def test_rules_have_thresholds_and_consequences():
    assert all(issubclass(rule, Invariant) and rule.enough >= 1 for rule in RULES)
    assert set(CONSEQUENCES) <= {rule.id for rule in RULES}


def test_findings_say_when_and_how_to_see_them():
    frames = frames_of("a_bus3.mcap")
    case = case_of(judged(frames, "cpp-2.0", enough=None), "CK_DATA_PACKED")
    assert case.verdict is Verdict.FAIL
    (mark, *_) = case.checks[0].frames
    assert case.checks[0].seconds == (frames[mark.frame - 1].time_ns - frames[0].time_ns) / 1e9
    assert case.show == f"dcp-codec decode test.mcap --profile cpp-2.0 --frames {mark.frame}" or "-" in case.show
    assert case.consequence.endswith(".")


def test_differences_are_reported_by_field():
    spec = VarSpec(7, b"\x02\0\0\0\0\1", 2, b"pos", 5, 0)
    other = VarSpec(7, b"\x02\0\0\0\0\2", 3, b"\xff", 5, 1)
    assert differences(spec, other) == (
        "prodId 02:00:00:00:00:01 -> 02:00:00:00:00:02, repCnt 2 -> 3, descr 'pos' -> '\\\\xff', timeout 0 -> 1"
    )
    assert spec_text(spec) == "prodId 02:00:00:00:00:01, repCnt 2, descr 'pos', creationTime 5, timeout 0"
    assert moment(2.5) == "at +2.500 s"


def test_the_command_shows_occasions(tmp_path):
    short = tmp_path / "short.pcap"
    with create_capture(short) as writer:
        for frame in frames_of("b_crud.mcap")[:12]:
            writer.write(frame)
    options = ["--profile", "cpp-2.0", "--requirements", "--report-dir", str(tmp_path / "r")]
    done = CliRunner().invoke(command, [str(short), *options], env={"COLUMNS": "200"}, standalone_mode=False)
    assert "too little" in done.output
    assert re.search(r"BP-FMT-02 +too-little +12 ", done.output)
    told = json.loads((tmp_path / "r" / "results.json").read_text())
    assert told["occasions"]["BP-FMT-02"] == 12
    page = (tmp_path / "r" / "report.html").read_text()
    assert "too little" in page


def check(*words: object) -> tuple[int, str]:
    """Call ``dcp-conformance check``; return its exit status and output."""
    done = CliRunner().invoke(command, [str(each) for each in words], env={"COLUMNS": "200"}, standalone_mode=False)
    assert done.exception is None
    return done.return_value, done.output


def test_quiet_shows_findings_and_damage_alone(tmp_path):
    whole = CAPTURES / "b_crud.mcap"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    status, told = check("-q", cut)
    assert status == 1
    first, _, findings = told.partition("\n")
    assert re.match(re.escape(f"{cut}: ") + r"\w", first)
    assert "\nfail CK_" in findings
    assert "CK_DATA" in findings
    for absent in ("observed\n", "requirements:", "note:", "robustness"):
        assert absent not in told
    assert f"{whole}: " not in check("-q", whole)[1]


def test_a_file_that_cannot_be_read_does_not_hide_the_others(tmp_path):
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"")
    alone = check(CAPTURES / "b_crud.mcap")[1]
    status, told = check(bad, CAPTURES / "b_crud.mcap")
    assert status == 2
    assert told.startswith(f"dcp-conformance: {bad}: ")
    assert re.findall("fail CK_.*", told) == re.findall("fail CK_.*", alone) != []


def test_one_question_does_not_displace_the_other_observations(capsys):
    checks = [Check(Verdict.INFO, (), "mean interval", f"of node {each}") for each in range(30)]
    checks.append(Check(Verdict.INFO, (), "requests without end", "of node 7"))
    run = judged(frames_of("b_crud.mcap")[:12], "cpp-2.0")
    run = msgspec.structs.replace(run, cases=(msgspec.structs.replace(run.cases[0], checks=tuple(checks)),))
    print_summary(run)
    shown = capsys.readouterr().out
    assert "requests without end: of node 7" in shown
    assert shown.count("mean interval: of node") == 11
    assert "... and 19 more" in shown


def test_the_page_shows_who_holds_what_and_who_hears_whom():
    """The data of the page is that of the results, and cannot end the element that it is in."""
    run = judged(frames_of("b_crud.mcap"), "cpp-2.0", enough=None)
    assert run.holdings["nodes"] == [f"02:00:00:00:00:0{each}" for each in (1, 2, 3)]
    assert sorted(run.holdings["variables"])[:3] == [10, 11, 12]
    assert all(0 < each.share <= 1 and each.reactions <= each.trials for each in run.links)
    page = render(run, None)
    assert _data(page) == json.loads(json.dumps(run.holdings))
    assert "Reception between nodes" in page
    hostile = msgspec.structs.replace(run, holdings=run.holdings | {"nodes": ["</div><b>", "b", "c"]})
    page = render(hostile, None)
    assert "</div><b>" not in page
    assert _data(page)["nodes"][0] == "</div><b>"


def _data(page: str) -> dict[str, Any]:
    found = re.search(r'<div id="holds-data" hidden>(.*?)</div>', page, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(html.unescape(found[1]))
    return data


@pytest.mark.tool("chromium")
def test_the_page_marks_stale_states(tmp_path):
    run = judged(frames_of("b_crud.mcap"), "cpp-2.0", enough=None)
    (tmp_path / "page.html").write_text(render(run, None), encoding="utf-8")
    chromium = ["chromium", "--headless", "--no-sandbox", "--virtual-time-budget=3000", "--dump-dom"]
    done = subprocess.run([*chromium, f"file://{tmp_path}/page.html"], capture_output=True, timeout=60, check=True)
    dom = done.stdout.decode()
    table = dom[dom.index('id="holds"') :]
    row = re.search(r'<th scope="row" title="variable 11">11</th>(.*?)</tr>', table)
    assert row is not None
    assert re.findall(r'class="(\w*)"[^>]*>([^<]*)<(?:small>([^<]*))?', row[1]) == [
        ("own", "\u00d7", ""),
        ("bad", "5", "\u22121 \u00d7, 3.2 s"),
        ("bad", "5", "\u22121 \u00d7, 3.2 s"),
    ]
    assert re.search(r"\+[0-9.]+ s: [2-9] states are stale, the oldest ", dom)


def test_a_bad_payload_is_not_evidence_of_padding():
    """A test pattern in place of a report that has opaque octets in the profile: no part of it is a pointer."""
    codec = get_codec("cpp-1.3")
    vardis = codec.encode_containers((Container(1, (VarSumm(7, 3),)),))
    frames = []
    for number in range(40):
        node = b"\x02\0\0\0\0\1"
        octets = codec.encode_envelope(
            Beacon(BPHeader(node, number), (Payload(1, bytes(range(0x20, 0x48))), Payload(2, vardis)))
        )
        data = Envelope(codec.profile.link).frame(octets, node)
        frames.append(Frame(number + 1, 1_750_000_000_000_000_000 + number * 100_000_000, data, len(data)))
    run = judged(frames, "cpp-1.3", enough=None)
    assert case_of(run, "CK_BP_FORMAT").verdict is Verdict.FAIL
    assert case_of(run, "CK_DATA_PACKED").verdict is Verdict.NOT_APPLICABLE
    # The remaining contents of the beacon are judged.
    assert case_of(run, "CK_VD_SEQNO").occasions["VD-TYP-03"] == 39


def test_jumps_of_a_node_are_one_observation():
    air = Script("cpp-2.0")
    for number in range(1, 40):
        air.say(1, report=air.report(1, seqno=number << 24))
    run = judged(air.frames, "cpp-2.0", enough=None)
    jumps = [each for each in case_of(run, "CK_SRP_SEQNO").checks if "a jump" in each.expected]
    assert len(jumps) == 1
    assert re.search(r": 33554432 after 16777216; \d\d jumps in all", jumps[0].observed)
