"""What lasts from case to case."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from statistics import median
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from dcp_spec.constants import BP_SEQNO_MODULUS, ICType, features

from dcp_codec.codec import Codec
from dcp_conformance.lower_tester import Arrival, Impairs, LowerTester, OnThisMachine
from dcp_conformance.model.pics import REACTION_FLOOR, Pics
from dcp_conformance.passive import PassiveTester
from dcp_conformance.upper_tester import UpperTester

from .contact import Contact
from .identifiers import Identifiers
from .misreading import Field

if TYPE_CHECKING:
    from dcp_conformance.execution.concurrent.short_period import ShortPeriod
    from dcp_conformance.frames.received import ReceivedBeacon

    from .waiting import Waiting

FLOOR: Final = REACTION_FLOOR


class Reaction(NamedTuple):
    """What was measured; times in beacon periods."""

    periods: float = FLOOR
    """Within this time the answer to a single question is to be expected, with a margin."""
    per_payload: float = 0.0
    """Additional time for each received payload that waits before the one that is asked about; 0: it takes all."""
    samples: tuple[float, ...] = ()
    """From question to answer, one by one; empty if nothing was answered."""

    def __str__(self) -> str:
        if not self.samples:
            return f"{self.periods:g} beacon periods (not measured: no answer)"
        one = f", and {self.per_payload:.2g} for each payload that waits" if self.per_payload else ""
        return (
            f"{self.periods:.1f} beacon periods{one} (slowest of {len(self.samples)} answers: {max(self.samples):.2f})"
        )


#: Calls of the upper tester that are looked back on.
_CALLS = 64
#: With fewer identifiers none is kept for the cases that try boundary values.
_MANY = 63
#: So often a step must have been seen, and so many times as often as 1, to be how an implementation counts.
_STEPS = 5


class Counting:
    """The steps between the sequence numbers of beacons that were heard one after the other."""

    def __init__(self) -> None:
        self._steps: Counter[int] = Counter()
        self._last: int | None = None

    def heard(self, seqno: int | None) -> None:
        """The next beacon; None if its number cannot be read."""
        if seqno is not None and self._last is not None:
            self._steps[(seqno - self._last) % BP_SEQNO_MODULUS] += 1
        self._last = seqno

    def by(self, step: int) -> bool:
        """Whether the implementation itself counts in such steps: almost none of its numbers are consecutive."""
        return self._steps[step] >= _STEPS and self._steps[step] > _STEPS * self._steps[1]


class Session:
    """What lasts from case to case: the way to the implementation, what is known of it, and names not used yet."""

    def __init__(
        self,
        codec: Codec,
        lower: LowerTester,
        upper: UpperTester | None,
        pics: Pics,
        *,
        timing_scale: float = 1.0,
        seed: int = 1,
    ) -> None:
        self.codec = codec
        self.lower = lower
        self.upper = upper
        self.pics = pics
        self.timing_scale = timing_scale
        self.seed = seed
        self.sut_id: bytes | None = None
        """The implementation's node identifier, once it is known."""
        self.parameters: dict[str, Any] = {}
        """Initial values of parameters, as the upper tester told them."""
        self.contact: Contact | None = None
        """What the basic interconnection test has found; None before it, and where it is left out."""
        self.can_restart = False
        self.renewable = False
        """Whether a case that finds all identifiers used up is run again after a restart."""
        self.restart: Callable[[], None] | None = None
        """Starts the implementation again, from its initial state; None where that cannot be done."""
        self.switch_link: Callable[[bool], None] | None = None
        """Takes the implementation's link up (True) or down; None where the tester cannot do that."""
        self.next_peer = 0
        self.next_protocol = 0
        self.held_protocols: set[int] = set()
        """Protocol identifiers of the tester's clients that may still be registered, though their cases are over."""
        profile = codec.profile
        known = features(profile.spec_version)
        top = (1 << (8 * profile.types.var_id.width)) - 1
        first, last = pics.pixit.var_ids or (0, min(top, 0xFFFF))
        self.boundaries = {"lowest": 0, "below-half": top // 2, "half": top // 2 + 1, "highest": top}
        """Identifiers of variables with which counting and signs go wrong, by name."""
        self.identifiers = Identifiers(
            first,
            last,
            leave=known.removed_after_deletion,
            timed=known.creation_time,
            kept=self.boundaries.values() if last - first >= _MANY else (),
        )
        self.creation_time = 0
        self.reaction: Reaction | None = None
        """How fast the implementation reacts, once it was measured."""
        self.short_period: ShortPeriod | None = None
        """The short beacon period, while it is in force."""
        self.busy_until = 0
        """Time (ns) until which it is busy with what it was sent, if it takes one received payload at a time."""
        self.call_times: deque[int] = deque(maxlen=_CALLS)
        """ns that the last calls of the upper tester took which the implementation carried out."""
        self.lost_container = ""
        """Which of the two containers of a payload the implementation was found to lose, "first" or "second"; empty if
        none (see :mod:`dcp_conformance.test_system.extraction`)."""
        self.misread: dict[Field, str] = {}
        """The fields that the implementation was found to misread (``interconnection/misreading.py``)."""
        self.pausing_fails = False
        """Whether deactivating BP, as a means to an end, was found to kill the implementation or to fail."""
        self.counting = Counting()
        """By how much its beacons are numbered."""
        overload = lower.overload if isinstance(lower, OnThisMachine) else None
        self.passive = PassiveTester(codec, pics, self.parameters, overload)
        """Judges every beacon of the implementation, whatever the case is about."""
        if isinstance(lower, Impairs) and lower.changes_intervals:
            self.passive.without_intervals()

    @property
    def typical_call(self) -> int:
        """The median time of calls in ns; 0 before the first one. A single call may hang for reasons of its own."""
        return round(median(self.call_times)) if self.call_times else 0

    @property
    def slow_call(self) -> int:
        """The time in ns that nine of ten calls do not exceed; 0 before the first one."""
        return sorted(self.call_times)[len(self.call_times) * 9 // 10] if self.call_times else 0

    def heard(self, heard: ReceivedBeacon, arrival: Arrival, bench: Waiting) -> None:
        """Take a frame of the implementation that ``bench`` has received into account for the rest of the run."""
        self.take(heard, arrival, bench.case.id, bench.traffic, bench.departure())

    def take(self, heard: ReceivedBeacon, arrival: Arrival, case: str, traffic: object, departure: int) -> None:
        """As :meth:`heard`; ``departure``: see :meth:`dcp_conformance.test_system.allocation.Allocation.departure`."""
        self.counting.heard(heard.seqno)
        self.passive.heard(heard, arrival.frame, len(arrival.frame) - len(arrival.octets), case, traffic)
        gone = {each.var_id for each in heard.instructions(ICType.DELETE_VARIABLES)}
        self.identifiers.heard(heard.known - gone, gone, departure)

    def forget(self) -> None:
        """The implementation is in its initial state: it knows nothing of what was sent or asked before."""
        self.identifiers.forget()
        self.held_protocols.clear()
        self.passive.interrupted(self.lower.now())
