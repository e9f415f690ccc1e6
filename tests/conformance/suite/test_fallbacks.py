"""Requirements of which a parameter would be set or asked are decided without, where the PIXIT or waiting can tell."""

from __future__ import annotations

import random
from collections import Counter
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reference.inprocess import MakeNode
from dcp_selftest.mutants import all_mutants, node_with

from dcp_codec.values import Container
from dcp_stack.config import BPConfig, NodeConfig
from dcp_stack.node import Node
from dcp_stack.vardis.compose import Composer

from ..rig import every_case, known_cases
from ..slow import runner_for

HIDDEN = tuple(f"{entity}-{what}" for entity in ("BP", "SRP", "VD") for what in ("GetParameters", "SetParameter"))
TOLD = Testing(
    max_packet_size=1500,
    max_payload_size=1000,
    max_value_length=32,
    max_description_length=32,
    max_summaries=20,
    max_repetitions=15,
    neighbour_timeout_ms=3000,
    scrubbing_period_ms=1000,
)
#: Cases about setting parameters, or about an effect that only another value than the configured one has.
NOT_DECIDED = 95


def one(case_id: str, pixit: Testing = TOLD, **how: Any) -> CaseResult:
    return runner_for(without=HIDDEN, pics=Pics(pixit=pixit), **how).run(known_cases()[case_id])


@pytest.mark.part("suite")
def test_cases_that_are_not_applicable_without_parameters():
    open_, hidden = runner_for(), runner_for(without=HIDDEN, pics=Pics(pixit=TOLD))
    results = [(open_.run(each), hidden.run(each)) for each in every_case()]
    assert Counter(str(each.verdict) for _, each in results).keys() == {"pass", "info", "not-applicable"}
    lost = [
        after.id
        for before, after in results
        if before.verdict is not Verdict.NOT_APPLICABLE and after.verdict is Verdict.NOT_APPLICABLE
    ]
    assert len([each for each in lost if not each.startswith("TC_DCP_MODEL")]) <= NOT_DECIDED
    setting = (
        *(
            "_PAR_",
            "TC_BP_TX_TI_02",
            "TC_BP_PTI_TI_02",
            "TC_BP_HDR_TI_01",
            "TC_BP_LIFE_",
            "TC_SRP_NT_TI_",
            "TC_VD_RUN_",
        ),
        *(
            "TC_VD_SCR_TI_11",
            "TC_VD_SCR_TI_24",
            "TC_VD_LEN_BV_",
            "TC_VD_ROOM_BV_02",
            "TC_VD_CHG_",
            "TC_DCP_MODEL_BV_01",
            "TC_DCP_KEEP_BO_01-the-",
        ),
        # Records that fill a payload to its last octet: the payload is cut to fit them.
        *("TC_VD_PAY_BV_09", "TC_VD_PAY_BV_10", "TC_VD_CRE_BV_09", "TC_VD_UPD_BV_08", "TC_VD_ORD_"),
    )
    assert {each for each in lost if not any(name in each for name in setting)} <= {
        "TC_BP_HDR_BV_10",
        "TC_VD_CMP_BV_12",
        "TC_VD_SUM_BV_03",
    }


@pytest.mark.parametrize(
    "mutant",
    [
        "M-VD-CMP-02-one-more",
        "M-VD-CMP-02-unlimited",
        "M-VD-CMP-03-stays",
        "M-VD-CMP-03-half-turn",
        "M-VD-PAY-02-one-record",
        "M-VD-PAY-02-five-records",
        "M-VD-IC-05-too-large",
    ],
)
def test_faults_are_found_without_parameters(mutant: str):
    fault = all_mutants()[mutant]
    runner = runner_for(make=fault.make, without=HIDDEN, pics=Pics(pixit=TOLD))
    failed = set()
    for name in ("TC_VD_PAY_BV_07", "TC_VD_SUM_BV_02", "TC_VD_SUM_BV_05"):
        for case in (each for each in known_cases().values() if each.base == name):
            result = runner.run(case)
            failed |= {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert failed & set(fault.requirements)


@pytest.mark.parametrize("size", [200, 333, 700])
@pytest.mark.parametrize("base", ["TC_VD_PAY_BV_07", "TC_VD_SUM_BV_05", "TC_VD_SUM_BV_02"])
def test_other_sizes_never_fail_and_pass_if_they_are_stated(base: str, size: int):
    for case in (each for each in known_cases().values() if each.base == base):
        told = Testing(max_payload_size=size, max_value_length=30, max_description_length=20, max_summaries=7)
        node = {
            "max_payload_size": size,
            "max_value_length": 30,
            "max_description_length": 20,
            "max_summaries": 7,
        }
        result = one(case.id, told, **node)
        assert result.verdict is Verdict.PASS, result.reason
        assert one(case.id, Testing(), **node).verdict in (Verdict.PASS, Verdict.INCONCLUSIVE)


def test_no_summaries_if_none_are_configured():
    told = Testing(max_summaries=0)
    assert one("TC_VD_SUM_BV_03", told, max_summaries=0).verdict is Verdict.PASS
    make = all_mutants()["M-VD-CMP-01-zero-is-all"].make
    assert one("TC_VD_SUM_BV_03", told, max_summaries=0, make=make).verdict is Verdict.FAIL
    assert one("TC_VD_SUM_BV_03").verdict is Verdict.NOT_APPLICABLE


ROOM = 60


class Small(Composer):
    """Payloads of 60 octets, in which a VarCreate with 32 + 32 octets has no room."""

    def compose(self, room: int) -> tuple[Container, ...]:
        return super().compose(min(room, ROOM))


def node_of(part: type) -> MakeNode:
    def make(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Any:
        return node_with(part)(config, rng=rng, now=now, wall=wall)

    return make


def test_a_record_that_is_larger_than_a_payload():
    told = Testing(max_payload_size=ROOM, max_value_length=32, max_description_length=32, max_summaries=20)
    good = one("TC_VD_CMP_BV_12", told, make=node_of(Small))
    assert good.verdict is Verdict.PASS, good.reason
    # Sends nothing after a container whose first record does not fit.
    stops = type("SmallAndStops", (Small, all_mutants()["M-VD-CMP-08-stops"].part), {})
    assert one("TC_VD_CMP_BV_12", told, make=node_of(stops)).verdict is Verdict.FAIL
    assert "with the maximum sizes in the PIXIT" in one("TC_VD_CMP_BV_12").reason


def test_the_longest_value_is_found_by_trial():
    assert one("TC_VD_PAR_BV_01").verdict is Verdict.PASS
    other = one("TC_VD_PAR_BV_01", Testing(), max_value_length=64)
    assert "33 octets: VARDIS-STATUS-OK" in next(check.observed for check in other.checks if check.observed)


@pytest.mark.parametrize(("period", "verdict"), [(100, Verdict.PASS), (300, Verdict.FAIL)])
def test_the_beacon_period_is_measured(period: int, verdict: Verdict):
    assert one("TC_BP_PAR_BV_05", make=every(period)).verdict is verdict


def every(period_ms: int) -> MakeNode:
    """A node with a beacon period that is stated nowhere."""

    def make(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Any:
        other = msgspec.structs.replace(config, bp=BPConfig(beacon_period_ms=period_ms))
        return Node(other, rng=rng, now=now, wall=wall)

    return make
