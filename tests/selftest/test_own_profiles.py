"""Profiles with fields and containers of their own: the suite and a node use them, or refuse them and name the keys."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_conformance.check.recording import judge_versions
from dcp_conformance.definitions.case import all_cases
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.target import TargetOptions, describe
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.frames.sampling import plain, sampler
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_selftest.runner import cases

from dcp_codec import Codec
from dcp_codec.capture import Frame, create_capture
from dcp_codec.values import VarCreate, VarDelete, VarSpec, VarUpdate
from dcp_stack.config import NodeConfig

from ..odd_profiles import codec_of, write_profile


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    return write_profile("odd-own", tmp_path)


def test_the_suite_refuses_such_a_profile(profile: Path) -> None:
    with pytest.raises(UsageError, match=r"bp\.header: has hops, load.*vardis\.records\.VarReqCreate: has reason"):
        describe(TargetOptions(in_process=True, profile=str(profile)))


def test_a_node_refuses_such_a_profile(profile: Path) -> None:
    codec = Codec(profile)
    with pytest.raises(ValueError, match=r"vardis\.records\.VarReqCreate: has reason"):
        NodeConfig(node_id=bytes(6), codec=codec)


def test_check_refuses_records_that_it_has_no_rules_for(profile: Path, tmp_path: Path) -> None:
    capture = tmp_path / "own.pcap"
    with create_capture(capture) as file:
        file.write(Frame(1, 10**18, bytes(60), 60))
    with pytest.raises(UsageError, match=r"check has rules .*vardis\.own_containers has GEO-FENCE, Ping"):
        judge_versions(capture, str(profile), Pics())


def test_a_pattern_in_place_of_reports_is_judged_without_srp() -> None:
    codec, _ = describe(TargetOptions(in_process=True, profile="cpp-1.2"))
    assert not codec.profile.srp.is_report


def test_sizes_of_records_with_fields_of_the_profile(tmp_path: Path) -> None:
    builder = FrameBuilder(codec_of("odd-records", tmp_path))
    assert builder.container_header_size == 2
    assert builder.record_size(VarDelete(1)) == 2
    assert builder.empty_container(1, 3, b"rest") == b"\1\3rest"


def test_records_of_the_tester_have_values_in_these_fields(tmp_path: Path) -> None:
    made_by = sampler(codec_of("odd-records", tmp_path))
    made = made_by.filled(VarCreate(VarSpec(1, bytes(6), 1, b"d", 1, 0), VarUpdate(1, 4, b"v")))
    assert (made.extra, made.spec.extra, made.upd.extra) == ((1.0,), (1, b"\0\0"), (5, b"\0\0"))  # type: ignore[attr-defined]
    assert made_by.filled(made) is made
    assert plain(made.upd) == VarUpdate(1, 4, b"v")


def test_limits_with_added_octets_of_varying_number(tmp_path: Path) -> None:
    profile = tmp_path / "label.toml"
    label = '{ name = "label", block = { lengths = [{ width = 1 }] }, text = true }'
    layout = f'["varId", "prodId", "repCnt", "creationTime", "timeout", "descr", {label}]'
    profile.write_text(f'extends = "dcp-2.0"\nname = "label"\n[vardis]\nvar_spec = {layout}', encoding="utf-8")
    codec = Codec(profile)
    sut = InProcess(reference_config(codec))
    runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    chosen = ("TC_VD_PAR_BI_03", "TC_VD_PAR_BI_09", "TC_NET_HOP_BV_01-2", "TC_DCP_MODEL_BV_01-variable-01")
    verdicts = [str(runner.run(all_cases()[name]).verdict) for name in chosen]
    runner.finish()
    assert verdicts == ["pass", "pass", "pass", "not-applicable"]


@pytest.mark.part("suite")
def test_every_case_with_fields_in_every_record(tmp_path: Path) -> None:
    codec = codec_of("odd-records", tmp_path)
    sut = InProcess(reference_config(codec))
    runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    results = [runner.run(each) for each in cases() if not each.long]
    runner.finish()
    # The profile declares octets that belong to no field.
    assert [each.id for each in results if str(each.verdict) in ("fail", "error", "inconclusive")] == [
        "TC_DCP_PROF_BV_01"
    ]
    assert sum(each.verdict is Verdict.PASS for each in results) > 1200
