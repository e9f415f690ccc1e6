"""Implementations that lay a field out otherwise than the profile: one cause is named once, by the cases about it."""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec
import pytest
from dcp_conformance.execution.runner import Runner
from dcp_conformance.interconnection.findings import Findings
from dcp_conformance.model.case import DECLARED, DENIED
from dcp_conformance.model.pics import Pics
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.session import Session
from dcp_spec.profile.definition import Profile

from dcp_codec.codec import Codec

from ..rig import codec_of, every_case, known_cases
from ..slow import runner_for

STRICT = "dcp-2.0"


def other(**changes: dict[str, Any]) -> Profile:
    """The profile with some types laid out otherwise."""
    profile = codec_of(STRICT).profile
    types = {name: msgspec.structs.replace(getattr(profile.types, name), **each) for name, each in changes.items()}
    return msgspec.structs.replace(profile, types=msgspec.structs.replace(profile.types, **types))


def outcome_of(spoken: Profile, *, cases: tuple[str, ...] = ("",)) -> tuple[Runner, Counter[str], list[str]]:
    """Test a node that speaks another profile as one of :data:`STRICT`: failed requirements, and all reasons."""
    sut = InProcess(reference_config(Codec(spoken)))
    runner = Runner(Session(codec_of(STRICT), sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    failed: Counter[str] = Counter()
    reasons: list[str] = []
    for each in every_case():
        if each.id not in (DECLARED, DENIED) and each.id.startswith(("TC_DCP_SANITY", *cases)):
            result = runner.run(each)
            bad = [check for check in result.checks if check.verdict is Verdict.FAIL]
            failed.update({requirement for check in bad for requirement in check.requirements})
            reasons.append(result.reason)
            assert result.verdict is not Verdict.ERROR, result.reason
    return runner, failed, reasons


@pytest.mark.part("suite")
def test_swapped_times_and_reports_in_memory_layout_are_reported_once() -> None:
    runner, failed, reasons = outcome_of(codec_of("cpp-2.0").profile)
    assert failed.keys() == {"DATA-01", "DATA-05", "SRP-FMT-01", "SRP-TYP-02"}
    assert Findings.of(runner.session).misread.keys() == {"creationTime", "report"}
    for text in ("it compares creation times as if", "its own state reports are laid out otherwise"):
        assert any(f"but this follows from another fault: {text}" in each for each in reasons)
        assert sum(note.startswith(text) for note in runner.notes) == 1


def test_swapped_protocol_identifiers_are_reported_without_their_consequences() -> None:
    _, failed, _ = outcome_of(
        other(protocol_id={"byte_order": "little"}), cases=("TC_BP_HDR_", "TC_VD_RX", "TC_VD_SPLIT", "TC_SRP_")
    )
    # The byte order, and the two rules about the field itself.
    assert failed.keys() <= {"DATA-01", "BP-HDR-10", "BP-HDR-11"}
    assert failed["DATA-01"]


def test_misread_creations_are_reported_once() -> None:
    runner, failed, _ = outcome_of(
        other(var_timeout={"width": 4}), cases=("TC_VD_CRT", "TC_VD_LEN", "TC_VD_ROB", "TC_NET_HOP", "TC_VD_FWD")
    )
    assert "VarCreate" in Findings.of(runner.session).misread
    assert failed.keys() <= {"VD-PC-09", "VD-PC-07", "VD-CMP-06", "VD-SCP-02", "SRP-FMT-01"}


def test_a_node_that_sends_unreadable_payloads_is_alive() -> None:
    _, _, reasons = outcome_of(other(var_seqno={"width": 2}), cases=("TC_VD_CRE", "TC_VD_UPD"))
    assert not any("does not answer any more" in each for each in reasons)


@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.2", "dcp-2.0", "cpp-2.0"])
def test_a_conforming_node_misreads_nothing(profile: str) -> None:
    runner = runner_for(profile)
    runner.run(known_cases()["TC_DCP_SANITY_BV_01"])
    assert Findings.of(runner.session).misread == {}
    assert runner.notes == []
