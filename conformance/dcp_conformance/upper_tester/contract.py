"""Check the messages of an upper tester against its contract (conformance/UPPER-TESTER.md).

The types of the messages are those from which the published schema is generated. A message that breaks the contract is
a fault of the adapter: it is recorded once for each kind, and no requirement of the implementation fails for it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Mapping
from typing import Any, Final

import msgspec

from dcp_conformance.errors import ContractError
from dcp_stack.control.methods import METHODS, NOTIFICATIONS

from .base import Answer, Notification, status_of_success
from .faults import Faults, Violation, shown

_STATUS: Final = re.compile(r"[A-Za-z]+[-_]STATUS[-_].+")
#: Members that a successful result must have, beyond those that its type demands for any status.
_MEMBERS: Final = {
    "BP-QueryNumberBufferedPayloads": ("number",),
    "SRP-NeighbourTable": ("neighbours",),
    "RTDB-DescribeDatabase": ("variables",),
    "RTDB-DescribeVariable": ("variable",),
    "RTDB-Read": ("value", "tStamp"),
}
_OF_A_VARIABLE: Final = ("value", "seqno", "isDeleted", "tStamp")
_NODE_IDS: Final = frozenset({"nodeId", "prodId", "senderId", "ownNodeIdentifier"})
_OCTETS: Final = frozenset({"payload", "value", "descrHex"}) | _NODE_IDS
_NAMED_FIELDS: Final = frozenset({"sData", "ownFields"})
_NO_OCTETS: Final = frozenset({"NaN", "Infinity", "-Infinity"})
#: Times of day in ns, apart from the ``tStamp`` of state reports, which has the unit of the profile.
_TIMES: Final = frozenset({"tStamp", "receptionTime", "timeStampRegistration", "nextBeaconGenerationEpoch"})
_UNITS: Final = {"s": 10**9, "ms": 10**6, "us": 10**3}
_DAY: Final = 86_400 * 10**9
_FACTOR: Final = 1000


class Contract:
    """Checks what one connection receives."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._timeouts: dict[object, Any] = {}
        """By variable, the timeout that was given to RTDB-Create."""

    def answer(self, method: str, params: Mapping[str, Any], message: Mapping[str, Any], answer: Answer) -> Answer:
        """Check an answer; return it with hexadecimal digits in lower case.

        Raise ``ContractError`` if it cannot be used.
        """

        def broken(what: str, place: str, *, usable: bool = False) -> None:
            self._faults.add(Violation(method, what, place, shown(message), usable))
            if not usable:
                raise ContractError(f"{method}: the answer breaks the contract of the upper tester: {what}")

        if message.get("jsonrpc") != "2.0":
            broken('the answer has no member "jsonrpc": "2.0"', "Transport", usable=True)
        known = METHODS.get(method)
        if answer.code is not None:
            if answer.unreachable:
                broken(
                    "error -32603 for an implementation that cannot be reached, which is -32003", "Errors", usable=True
                )
            return answer
        if known is None:
            return answer
        if not _STATUS.fullmatch(answer.status):
            broken(f"{answer.status!r} has not the form of a status, such as BP-STATUS-OK", "Values")
        if not answer.ok:
            return answer
        missing = [each for each in _MEMBERS.get(method, ()) if each not in answer.result]
        missing += [f"variable.{each}" for each in self._missing_of_variable(method, answer.result)]
        if missing:
            broken(f"the result has no member {', '.join(missing)}", "Methods")
        try:
            # Whether the status is the right one is for the case to judge.
            msgspec.convert({**answer.result, "status": status_of_success(method)}, known.result)
        except msgspec.ValidationError as error:
            broken(_worded(error), "Methods")
        for where, what in self._units(method, answer.result):
            broken(f"{where}: {what}", "Values")
        if method == "RTDB-Create":
            self._timeouts[params.get("varId")] = params.get("timeout")
        return msgspec.structs.replace(answer, result=self._plain(answer.result, method, message))

    def notification(self, method: str, params: dict[str, Any], message: Mapping[str, Any]) -> Notification:
        """Check a notification, and return it with hexadecimal digits in lower case. ``time`` is 0."""
        if message.get("jsonrpc") != "2.0":
            self._faults.add(Violation(method, 'no member "jsonrpc": "2.0"', "Transport", shown(message), usable=True))
        known = NOTIFICATIONS.get(method)
        if known is None:
            return Notification(method, params)
        try:
            msgspec.convert(params, known)
        except msgspec.ValidationError as error:
            self._faults.add(Violation(method, _worded(error), "Notifications", shown(message)))
        else:
            for where, what in self._units(method, params):
                self._faults.add(Violation(method, f"{where}: {what}", "Values", shown(message)))
        return Notification(method, self._plain(params, method, message))

    def early(self, method: str, params: Mapping[str, Any], notification: Notification) -> None:
        """Record a notification that precedes the confirm of the request which caused it."""
        told = notification.params
        change = {"RTDB-Create": "created", "RTDB-Update": "updated", "RTDB-Delete": "deleted"}.get(method)
        same = told.get("event") == change and told.get("varId") == params.get("varId")
        if change is not None and same and notification.method == "UT-VariableChanged":
            what = f"the notification of {method} precedes its answer"
            self._faults.add(Violation(notification.method, what, "Notifications", usable=True))

    @staticmethod
    def _missing_of_variable(method: str, result: Mapping[str, Any]) -> Iterator[str]:
        variable = result.get("variable")
        if method == "RTDB-DescribeVariable" and isinstance(variable, dict):
            yield from (each for each in _OF_A_VARIABLE if each not in variable)
            if not {"descr", "descrHex"} & variable.keys():
                yield "descr"

    def _units(self, method: str, value: Any, path: str = "") -> Iterator[tuple[str, str]]:
        """Yield members that have another unit than the contract's, with what is wrong."""
        if isinstance(value, list):
            for number, each in enumerate(value):
                yield from self._units(method, each, f"{path}[{number}]")
        elif isinstance(value, dict):
            for name, each in value.items():
                where = f"{path}.{name}".lstrip(".")
                # The time stamp of a state report has the unit of the profile.
                if name in _TIMES and not (name == "tStamp" and "sData" in value) and isinstance(each, int):
                    if unit := _wrong_unit(each):
                        yield where, f"{each} is a time in {unit}, not in ns since 1970"
                elif name == "timeout" and (asked := self._timeouts.get(value.get("varId"))):
                    if each in (asked * _FACTOR, asked / _FACTOR):
                        yield where, f"{each} for a variable that was created with {asked} ms"
                elif isinstance(each, dict | list):
                    yield from self._units(method, each, where)

    def _plain(self, value: Any, method: str, message: Mapping[str, Any], *, fields: bool = False) -> Any:
        """Return a value of a message with hexadecimal digits in lower case, and node identifiers with colons."""
        if isinstance(value, list):
            return [self._plain(each, method, message) for each in value]
        if not isinstance(value, dict):
            return value
        plain = {}
        for name, each in value.items():
            if isinstance(each, str) and (name in _OCTETS or (fields and each not in _NO_OCTETS)):
                text = each.lower()
                if name in _NODE_IDS and text and ":" not in text:
                    what = f"{name} is without colons"
                    self._faults.add(Violation(method, what, "Values", shown(message), usable=True))
                    text = ":".join(text[place : place + 2] for place in range(0, len(text), 2))
                plain[name] = text
            else:
                plain[name] = self._plain(each, method, message, fields=name in _NAMED_FIELDS)
        return plain


def _wrong_unit(moment: int) -> str:
    """Return the unit in which a number is the time of day, if it is not ns; a clock may also begin in 1970."""
    now = time.time_ns()
    if abs(moment - now) < _DAY:
        return ""
    return next((unit for unit, factor in _UNITS.items() if abs(moment * factor - now) < _DAY), "")


def _worded(error: msgspec.ValidationError) -> str:
    """Return the message of a wrong member: where, what was expected, what there is."""
    text, _, path = str(error).partition(" - at `")
    where = path.rstrip("`").removeprefix("$").lstrip(".")
    text = text.replace("Object missing required field", "there is no member").replace("Expected", "expected")
    return f"{where}: {text}" if where else text
