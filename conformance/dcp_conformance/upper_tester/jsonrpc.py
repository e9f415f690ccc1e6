"""The messages of the upper tester interface, as conformance/UPPER-TESTER.md has them."""

from __future__ import annotations

from typing import Any

import msgspec

from dcp_conformance.errors import UpperTesterError

from .base import Answer, Notification
from .faults import shown


def request_line(number: int, method: str, params: dict[str, Any]) -> bytes:
    """A request, ready to be sent."""
    return msgspec.json.encode({"jsonrpc": "2.0", "id": number, "method": method, "params": params}) + b"\n"


def answer_of(message: dict[str, Any]) -> Answer:
    """A response as an answer. Raises ``UpperTesterError`` for one that is against the contract."""
    error, result = message.get("error"), message.get("result")
    if isinstance(error, dict):
        code, text = error.get("code"), error.get("message")
        if not isinstance(code, int) or not isinstance(text, str):
            raise UpperTesterError(f"an error without code or message: {shown(message)}")
        return Answer(code=code, message=text, data=error.get("data"))
    if not isinstance(result, dict) or not isinstance(result.get("status"), str):
        raise UpperTesterError(f"a result without a status: {shown(message)}")
    return Answer(result["status"], result)


def notification_of(message: dict[str, Any], time: int) -> Notification:
    """A notification. Raises ``UpperTesterError`` for one that is against the contract."""
    method, params = message.get("method"), message.get("params", {})
    if not isinstance(method, str) or not isinstance(params, dict):
        raise UpperTesterError(f"neither a response nor a notification: {shown(message)}")
    return Notification(method, params, time)
