"""A profile with fields and containers of its own: the suite and a node refuse it, and name the keys."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_conformance.check.recording import judge_recording
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.target import TargetOptions, describe
from dcp_conformance.model.pics import Pics

from dcp_codec import Codec
from dcp_codec.capture import Frame, create_capture
from dcp_stack.config import NodeConfig

from ..odd_profiles import write_profile


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    return write_profile("odd-own", tmp_path)


def test_the_suite_refuses_such_a_profile(profile: Path) -> None:
    with pytest.raises(UsageError, match=r"bp\.header: has hops, load.*vardis\.records\.VarSumm: has age"):
        describe(TargetOptions(in_process=True, profile=str(profile)))


def test_a_node_refuses_such_a_profile(profile: Path) -> None:
    codec = Codec(profile)
    with pytest.raises(ValueError, match=r"vardis\.records\.VarSumm: has age"):
        NodeConfig(node_id=bytes(6), codec=codec)


def test_check_refuses_records_that_it_has_no_rules_for(profile: Path, tmp_path: Path) -> None:
    capture = tmp_path / "own.pcap"
    with create_capture(capture) as file:
        file.write(Frame(1, 10**18, bytes(60), 60))
    with pytest.raises(UsageError, match=r"check has rules .*vardis\.own_containers has GEO-FENCE, Ping"):
        judge_recording(capture, str(profile), Pics())


def test_a_pattern_in_place_of_reports_is_judged_without_srp() -> None:
    codec, _ = describe(TargetOptions(in_process=True, profile="cpp-1.2"))
    assert not codec.profile.srp.is_report
