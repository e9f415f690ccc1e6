"""The session: the state of a run that lasts from case to case."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from statistics import median
from typing import Any, Final

from dcp_spec.constants import ICType, features

from dcp_codec.codec import Codec
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.lower_tester import Arrival, Impairs, LowerTester, OnThisMachine
from dcp_conformance.passive import PassiveTester
from dcp_conformance.upper_tester import UpperTester

from .foreign_reports import ForeignReports
from .identifiers.pool import IdentifierPool
from .judgement.counting import Counting
from .known import Known
from .sut_properties import FLOOR, PeriodOverride, capacity

__all__ = ["FLOOR", "Session"]

#: Number of recent calls of the upper tester whose durations are kept.
_CALLS: Final = 64
#: With fewer identifiers, none is kept for the cases that test boundary values.
_MANY: Final = 63


class Session:
    """The connection to the implementation, the known facts about it, and the identifiers that are still unused."""

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
        """``timing_scale``: factor for all time windows. ``seed``: of the random numbers of cases."""
        self.codec = codec
        self.lower = lower
        self.upper = upper
        self.pics = pics
        self.timing_scale = timing_scale
        self.seed = seed
        self.sut_id: bytes | None = None
        """The implementation's node identifier, once it is known."""
        self.sut_address: bytes | None = None
        """The source address of its last frame: no station of the tester has it."""
        self.parameters: dict[str, Any] = {}
        """Initial values of parameters, as the upper tester reports them."""
        self.known = Known()
        """The findings about the implementation before the first case."""
        self.can_restart = False
        self.renewable = False
        """Whether a case that finds all identifiers used up is run again after a restart."""
        self.restart: Callable[[], None] | None = None
        """Restarts the implementation in its initial state; None if that is not possible."""
        self.switch_link: Callable[[bool], None] | None = None
        """Takes the implementation's link up (True) or down; None if the tester cannot do that."""
        self.survived: set[frozenset[int]] = set()
        """The kinds of containers in each valid frame of cases that the implementation has survived."""
        self.next_node = 0
        """The number of the last virtual node."""
        self.next_protocol = 0
        self.held_protocols: set[int] = set()
        """Protocol identifiers of the tester's clients that may still be registered after their cases."""
        profile = codec.profile
        known = features(profile.spec_version)
        top = (1 << (8 * profile.types.var_id.width)) - 1
        first, last = pics.pixit.var_ids or (0, min(top, 0xFFFF))
        self.boundaries: Mapping[str, int] = {"lowest": 0, "below-half": top // 2, "half": top // 2 + 1, "highest": top}
        """Identifiers of variables with which counters and signs are likely to fail, by name."""
        self.identifier_pool = IdentifierPool(
            first,
            last,
            leave=known.removed_after_deletion,
            timed=known.creation_time,
            kept=self.boundaries.values() if last - first >= _MANY else (),
            capacity=capacity(pics.pixit, profile, "variables"),
        )
        self.creation_time = 0
        """The last time stamp in a record of the tester, in ticks of the profile's clock."""
        self.short_period: PeriodOverride | None = None
        """The short beacon period, while it is in force."""
        self.busy_until = 0
        """Time (ns) until which an implementation that processes payloads one at a time may process those it was sent.
        """
        self.call_times: deque[int] = deque(maxlen=_CALLS)
        """Durations in ns of the last calls of the upper tester that were executed."""
        self.beside = False
        """Whether a case is executed beside others, whose payloads share the beacons with its own."""
        self.provisional = False
        """True if the case will be executed again unless it passes this time."""
        self.counterexamples: set[tuple[str, ...]] = set()
        """The counterexamples that were made shorter: requirements, expectation and observation."""
        self.notifications = 0
        """The time in ns by which notifications are late."""
        self.consumer_scrubs = ""
        """The first case in which the implementation has scrubbed a variable of another node (X26)."""
        self.pausing_fails = False
        """Whether the implementation failed or crashed when BP was deactivated only as a means of a case."""
        self.keeps_payloads: bool | None = None
        """Whether it keeps buffered payloads while BP is deactivated; None: not tried yet."""
        self.foreign_reports = ForeignReports(lower.now())
        """The evidence that an application on the node submits safety data."""
        self.counting = Counting()
        """The steps between the sequence numbers of its beacons."""
        overload = lower.overload if isinstance(lower, OnThisMachine) else None
        self.passive = PassiveTester(codec, pics, self.parameters, overload)
        """Judges every beacon of the implementation, in all cases."""
        if isinstance(lower, Impairs) and lower.changes_intervals:
            self.passive.without_intervals()

    @property
    def typical_call(self) -> int:
        """The median duration of calls in ns; 0 before the first one. A single call may take much longer."""
        return round(median(self.call_times)) if self.call_times else 0

    @property
    def slow_call(self) -> int:
        """The duration in ns that nine of ten calls do not exceed; 0 before the first one."""
        return sorted(self.call_times)[len(self.call_times) * 9 // 10] if self.call_times else 0

    def heard(self, heard: ReceivedBeacon, arrival: Arrival, case: str, traffic: object, departure: int) -> None:
        """Take a frame of the implementation into account for the rest of the run.

        ``case``: identifier of the case that has received it, and ``traffic`` its recording. ``departure``: see
        :meth:`dcp_conformance.test_system.identifiers.allocation.Identifiers.departure`.
        """
        self.sut_address = heard.source
        self.counting.heard(heard.seqno)
        self.foreign_reports.heard(heard.report, arrival.time)
        self.passive.heard(heard, arrival.frame, len(arrival.frame) - len(arrival.octets), case, traffic)
        gone = {each.var_id for each in heard.instructions(ICType.DELETE_VARIABLES)}
        creations = heard.instructions(ICType.CREATE_VARIABLES)
        produced = {each.var_id for each in creations if each.record.spec.prod_id == self.sut_id}
        self.identifier_pool.heard(heard.known - gone, gone, departure, produced)

    def called(self, method: str, params: Mapping[str, Any], case: str) -> None:
        """Take a call of a service into account that a case is about to make."""
        if method == "SRP-UpdateSafetyData":
            self.foreign_reports.submitted(params.get("sData"), self.lower.now())
        self.passive.called(method, params, case)

    def forget(self) -> None:
        """Record that the implementation is in its initial state: it knows nothing from before."""
        self.identifier_pool.forget()
        self.held_protocols.clear()
        self.foreign_reports.forget(self.lower.now())
        self.interrupted()

    def interrupted(self) -> None:
        """Record that the sequence of beacons was interrupted: the next one may begin with any number."""
        self.passive.interrupted(self.lower.now())
