"""Claims of the PICS are tested like everything else."""

from __future__ import annotations

from pathlib import Path

import dcp_conformance.suite as cases
import msgspec
import pytest
from dcp_conformance.definitions.case import all_cases
from dcp_conformance.definitions.pics import Capabilities, Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reference.inprocess import plain_node
from dcp_conformance.test_system.services.calls import Services

from dcp_stack.config import BPConfig

from ..rig import ids_of

CASES = ids_of("bp.queues.claims")
ALL = Pics(
    pics=Capabilities(triggered_beacons=True, loss_estimation=True, runtime_parameters=True, parameter_feedback=True)
)


def triggered_node(config, rng, now, wall):
    """Our node with beacons that payloads trigger."""
    period = config.bp.beacon_period_ms
    return plain_node(
        msgspec.structs.replace(config, bp=BPConfig(beacon_period_ms=period, triggered=True)), rng, now, wall
    )


@pytest.mark.parametrize("case_id", CASES)
def test_unclaimed_capabilities_are_not_judged(run_case, case_id):
    verdict = run_case(case_id).verdict
    assert verdict is Verdict.NOT_APPLICABLE


@pytest.mark.parametrize("profile", ["dcp-1.0", "dcp-1.2", "dcp-2.0"])
@pytest.mark.parametrize("case_id", CASES)
def test_true_claims_pass(run_case, case_id, profile):
    result = run_case(case_id, profile, triggered_node, pics=ALL)
    verdict, reason = result.verdict, result.reason
    if case_id == "TC_BP_CLAIM_BI_01" and profile == "dcp-1.0":
        assert verdict is Verdict.NOT_APPLICABLE
    else:
        assert verdict is Verdict.PASS, reason


@pytest.mark.req("BP-TXP-07")
def test_a_node_that_triggers_no_beacons_is_noticed(run_case):
    result = run_case("TC_BP_CLAIM_TI_01", pics=ALL)
    verdict, reason = result.verdict, result.reason
    assert verdict is Verdict.FAIL
    assert "half a period" in reason


def test_a_table_without_losses_is_noticed(run_case, monkeypatch):
    real = Services.call

    def plain(services, method, /, **params):
        answer = real(services, method, **params)
        if method != "SRP-NeighbourTable":
            return answer
        kept = ("nodeId", "sData", "tStamp", "seqno", "receptionTime")
        rows = [{name: row[name] for name in kept} for row in answer.result["neighbours"]]
        return msgspec.structs.replace(answer, result={**answer.result, "neighbours": rows})

    monkeypatch.setattr(Services, "call", plain)
    verdict = run_case("TC_BP_CLAIM_BV_01", pics=ALL).verdict
    assert verdict is Verdict.FAIL


def test_unchanged_parameters_and_hidden_refusals_are_noticed(run_case, monkeypatch):
    real = Services.call

    def deaf(services, method, /, **params):
        if method == "BP-SetParameter":
            return real(services, "UT-Hello")
        return real(services, method, **params)

    monkeypatch.setattr(Services, "call", deaf)
    verdicts = [run_case(case_id, pics=ALL).verdict for case_id in ("TC_BP_CLAIM_BV_02", "TC_BP_CLAIM_BI_01")]
    assert verdicts == [Verdict.FAIL, Verdict.FAIL]


def test_every_claim_is_read_by_some_case():
    """A capability that no case needs or reads could be claimed by any implementation."""
    text = "".join(path.read_text() for path in Path(cases.__file__).parent.rglob("*.py"))
    text += Path(cases.__file__).parent.parent.joinpath("test_steps", "bp_clients.py").read_text()
    needed = {name for case in all_cases().values() for name in (*case.needs.pics, *case.needs.entities)}
    missing = [name for name in Capabilities.__struct_fields__ if name not in needed and f"pics.{name}" not in text]
    assert missing == []
