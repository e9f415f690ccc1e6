"""Behaviour that the specification leaves free must not fail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fnmatch import fnmatchcase

import pytest
from dcp_conformance.definitions.case import all_cases
from dcp_conformance.definitions.pics import Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.stateful.corpus import Sequence
from dcp_conformance.stateful.judged import judge as judge_steps
from dcp_conformance.stateful.steps import Call, Step
from dcp_selftest.mutants import node_with
from dcp_selftest.variants import Variant, all_variants
from dcp_selftest.variants.campaign import judge
from dcp_selftest.variants.variant import setup

from dcp_stack.bp.clients import Chosen, ClientList

from ..conformance.rig import PROFILES, ids_of, in_session, one_case

FINE = (Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE)


class FixedOrder(ClientList):
    """Serves SRP first, then VarDis, then the others, in every beacon (BP-TX-03)."""

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        self._order.sort(key=lambda client: client.protocol_id)
        return super().take(room, size, most)


class LastFirst(ClientList):
    """Serves the client that has registered last first, in every beacon."""

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        self._order = list(self)[::-1]
        return super().take(room, size, most)


class OneBlock(ClientList):
    """Puts one block into a beacon."""

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        return super().take(room, size, min(most, 1))


class Forgets(ClientList):
    """Puts no more than four clients into its list of those that wait: a fault."""

    def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
        del self._order[4:]
        return super().take(room, size, most)


BP = ids_of(
    "bp.beacons.header",
    "bp.queues.fitting",
    "bp.queues.queueing",
    "bp.services.services",
    "bp.services.registration",
    "bp.services.deregistration",
)


@pytest.mark.part("suite")
@pytest.mark.parametrize("variant", [FixedOrder, LastFirst, OneBlock])
def test_the_order_and_the_number_of_blocks_are_free(variant: type[ClientList]):
    made_of = node_with(variant)

    def make(config, rng, now, wall):  # type: ignore[no-untyped-def]
        return made_of(config, rng=rng, now=now, wall=wall)

    for profile in PROFILES:
        wrong = [f"{each.id}: {each.reason}" for each in in_session(BP, profile, make) if each.verdict not in FINE]
        assert not wrong, profile


def test_a_payload_that_is_never_sent_without_reason_fails():
    made_of = node_with(Forgets)

    def make(config, rng, now, wall):  # type: ignore[no-untyped-def]
        return made_of(config, rng=rng, now=now, wall=wall)

    result = one_case("TC_BP_FMT_BV_01", "dcp-2.0", make)
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert failed == {"BP-TX-04"}


_SRP = "srp.forwarding srp.init srp.record srp.soft_state srp.table"
_APPLICATIONS = ["V-APP-initial-report", "V-APP-reports-1Hz", "V-APP-reports-10Hz", "V-APP-reports-50Hz"]


def judged(variant: str, profile: str, *modules: str) -> list[str]:
    """Findings of the suite about a variant of the collection."""
    cases = [all_cases()[each] for each in ids_of(*modules)]
    result = judge(all_variants()[variant], profile, cases)
    assert result.passed
    return [f"{each}" for each in (*result.fails, *result.inconclusive, *result.errors)]


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.2"])
@pytest.mark.parametrize("variant", _APPLICATIONS)
def test_reports_of_an_application_are_distinguished_from_those_of_the_tester(variant: str, profile: str):
    assert not judged(variant, profile, *_SRP.split())


@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.1"])
def test_a_beacon_with_another_number_of_blocks_may_be_discarded(profile: str):
    assert not judged("V-BP-RX-count-checked", profile, "bp.beacons.receive")


def test_an_empty_payload_is_judged_without_a_confirm_too():
    assert not judged("V-UT-unconfirmed", "dcp-2.0", "bp.services.services", "bp.queues.queueing")


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-2.0", "cpp-2.0"])
@pytest.mark.parametrize(
    "variant",
    [
        "V-BP-TX-priority-one-block",
        "V-BP-PAR-derived",
        "V-BP-PAR-ticks",
        "V-UT-ascii-names",
        "V-APP-every-beacon",
        "V-PAR-packet-600-unknown",
    ],
)
def test_permitted_variants_of_bp_do_not_fail(variant: str, profile: str):
    modules = (
        "bp.queues.fitting bp.beacons.header bp.services.parameters bp.queues.queueing "
        "bp.services.registration bp.services.services bp.beacons.timing"
    )
    assert not judged(variant, profile, *modules.split())


def test_whole_records_may_be_listed_in_1_0():
    assert not judged("V-UT-whole-records", "dcp-1.0", "bp.services.deregistration")


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    ("variant", "profile", "cases"),
    [
        # An application's variable is summarised, and its VarCreate takes room.
        ("V-APP-variable", "dcp-1.1", ["TC_VD_SUM_BV_04", "TC_VD_PAY_BV_05", "TC_VD_ROOM_BV_0*"]),
        # The limit that decides whether a case applies is itself an assumption.
        ("V-PAR-summaries-0-unknown", "dcp-2.0", ["TC_VD_SUM_*", "TC_VD_PAY_BV_01", "TC_NET_JOIN_BV_06"]),
        ("V-PAR-repetitions-1-unknown", "cpp-1.2", ["TC_VD_FWD_BV_0*", "TC_VD_PAR_BV_0[45]*"]),
        ("V-PAR-value-16-unknown", "dcp-1.0", ["TC_VD_PAR_BV_03"]),
        ("V-PAR-description-17-pixit", "dcp-1.0", ["TC_VD_CRE_BI_01", "TC_VD_PAR_BV_02"]),
        # Before 1.2 BP cannot be deactivated while payloads are submitted.
        ("V-UT-slow-250", "dcp-1.1", ["TC_BP_TX_BV_0*", "TC_BP_QM_BV_0*", "TC_VD_CRE_BV_08", "TC_VD_UPD_BV_05"]),
        # Beacons with the former payload come during a call.
        ("V-UT-slow-500", "dcp-2.0", ["TC_DCP_MODEL_BV_01-registrations-17"]),
        ("V-BP-TX-triggered", "dcp-1.1", ["TC_BP_TXP_BI_02*"]),
        ("V-TYPE-node-id-2", "dcp-1.1", ["TC_BP_RX_BI_2*"]),
        ("V-TYPE-var-len-2", "dcp-2.0", ["TC_DCP_PROF_BV_01"]),
        ("V-X04-blocks-only", "cpp-1.2", ["TC_BP_TX_BV_0*"]),
        # The record comes while the deletion is still repeated only if the payload before it was taken in time.
        ("V-TIME-polling-200", "dcp-1.1", ["TC_VD_STATE_BO_01*"]),
        # It receives five beacons at once, and processes the fifth one second later.
        ("V-TIME-polling-200", "dcp-2.0", ["TC_DCP_MODEL_BV_01-search-0[23]"]),
        # So many VarCreates come before the answer that shows that it lives.
        ("V-PAR-payload-120-unknown", "dcp-1.0", ["TC_VD_CMP_BV_04*"]),
        ("V-UT-no-get", "cpp-1.2", ["TC_VD_INI_BV_02", "TC_VD_ROOM_*"]),
        # The case needs more variables than the node can hold together with those for probes.
        ("V-LIM-variables-16", "dcp-1.1", ["TC_VD_ORD_BV_02"]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_suite_passes_permitted_variants(variant: str, profile: str, cases: list[str]):
    picked = [case for case in all_cases().values() if any(fnmatchcase(case.id, each) for each in cases)]
    result = judge(all_variants()[variant], profile, picked)
    assert picked
    assert [str(each) for each in (*result.fails, *result.inconclusive, *result.errors)] == []


@pytest.mark.req("VD-SCR-01", "VD-PAR-02")
@pytest.mark.parametrize(
    ("variant", "steps"),
    [
        # The variable is created half a second before the confirm, and its timeout passes during the next calls.
        (
            "V-UT-slow-500",
            (
                Call("RTDB-Create", {"varId": 3, "repCnt": 1, "descr": 3, "value": 2, "timeout": 1200}),
                Call("RTDB-Update", {"varId": 2, "value": 32}, 6),
            ),
        ),
        # It sets a smaller maximum, so that a record with such a value fits into its payloads.
        (
            "V-PAR-payload-400-get",
            (
                Call("VD-SetParameter", {"name": "VARDISPAR_MAX_DESCRIPTION_LENGTH", "value": 255}),
                Call("VD-SetParameter", {"name": "VARDISPAR_MAX_VALUE_LENGTH", "value": 255}),
                Call("RTDB-Create", {"varId": 1, "repCnt": 1, "descr": 255, "value": 255, "timeout": 0}),
            ),
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_the_model_passes_permitted_variants(variant: str, steps: tuple[Step, ...]):
    base = next(case for case in all_cases().values() if case.id.startswith("TC_DCP_MODEL"))
    needs = replace(base.needs, ut=Sequence("", steps).methods)
    case = replace(base, needs=needs, run=lambda bench: judge_steps(bench, steps, alone=False))
    result = judge(all_variants()[variant], "dcp-2.0", [case])
    assert [str(each) for each in (*result.fails, *result.inconclusive, *result.errors)] == []
    assert result.passed


#: Cases that compare time stamps of the node's clock.
_STAMPS = [
    "TC_SRP_REC_BV_03",
    "TC_SRP_REC_TI_01",
    "TC_SRP_RX_BV_02",
    "TC_VD_CRE_BV_02",
    "TC_VD_UPD_BV_07",
    "TC_VD_REA_BV_01",
    "TC_VD_REA_BV_02",
    "TC_VD_DB_BV_07-own",
    "TC_VD_DB_BV_07-received",
]


@pytest.mark.part("suite")
@pytest.mark.parametrize("offset_ms", range(0, 2000, 250))
def test_a_clock_that_is_set_between_two_time_stamps_is_not_a_fault(offset_ms: int):
    def steps(now: int) -> int:
        """Set back by 1.5 s each 4 s, the first time after ``offset_ms``."""
        return -1_500_000_000 if (now // 1_000_000 + offset_ms) // 2000 % 2 else 0

    pixit = Testing(clock_tolerance_ms=3000.0)
    variant = Variant("V-STEPS", "has a clock that is set", "-", lambda name: setup(name, clock=steps, pixit=pixit))
    result = judge(variant, "dcp-2.0", [all_cases()[each] for each in _STAMPS])
    assert result.passed == len(_STAMPS)
