"""JSON-RPC 2.0, one message per line: parsing of requests and encoding of messages.

No library fits. Those for streams (pygls, python-lsp-jsonrpc) frame by Content-Length and require threads or asyncio.
jsonrpcserver answers single strings but cannot send notifications to clients, and it checks every message with
jsonschema, which takes more memory than the whole node. The remainder of JSON-RPC is this module; msgspec checks the
types.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, Final

import msgspec
from msgspec import UNSET, UnsetType


class ErrorCode(IntEnum):
    """The codes of errors, each with its meaning."""

    meaning: str

    PARSE_ERROR = -32700, "not JSON"
    INVALID_REQUEST = -32600, "not a valid request"
    METHOD_NOT_FOUND = -32601, "the node has no such method"
    INVALID_PARAMS = -32602, "invalid parameters"
    INTERNAL_ERROR = -32603, "internal error of the implementation"
    TOO_MUCH = -32000, "the answers of the batch are too long; this request was not carried out"
    REFUSED = -32001, "a parameter cannot have the value"
    """The member ``data`` of the error names the violated bound."""
    NO_ANSWER = -32002, "the service does not answer in this state"
    """Readings X10 and X30, choice ``no-response``."""

    def __new__(cls, code: int, meaning: str) -> ErrorCode:
        member = int.__new__(cls, code)
        member._value_ = code
        member.meaning = meaning
        return member


MAX_LINE: Final = 1 << 20
"""Maximum length of a request in octets, without the end of its line."""

RequestId = int | float | str | None
_ENCODER: Final = msgspec.json.Encoder()


class RpcError(Exception):
    """A request that is answered with an error instead of a result."""

    def __init__(self, code: int, message: str, data: Any = UNSET) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.data = data


class Call(msgspec.Struct, frozen=True):
    """A valid request. Without ``id`` (UNSET) it is a notification and gets no answer."""

    method: str
    params: Any
    id: RequestId | UnsetType


def parse(line: bytes) -> Any:
    """Return the JSON value of a line. Raises RpcError if it is not JSON."""
    try:
        return msgspec.json.decode(line)
    except RecursionError:
        raise RpcError(ErrorCode.PARSE_ERROR, "the message is nested too deeply") from None
    except (msgspec.MsgspecError, ValueError) as error:
        # ValueError: octets that are not UTF-8, and integers of thousands of digits.
        raise RpcError(ErrorCode.PARSE_ERROR, f"not JSON: {error}") from None


def read_call(message: Any) -> Call:
    """Return the request in a JSON value. Raises RpcError if the value is not a valid request."""
    if not isinstance(message, dict):
        raise RpcError(ErrorCode.INVALID_REQUEST, f"a request must be an object, not {_kind(message)}")
    if message.get("jsonrpc") != "2.0":
        raise RpcError(ErrorCode.INVALID_REQUEST, 'the request has no "jsonrpc": "2.0"')
    identifier = message.get("id", UNSET)
    if identifier is not UNSET and not _is_id(identifier):
        raise RpcError(ErrorCode.INVALID_REQUEST, '"id" must be a string, a number of at most 64 bits, or null')
    method = message.get("method")
    if not isinstance(method, str):
        raise RpcError(ErrorCode.INVALID_REQUEST, '"method" must be a string, the name of a method')
    unknown = message.keys() - {"jsonrpc", "id", "method", "params"}
    if unknown:
        raise RpcError(ErrorCode.INVALID_REQUEST, f"unknown member {min(unknown)[:80]!r} in the request")
    return Call(method, message.get("params", {}), identifier)


def id_of(message: Any) -> RequestId:
    """Return the id for the answer to an invalid request; None if it has no valid id."""
    identifier = message.get("id") if isinstance(message, dict) else None
    return identifier if _is_id(identifier) else None


def _is_id(value: Any) -> bool:
    if isinstance(value, bool):
        return False
    # Larger integers cannot be written back unchanged.
    return value is None or isinstance(value, str | float) or (isinstance(value, int) and abs(value) < 1 << 63)


def _kind(value: Any) -> str:
    names = {list: "an array", str: "a string", bool: "a boolean", int: "a number", float: "a number"}
    return names.get(type(value), "null")


def result_message(identifier: RequestId, result: Any) -> bytes:
    """Return a response with a result, without the end of the line."""
    return _ENCODER.encode({"jsonrpc": "2.0", "id": identifier, "result": result})


def error_message(identifier: RequestId, error: RpcError) -> bytes:
    """Return a response with an error, without the end of the line."""
    shown: dict[str, Any] = {"code": error.code, "message": error.message}
    if error.data is not UNSET:
        shown["data"] = error.data
    return _ENCODER.encode({"jsonrpc": "2.0", "id": identifier, "error": shown})


def notification_message(method: str, params: Any) -> bytes:
    """Return a notification, without the end of the line."""
    return _ENCODER.encode({"jsonrpc": "2.0", "method": method, "params": params})


def request_message(identifier: RequestId, method: str, params: Any) -> bytes:
    """Return a request, without the end of the line."""
    return _ENCODER.encode({"jsonrpc": "2.0", "id": identifier, "method": method, "params": params})
