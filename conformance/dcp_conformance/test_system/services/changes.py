"""Changes that a case makes to the implementation and that outlast the case, with the calls that undo them.

A case can stop between the call that changes something and the call that changes it back: a check fails, or the upper
tester does not answer. :class:`Changes` gets each call. After the case, :class:`Restoration` makes the calls that are
still due.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

from dcp_conformance.errors import ConformanceError, NeverAnsweredError
from dcp_conformance.upper_tester import Answer

Call = tuple[str, dict[str, Any]]
"""A method and its parameters."""

_REGISTER, _DEREGISTER = "BP-RegisterProtocol", "BP-DeregisterProtocol"
_OFF, _ON, _SET = "-MGMT-Deactivate", "-MGMT-Activate", "-SetParameter"
_SUBSCRIBE, _RESET = "UT-Subscribe", "UT-Reset"
#: Number of calls without an answer after which :meth:`Restoration.restore` gives up.
_GIVEN_UP: Final = 3


class Changes:
    """The changes of one case that are in force.

    A call without an answer counts as executed: its effect is unknown, and undoing it twice does no harm.
    """

    def __init__(self, initial: Callable[[str], Any]) -> None:
        """``initial``: returns the value of a parameter before the case, None if it is not known."""
        self._initial = initial
        self._undo: dict[tuple[str, Any], Call] = {}
        self._confirmed: set[tuple[str, Any]] = set()

    def due(self) -> list[Call]:
        """Return the calls that undo the changes in force, for the latest change first."""
        return list(reversed(self._undo.values()))

    def forget(self) -> None:
        """Record that the implementation is in its initial state: no change is in force."""
        self._undo.clear()
        self._confirmed.clear()

    def asked(self, method: str, params: Mapping[str, Any]) -> None:
        """Record a call that is about to be made."""
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
        """Record the answer to a call."""
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


class Caller(Protocol):
    """Calls services of the implementation."""

    def call(self, method: str, /, **params: Any) -> Answer:
        """Call a service. Raises ``ConformanceError`` if there is no answer."""
        ...


class Restoration:
    """Undoes the changes of a case: activity, parameters, registrations, subscriptions."""

    def __init__(self, changes: Changes, services: Caller, held_protocols: set[int]) -> None:
        """``held_protocols``: gets the protocol identifiers that may still be registered after the case."""
        self._changes = changes
        self._services = services
        self._held_protocols = held_protocols
        self.failure = ""
        """Why :meth:`restore` failed; empty if it succeeded."""

    def restore(self) -> None:
        """Undo the changes of the case. Does not raise: :attr:`failure` describes changes that could not be undone.

        Call it after each case, however it ended.
        """
        self._restore()
        left = (params.get("protId") for method, params in self._changes.due() if method == _DEREGISTER)
        self._held_protocols.update(each for each in left if isinstance(each, int))

    @property
    def restore_failure(self) -> str:
        """Reason why :meth:`restore` could not undo a change that can affect later cases; empty if there is none.

        Remaining registrations and subscriptions do not affect them.
        """
        harmless = (_DEREGISTER, _SUBSCRIBE)
        lasting = any(method not in harmless for method, _ in self._changes.due())
        return self.failure if lasting else ""

    def _restore(self) -> None:
        self.failure, failures = "", 0
        unanswered: set[str] = set()
        # The limits of some parameters depend on others: a value rejected first may be accepted later.
        for _ in range(2):
            for method, params in self._changes.due():
                if method in unanswered:
                    continue
                try:
                    answer = self._services.call(method, **params)
                except NeverAnsweredError as error:
                    self.failure = f"{method}: {error}"
                    unanswered.add(method)
                except ConformanceError as error:
                    self.failure, failures = f"{method}: {error}", failures + 1
                    # Give up on an implementation that does not answer: each call takes the whole time limit.
                    if failures == _GIVEN_UP:
                        return
                else:
                    self.failure = "" if answer.ok else f"{method}: {answer}"
            if not self._changes.due():
                self.failure = ""
                return
