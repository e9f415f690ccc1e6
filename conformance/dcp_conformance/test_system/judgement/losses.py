"""Frames that the tester has lost in one case, and its other faults that may explain a failed check."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from dcp_spec.constants import BP_SEQNO_MODULUS

from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.impaired_link import incidents_text
from dcp_conformance.lower_tester import Incident, LowerTester
from dcp_conformance.test_system.steps import Steps
from dcp_conformance.test_system.sut_properties import MS, SutProperties
from dcp_conformance.test_system.traffic import Traffic

from .counting import Counting

#: Larger gaps between sequence numbers are not losses: the implementation was restarted, or skips numbers itself.
_LARGEST_GAP = 5
#: Delays of the tester, and times without a beacon, from which a failure is confirmed; in beacon periods.
_HELD, _SILENT = 0.25, 2


@dataclass(eq=False)
class Losses:
    """Frames dropped by the kernel, effects of an impaired link, late steps, and gaps between sequence numbers."""

    _link: LowerTester
    _traffic: Traffic
    _heard: Sequence[ReceivedBeacon]
    """The beacons of the case, which the listener extends."""
    _sut: SutProperties
    _steps: Steps
    _counting: Counting
    """Steps of the beacon numbers in the whole run."""
    dropped: int = field(default=0, init=False)
    """Number of frames that the kernel dropped in this case."""
    _incidents: list[Incident] = field(default_factory=list, init=False)
    _incident_frames: list[int] = field(default_factory=list, init=False)
    """For each incident the number of its frame in the recording; 0 for a frame that is not in the recording."""

    def take_incidents(self, number: int = 0) -> list[Incident]:
        """Ask the link for losses since the last call. Return the effects of an impaired link in this case so far.

        ``number``: of the frame in the recording that has just been sent.
        """
        health = self._link.health()
        self.dropped += health.dropped
        for incident in health.incidents:
            frame = number if incident.to else 0
            self._incidents.append(incident)
            self._incident_frames.append(frame)
            self._traffic.note("note", self._link.wall(), incidents_text([incident], [frame]))
        return self._incidents

    @property
    def of_link(self) -> int:
        """The number of beacons of the implementation that an impaired link is known to have lost in this case."""
        return sum(not each.to for each in self.take_incidents())

    def misleading(self) -> str:
        """Describe effects after which even received data may be wrong; empty without any.

        These are effects of an impaired link, and frames that other data have overtaken on a busy machine: the case has
        taken them for frames that were sent later.
        """
        return self._described(each for each in self.take_incidents() if each.misleads) or self.overtaken()

    def overtaken(self) -> str:
        """Describe the frame that other data have overtaken by the longest time; empty without any."""
        late = self._steps.overtaken_ns
        return f"a frame sent {late / MS:.1f} ms before the end of a wait was received after it" if late else ""

    def own(self, *, numbers: bool = False, patience: float = 1.0) -> str:
        """Describe everything that the tester has missed in this case; empty if nothing is known.

        ``numbers``: only losses that can explain a gap between the sequence numbers of beacons. ``patience``: number of
        beacon periods by which the tester may be late without an effect.
        """
        lost = self.of_tester(numbers=numbers, patience=patience)
        if not numbers and (gaps := self.gaps()):
            lost.append(f"beacons were not heard ({gaps})")
        return ", ".join(lost)

    def of_tester(self, *, numbers: bool = False, patience: float = 1.0) -> list[str]:
        """Describe the faults of the tester or its link in this case. ``numbers`` and ``patience``: see :meth:`own`."""
        incidents = self.take_incidents()
        faults = []
        # Only the loss of a beacon explains a missing sequence number, not the loss of a stimulus.
        if link := self._described(each for each in incidents if not (numbers and each.to)):
            faults.append(link)
        if self.dropped:
            faults.append(f"the kernel dropped {self.dropped} frames")
        if not numbers and (overtaken := self.overtaken()):
            faults.append(overtaken)
        if self._sut.pixit.loss and (gaps := self.gaps()):
            faults.append(f"{self.declared}: {gaps}")
        if not numbers and self._steps.late_ns > patience * self._sut.period:
            faults.append(f"it acted late by {self._steps.late_ns / MS:.0f} ms")
        return faults

    @property
    def declared(self) -> str:
        """The declared loss of the link, as a reason; empty if none is declared."""
        return f"the link loses {self._sut.pixit.loss:.0%} of the frames (pixit.loss)" if self._sut.pixit.loss else ""

    @property
    def chance(self) -> float:
        """The probability, 0..1, that a link with the declared loss has lost a frame of the tester in this case."""
        sent = sum(each.direction == "sent" for each in self._traffic.events)
        return 1 - (1 - (self._sut.pixit.loss or 0)) ** sent

    def lateness(self) -> str:
        """Describe delays after which a reaction may have come too late for a wait of the case; empty without any."""
        silence = self._steps.silence_ns
        silent = f"the implementation sent nothing for {silence / MS:.0f} ms"
        return self.held_up() or (silent if silence > _SILENT * self._sut.period else "")

    def held_up(self) -> str:
        """Describe the longest delay of a wait or a call; empty if none was long."""
        held = self._steps.held_ns
        if held <= _HELD * self._sut.period:
            return ""
        return f"tester or implementation were held up for {held / MS:.0f} ms"

    def explain_all(self, *, numbers: bool = False) -> bool:
        """Return whether faults of the tester explain everything that is missing, so that a repetition may succeed."""
        if not self.of_tester(numbers=numbers):
            return False
        # Frames that the kernel or an impaired link lost explain a gap; lateness does not.
        return bool(self.dropped or self._incidents or self._sut.pixit.loss) or not self.gaps()

    def gaps(self) -> str:
        """Describe the first gap between the sequence numbers of received beacons; empty if there is none."""
        before: int | None = None
        unreadable = 0
        for heard in self._heard:
            after = heard.seqno
            if after is None:
                # Received, but without a readable number: not a loss.
                unreadable += 1
                continue
            if before is not None:
                missing = (after - before - 1) % BP_SEQNO_MODULUS
                if unreadable < missing <= _LARGEST_GAP and not self._counting.by(missing + 1):
                    return f"sequence number {after} follows {before}"
            before, unreadable = after, 0
        return ""

    def _described(self, chosen: Iterable[Incident]) -> str:
        """Return some of the incidents in words; empty for none."""
        frames = {id(incident): number for incident, number in zip(self._incidents, self._incident_frames, strict=True)}
        found = list(chosen)
        return incidents_text(found, [frames[id(each)] for each in found])
