"""The contract: its schema is that of the code, its examples are true, and what a node says keeps to it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import pytest
from referencing import Registry
from referencing.jsonschema import DRAFT202012

from dcp_stack.control.methods import METHODS, NOTIFICATIONS
from dcp_stack.control.schema import schema_text, upper_tester_schema

from ..control_rig import Rig

ROOT = Path(__file__).parents[3]
CONTRACT = (ROOT / "conformance" / "UPPER-TESTER.md").read_text(encoding="utf-8")
COMMITTED = ROOT / "spec" / "dcp_spec" / "data" / "upper-tester.schema.json"
EXAMPLES = re.findall(r"```jsonrpc\n(.*?)```", CONTRACT, re.DOTALL)
SCHEMA = upper_tester_schema()
REGISTRY = Registry().with_resource("urn:ut", DRAFT202012.create_resource(SCHEMA))


def validator(name):
    reference = "urn:ut" + (f"#/$defs/{name}" if name else "")
    return jsonschema.Draft202012Validator({"$ref": reference}, registry=REGISTRY)


def test_the_committed_schema_is_the_generated_one():
    assert COMMITTED.read_text(encoding="utf-8") == schema_text(), "run: python -m dcp_stack.control.schema > FILE"
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


def test_the_contract_names_every_method_and_notification():
    for name in [*METHODS, *NOTIFICATIONS]:
        assert f"`{name}`" in CONTRACT, name


def matches(found, expected):
    if expected == "...":
        return True
    if isinstance(expected, dict):
        return (
            isinstance(found, dict)
            and found.keys() == expected.keys()
            and all(matches(found[key], value) for key, value in expected.items())
        )
    if isinstance(expected, list):
        return (
            isinstance(found, list)
            and len(found) == len(expected)
            and all(matches(one, other) for one, other in zip(found, expected, strict=True))
        )
    return found == expected


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_the_examples_are_true(number):
    rig = Rig()
    client = rig.client()
    waiting = []
    whole = validator("")
    for line in EXAMPLES[number].splitlines():
        arrow, _, text = line.partition(" ")
        if arrow == "-->":
            assert waiting == []
            waiting = client.feed(text.encode() + b"\n")
            if text.endswith(("}", "]")):
                # The schema refuses what the node refuses for its form.
                code = waiting[0].get("error", {}).get("code") if isinstance(waiting[0], dict) else None
                refused = code in (-32600, -32601) or (code == -32602 and "Object" in str(waiting[0]))
                assert whole.is_valid(json.loads(text)) is not refused
            continue
        assert arrow == "<--"
        waiting += client.notifications()
        if not waiting:
            rig.run(150)
            # In the examples the time of day stands still.
            rig.now = 0
            waiting += client.notifications()
        found = waiting.pop(0)
        assert matches(found, json.loads(text)), found
        whole.validate(found)
    assert waiting == []


def test_there_are_examples_of_all_important_messages():
    assert len(EXAMPLES) >= 4


@pytest.mark.parametrize(
    ("message", "valid"),
    [
        ({"jsonrpc": "2.0", "id": 1, "method": "UT-Hello"}, True),
        ({"jsonrpc": "2.0", "method": "RTDB-Read", "params": {"varId": 1}}, True),
        ({"jsonrpc": "2.0", "id": 1, "method": "RTDB-Read"}, False),
        ({"jsonrpc": "2.0", "id": 1, "method": "RTDB-Read", "params": {"varId": "1"}}, False),
        ({"jsonrpc": "2.0", "id": 1, "method": "RTDB-Read", "params": {"varId": 1, "more": 1}}, False),
        ({"jsonrpc": "2.0", "id": 1, "method": "RTDB-Update", "params": {"varId": 1, "value": "0"}}, False),
        ({"jsonrpc": "2.0", "id": 1, "method": "RTDB-Write", "params": {}}, False),
        ({"jsonrpc": "2.0", "id": 1, "result": {"status": "VARDIS-STATUS-OK"}}, True),
        ({"jsonrpc": "2.0", "id": 1, "result": {"status": "VARDIS-STATUS-FINE"}}, False),
        ({"jsonrpc": "2.0", "id": None, "error": {"code": -32700, "message": "not JSON"}}, True),
        ([{"jsonrpc": "2.0", "id": 1, "method": "UT-Hello"}], True),
        ([], False),
        ("UT-Hello", False),
    ],
)
def test_the_schema_rejects_invalid_messages(message, valid):
    assert validator("").is_valid(message) is valid


def test_results_of_a_busy_node_keep_to_their_schemas():
    rig = Rig()
    client = rig.client()
    client.call("RTDB-Create", varId=1, repCnt=1, descr="x", value="00")
    client.call("SRP-UpdateSafetyData", sData={"x": 1, "y": 2, "z": "NaN"})
    rig.run(300)
    for name in ("UT-Hello", "UT-Status", "BP-ListRegisteredProtocols", "BP-GetParameters", "SRP-NeighbourTable",
                 "SRP-GetParameters", "RTDB-DescribeDatabase", "VD-GetParameters"):  # fmt: skip
        validator(f"{name}.result").validate(client.call(name))
    validator("RTDB-DescribeVariable.result").validate(client.call("RTDB-DescribeVariable", varId=1))
