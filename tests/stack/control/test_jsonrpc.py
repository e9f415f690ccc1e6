"""Lines and JSON-RPC: an invalid request gets a clear answer, and does not affect other clients."""

from __future__ import annotations

import contextlib
import json
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.common.lines import LineBuffer, LineTooLongError
from dcp_stack.bp.services import StatusConfirm
from dcp_stack.control import server as server_module
from dcp_stack.control.jsonrpc import MAX_LINE
from dcp_stack.control.methods import METHODS
from dcp_stack.control.server import HIGH_WATER, MAX_BACKLOG, MAX_BATCH

from ...chance import examples
from ..control_rig import Rig

HELLO = {"jsonrpc": "2.0", "id": 1, "method": "UT-Hello"}


@pytest.fixture
def rig():
    return Rig()


def only_error(answers):
    (answer,) = answers
    assert answer["jsonrpc"] == "2.0"
    return answer["id"], answer["error"]["code"], answer["error"]["message"]


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (b"hello", "not JSON"),
        (b'{"jsonrpc": "2.0", ', "not JSON"),
        (b'{"a": 1} {"b": 2}', "not JSON"),
        (b'{"a": "\xff"}', "not JSON"),
        (b'"\\ud800"', "not JSON"),
        (b"1e999", "not JSON"),
        (b"[" * 100_000, "nested"),
        (b"1" * 5_000, "not JSON"),
    ],
)
def test_invalid_json(rig, line, text):
    client = rig.client()
    identifier, code, message = only_error(client.feed(line + b"\n"))
    assert (identifier, code) == (None, -32700)
    assert text in message
    assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"


@pytest.mark.parametrize(
    ("message", "identifier", "text"),
    [
        (1, None, "not a number"),
        (None, None, "not null"),
        ("UT-Hello", None, "not a string"),
        (True, None, "not a boolean"),
        ({}, None, "jsonrpc"),
        ({"id": 3, "method": "UT-Hello"}, 3, "jsonrpc"),
        ({"jsonrpc": "1.0", "id": "a", "method": "UT-Hello"}, "a", "jsonrpc"),
        ({"jsonrpc": "2.0", "id": 3}, 3, "method"),
        ({"jsonrpc": "2.0", "id": 3, "method": 7}, 3, "method"),
        ({"jsonrpc": "2.0", "id": [1], "method": "UT-Hello"}, None, '"id"'),
        ({"jsonrpc": "2.0", "id": True, "method": "UT-Hello"}, None, '"id"'),
        ({"jsonrpc": "2.0", "id": 1 << 70, "method": "UT-Hello"}, None, '"id"'),
        ({"jsonrpc": "2.0", "id": 3, "method": "UT-Hello", "parms": {}}, 3, "'parms'"),
        ([], None, "empty"),
        ([HELLO] * (MAX_BATCH + 1), None, f"more than {MAX_BATCH}"),
    ],
)
def test_invalid_requests(rig, message, identifier, text):
    found, code, shown = only_error(rig.client().say(message))
    assert (found, code) == (identifier, -32600)
    assert text in shown


@pytest.mark.parametrize(
    ("method", "params", "code", "text"),
    [
        ("RTDB-Write", {}, -32601, "'RTDB-Write'"),
        ("ut-hello", {}, -32601, "'ut-hello'"),
        ("x" * 100_000, {}, -32601, "no method"),
        ("RTDB-Read", {}, -32602, "`varId`"),
        ("RTDB-Read", [7], -32602, "by name"),
        ("RTDB-Read", "7", -32602, "RTDB-Read"),
        ("RTDB-Read", None, -32602, "RTDB-Read"),
        ("RTDB-Read", {"varId": "7"}, -32602, "Expected `int`, got `str` - at `$.varId`"),
        ("RTDB-Read", {"varId": True}, -32602, "Expected `int`, got `bool`"),
        ("RTDB-Read", {"varId": 7.5}, -32602, "Expected `int`, got `float`"),
        ("RTDB-Read", {"varId": 7, "var_id": 7}, -32602, "unknown field `var_id`"),
        ("RTDB-Update", {"varId": 7, "value": "0"}, -32602, "$.value"),
        ("RTDB-Update", {"varId": 7, "value": "0g"}, -32602, "$.value"),
        ("RTDB-Update", {"varId": 7, "value": "00 00"}, -32602, "$.value"),
        ("SRP-NeighbourTable", {"nodeId": "02:"}, -32602, "$.nodeId"),
        ("RTDB-Create", {"varId": -1, "repCnt": 1, "descr": "", "value": "00"}, -32602, "0 to 255"),
        ("RTDB-Create", {"varId": 1 << 80, "repCnt": 1, "descr": "", "value": "00"}, -32602, "0 to 255"),
        ("RTDB-Create", {"varId": 1, "repCnt": 1, "descr": "", "value": "00", "timeout": 65536}, -32602, "65535"),
        ("BP-QueryNumberBufferedPayloads", {"protId": 65536}, -32602, "0..65535"),
        ("BP-SetParameter", {"name": "BPPAR_PERIOD", "value": 1}, -32602, "BPPAR_PERIOD"),
        ("BP-SetParameter", {"name": "VARDISPAR_MAX_SUMMARIES", "value": 1}, -32602, "BP has no parameter"),
        ("BP-SetParameter", {"name": "BPPAR_BEACON_PERIOD", "value": "1"}, -32602, "$.value"),
        ("SRP-UpdateSafetyData", {"sData": {"x": 1}}, -32602, "needs y, z"),
        ("SRP-UpdateSafetyData", {"sData": {"x": 1, "y": 2, "z": "high"}}, -32602, "takes a number"),
    ],
)
def test_wrong_methods_and_parameters(rig, method, params, code, text):
    before = rig.node.snapshot()
    answers = rig.client().say({"jsonrpc": "2.0", "id": "q", "method": method, "params": params})
    found, shown_code, message = only_error(answers)
    assert (found, shown_code) == ("q", code)
    assert text in message
    assert len(message) < 500
    assert rig.node.snapshot() == before


@pytest.mark.parametrize("method", ["BP-ListRegisteredProtocols", "BP-GetParameters"])
def test_a_type_error_in_a_core_is_not_reported_as_invalid_parameters(rig, method):
    """The types of parameters are checked with the message, so that a later TypeError is a mistake of the node."""
    name = "list_registered" if method == "BP-ListRegisteredProtocols" else "parameters"
    with patch.object(type(rig.node.bp), name, side_effect=TypeError("not iterable")):
        assert rig.client().error(method)["code"] == -32603


def test_a_confirm_without_a_status_is_a_mistake_of_the_node(rig):
    with patch.object(type(rig.node.bp), "deregister", return_value=StatusConfirm(None)):
        error = rig.client().error("BP-DeregisterProtocol", protId=9)
    assert error == {"code": -32603, "message": "TypeError: BP-DeregisterProtocol was confirmed without a status"}


def test_an_internal_error_does_not_end_the_session(rig, caplog):
    # A fuzzing target may have silenced it in this process.
    caplog.set_level("ERROR", logger="dcp_stack.control.server")
    client = rig.client()
    with patch.object(server_module, "perform", side_effect=RuntimeError("oops")):
        assert client.error("UT-Hello") == {"code": -32603, "message": "RuntimeError: oops"}
        assert client.say({"jsonrpc": "2.0", "method": "UT-Hello"}) == []
    assert "UT-Hello failed" in caplog.text
    assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"


def test_requests_without_id_are_carried_out_and_not_answered(rig):
    client = rig.client()
    assert client.say({"jsonrpc": "2.0", "method": "BP-MGMT-Deactivate"}) == []
    assert not rig.node.bp.active
    assert client.say({"jsonrpc": "2.0", "method": "No-Such-Method"}) == []
    assert client.say({"jsonrpc": "2.0", "method": "RTDB-Read", "params": {}}) == []


@pytest.mark.parametrize("identifier", [0, -5, "x", "", None, 1.5, (1 << 63) - 1])
def test_ids_are_returned_unchanged(rig, identifier):
    (answer,) = rig.client().say({"jsonrpc": "2.0", "id": identifier, "method": "UT-Hello"})
    assert answer["id"] == identifier
    assert "result" in answer


def test_batches_answer_each_request_in_order(rig):
    client = rig.client()
    (answers,) = client.say([HELLO, 1, {**HELLO, "method": "?", "id": 2}, {"jsonrpc": "2.0", "method": "UT-Hello"}])
    assert [(each["id"], each.get("error", {}).get("code")) for each in answers] == [
        (1, None),
        (None, -32600),
        (2, -32601),
    ]
    assert client.say([{"jsonrpc": "2.0", "method": "UT-Hello"}] * 3) == []


def test_the_answers_to_a_batch_are_bounded(rig):
    client = rig.client()
    with patch.object(server_module, "MAX_BATCH_ANSWER", 1000):
        (answers,) = client.say([{**HELLO, "id": number} for number in range(10)])
    codes = [each.get("error", {}).get("code") for each in answers]
    assert codes[0] is None
    assert codes[-1] == -32000
    assert sorted(codes, key=str) == sorted([None] * codes.count(None) + [-32000] * codes.count(-32000), key=str)


def test_lines_may_come_in_pieces_and_together(rig):
    line = json.dumps(HELLO).encode()
    client = rig.client()
    for octet in line:
        assert client.feed(bytes([octet])) == []
    assert len(client.feed(b"\n")) == 1
    assert len(client.feed(line + b"\r\n" + b"\n \n" + line + b"\n" + line)) == 2
    assert len(client.feed(b"\n")) == 1


def test_the_longest_line_is_taken_and_a_longer_one_skipped(rig):
    client = rig.client()
    line = json.dumps(HELLO).encode()
    fitting = line + b" " * (MAX_LINE - len(line))
    assert "result" in client.feed(fitting + b"\n")[0]
    assert only_error(client.feed(fitting + b" \n"))[:2] == (None, -32600)
    # The error comes once, as soon as the line is too long; the rest is discarded.
    answers = []
    for _ in range(40):
        answers += client.feed(b"x" * 65_536)
    assert len(answers) == 1
    assert "longer than 1048576" in answers[0]["error"]["message"]
    assert client.feed(b"rest\n" + line + b"\n")[0]["id"] == 1


def test_line_buffers_are_bounded():
    lines = LineBuffer(limit=10)
    for _ in range(100):
        lines.add(b"x" * 8)
        with contextlib.suppress(LineTooLongError):
            assert lines.next() is None
        assert len(lines) <= 18


def test_a_last_line_needs_no_end(rig):
    session = rig.server.open()
    session.receive(json.dumps(HELLO).encode())
    assert not session.process(now=0, wall=0)
    assert session.output == b""
    session.end_of_input()
    assert not session.finished
    session.process(now=0, wall=0)
    assert b"UT-STATUS-OK" in session.output
    session.sent(len(session.output))
    assert session.finished
    assert not session.wants_input


def test_requests_wait_while_answers_are_queued(rig):
    session = rig.server.open()
    request = json.dumps({**HELLO, "method": "UT-Status"}).encode() + b"\n"
    session.receive(request * 1000)
    while session.process(now=0, wall=0):
        pass
    assert HIGH_WATER < len(session.output) < HIGH_WATER + 65_536
    assert not session.wants_input
    answered = 0
    for _ in range(10_000):
        answered += session.output.count(b"\n")
        session.sent(len(session.output))
        if not session.process(now=0, wall=0) and not session.output:
            break
    assert answered == 1000
    assert session.wants_input


def test_each_call_of_process_answers_a_portion(rig):
    session = rig.server.open()
    session.receive((json.dumps(HELLO).encode() + b"\n") * 100)
    assert session.process(now=0, wall=0, most=10)
    assert session.output.count(b"\n") == 10


def test_a_subscriber_that_does_not_read_is_disconnected(rig):
    deaf, other = rig.client(), rig.client()
    for client in (deaf, other):
        client.call("UT-Subscribe", variables=True)
    maker = rig.client()
    heard = 0
    assert maker.call("RTDB-Create", varId=1, repCnt=1, descr="", value="00")["status"] == "VARDIS-STATUS-OK"
    for number in range(100_000):
        rig.node.vardis.update(1, bytes([number & 0xFF]), now=0, wall=0)
        rig.node.settle(0, 0)
        rig.settle()
        if number % 1000 == 0:
            heard += len(other.notifications())
        if deaf.session.overrun:
            break
    assert deaf.session.overrun
    assert len(deaf.session.output) < MAX_BACKLOG + 1000
    heard += len(other.notifications())
    assert not other.session.overrun
    assert heard == number + 2


@settings(max_examples=examples(300))
@given(st.lists(st.binary(max_size=200), max_size=5))
def test_arbitrary_octets_never_raise(chunks):
    rig = SHARED
    client = rig.client()
    for chunk in chunks:
        for answer in client.feed(chunk):
            for each in answer if isinstance(answer, list) else [answer]:
                assert each["error"]["code"] in (-32700, -32600, -32601, -32602)
    client.feed(b"\n")
    assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"
    client.session.close()


SHARED = Rig()
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
NAMES = ["varId", "protId", "value", "payload", "repCnt", "descr", "timeout", "name", "sData", "nodeId", "maxEntries"]
VALUES = JSON | st.sampled_from(["00", "ff" * 40, "BP_QMODE_ONCE", "BPPAR_BEACON_PERIOD", {"x": 1, "y": 2, "z": 3}])
REQUESTS = st.fixed_dictionaries(
    {
        "jsonrpc": st.just("2.0"),
        "id": JSON,
        "method": st.sampled_from([*METHODS]) | st.text(max_size=10),
        "params": st.dictionaries(st.sampled_from(NAMES), VALUES, max_size=6) | JSON,
    }
)


@settings(max_examples=examples(500))
@given(st.lists(REQUESTS | JSON, max_size=4), st.booleans())
def test_arbitrary_messages_never_raise_and_never_break_the_node(messages, batch):
    client = SHARED.client()
    answers = client.say(messages) if batch else [each for message in messages for each in client.say(message)]
    for answer in answers:
        for each in answer if isinstance(answer, list) else [answer]:
            assert ("method" in each) or (("result" in each) != ("error" in each))
            if "error" in each:
                assert each["error"]["code"] != -32603, each
            elif "result" in each:
                assert "-STATUS-" in each["result"]["status"]
    SHARED.run(120)
    SHARED.node.vardis.check_invariants()
    assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"
    client.session.close()
    SHARED.server.open().close()
