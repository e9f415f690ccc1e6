"""Requirements that a profile declares as not met are never a pass."""

from __future__ import annotations

import msgspec
import pytest
from dcp_conformance.cli.display import print_summary
from dcp_conformance.declared import declared_by
from dcp_conformance.outcome import assemble
from dcp_conformance.pics import Pics
from dcp_conformance.reporting.page import render
from dcp_conformance.verdict import Verdict
from dcp_spec.requirements import requirements

from dcp_codec.values import VarSumm

from .air import Script, judged
from .rig import OTHER_PROFILES, PROFILES, codec_of, one_case
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


def test_a_failure_stays_one():
    case = a_case(Verdict.FAIL)
    check = msgspec.structs.replace(case.checks[0], requirements=("DATA-01",))
    run = assemble(codec_of("cpp-2.0").profile, Pics(), [msgspec.structs.replace(case, checks=(check,))])
    assert run.requirements["DATA-01"] is Verdict.FAIL


def test_a_recording_shows_no_pass_either():
    air = Script("cpp-2.0")
    air.say(1, air.create(1, 1), VarSumm(1, 0))
    assert judged(air.frames, "cpp-2.0").requirements.get("DATA-01") is not Verdict.PASS
