"""Calls through the upper tester, and the calls that undo their effects."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import StopCase, UpperTesterError
from dcp_conformance.test_system.services.changes import Restoration
from dcp_conformance.upper_tester import Answer

from .parts import PERIOD, Parts, Upper

OK = Answer("BP-STATUS-OK")
REFUSED = Answer("BP-STATUS-EMPTY-PAYLOAD")


def parts_with(**answers: Answer | UpperTesterError) -> tuple[Parts, Upper]:
    parts = Parts()
    parts.run.upper = upper = Upper(**answers)
    return parts, upper


def test_without_an_upper_tester_a_call_is_an_error():
    with pytest.raises(UpperTesterError, match="none is configured"):
        Parts().services.call("RTDB-Read", varId=1)


def test_a_call_is_recorded_and_its_duration_does_not_count_as_lateness():
    parts, upper = parts_with()

    def slow() -> None:
        parts.link.time += 3 * PERIOD

    upper.on_call = slow
    assert parts.services.call("RTDB-Read", varId=1).ok
    parts.steps.begin()
    assert parts.steps.late_ns == 0
    assert list(parts.run.call_times) == [3 * PERIOD]
    assert parts.run.log == ["TC_BP_X_BV_01 called RTDB-Read"]
    assert [each.direction for each in parts.traffic.events] == ["call", "answer"]
    assert parts.steps.silent


@pytest.mark.parametrize(
    ("answer", "known"),
    [(Answer("VARDIS-STATUS-OK"), True), (Answer("VARDIS-STATUS-INACTIVE"), False), (UpperTesterError("lost"), True)],
)
def test_a_creation_that_may_have_succeeded_makes_the_variable_known(answer: Answer | UpperTesterError, known: bool):
    parts, _ = parts_with(RTDB_Create=answer)
    try:
        parts.services.call("RTDB-Create", varId=15)
    except UpperTesterError:
        assert isinstance(answer, UpperTesterError)
    assert (not parts.run.identifier_pool.is_unknown(15, 0)) is known
    assert parts.identifiers.produced == ({15} if known else set())


def test_a_reset_clears_the_knowledge_of_the_run():
    parts, _ = parts_with(UT_Reset=Answer("UT-STATUS-OK"))
    parts.services.call("UT-Reset")
    assert parts.run.log[-1] == "forget"


def test_a_wrong_status_fails_and_is_proved():
    parts, _ = parts_with(BP_ClearBuffer=REFUSED)
    parts.services.expect_status("BP-STATUS-EMPTY-PAYLOAD", "BP-ClearBuffer")
    parts.services.expect_status("BP-STATUS-OK", "BP-ClearBuffer", "BP-CLR-02", protId=1)
    first, second = parts.verdicts.checks
    assert (first.verdict, second.verdict, second.shown) == (Verdict.PASS, Verdict.FAIL, True)
    assert second.requirements == ("BP-CLR-02",)


def test_a_call_that_the_upper_tester_cannot_make_decides_nothing():
    parts, _ = parts_with(BP_ClearBuffer=Answer(code=-32000, message="the socket is closed"))
    with pytest.raises(StopCase):
        parts.services.expect_status("BP-STATUS-OK", "BP-ClearBuffer")
    assert parts.verdicts.verdict() is Verdict.INCONCLUSIVE


def test_a_service_that_is_only_needed_is_inconclusive_when_it_fails():
    parts, _ = parts_with(BP_ClearBuffer=REFUSED)
    with pytest.raises(StopCase):
        parts.services.must("BP-ClearBuffer")
    assert "which this case needs" in parts.verdicts.checks[0].expected
    assert parts.verdicts.verdict() is Verdict.INCONCLUSIVE


def test_an_entity_is_activated_again_however_the_block_ends():
    parts, upper = parts_with()
    with pytest.raises(StopCase), parts.services.deactivated("BP"):
        parts.verdicts.inconclusive("something", "nothing")
    assert [method for method, _ in upper.calls] == ["BP-MGMT-Deactivate", "BP-MGMT-Activate"]
    assert parts.changes.due() == []


# -- restoration -------------------------------------------------------------------------------------------------------


def test_changes_are_undone_in_reverse_order():
    parts, upper = parts_with(BP_RegisterProtocol=OK, BP_DeregisterProtocol=OK, BP_SetParameter=OK)
    held: set[int] = set()
    parts.run.parameters["BPPAR_BEACON_PERIOD"] = 100
    parts.services.call("BP-RegisterProtocol", protId=0x7000)
    parts.services.call("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=50)
    upper.calls.clear()
    restoration = Restoration(parts.changes, parts.services, held)
    restoration.restore()
    assert upper.calls == [
        ("BP-SetParameter", {"name": "BPPAR_BEACON_PERIOD", "value": 100}),
        ("BP-DeregisterProtocol", {"protId": 0x7000}),
    ]
    assert (restoration.failure, restoration.restore_failure, held) == ("", "", set())


def test_a_remaining_registration_does_not_affect_later_cases():
    parts, _ = parts_with(BP_RegisterProtocol=OK, BP_DeregisterProtocol=REFUSED)
    held: set[int] = set()
    parts.services.call("BP-RegisterProtocol", protId=0x7000)
    restoration = Restoration(parts.changes, parts.services, held)
    restoration.restore()
    assert restoration.failure == "BP-DeregisterProtocol: BP-STATUS-EMPTY-PAYLOAD"
    assert (restoration.restore_failure, held) == ("", {0x7000})


def test_a_remaining_parameter_change_affects_later_cases():
    parts, upper = parts_with(BP_SetParameter=OK)
    parts.run.parameters["BPPAR_BEACON_PERIOD"] = 100
    parts.services.call("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=50)
    upper.answers["BP-SetParameter"] = UpperTesterError("no answer")
    restoration = Restoration(parts.changes, parts.services, set())
    restoration.restore()
    assert restoration.restore_failure == "BP-SetParameter: no answer"


def test_an_upper_tester_that_does_not_answer_is_given_up():
    parts, upper = parts_with(BP_SetParameter=OK)
    for name in ("BPPAR_BEACON_PERIOD", "BPPAR_MAXIMUM_PACKET_SIZE"):
        parts.run.parameters[name] = 100
        parts.services.call("BP-SetParameter", name=name, value=50)
    upper.calls.clear()
    upper.answers["BP-SetParameter"] = UpperTesterError("no answer")
    Restoration(parts.changes, parts.services, set()).restore()
    assert len(upper.calls) == 3
