"""Requests that do not end: no node has the variable (H1), or the answer is rejected, with the likely reason."""

from __future__ import annotations

from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.values import VarReqCreate, VarSumm

from ..air import Script, case_of, findings, judged

A, B, C = 1, 2, 3


def observed(run, rule: str) -> list[str]:
    """Observations of a rule, with their labels."""
    return [f"{each.expected}: {each.observed}" for each in case_of(run, rule).checks if each.verdict is Verdict.INFO]


def test_an_answer_above_the_limits_of_the_requester_is_not_ping_pong():
    air = Script()
    for who in (B, C):
        air.say(who, air.create(50 + who, who), VarSumm(50 + who, 0))
    for _ in range(15):
        for who in (B, C):
            air.say(who, VarReqCreate(7), VarSumm(50 + who, 0))
        air.say(A, air.create(7, A, rep_cnt=3), VarSumm(7, 0))
    run = judged(air.frames, "dcp-2.0")
    assert not [each for each in findings(run) if "VD_RE" in each]
    assert not [each for each in observed(run, "CK_VD_REQUEST") if "H1" in each]
    told = observed(run, "CK_VD_ENDLESS")
    assert len(told) == 2
    assert all("the likely reason: repCnt 3 is above the node's maximum" in each for each in told)


def test_requests_for_a_variable_that_no_node_has_are_ping_pong():
    air = Script()
    for _ in range(15):
        for who in (B, C):
            air.say(who, VarReqCreate(7))
    run = judged(air.frames, "dcp-2.0")
    assert [each for each in observed(run, "CK_VD_REQUEST") if "H1" in each]
    assert all("it was sent 0 times" in each for each in observed(run, "CK_VD_ENDLESS"))
