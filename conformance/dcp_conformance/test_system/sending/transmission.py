"""Transmission of frames to the implementation."""

from __future__ import annotations

from dcp_conformance.lower_tester import LowerTester
from dcp_conformance.test_system.judgement.losses import Losses
from dcp_conformance.test_system.steps import Steps
from dcp_conformance.test_system.sut_properties import SutProperties
from dcp_conformance.test_system.traffic import Traffic


class Transmission:
    """Sends the frames of one case, and records them as stimuli. Raises ``LowerTesterError`` if the link fails."""

    def __init__(self, link: LowerTester, traffic: Traffic, steps: Steps, losses: Losses, sut: SutProperties) -> None:
        self._link = link
        self._traffic = traffic
        self._steps = steps
        self._losses = losses
        self._sut = sut

    def send(self, octets: bytes, source: bytes, payloads: int = 1) -> int:
        """Send a bearer payload and return the number of its frame in the recording.

        ``payloads``: number of its blocks that an implementation may process one at a time.
        """
        self._begin()
        frame = self._link.send(octets, source)
        # The duration of the transmission counts as a delay of the tester.
        self._steps.begin()
        self._sut.load(payloads)
        return self._record(frame, len(frame) - len(octets), source.hex(":"))

    def send_frame(self, frame: bytes, start: int) -> int:
        """Send a whole link-layer frame with its bearer payload at offset ``start``; return its number."""
        self._begin()
        self._link.send_frame(frame)
        self._steps.begin()
        return self._record(frame, start)

    def _begin(self) -> None:
        self._steps.begin()
        # Losses before the transmission do not belong to its frame.
        self._losses.take_incidents()

    def _record(self, frame: bytes, start: int, source: str = "") -> int:
        self._steps.stimulated()
        number = self._traffic.frame("sent", self._link.wall(), source, frame, start)
        self._losses.take_incidents(number)
        return number
