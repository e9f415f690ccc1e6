"""Calls of the implementation's services through the upper tester."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Protocol

from dcp_codec.codec import Codec
from dcp_conformance.errors import ConformanceError, NeverAnsweredError, UpperTesterError
from dcp_conformance.lower_tester import Impairs, LowerTester
from dcp_conformance.test_system.identifiers.allocation import Identifiers
from dcp_conformance.test_system.judgement.matchers import Matchers
from dcp_conformance.test_system.judgement.verdicts import Verdicts
from dcp_conformance.test_system.reception.receiver import Receiver
from dcp_conformance.test_system.steps import Steps
from dcp_conformance.test_system.traffic import Traffic
from dcp_conformance.upper_tester import Answer, UpperTester
from dcp_conformance.upper_tester.base import INTERNAL_ERROR

from .changes import Changes
from .requirements import family, of_effect


class RunServices(Protocol):
    """The parts of a run that are informed of each call."""

    upper: UpperTester | None
    codec: Codec
    call_times: deque[int]

    @property
    def typical_call(self) -> int:
        """The median duration of calls in ns."""
        ...

    def called(self, method: str, params: Mapping[str, Any], case: str) -> None:
        """Take a call into account that is about to be made."""
        ...

    def forget(self) -> None:
        """Record that the implementation is in its initial state."""
        ...


@dataclass(eq=False)
class Services:
    """Calls services for one case, and checks their statuses. Calls raise ``UpperTesterError`` without an answer."""

    _run: RunServices
    _case_id: str
    _link: LowerTester
    _traffic: Traffic
    _steps: Steps
    _identifiers: Identifiers
    _receiver: Receiver
    _verdicts: Verdicts
    _changes: Changes

    @property
    def upper(self) -> UpperTester:
        """The upper tester. The needs of cases that use it name its methods."""
        if self._run.upper is None:
            raise UpperTesterError("this case needs an upper tester, but none is configured")
        return self._run.upper

    def offers(self, *methods: str) -> bool:
        """Return whether there is an upper tester that offers these methods."""
        return self._run.upper is not None and self._run.upper.methods >= set(methods)

    def call(self, method: str, /, **params: Any) -> Answer:
        """Call a service of the implementation; the answer may be an error."""
        return self.call_on(self.upper, method, **params)

    def call_on(self, upper: UpperTester, method: str, /, **params: Any) -> Answer:
        """As :meth:`call`, on another connection."""
        link, traffic = self._link, self._traffic
        self._steps.begin()
        traffic.note("call", link.wall(), method, params, upper.name)
        self._changes.asked(method, params)
        self._run.called(method, params, self._case_id)
        if isinstance(link, Impairs):
            # A call does not overtake what was sent before it.
            link.settle()
        begun = link.now()
        try:
            answer = upper.call(method, params)
        except UpperTesterError as error:
            self._carried_out(method, params)
            # Waiting for a missing answer is not a delay of the tester.
            self._steps.end(link.now())
            if not isinstance(error, NeverAnsweredError):
                self._steps.held(link.now() - begun - self._run.typical_call)
            raise
        self._changes.answered(method, params, answer)
        if answer.ok and method == "UT-Reset":
            self._run.forget()
        elif answer.ok:
            self._carried_out(method, params)
        # Beacons received during the call are not the tester's delay.
        link.take_in()
        ended = link.now()
        self._steps.end(ended)
        self._steps.held(ended - begun - self._run.typical_call)
        if answer.ok:
            self._run.call_times.append(ended - begun)
        self._steps.stimulated()
        data = answer.result if answer.code is None else {"code": answer.code, "message": answer.message}
        traffic.note("answer", link.wall(), f"{method}: {answer}", data, upper.name)
        self._receiver.take_notifications()
        return answer

    def _carried_out(self, method: str, params: Mapping[str, Any]) -> None:
        """Record the effect of a call that succeeded, or may have."""
        if method == "RTDB-Create" and isinstance(params.get("varId"), int):
            self._identifiers.created_by_others(params["varId"], application=True)

    def expect_status(self, status: str, method: str, /, *requirements: str, **params: Any) -> Answer:
        """Call a service that must answer with this status; a check that does not stop the case."""
        answer = self.call(method, **params)
        self.check_status(answer, (status,), method, *requirements)
        return answer

    def check_status(self, answer: Answer, statuses: Collection[str], method: str, /, *requirements: str) -> bool:
        """Check that the answer to a service has one of these statuses; an unknown status fails.

        A status that the specification lacks, instead of success, violates the requirement about the service: it tells
        nothing about the subject of the case. Stops as inconclusive if the upper tester could not ask the
        implementation.
        """
        expected = f"{method} answers {' or '.join(statuses)}"
        self.require_asked(answer, expected, *requirements)
        other = not any(map(answer.is_status, statuses))
        # An internal error proves nothing: an adapter may send it because the implementation has ended.
        given = answer.code != INTERNAL_ERROR
        if answer.code is None and not answer.known and any(each.endswith("-STATUS-OK") for each in statuses):
            requirements = self._about(method, requirements)
        return Matchers(self._verdicts).none(other, expected, *requirements, seen=answer, given=given)

    def _about(self, method: str, requirements: tuple[str, ...]) -> tuple[str, ...]:
        """Return those of the requirements that are about a service, or else the one about its effect."""
        prefix, events = family(method), self._traffic.events
        if not prefix or not requirements:
            return requirements
        if own := tuple(each for each in requirements if each.startswith(prefix)):
            return own
        call = next(each for each in reversed(events) if each.direction == "call" and each.text == method)
        return of_effect(call, events, self._run.codec.profile.spec_version) or requirements

    def require_asked(self, answer: Answer, expected: str, /, *requirements: str) -> None:
        """Stop as inconclusive unless the answer is that of the implementation."""
        if not answer.asked:
            self._verdicts.inconclusive(expected, f"the upper tester could not ask: {answer}", *requirements)

    def must(self, method: str, /, **params: Any) -> Answer:
        """Call a service that the case needs but does not test; inconclusive if it does not succeed."""
        answer = self.call(method, **params)
        self.require_success(method, answer)
        return answer

    def require_success(self, method: str, answer: Answer) -> None:
        """Stop as inconclusive unless a service that the case needs has succeeded."""
        expected = f"{method} succeeds, which this case needs"
        self.require_asked(answer, expected)
        if not answer.ok:
            self._verdicts.inconclusive(expected, str(answer))

    @contextmanager
    def deactivated(self, entity: str) -> Iterator[None]:
        """Deactivate ``BP`` or ``VD`` within the block; inconclusive if one of the calls does not succeed.

        The entity is activated again however the block ends.
        """
        self.must(f"{entity}-MGMT-Deactivate")
        try:
            yield
        except BaseException:
            with suppress(ConformanceError):
                self.call(f"{entity}-MGMT-Activate")
            raise
        self.must(f"{entity}-MGMT-Activate")
