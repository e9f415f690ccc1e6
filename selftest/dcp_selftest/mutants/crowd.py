"""Faults that show with many neighbours, large payloads, long timeouts, or a link that is down for a while."""

from __future__ import annotations

from typing import Literal

import msgspec
from dcp_spec.constants import SpecVersion

from dcp_codec.values import ExtendedSafetyData
from dcp_stack.node import Node
from dcp_stack.srp.neighbour_table import NeighbourTable
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.wire import Extracted, Extractor

from .family import around, instead
from .mutant import mutant

around(NeighbourTable, NeighbourTable.record)("thousand", "SRP-RX-03",
    "has 1000 entries for neighbours and never reuses one",
    lambda self, proceed, report, sender_id, *, now, wall: (
        "full" if report.node_id not in self._entries
        and len(self._entries) >= 1000 else proceed(report, sender_id, now=now, wall=wall)))  # fmt: skip


@mutant("dies-of-1001", "SRP-RX-03 BP-RX-16", "crashes on the 1001st neighbour")
class CrashesOnMany(NeighbourTable):
    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        outcome = super().record(report, sender_id, now=now, wall=wall)
        if len(self._entries) > 1000:
            raise IndexError("no place left in the neighbour table")
        return outcome


@mutant("dies-of-large", "VD-ROB-01", "crashes on a payload larger than its own maximum")
class CrashesOnLarge(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        if len(payload) > self._largest:
            raise BufferError("the buffer is too small")
        return super().extract(payload)

    _largest = 1000
    """Octets; VARDISPAR_MAX_PAYLOAD_SIZE in the profile of the self-test."""


class Scrubs(Vardis):
    """Changes timeouts."""

    def _scrub(self, now: int) -> None:
        entries = self._database.entries
        specs = {var_id: entry.spec for var_id, entry in entries.items()}
        for entry in entries.values():
            entry.spec = msgspec.structs.replace(entry.spec, timeout=self.measured(entry.spec.timeout or 0))
        super()._scrub(now)
        for var_id, entry in entries.items():
            entry.spec = specs[var_id]

    def measured(self, timeout: int) -> int:
        """Return the timeout in ms that is used."""
        return timeout


measured = instead(Scrubs, Scrubs.measured)
measured("signed", "VD-TYP-04 VD-SCR-01", "treats timeouts above 32,767 ms as none",
    lambda self, timeout: timeout if timeout < 0x8000 else 0, since=SpecVersion.V2_0)  # fmt: skip
measured("minute", "VD-TYP-04 VD-SCR-01", "deletes variables after one minute even if their timeout is longer",
    lambda self, timeout: min(timeout, 60_000), since=SpecVersion.V2_0)  # fmt: skip


@mutant("gives-up", "UWB-01", "stops sending after it has received no beacon for 0.7 s")
class GivesUp(Node):
    _heard_at: int | None = None

    def handle_frame(self, octets: bytes, now: int, wall: int) -> None:
        self._heard_at = now if self._listens(now) else self._heard_at
        super().handle_frame(octets, now=now, wall=wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        super().handle_timeout(now, wall)
        if not self._listens(now):
            self.take_effects()

    def _listens(self, now: int) -> bool:
        return self._heard_at is None or now - self._heard_at < 700_000_000
