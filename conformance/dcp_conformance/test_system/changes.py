"""Changes that a case makes at the implementation and that would outlast the case, with the calls that undo them.

A case can stop between the call that changes something and the call that changes it back: a check fails, or the upper
tester does not answer. The bench reports each call to :class:`Changes` and, after the case, makes the calls that are
still due.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from dcp_conformance.upper_tester import Answer

Call = tuple[str, dict[str, Any]]
"""A method and its parameters."""

_REGISTER, _DEREGISTER = "BP-RegisterProtocol", "BP-DeregisterProtocol"
_OFF, _ON, _SET = "-MGMT-Deactivate", "-MGMT-Activate", "-SetParameter"
_SUBSCRIBE, _RESET = "UT-Subscribe", "UT-Reset"


class Changes:
    """The changes of one case that are in force.

    A call without an answer counts as carried out: nobody knows, and to undo it once too often does no harm.
    """

    def __init__(self, initial: Callable[[str], Any]) -> None:
        """``initial``: returns the value of a parameter before the case, None if it is not known."""
        self._initial = initial
        self._undo: dict[tuple[str, Any], Call] = {}
        self._confirmed: set[tuple[str, Any]] = set()

    def due(self) -> list[Call]:
        """The calls that undo what is in force; the latest change comes first."""
        return list(reversed(self._undo.values()))

    def forget(self) -> None:
        """The implementation is in its initial state: nothing is in force any more."""
        self._undo.clear()
        self._confirmed.clear()

    def asked(self, method: str, params: Mapping[str, Any]) -> None:
        """A call is about to be made."""
        key, undo = (method, None), None
        if method == _REGISTER:
            key, undo = (method, params.get("protId")), (_DEREGISTER, {"protId": params.get("protId")})
        elif method.endswith(_OFF):
            undo = (method.removesuffix(_OFF) + _ON, {})
        elif method == _SUBSCRIBE and params:
            undo = (method, {})
        elif method.endswith(_SET) and (old := self._initial(str(params.get("name")))) is not None:
            key, undo = (method, params["name"]), (method, {"name": params["name"], "value": old})
        if undo is not None:
            self._undo.setdefault(key, undo)

    def answered(self, method: str, params: Mapping[str, Any], answer: Answer) -> None:
        """A call was answered."""
        if method == _REGISTER:
            key = (method, params.get("protId"))
            if answer.ok:
                self._confirmed.add(key)
            elif key not in self._confirmed:
                self._drop(key)
        elif method == _DEREGISTER and (answer.ok or answer.status.replace("_", "-").endswith("-UNKNOWN-PROTOCOL")):
            self._drop((_REGISTER, params.get("protId")))
        elif not answer.ok:
            return
        elif method == _RESET:
            self.forget()
        elif method.endswith(_ON):
            self._drop((method.removesuffix(_ON) + _OFF, None))
        elif method == _SUBSCRIBE and not params:
            self._drop((method, None))
        elif method.endswith(_SET):
            key = (method, params.get("name"))
            if key in self._undo and self._undo[key][1]["value"] == params.get("value"):
                self._drop(key)

    def _drop(self, key: tuple[str, Any]) -> None:
        self._undo.pop(key, None)
        self._confirmed.discard(key)
