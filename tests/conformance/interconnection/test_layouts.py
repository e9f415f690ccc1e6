"""Implementations that lay a field out otherwise than the profile: one cause is named once, by the cases about it."""

from __future__ import annotations

from collections import Counter
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.case import DECLARED, DENIED
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.interconnection.findings import Findings
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.session import Session
from dcp_selftest.mutants import all_mutants
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


def outcome_of(
    spoken: Profile, *, cases: tuple[str, ...] = ("",), services: bool = True, make: MakeNode = plain_node
) -> tuple[Runner, Counter[str], list[str]]:
    """Test a node that speaks another profile as one of :data:`STRICT`: failed requirements, and all reasons."""
    sut = InProcess(reference_config(Codec(spoken)), make=make)
    upper = sut.upper_tester() if services else None
    runner = Runner(Session(codec_of(STRICT), sut.lower_tester(), upper, Pics()), sut)
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


@pytest.mark.part("suite")
def test_limits_of_sizes_follow_from_headers_of_another_size() -> None:
    _, failed, _ = outcome_of(
        other(bp_seqno={"width": 2}), cases=("TC_BP_LIFE", "TC_BP_PAR", "TC_BP_REG", "TC_BP_RXP", "TC_VD_PAR")
    )
    assert failed.keys() == {"BP-HDR-08"}


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("changes", "owners"),
    [
        ({"var_timeout": {"width": 4}}, {"DATA-07"}),
        # None of its payloads is readable, for which the sanity case fails.
        ({"var_seqno": {"width": 2}}, {"VD-IC-01", "VD-IC-02", "VD-IC-03", "VD-TYP-05"}),
    ],
)
def test_records_of_another_layout_are_reported_without_their_consequences(
    changes: dict[str, Any], owners: set[str]
) -> None:
    cases = ("TC_DCP_", "TC_NET_JOIN", "TC_VD_CRE", "TC_VD_ID", "TC_VD_PAR", "TC_VD_RX", "TC_VD_SPLIT", "TC_VD_STATE")
    _, failed, reasons = outcome_of(other(**changes), cases=cases)
    assert failed
    assert failed.keys() <= owners
    assert any("this follows from another fault: its own records of VarDis are laid out" in each for each in reasons)


@pytest.mark.parametrize(
    ("mutant", "case"),
    [("M-BP-QM-03-drophead-repeats", "TC_BP_QM_BV"), ("M-SRP-SEQ-01-by-two", "TC_SRP_REC_BV")],
)
def test_another_layout_of_records_hides_no_fault_of_another_protocol(mutant: str, case: str) -> None:
    fault = all_mutants()[mutant]
    _, failed, _ = outcome_of(other(var_timeout={"width": 4}), cases=("TC_DCP_DATA_BV_06", case), make=fault.make)
    assert failed.keys() >= {"DATA-07", fault.requirements[0]}


def test_an_identifier_of_another_size_does_not_stop_the_tester() -> None:
    cases = ("TC_BP_RX_BI_06", "TC_DCP_DATA_BV_06", "TC_SRP_RX_BV_12", "TC_VD_ID_BV_03")
    _, failed, _ = outcome_of(other(node_id={"width": 8}), cases=cases)
    assert failed.keys() == {"DATA-04"}


def test_with_the_wrong_profile_no_frame_is_judged() -> None:
    cases = ("TC_BP_LIFE_BV_01", "TC_BP_QM_BV_17", "TC_BP_TX_BV_04")
    _, failed, reasons = outcome_of(codec_of("dcp-1.1").profile, cases=cases)
    assert not failed
    assert any("1.1" in each for each in reasons)


@pytest.mark.parametrize("field", ["srp_seqno", "var_timeout"])
def test_a_value_with_swapped_octets_violates_the_byte_order(field: str) -> None:
    _, failed, _ = outcome_of(
        other(**{field: {"byte_order": "little"}}), cases=("TC_DCP_DATA_BV_04", "TC_SRP_RX_BV_0", "TC_VD_DVA_BV_02")
    )
    assert failed.keys() - {"SRP-RX-03"} == {"DATA-01"}


def test_misread_creations_are_reported_once() -> None:
    # Without an upper tester nothing is known of its own records.
    cases = ("TC_VD_CRT", "TC_VD_LEN", "TC_VD_ROB", "TC_NET_HOP", "TC_VD_FWD")
    runner, failed, _ = outcome_of(other(var_timeout={"width": 4}), cases=cases, services=False)
    assert "VarCreate" in Findings.of(runner.session).misread
    assert failed
    assert failed.keys() <= {"VD-PC-09", "VD-PC-07", "VD-CMP-06"}


def test_a_node_that_sends_unreadable_payloads_is_alive() -> None:
    _, _, reasons = outcome_of(other(var_seqno={"width": 2}), cases=("TC_VD_CRE", "TC_VD_UPD"))
    assert not any("does not answer any more" in each for each in reasons)


@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.2", "dcp-2.0", "cpp-2.0"])
def test_a_conforming_node_misreads_nothing(profile: str) -> None:
    runner = runner_for(profile)
    runner.run(known_cases()["TC_DCP_SANITY_BV_01"])
    assert Findings.of(runner.session).misread == {}
    assert runner.notes == []
