"""Signs of life: check whether the implementation still takes part in the protocols, and describe how it ended.

The runner checks after every case that leaves a doubt, after every start, and before it reports a death.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from dcp_spec.constants import ICType

from dcp_conformance.definitions.case import Case
from dcp_conformance.errors import LowerTesterError, StopCase, UpperTesterError
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.sut.control import SeesSockets, SutControl
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.session import Session

#: Number of unanswered probes after which an implementation counts as silent. Several, because frames can be lost.
QUESTIONS: Final = 4
#: Maximum time in seconds from the loss of a connection to the end of the process.
DEATH_PATIENCE: Final = 1.5
#: Maximum time in seconds from a start to the first answer.
START_PATIENCE: Final = 30.0
#: Maximum time in seconds from opening the link to the first answer, after the first start. If the implementation has
#: several processes, the one that opens the link may start first.
READY_PATIENCE: Final = 8.0
#: Seconds of waiting after which the user gets a message.
SILENT: Final = 3.0
#: Maximum number of beacon periods for sending the records that precede an answer.
_BACKLOG: Final = 100
#: A VarCreate that is in none of this number of last beacons is no longer repeated.
_BEACONS: Final = 3
_BEFORE_REQUESTS: Final = (ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES)
Sign = Literal["answer", "beacon", "service"]
_POLL_NS: Final = 20_000_000
#: Separators in quoted last lines of a process (``dcp_codec.common.child.LastLines.shown``).
_OUTPUT, _LINES = "; its output: ", " | "
_FAULT: Final = re.compile(r"fatal|error|terminate|exception|what\(\)|assert|panic|abort|fault", re.IGNORECASE)
_NUMBERS: Final = re.compile(r"0x[0-9a-fA-F]+|\d+")


@dataclass(frozen=True, slots=True)
class Loss:
    """How the implementation stopped taking part."""

    died: bool
    """Whether its process has ended; otherwise it does not answer, and runs as far as is known."""
    observed: str
    """The observation for the failed check."""
    cause: str = ""
    """How the process ended, and the last lines of its output; empty if that is not known."""
    doubtful: bool = False
    """Whether it only stopped sending beacons and never answered on the link: it may have nothing to send."""
    upper_only: bool = False
    """Whether only the upper tester is lost; the implementation answers on the link."""

    @property
    def how(self) -> str:
        """The predicate of a message about the loss."""
        if self.upper_only:
            return "lost its upper tester"
        return "died" if self.died else "fell silent"

    @property
    def group(self) -> str:
        """A text that is equal for losses with the same probable cause: :attr:`summary`, with all numbers replaced.

        Process ids, addresses and line numbers differ from one loss to the next.
        """
        return _NUMBERS.sub("#", self.summary)

    @property
    def summary(self) -> str:
        """The loss in one line.

        Of the output only the summary of a sanitizer's report is used, or the last line that mentions a fault, or
        else the last line, because several processes print in any order.
        """
        ending, separator, words = self.cause.partition(_OUTPUT)
        if "Sanitizer: " in ending or ": runtime error: " in ending:
            return f"{self.how}: {ending}"
        lines = words.split(_LINES)
        telling = next((line for line in reversed(lines) if _FAULT.search(line)), lines[-1])
        cause = f"{ending}{separator}{telling}" or self.observed
        return f"{self.how}: {cause}"


class Life:
    """Checks whether one implementation is alive."""

    def __init__(self, session: Session, control: SutControl | None, start_timeout: float | None = None) -> None:
        """``start_timeout``: maximum time in seconds from a start to the first answer; None: ``START_PATIENCE``."""
        self._session = session
        self._control = control
        self._timeout_given = start_timeout is not None
        self._start_timeout = START_PATIENCE if start_timeout is None else start_timeout
        self._shown: set[Sign] = set()
        """Kinds of signs of life that were observed before; only the absence of these shows a death."""
        self.upper_tester_error = ""
        """Error message if the upper tester lost its connection since the last check; otherwise empty."""

    def ended(self) -> bool:
        """Return whether the process is known to have ended."""
        return self._control is not None and self._control.alive() is False

    def await_end(self, bench: Bench) -> bool:
        """Wait up to ``DEATH_PATIENCE`` for the process to end; return whether it is known to have ended."""
        deadline = bench.now() + round(DEATH_PATIENCE * 1e9)
        real = time.monotonic() + DEATH_PATIENCE
        # Two clocks are needed: the lower tester's clock stops while the link cannot be read.
        while not self.ended() and bench.now() < deadline and time.monotonic() < real:
            try:
                bench.waiting.wait_ns(_POLL_NS)
            except UpperTesterError as error:
                self.upper_tester_error = str(error)
            except LowerTesterError:
                time.sleep(_POLL_NS / 1e9)
        return self.ended()

    @property
    def has_answered(self) -> bool:
        """Whether the implementation ever answered a summary of an unknown variable."""
        return "answer" in self._shown

    def learn(self, bench: Bench, *, answered: bool = False) -> None:
        """Remember the signs of life in a case. ``answered``: whether a summary of an unknown variable was answered."""
        if bench.heard:
            self._shown.add("beacon")
        if answered:
            self._shown.add("answer")

    def answers(self, bench: Bench, questions: int = QUESTIONS) -> bool:
        """Send up to ``questions`` probes; return whether the implementation is alive.

        If it ever answered a summary of an unknown variable, it must answer one now, or send a VarDis payload that
        cannot be decoded. Otherwise, or if all identifiers are used up, a beacon or an answer of the upper tester
        suffices. No further probe follows once the process is known to have ended.
        """
        strict = "answer" in self._shown and self._can_ask(bench)
        for _ in range(questions):
            before = len(bench.heard)
            try:
                answered = self._asked(bench)
            except LowerTesterError:
                return False
            except UpperTesterError as error:
                # The connection for notifications has ended; the implementation may still be alive.
                self.upper_tester_error = str(error)
                continue
            # A VarDis payload that cannot be decoded may hold the answer, and its sender is alive.
            spoken = any(each.vardis_problems for each in bench.heard[before:])
            if answered or spoken or (not strict and len(bench.heard) > before):
                self.learn(bench, answered=answered and self._can_ask(bench))
                return True
            if self.ended():
                return False
            self._await_backlog(bench, before)
        return not strict and self.serves()

    def _asked(self, bench: Bench) -> bool:
        if self._can_ask(bench):
            with contextlib.suppress(StopCase):
                patience = max(5, bench.sut.reaction)
                return bench.probes.probe(patience) or self._delivers(bench, patience)
        return bool(bench.beacons(1, 5))

    @staticmethod
    def _delivers(bench: Bench, patience: float) -> bool:
        """Request a variable that the implementation states in a summary; return whether it sends the VarCreate.

        A full database requests no further variable (X43), and its limit may be unknown.
        """
        repeated = {each.var_id for each in bench.instructions(ICType.CREATE_VARIABLES, since=-_BEACONS)}
        stated = [each.var_id for each in bench.instructions(ICType.SUMMARIES) if each.var_id not in repeated]
        if not stated:
            return False
        var_id, peer = stated[-1], bench.peer()
        peer.send(peer.request_create(var_id))
        return bench.until_instruction(ICType.CREATE_VARIABLES, var_id, patience) is not None

    @staticmethod
    def _await_backlog(bench: Bench, since: int) -> None:
        """Wait while the SUT sends records that precede requests in a payload; with small payloads this takes long."""

        def leading(heard: ReceivedBeacon) -> bool:
            return any(heard.instructions(kind) for kind in _BEFORE_REQUESTS)

        if any(map(leading, bench.heard[since:])):
            bench.until_quiet(leading, _BACKLOG)

    @staticmethod
    def _can_ask(bench: Bench) -> bool:
        return bench.sut.pics.vardis is not False and bench.identifiers.has_unknown_ids()

    def serves(self) -> bool:
        """Call UT-Hello; return whether the upper tester answers."""
        upper = self._session.upper
        if upper is None or "UT-Hello" not in upper.methods:
            return False
        try:
            upper.call("UT-Hello", {})
        except UpperTesterError as error:
            self.upper_tester_error = str(error)
            return False
        self._shown.add("service")
        return True

    def loss(self, bench: Bench, *, ask: bool) -> Loss | None:
        """Check the implementation after a case; return how it was lost, or None if it is alive.

        ``ask``: whether the case leaves a doubt, so that the implementation must answer a probe.
        """
        self.learn(bench)
        if not self.ended():
            if self.upper_tester_error:
                # A lost connection often precedes the end of the process.
                self.await_end(bench)
                ask = True
            if not self.ended() and (not ask or self.answers(bench)):
                if not self.upper_tester_error or self.serves():
                    self.upper_tester_error = ""
                    return None
                # Calling the upper tester takes seconds, in which the implementation may have ended, too.
                why = self.upper_tester_error
                if not self.ended() and self.answers(bench):
                    self.upper_tester_error = ""
                    observed = f"its upper tester is gone, though it answers on the link: {why}"
                    return Loss(False, observed, upper_only=True)
        self.await_end(bench)
        if not self._shown and not self.ended():
            return None
        self.upper_tester_error = ""
        control = self._control
        if control is not None and self.ended():
            cause = control.why_dead()
            return Loss(
                True, f"it is not running after this case{f': {cause}' if cause else ''}{_last_sign(bench)}", cause
            )
        return Loss(False, self._silence(bench), doubtful=not {"answer", "service"} & self._shown)

    def _silence(self, bench: Bench) -> str:
        """Describe the remaining activity of an implementation that does not answer."""
        try:
            if bench.beacons(1, 5):
                return "VarDis does not answer any more, though there are beacons"
        except (LowerTesterError, UpperTesterError):
            pass
        runs = self._control is not None and self._control.alive()
        return "it does not answer any more" + (", though its process runs" if runs else "")

    def await_answer(self, case: Case) -> str:
        """Wait until a started implementation answers, because it misses frames that are sent earlier.

        ``case`` is the next case, or the last one. Return the reason if it does not answer in time, otherwise an empty
        text.
        """
        if not self._shown and self._control is None:
            return ""
        return self._await(case, lambda _: "")

    def await_start(self, case: Case, say: Callable[[str], None]) -> str:
        """Wait until the implementation answers after its first start, as :meth:`await_answer` does.

        The implementation may be unable to answer. Unless the user has set a timeout, the wait ends
        ``READY_PATIENCE`` s after the implementation has opened the link. After ``SILENT`` s, ``say`` is called with a
        message for the user.
        """
        begun = self._session.lower.now()
        announced, ready = False, 0

        def given_up(bench: Bench) -> str:
            nonlocal announced, ready
            now = bench.now()
            on_link = isinstance(self._control, SeesSockets) and self._control.on_link()
            if not announced and now - begun >= SILENT * 1e9:
                announced = True
                say(self._waiting(bench, (now - begun) / 1e9, on_link=on_link))
            if on_link and not ready:
                ready = now
            if self._timeout_given or not ready or now - ready < READY_PATIENCE * 1e9:
                return ""
            return f"does not answer, though it opened the link {(now - ready) / 1e9:.0f} s ago"

        return self._await(case, given_up, questions=1)

    def _waiting(self, bench: Bench, passed: float, *, on_link: bool) -> str:
        """Describe an implementation that does not answer ``passed`` s after its start, and the remaining wait."""
        runs = self._control is not None and self._control.alive()
        known = "its process runs" if runs else "it is not known whether its process runs"
        if on_link:
            known = "it has opened the link"
        frames = f"{len(bench.receiver.others)} frames of other nodes" if bench.receiver.others else "nothing"
        left = max(0.0, self._start_timeout - passed)
        return (
            f"waiting for the implementation to start: {known}, {frames} heard on {bench.lower.name}; "
            f"at most {left:.0f} s more (access.start_timeout)"
        )

    def _await(self, case: Case, given_up: Callable[[Bench], str], questions: int = QUESTIONS) -> str:
        """Wait for an answer; return why there is none, or an empty text.

        After each attempt ``given_up`` returns a reason to stop waiting, or an empty text.
        """
        # Traffic while waiting is not evidence of the case.
        bench, control = Bench(self._session, case), self._control
        deadline = bench.now() + round(self._start_timeout * 1e9)
        while not self.answers(bench, questions):
            why = given_up(bench)
            bench.receiver.take_newcomer()
            if control is not None and control.alive() is False:
                return f"is dead again: {control.why_dead()}"
            if why or bench.now() >= deadline:
                return why or f"does not answer within {self._start_timeout:g} s"
            try:
                bench.wait(1)
            except LowerTesterError as error:
                return f"cannot be reached: {error}"
            except UpperTesterError as error:
                self.upper_tester_error = str(error)
        self.upper_tester_error = ""
        if isinstance(control, SeesSockets):
            # From now on the loss of its socket shows its end.
            control.on_link()
        return ""


def _last_sign(bench: Bench) -> str:
    """Return a clause with the frame that was sent after the last beacon of the SUT; empty without such a frame."""
    frames = [event for event in bench.traffic.events if event.number and event.direction in ("sent", "heard")]
    last = max((place for place, event in enumerate(frames) if event.direction == "heard"), default=len(frames))
    after = frames[last + 1 :]
    return f"; its last beacon came before frame {after[0].number} of {bench.traffic.frames}" if after else ""
