"""Walk through the methods of an upper tester, and report which are there and keep to the contract.

No behaviour of the protocols is judged: only what an adapter must add to any implementation.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, SpecVersion
from dcp_spec.profile.definition import Profile

from dcp_conformance.errors import ContractError, CouldNotAskError, NoAnswerError

from .base import METHOD_NOT_FOUND, Answer, Notification, UpperTester
from .faults import Checked, Faults, Violation

#: Identifiers that no case uses first, and a client protocol of the examination.
_VARIABLE, _PROTOCOL = 251, 0x7A3E
#: Timeout of the variable in ms, and its values.
_TIMEOUT, _VALUE, _NEXT = 60_000, "0a", "0b0c"
#: Seconds that a notification may take; unanswered calls after which the walk ends.
_NOTIFIED, _UNANSWERED = 2.0, 3
_PERIOD: Final = "BPPAR_BEACON_PERIOD"
_OWN: Final = frozenset({BP_PROTID_SRP, BP_PROTID_VARDIS})
Outcome = Literal["right", "optional", "absent", "wrong"]
"""``optional``: absent, which the contract allows."""


@dataclass(frozen=True, slots=True)
class Examined:
    """The finding about one method or notification."""

    method: str
    outcome: Outcome
    what: str = ""
    """The observation; for a method that is right, its answer."""


class Examination:
    """One walk through the methods."""

    def __init__(self, upper: UpperTester, profile: Profile, *, whole: bool) -> None:
        """``whole``: also use what an implementation may not survive, or UT-Reset may not undo."""
        self._upper, self._profile, self._whole = upper, profile, whole
        self._faults = upper.faults if isinstance(upper, Checked) else Faults()
        self._found: dict[str, Examined] = {}
        self._unanswered = 0
        self._told: list[Notification] = []

    def walk(self) -> list[Examined]:
        """Call all methods. Raise ``UpperTesterError`` if the connection is lost."""
        from dcp_stack.control.methods import METHODS, NOTIFICATIONS

        for name, method in METHODS.items():
            if name not in self._upper.methods:
                self._found[name] = Examined(name, "optional" if method.optional else "absent")
        self._found["UT-Hello"] = Examined("UT-Hello", "right", str(self._upper.about.get("name", "")))
        before = set(self._faults.found)
        self._call("UT-Reset")
        parameters = self._parameters()
        self._notified(NOTIFICATIONS)
        if self._whole:
            self._bp()
        self._vardis()
        self._srp()
        if self._whole:
            for entity in ("VD", "BP"):
                self._call(f"{entity}-MGMT-Deactivate")
                self._call(f"{entity}-MGMT-Activate")
        self._call("UT-Status")
        self._restored(parameters)
        for kind, violation in self._faults.found.items():
            if kind not in before:
                self._found[violation.method] = Examined(violation.method, "wrong", violation.what)
        return [self._found[name] for name in (*METHODS, *NOTIFICATIONS) if name in self._found]

    # -- one method after another ------------------------------------------------------------------------------------

    def _bp(self) -> None:
        self._call("BP-ListRegisteredProtocols")
        mode = "BP_QMODE_REPEAT"
        about = {"name": "examination", "maxPayloadSize": 8, "queueingMode": mode}
        if not self._result("BP-RegisterProtocol", protId=_PROTOCOL, **about):
            return
        self._call("BP-TransmitPayload", protId=_PROTOCOL, payload="00ff")
        self._await("BP-PayloadTransmitted.indication", lambda told: told.get("protId") == _PROTOCOL)
        self._call("BP-QueryNumberBufferedPayloads", protId=_PROTOCOL)
        self._call("BP-ClearBuffer", protId=_PROTOCOL)
        self._call("BP-DeregisterProtocol", protId=_PROTOCOL)

    def _vardis(self) -> None:
        create: dict[str, Any] = {"varId": _VARIABLE, "repCnt": 1, "descr": "examination", "value": _VALUE}
        if self._profile.spec_version >= SpecVersion.V2_0:
            create["timeout"] = _TIMEOUT
        own = self._upper.about.get("nodeId")
        if self._profile.spec_version <= SpecVersion.V1_1 and isinstance(own, str):
            create["prodId"] = own
        made = self._result("RTDB-Create", **create)
        if made:
            self._await("UT-VariableChanged", lambda told: told.get("varId") == _VARIABLE)
        listed = self._result("RTDB-DescribeDatabase")
        if made and listed.get("variables") == []:
            self._wrong("RTDB-DescribeDatabase", "no variable is listed after RTDB-Create answered OK", "Methods")
        self._call("RTDB-DescribeVariable", varId=_VARIABLE)
        read = self._result("RTDB-Read", varId=_VARIABLE)
        if made and read and read.get("value") != _VALUE:
            self._wrong("RTDB-Read", f"value is {read.get('value')!r}, but {_VALUE!r} was created", "Values")
        self._call("RTDB-Update", varId=_VARIABLE, value=_NEXT)
        self._call("RTDB-Delete", varId=_VARIABLE)

    def _srp(self) -> None:
        fields = self._profile.srp.safety_data
        values = {each.name: bytes(each.octets).hex() if each.type == "opaque" else 1 for each in fields}
        self._call("SRP-UpdateSafetyData", sData=values)
        self._call("SRP-NeighbourTable")

    def _parameters(self) -> dict[str, dict[str, Any]]:
        """Read all parameters, and set the period to another value; return the initial values by protocol."""
        found: dict[str, dict[str, Any]] = {}
        for protocol in ("BP", "SRP", "VD"):
            values = self._result(f"{protocol}-GetParameters").get("parameters")
            if not isinstance(values, dict):
                continue
            found[protocol] = values
            number = {name: value for name, value in values.items() if isinstance(value, int | float)}
            name = _PERIOD if _PERIOD in number else next(iter(number), "")
            if name and "UT-Reset" in self._upper.methods:
                # Another value of the period shows later whether UT-Reset restores it.
                value = number[name] + (10 if name == _PERIOD else 0)
                self._call(f"{protocol}-SetParameter", name=name, value=value)
        return found

    def _notified(self, names: Mapping[str, object]) -> None:
        if "UT-Subscribe" in self._upper.methods:
            self._call("UT-Subscribe", variables=True, neighbours=True, protIds=[])
            return
        for name in names:
            if name.startswith("UT-"):
                self._found[name] = Examined(name, "optional")

    def _restored(self, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        """Check that UT-Reset restores parameters, and the registrations of SRP and VarDis."""
        if "UT-Reset" not in self._upper.methods:
            return
        listing = "BP-ListRegisteredProtocols" in self._upper.methods
        before = self._registered() if listing else frozenset()
        if self._whole and BP_PROTID_VARDIS in before:
            self._call("BP-DeregisterProtocol", protId=BP_PROTID_VARDIS)
        self._call("UT-Subscribe")
        self._call("UT-Reset")
        for protocol, values in parameters.items():
            now = self._result(f"{protocol}-GetParameters").get("parameters")
            if isinstance(now, dict) and _PERIOD in values and now.get(_PERIOD) != values[_PERIOD]:
                self._faults.forgets_parameters = True
                what = f"{_PERIOD} is {now.get(_PERIOD)} after it, and was {values[_PERIOD]} at the start"
                self._wrong("UT-Reset", f"it does not restore parameters: {what}", "Methods")
        deadline = time.monotonic() + _NOTIFIED
        while listing and before and not before & _OWN <= (now_listed := self._registered()):
            if time.monotonic() >= deadline:
                lost = "VarDis" if BP_PROTID_VARDIS not in now_listed else "SRP"
                self._faults.lost_registration(lost)
                break
            time.sleep(0.05)

    def _registered(self) -> frozenset[int]:
        listed = self._result("BP-ListRegisteredProtocols").get("protocols", ())
        return frozenset(each["protocolId"] for each in listed)

    # -- calls ---------------------------------------------------------------------------------------------------------

    def _call(self, method: str, **params: Any) -> Answer | None:
        """Call a method that the upper tester lists; None without a usable answer."""
        if method not in self._upper.methods or self._unanswered >= _UNANSWERED:
            return None
        try:
            answer = self._upper.call(method, params)
        except NoAnswerError as error:
            self._unanswered += 1
            self._found[method] = Examined(method, "wrong", str(error))
            return None
        except ContractError as error:
            self._found[method] = Examined(method, "wrong", str(error))
            return None
        except CouldNotAskError as error:
            self._found.setdefault(method, Examined(method, "right", f"not asked: {error}"))
            return None
        if answer.code == METHOD_NOT_FOUND:
            self._wrong(method, "UT-Hello lists it, but it is answered with -32601", "Methods")
        elif method not in self._found:
            self._found[method] = Examined(method, "right", str(answer))
        self._told += self._upper.poll()
        return answer

    def _result(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method; return the members of a confirm with OK, the status among them; otherwise none."""
        answer = self._call(method, **params)
        return answer.result if answer is not None and answer.ok else {}

    def _await(self, method: str, fits: Callable[[dict[str, Any]], bool]) -> None:
        """Wait for a notification."""
        if method.startswith("UT-") and "UT-Subscribe" not in self._upper.methods:
            return
        deadline = time.monotonic() + _NOTIFIED
        while not (there := any(each.method == method and fits(each.params) for each in self._told)):
            if time.monotonic() >= deadline or not self._upper.filenos():
                break
            time.sleep(0.01)
            self._told += self._upper.poll()
        self._found[method] = Examined(method, "right" if there else "absent", "" if there else "none within 2 s")

    def _wrong(self, method: str, what: str, place: str) -> None:
        self._found[method] = Examined(method, "wrong", what)
        self._faults.add(Violation(method, what, place, usable=True))


def table(found: list[Examined]) -> Iterator[tuple[str, str, str]]:
    """Yield the rows of a table: method, outcome, and what was observed."""
    words = {"right": "ok", "optional": "- (optional)", "absent": "ABSENT", "wrong": "WRONG"}
    for each in found:
        yield each.method, words[each.outcome], each.what
