"""Requirements that a profile declares as not met are never a pass."""

from __future__ import annotations

import datetime
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.case import DECLARED, SANITY
from dcp_conformance.cli.display import print_summary
from dcp_conformance.declared import declared_by
from dcp_conformance.expected import ExpectedResults
from dcp_conformance.outcome import assemble
from dcp_conformance.pics import Pics
from dcp_conformance.reporting.page import render
from dcp_conformance.selftest import baseline
from dcp_conformance.verdict import Verdict
from dcp_spec.profile_loading import load_profile
from dcp_spec.requirements import requirements

from dcp_codec.values import VarSumm

from .air import Script, judged
from .rig import OTHER_PROFILES, PROFILES, codec_of, known_cases, one_case
from .test_reporting import a_case


@pytest.mark.parametrize("profile", PROFILES)
def test_the_profiles_of_the_specification_declare_nothing(profile: str):
    declared = declared_by(codec_of(profile).profile)
    assert (declared == {}) is profile.startswith("dcp-")
    assert ("DATA-01" in declared) is profile.startswith("cpp-")


@pytest.mark.parametrize("profile", [*PROFILES, *OTHER_PROFILES])
def test_what_is_declared_are_requirements(profile: str):
    assert set(declared_by(codec_of(profile).profile)) <= set(requirements())


def test_a_case_that_passes_is_no_pass_of_the_requirement(capsys: pytest.CaptureFixture[str]):
    case = one_case("TC_DCP_DATA_BV_02", "cpp-2.0")
    assert case.verdict is Verdict.PASS
    for profile, verdict in (("cpp-2.0", Verdict.INFO), ("dcp-2.0", Verdict.PASS)):
        run = assemble(codec_of(profile).profile, Pics(), [case])
        assert run.requirements["DATA-01"] is verdict
        print_summary(run)
        told = "DATA-01 is not met, as the profile declares: least significant octet first: timestamp"
        assert (told in capsys.readouterr().out) is (profile == "cpp-2.0")
        assert ("Not met, as the profile declares" in render(run, None)) is (profile == "cpp-2.0")


@pytest.mark.parametrize("profile", [*PROFILES, *OTHER_PROFILES])
def test_what_is_declared_fails_in_a_run(profile: str):
    codec = codec_of(profile)
    declared = declared_by(codec.profile)
    case = one_case(DECLARED, profile)
    run = assemble(codec.profile, Pics(), [case])
    failed = {each for each, verdict in run.requirements.items() if verdict is Verdict.FAIL}
    assert failed == set(declared)
    assert case.verdict is (Verdict.FAIL if declared else Verdict.NOT_APPLICABLE)
    for identifier, check in zip(declared, case.checks, strict=True) if declared else ():
        assert check.requirements == (identifier,)
        assert check.observed == f"declared by the profile {profile}: {declared[identifier]}"


def test_one_line_accepts_what_is_declared(tmp_path: Path):
    path = tmp_path / "expected.toml"
    path.write_text(f'[[expected]]\ncase = "{DECLARED}"\nreason = "the published layout"\nmatch = "cpp-2.0"\n')
    expected = ExpectedResults.load(path, known_cases().values())
    case = known_cases()[DECLARED]
    assert expected.judge(case, one_case(DECLARED, "cpp-2.0")) == ""
    assert expected.complaints([case], datetime.date(2030, 1, 1)) == []


def test_a_baseline_is_good_with_what_is_declared_and_with_nothing_else(monkeypatch: pytest.MonkeyPatch):
    chosen = tuple(known_cases()[each] for each in (SANITY, DECLARED, "TC_DCP_DATA_BV_02"))
    monkeypatch.setattr("dcp_conformance.selftest._cases", lambda: chosen)
    assert baseline("cpp-2.0").good
    monkeypatch.setattr("dcp_conformance.selftest.declared_by", lambda _: {"DATA-01": "less than there is"})
    assert [each.case for each in baseline("cpp-2.0").findings] == [DECLARED]


_FIRST_TWO, _EXCHANGED = ('"version", "magicNo"', '"magicNo", "version"')
_ALL = '"version", "magicNo", "senderId", "networkId", "length", "numPayloads", "seqno"'
WRONG: dict[str, tuple[str, str]] = {
    "order of the header": ("BP-HDR-10", f"[bp]\nheader = [{_ALL.replace(_FIRST_TWO, _EXCHANGED)}]"),
    "order of a block": ("BP-HDR-10", '[bp]\npayload_header = ["length", "protocolId"]'),
    "width of a number": ("BP-HDR-08", "[types]\nbp_seqno = { width = 2 }"),
    "description": ("DATA-07", "[types]\nstring = { lengths = [{ width = 2 }] }"),
    "value": ("DATA-06", "[types]\nvalue = { lengths = [{ width = 1 }], terminated = true }"),
    "report": ("SRP-TYP-03", '[srp]\nrecord = ["seqno", "sData", "nodeId", "tStamp"]'),
    "containers": ("VD-IC-02", "[vardis.container_types]\nSUMMARIES = 2\nUPDATES = 1"),
    "list": ("VD-IC-01", "[vardis]\nlist_length = { width = 2 }"),
    "order of octets": ("DATA-01", '[types]\nbp_length = { width = 2, byte_order = "little" }'),
}


@pytest.mark.parametrize("name", WRONG)
def test_each_departure_is_declared_under_its_requirement(name: str, tmp_path: Path):
    requirement, text = WRONG[name]
    path = tmp_path / "own.toml"
    path.write_text(f'extends = "dcp-2.0"\nname = "own"\ntitle = "own"\n{text}\n')
    assert list(declared_by(load_profile(path))) == [requirement]


@pytest.mark.parametrize(
    "text",
    [
        '[types]\nnode_id = { width = 8, representation = "hex" }\nvar_id = { width = 2 }\nvar_seqno = { width = 4 }',
        # VarLenT (X13)
        "[types]\nvalue = { lengths = [{ width = 2 }] }",
        '[types]\ntimestamp = { width = 4, unit = "ms" }\nnetwork_id = { width = 4 }',
        '[srp]\nsafety_data = [{ name = "height", type = "f32", byte_order = "little" }]',
        "[link]\nether_type = 0x88b5",
    ],
)
def test_what_the_specification_leaves_open_is_no_departure(text: str, tmp_path: Path):
    path = tmp_path / "own.toml"
    path.write_text(f'extends = "dcp-2.0"\nname = "own"\ntitle = "own"\n{text}\n')
    assert declared_by(load_profile(path)) == {}


def test_a_failure_stays_one():
    case = a_case(Verdict.FAIL)
    check = msgspec.structs.replace(case.checks[0], requirements=("DATA-01",))
    run = assemble(codec_of("cpp-2.0").profile, Pics(), [msgspec.structs.replace(case, checks=(check,))])
    assert run.requirements["DATA-01"] is Verdict.FAIL


def test_a_recording_shows_no_pass_either():
    air = Script("cpp-2.0")
    air.say(1, air.create(1, 1), VarSumm(1, 0))
    assert judged(air.frames, "cpp-2.0").requirements.get("DATA-01") is not Verdict.PASS
