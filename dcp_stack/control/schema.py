"""The control interface as JSON Schema (draft 2020-12), generated from the structs that check its messages.

``python -m dcp_stack.control.schema > spec/dcp_spec/data/upper-tester.schema.json``
"""

from __future__ import annotations

import sys
from typing import Any

import msgspec

from dcp_codec.common.schemas import schema_components

from .jsonrpc import ErrorCode
from .methods import METHODS, NOTIFICATIONS

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def upper_tester_schema() -> dict[str, Any]:
    """Return the schema of a line: a request, a response, a notification or a batch of them.

    ``$defs`` contains ``M.request`` (the whole message) and ``M.result`` (the member ``result``) for each method M, and
    N for each notification N.
    """
    types = [each for method in METHODS.values() for each in (method.params, method.result)]
    _, definitions = schema_components([*types, *NOTIFICATIONS.values()])
    identifier = {"type": ["string", "number", "null"]}
    defs: dict[str, Any] = {"id": identifier, "error": _error(), **definitions}
    for name, method in METHODS.items():
        defs[f"{name}.request"] = {
            "description": method.about,
            "type": "object",
            "properties": {
                "jsonrpc": {"const": "2.0"},
                "id": {"$ref": "#/$defs/id"},
                "method": {"const": name},
                "params": {"$ref": f"#/$defs/{method.params.__name__}"},
            },
            "required": ["jsonrpc", "method", *(["params"] if _required(method.params) else [])],
            "additionalProperties": False,
        }
        defs[f"{name}.result"] = {"$ref": f"#/$defs/{method.result.__name__}"}
    for name, params in NOTIFICATIONS.items():
        defs[name] = {
            "type": "object",
            "properties": {
                "jsonrpc": {"const": "2.0"},
                "method": {"const": name},
                "params": {"$ref": f"#/$defs/{params.__name__}"},
            },
            "required": ["jsonrpc", "method", "params"],
            "additionalProperties": False,
        }
    defs["response"] = _response()
    defs["message"] = {
        "anyOf": [{"$ref": f"#/$defs/{name}.request"} for name in METHODS]
        + [{"$ref": f"#/$defs/{name}"} for name in ("response", *NOTIFICATIONS)]
    }
    return {
        "$schema": DIALECT,
        "title": "DCP upper tester interface",
        "description": "One line of the interface in UPPER-TESTER.md: JSON-RPC 2.0, one message or batch per line.",
        "anyOf": [
            {"$ref": "#/$defs/message"},
            {"type": "array", "items": {"$ref": "#/$defs/message"}, "minItems": 1},
        ],
        "$defs": defs,
    }


def _required(params: type[msgspec.Struct]) -> bool:
    return any(field.required for field in msgspec.structs.fields(params))


def _response() -> dict[str, Any]:
    results = sorted({method.result.__name__ for method in METHODS.values()})
    both = {"jsonrpc": {"const": "2.0"}, "id": {"$ref": "#/$defs/id"}}
    return {
        "oneOf": [
            {
                "type": "object",
                "properties": {**both, "result": {"anyOf": [{"$ref": f"#/$defs/{name}"} for name in results]}},
                "required": ["jsonrpc", "id", "result"],
                "additionalProperties": False,
            },
            {
                "type": "object",
                "properties": {**both, "error": {"$ref": "#/$defs/error"}},
                "required": ["jsonrpc", "id", "error"],
                "additionalProperties": False,
            },
        ]
    }


def _error() -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {
            "code": {"type": "integer", "description": "; ".join(f"{code} {code.meaning}" for code in ErrorCode)},
            "message": {"type": "string"},
            "data": {},
        },
        "required": ["code", "message"],
        "additionalProperties": False,
    }


def schema_text() -> str:
    """Return the schema as the text of the committed file."""
    return msgspec.json.format(msgspec.json.encode(upper_tester_schema(), order="sorted"), indent=2).decode() + "\n"


if __name__ == "__main__":
    sys.stdout.write(schema_text())
