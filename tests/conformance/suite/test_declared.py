"""Requirements that a profile or a PICS declares as not met fail, in every command."""

from __future__ import annotations

import datetime
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result
from dcp_conformance.check.judge import Judge
from dcp_conformance.cli.compare import command as compare_cli
from dcp_conformance.cli.display import print_summary
from dcp_conformance.definitions.case import DECLARED, DENIED, SANITY
from dcp_conformance.definitions.declared import declared_by, denied_by
from dcp_conformance.definitions.outcome import AS_EXPECTED, INCONCLUSIVE, assemble, exit_status
from dcp_conformance.definitions.pics import Capabilities, Pics
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.expected import ExpectedResults
from dcp_conformance.reporting import write_report
from dcp_conformance.reporting.page import render
from dcp_selftest.runner import baseline
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.profile.loading import load_profile

from dcp_codec.values import VarSumm

from ..air import Script, judged
from ..reporting.test_reporting import a_case
from ..rig import OTHER_PROFILES, PROFILES, codec_of, known_cases, one_case


@pytest.mark.parametrize("profile", PROFILES)
def test_the_profiles_of_the_specification_declare_nothing(profile: str):
    declared = declared_by(codec_of(profile).profile)
    assert (declared == {}) is profile.startswith("dcp-")
    # cpp-1.2 has no time stamp in any record, and so none in the wrong order.
    assert ("DATA-01" in declared) is (profile.startswith("cpp-") and profile != "cpp-1.2")


@pytest.mark.parametrize("profile", [*PROFILES, *OTHER_PROFILES])
def test_declarations_are_requirements(profile: str):
    assert set(declared_by(codec_of(profile).profile)) <= set(requirements())


def test_a_passing_case_does_not_pass_a_declared_requirement(capsys: pytest.CaptureFixture[str]):
    case = one_case("TC_DCP_DATA_BV_02", "cpp-2.0")
    assert case.verdict is Verdict.PASS
    for profile, verdict in (("cpp-2.0", Verdict.FAIL), ("dcp-2.0", Verdict.PASS)):
        run = assemble(codec_of(profile).profile, Pics(), [case])
        assert run.requirements["DATA-01"] is verdict
        print_summary(run)
        told = "DATA-01 is not met, as the profile declares: little-endian: timestamp"
        assert (told in capsys.readouterr().out) is (profile == "cpp-2.0")
        assert ("Not met, as the profile declares" in render(run, None)) is (profile == "cpp-2.0")


@pytest.mark.parametrize("profile", [*PROFILES, *OTHER_PROFILES])
def test_declared_requirements_fail_in_a_run(profile: str):
    codec = codec_of(profile)
    declared = declared_by(codec.profile)
    case = one_case(DECLARED, profile)
    run = assemble(codec.profile, Pics(), [case])
    failed = {each for each, verdict in run.requirements.items() if verdict is Verdict.FAIL}
    assert failed == set(declared) | set(denied_by(Capabilities(), codec.profile))
    assert case.verdict is (Verdict.FAIL if declared else Verdict.NOT_APPLICABLE)
    for identifier, check in zip(declared, case.checks, strict=True) if declared else ():
        assert check.requirements == (identifier,)
        assert check.observed == f"declared by the profile {profile}: {declared[identifier]}"


def test_one_line_accepts_all_declared_requirements(tmp_path: Path):
    path = tmp_path / "expected.toml"
    path.write_text(f'[[expected]]\ncase = "{DECLARED}"\nreason = "the published layout"\nmatch = "cpp-2.0"\n')
    expected = ExpectedResults.load(path, known_cases().values())
    case = known_cases()[DECLARED]
    assert expected.judge(case, one_case(DECLARED, "cpp-2.0")) == ""
    assert expected.complaints([case], datetime.date(2030, 1, 1)) == []


def test_a_baseline_accepts_declared_requirements_only(monkeypatch: pytest.MonkeyPatch):
    chosen = tuple(known_cases()[each] for each in (SANITY, DECLARED, "TC_DCP_DATA_BV_02"))
    monkeypatch.setattr("dcp_selftest.runner.cases", lambda: chosen)
    assert baseline("cpp-2.0").good
    monkeypatch.setattr("dcp_selftest.runner.declared_by", lambda _: {"DATA-01": "less than there is"})
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
def test_each_deviation_is_declared_under_its_requirement(name: str, tmp_path: Path):
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
def test_choices_permitted_by_the_specification_are_not_deviations(text: str, tmp_path: Path):
    path = tmp_path / "own.toml"
    path.write_text(f'extends = "dcp-2.0"\nname = "own"\ntitle = "own"\n{text}\n')
    assert declared_by(load_profile(path)) == {}


def test_a_failure_of_a_declared_requirement_is_kept():
    case = a_case(Verdict.FAIL)
    check = msgspec.structs.replace(case.checks[0], requirements=("DATA-01",))
    run = assemble(codec_of("cpp-2.0").profile, Pics(), [msgspec.structs.replace(case, checks=(check,))])
    assert run.requirements["DATA-01"] is Verdict.FAIL


def test_a_declared_requirement_does_not_pass_in_a_recording():
    air = Script("cpp-2.0")
    air.say(1, air.create(1, 1), VarSumm(1, 0))
    assert judged(air.frames, "cpp-2.0").requirements.get("DATA-01") is not Verdict.PASS


# -- the PICS ----------------------------------------------------------------------------------------------------------

DENIALS = {
    "payload_transmitted_indication": ("dcp-2.0", ["BP-PTI-01", "BP-PTI-02", "BP-PTI-03"]),
    "runtime_parameters": ("dcp-1.2", ["BP-PAR-01"]),
    "transmit_payload_confirm": ("dcp-1.1", ["BP-TXP-11"]),
}


@pytest.mark.parametrize("name", DENIALS)
def test_a_pics_that_denies_something_mandatory_fails_in_run_and_check(name: str, capsys: pytest.CaptureFixture[str]):
    profile, identifiers = DENIALS[name]
    capabilities = Capabilities(**{name: False})
    codec, pics = codec_of(profile), Pics(pics=capabilities)
    assert list(denied_by(capabilities, codec.profile)) == identifiers
    case = one_case(DENIED, profile, pics=pics)
    assert case.verdict is Verdict.FAIL
    assert [check.requirements for check in case.checks] == [(each,) for each in identifiers]
    for run in (
        assemble(codec.profile, pics, [case]),
        assemble(codec.profile, pics, [a_case(Verdict.PASS)]),
        Judge(codec, pics).result(),
    ):
        assert all(run.requirements[each] is Verdict.FAIL for each in identifiers)
        print_summary(run)
        told = capsys.readouterr().out
        assert all(f"{each} is not met, declared by the PICS ({name} = false)" in told for each in identifiers)
        assert "Not met, as the PICS declares" in render(run, None)
    checked = Judge(codec, pics).result()
    assert exit_status(checked.cases) == 1
    assert [case.id for case in checked.cases if case.verdict is Verdict.FAIL] == [DENIED]


@pytest.mark.parametrize(
    ("capabilities", "profile"),
    [
        (Capabilities(), "dcp-2.0"),
        (Capabilities(payload_transmitted_indication=True), "cpp-2.0"),
        (Capabilities(transmit_payload_confirm=False), "dcp-1.2"),
        (Capabilities(multiple_payloads=False, triggered_beacons=False, parameter_feedback=False), "dcp-2.0"),
    ],
)
def test_a_pics_that_denies_optional_features_fails_nothing(capabilities: Capabilities, profile: str):
    assert denied_by(capabilities, codec_of(profile).profile) == {}


def test_the_profile_applies_where_the_pics_is_silent():
    denied = denied_by(Capabilities(), codec_of("cpp-2.0").profile)
    assert list(denied) == ["BP-PTI-01", "BP-PTI-02", "BP-PTI-03"]
    assert all("the profile cpp-2.0, as the PICS is silent" in text for text in denied.values())


def test_one_line_accepts_everything_the_pics_denies(tmp_path: Path):
    path = tmp_path / "expected.toml"
    path.write_text(f'[[expected]]\ncase = "{DENIED}"\nreason = "clients of ours poll"\n')
    case = known_cases()[DENIED]
    pics = Pics(pics=Capabilities(payload_transmitted_indication=False))
    expected = ExpectedResults.load(path, known_cases().values())
    assert expected.judge(case, one_case(DENIED, pics=pics)) == ""
    assert expected.complaints([case], datetime.date(2030, 1, 1)) == []


def test_run_and_check_are_compared_by_requirement(tmp_path: Path):
    codec = codec_of("dcp-2.0")
    right = msgspec.structs.replace(a_case(Verdict.PASS), requirements=("DATA-01",))
    right = msgspec.structs.replace(right, checks=(Check(Verdict.PASS, ("DATA-01",), "right"),))
    wrong = msgspec.structs.replace(right, verdict=Verdict.FAIL, checks=(Check(Verdict.FAIL, ("DATA-01",), "right"),))
    for name, case, kind in (("run", right, "run"), ("check", wrong, "check"), ("again", right, "check")):
        write_report(assemble(codec.profile, Pics(), [case], kind=kind), tmp_path / name, codec)
    both = compare_command(str(tmp_path / "run"), str(tmp_path / "check"))
    assert both.return_value == 1
    assert "DATA-01       pass           fail" in both.output
    assert compare_command(str(tmp_path / "run"), str(tmp_path / "again")).return_value == 0


def compare_command(*args: str) -> Result:
    return CliRunner().invoke(compare_cli, args, standalone_mode=False)


@pytest.mark.parametrize(
    ("verdicts", "status"),
    [
        ([Verdict.NOT_APPLICABLE], INCONCLUSIVE),
        ([Verdict.NOT_APPLICABLE, Verdict.NOT_APPLICABLE], INCONCLUSIVE),
        ([], INCONCLUSIVE),
        ([Verdict.NOT_APPLICABLE, Verdict.PASS], AS_EXPECTED),
        ([Verdict.INFO], AS_EXPECTED),
    ],
)
def test_a_run_that_decided_nothing_is_not_a_success(verdicts: list[Verdict], status: int):
    cases = [a_case(verdict) for verdict in verdicts]
    assert exit_status(cases) == status
    sanity = msgspec.structs.replace(a_case(Verdict.PASS), id=SANITY)
    assert exit_status([sanity, *cases]) == (status if cases else AS_EXPECTED)
