"""Findings as files: they are complete, their replay reports the outcome, and they are cases of a run."""

from __future__ import annotations

import json
import random

import pytest
from dcp_conformance.cli import main
from dcp_conformance.errors import UsageError
from dcp_lab.fuzz import Call, Campaign, Effect, Frame, Wait, load, save
from dcp_lab.fuzz.findings.artefact import SavedTarget, codec_of, found_in, make_artefact
from dcp_lab.fuzz.findings.cases import artefact_cases
from dcp_lab.fuzz.findings.description import evidence_lines, headline, summary_lines
from dcp_lab.fuzz.findings.replaying import judged, replay
from dcp_lab.fuzz.generate.samples import Samples
from dcp_lab.fuzz.reduce.causes import explained
from dcp_lab.fuzz.reduce.reduction import Finding
from dcp_lab.fuzz.steps import ROBUSTNESS
from dcp_lab.testing.mutation_values import valid_beacons
from dcp_selftest.fuzz.targets import target_in_process

from dcp_codec import Beacon, BPHeader, Codec, Payload
from dcp_codec.capture import open_capture
from dcp_codec.values import Container, VarSumm

CODEC = Codec("dcp-2.0")
#: A beacon that announces more octets than there are: M-BP-RX-15-dies crashes on it.
TOO_LONG = bytes.fromhex("01497e02dc900000011111ffff0100000001000200020100")
SOUND = Samples(CODEC).each()[0]
STEPS = [Frame(TOO_LONG, b"", "by hand"), Wait(0.5), Call("RTDB-Read", {"varId": 1})]


def summaries(count):
    return (Container(1, tuple(VarSumm(each, 1) for each in range(count))),)


def saved(folder, effect=None, mutant="M-BP-RX-15-dies", steps=STEPS, mode="stack", **more):
    effect = effect or Effect("raised", "IndexError: a read past the end of the frame", 0, "IndexError in repaired")
    target = SavedTarget(mode, "a mutant", mutant)
    cause = explained(CODEC, steps, effect) if mode != "codec" else None
    found = Finding(list(steps), effect, minimised=True, confirmed=True, cause=cause)
    artefact = make_artefact(CODEC, found, target, seed=7, directory=folder, **more)
    return save(artefact, folder)


def test_artefacts_survive_a_round_trip(tmp_path):
    path = saved(tmp_path / "findings")
    artefact = load(path)
    assert artefact.as_steps() == STEPS
    assert (artefact.profile, artefact.seed, artefact.schema, artefact.frames) == ("dcp-2.0", 7, 1, 1)
    assert artefact.tool.startswith("dcp-conformance ")
    assert str(path) in artefact.command
    with open_capture(path.with_suffix(".mcap")) as reader:
        assert [frame.data[14:] for frame in reader] == [TOO_LONG]


def test_the_same_finding_has_the_same_name_and_another_has_another(tmp_path):
    one, again = saved(tmp_path / "one"), saved(tmp_path / "two")
    other = saved(tmp_path / "one", steps=[Frame(TOO_LONG + b"\0")])
    assert one.name == again.name != other.name


def test_a_custom_profile_is_embedded(tmp_path):
    text = 'extends = "dcp-2.0"\nname = "mine"\n[link]\nether_type = 0x9999\n'
    artefact = load(saved(tmp_path, profile_text=text))
    assert codec_of(artefact).profile.link.ether_type == 0x9999


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"nonsense", "not an artefact"),
        (b"{}", "not an artefact"),
        (b"\xff\xfe", "not an artefact"),
    ],
)
def test_a_file_that_is_not_an_artefact_is_refused(tmp_path, content, says):
    path = tmp_path / "raised-00000000.json"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=says):
        load(path)


@pytest.mark.parametrize(
    ("member", "value", "says"),
    [("schema", 99, "schema 99"), ("steps", [{"frame": "zz"}], "step 0"), ("steps", [{}], "neither a frame")],
)
def test_an_artefact_that_cannot_be_used_is_refused_with_the_reason(tmp_path, member, value, says):
    path = saved(tmp_path)
    content = json.loads(path.read_bytes())
    content[member] = value
    path.write_text(json.dumps(content))
    with pytest.raises(UsageError, match=says):
        load(path)


def test_folders_are_searched_for_artefacts_only(tmp_path):
    path = saved(tmp_path)
    (tmp_path / "campaign.json").write_text("{}")
    assert found_in([tmp_path]) == [path]
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no artefacts"):
        found_in([tmp_path / "empty"])


def test_replay_reports_failed_fixed_and_error(tmp_path):
    assert replay(saved(tmp_path / "a"), target_in_process).status == "failed"
    assert replay(saved(tmp_path / "b", mutant=""), target_in_process).status == "fixed"
    assert replay(saved(tmp_path / "c", mutant="M-NOTHING"), target_in_process).status == "error"
    assert replay(saved(tmp_path / "d", mode="live"), target_in_process).status == "error"
    assert replay(tmp_path / "nothing.json", target_in_process).status == "error"


def test_findings_in_our_own_code_are_replayed_by_another_command(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["fuzz", "replay", str(saved(tmp_path))])
    assert stop.value.code == 4
    assert "use dcp-selftest fuzz replay" in capsys.readouterr().out


def test_replay_reports_flaky_findings(tmp_path):
    artefact = load(saved(tmp_path))
    same = Effect("raised", "IndexError: other words", 3, "IndexError in repaired")
    other = Effect("mute", "silent", 0)
    assert judged(artefact, [same, same, same])[0] == "failed"
    assert judged(artefact, [None, same, None]) == ("flaky", "the effect in 1 of 3 attempts")
    assert judged(artefact, [other, other])[0] == "flaky"
    assert "silent" in judged(artefact, [other, same])[1]
    assert judged(artefact, [None])[0] == "fixed"


def test_identifiers_of_cases_do_not_depend_on_other_artefacts(tmp_path):
    path = saved(tmp_path)
    [case] = artefact_cases(tmp_path)
    assert case.id == f"TC_DCP_FUZZ_BI_01-{path.stem}"
    assert case.destructive
    saved(tmp_path, steps=[Frame(b"\0")])
    saved(tmp_path, steps=[Frame(b"\0", b"", "pics")], mode="codec")
    cases = artefact_cases(tmp_path)
    assert len(cases) == 2
    assert case.id in [each.id for each in cases]


def test_the_requirement_of_a_finding_is_kept_and_named_by_its_case(tmp_path):
    """A wrong beacon is not a death: the requirement is that for its sender."""
    path = saved(tmp_path, Effect("bad-beacon", "an invalid beacon", 0, "zero-count BP-HDR-07"))
    assert load(path).effect.requirements == ("BP-HDR-07",)
    [case] = artefact_cases(tmp_path)
    assert case.requirements == ("BP-HDR-07",)
    assert not case.robustness
    gone = Effect("dead", "it is gone", 0, "dead")
    assert load(saved(tmp_path / "dead", gone, steps=[Frame(SOUND)])).effect.requirements == ROBUSTNESS
    [case] = artefact_cases(tmp_path / "dead")
    assert (case.requirements, case.robustness) == (ROBUSTNESS, True)


def test_a_crash_fails_the_requirements_about_the_damage_that_caused_it(tmp_path):
    """How else a node reacts to damage is most often its own choice: only survival is due."""
    gone = Effect("dead", "it is gone", 0, "dead")
    for number, (octets, requirements) in enumerate(
        [
            (SOUND[:11] + b"\xff\xff" + SOUND[13:], ("BP-RX-15",)),
            (SOUND[:12], ("BP-RX-16",)),
            (b"", ("BP-RX-16",)),
            (SOUND[:-2] + b"\x00\x00", ("VD-ROB-01",)),
            (SOUND[:12] + b"\x04" + SOUND[13:21] + b"\x00", ("BP-RX-16", "VD-ROB-01")),
        ]
    ):
        path = saved(tmp_path / str(number), gone, steps=[Frame(octets)])
        assert load(path).effect.requirements == requirements, octets.hex()


def test_an_artefact_is_shown_with_its_frames(tmp_path):
    beacon = valid_beacons(CODEC, random.Random(3), 1)[0]
    steps = [*STEPS, *[Frame(beacon)] * 9]
    told = [*evidence_lines(CODEC, load(saved(tmp_path, Effect("dead", "it is gone", 0, "dead"), steps=steps)))]
    assert told[0].startswith("sent      SUMMARIES(")
    assert told[0].endswith("ERROR beacon-overrun at bp.length [BP-RX-15]")
    assert told[1] == "wait      0.5 beacon periods"
    assert told[2] == 'call      RTDB-Read {"varId":1}'
    assert "... and 7 more steps" in told
    assert told[-3].startswith("cause     beacon-overrun at bp.length, zero-count at payloads[].vardis[].icNumRecords")
    assert told[-2].startswith("decides   BP-RX-15 (dcp-bp.md")
    assert told[-1].startswith("decides   VD-ROB-01 (")


def test_output_of_an_implementation_is_escaped_on_the_terminal(tmp_path):
    hostile = "it ended; its output: \x1b[2J\x1b]0;owned\x07\u202e"
    folder = tmp_path / "findings"
    artefact = load(saved(folder, Effect("dead", hostile, 0, "dead"), steps=[Frame(SOUND)]))
    campaign = Campaign(CODEC, target_in_process(artefact), None, artefact.target, 1, directory=folder)
    campaign.keep(Finding([Frame(SOUND)], Effect("dead", hostile, 0, "dead"), True, True, artefact.cause))
    told = [headline(artefact), *evidence_lines(CODEC, artefact), *summary_lines(campaign)]
    assert any("owned" in line for line in told)
    assert all(line.isprintable() for line in told)


def test_anomalies_are_shown_for_frames_of_any_length(tmp_path):
    long = Frame(CODEC.encode(Beacon(BPHeader(b"\2\0\0\0\0\1", 1, 0x1111), (Payload(2, summaries(200)),)))[:-1])
    line, _ = evidence_lines(CODEC, load(saved(tmp_path, Effect("unbounded", "x", 0), steps=[long])))
    assert line.endswith("ERROR beacon-overrun at bp.length [BP-RX-15]")
    assert len(line) < 300


@pytest.mark.parametrize(("mutant", "verdict"), [("", "pass"), ("M-BP-RX-15-dies", "fail")])
def test_artefacts_are_cases_of_the_runner(tmp_path, mutant, verdict):
    from dcp_conformance.definitions.pics import Pics
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.reference.inprocess import InProcess, plain_node, reference_config
    from dcp_conformance.test_system.bench import Session
    from dcp_selftest.mutants import all_mutants

    saved(tmp_path)
    [case] = artefact_cases(tmp_path)
    make = all_mutants()[mutant].make if mutant else plain_node
    sut = InProcess(reference_config(CODEC), make=make)
    runner = Runner(Session(CODEC, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    result = runner.run(case)
    assert str(result.verdict) == verdict
    assert result.killed == bool(mutant)


def test_an_artefact_of_another_profile_is_inconclusive(tmp_path):
    from dcp_conformance.definitions.pics import Pics
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.reference.inprocess import InProcess, reference_config
    from dcp_conformance.test_system.bench import Session

    saved(tmp_path)
    [case] = artefact_cases(tmp_path)
    codec = Codec("dcp-1.3")
    sut = InProcess(reference_config(codec))
    result = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut).run(case)
    assert str(result.verdict) == "inconclusive"
