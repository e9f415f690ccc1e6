"""Faults of SRP with many neighbours, several timeouts, long runs, and heuristics of the neighbour table."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import msgspec
from dcp_spec.constants import BP_PROTID_SRP
from dcp_spec.parameters import Violation

from dcp_codec.values import ExtendedSafetyData
from dcp_selftest.mutants.family import assign, attributes, before, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.config import MS
from dcp_stack.srp.entity import StateReporting
from dcp_stack.srp.neighbour_table import NeighbourTable

Outcome = Literal["new", "replaced", "full"]


# -- timeouts ----------------------------------------------------------------------------------------------------------


@mutant("timeout-of-reception", "SRP-RUN-02 SRP-PAR-01", "applies the timeout at the time of reception to each entry")
class TimeoutOfReception(StateReporting):
    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        super().handle_payload(payload, sender_id, now=now, wall=wall)
        kept: dict[bytes, int] = self.__dict__.setdefault("kept", {})
        for entry in self._table:
            if entry.received_at == now:
                kept[entry.node_id] = self._timeout

    def handle_timeout(self, now: int, wall: int) -> None:
        current, kept = self._timeout_ms, self.__dict__.get("kept", {})
        before = [entry for entry in self._table if now - entry.received_at <= kept.get(entry.node_id, 0)]
        super().handle_timeout(now, wall)
        for entry in before:
            self._table._entries.setdefault(entry.node_id, entry)
        for entry in self._table:
            if now - entry.received_at > kept.get(entry.node_id, round(current * MS)):
                self._table._remove(entry.node_id)


class OtherTimeout(StateReporting):
    """Uses another timeout than that of the parameter."""

    @property
    def _timeout(self) -> int:
        return round(self.used(self._timeout_ms) * MS)

    def used(self, timeout: float) -> float:
        """Return the timeout that is used, in ms."""
        return timeout


used = instead(OtherTimeout, OtherTimeout.used)
used("ten-seconds", "SRP-PAR-01 SRP-RUN-02", "treats timeouts above 10 s as 10 s",
    lambda self, timeout: min(timeout, 10_000))  # fmt: skip


@mutant("never-longer", "SRP-PAR-01 SRP-RUN-02", "does not use a timeout that is longer than the one before")
class NeverLonger(StateReporting):
    def set_parameter(self, name: str, value: object) -> Violation | None:
        before = self._timeout_ms
        violation = super().set_parameter(name, value)
        self.least = min(self.__dict__.get("least", self._timeout_ms), self._timeout_ms) if before else self._timeout_ms
        return violation

    @property
    def _timeout(self) -> int:
        return round(self.least * MS)


# -- removal -----------------------------------------------------------------------------------------------------------


class Expiry(NeighbourTable):
    """Removes other entries than those whose timeout has passed."""

    def expire(self, now: int, timeout: int) -> list[bytes]:
        old = [entry.node_id for entry in self if now - entry.received_at > timeout]
        gone = self.removed(old, now, timeout)
        for node_id in gone:
            self._remove(node_id)
        return gone

    def removed(self, old: list[bytes], now: int, timeout: int) -> list[bytes]:
        """Return the entries to be removed; ``old`` are those to be removed, in the order of insertion."""
        return old


# fmt: off
removed = instead(Expiry, Expiry.removed)
removed("two-at-a-time", "SRP-RUN-02", "removes at most two entries in each traversal",
    lambda self, old, now, timeout: old[:2])
removed("first-32", "SRP-RUN-02", "traverses only the first 32 entries",
    lambda self, old, now, timeout: [node_id for node_id in [*self._entries][:32] if node_id in old])
removed("before-the-next", "SRP-RUN-02", "removes an entry at the last traversal before its timeout",
    lambda self, old, now, timeout: [
        entry.node_id for entry in self if now - entry.received_at >= timeout - timeout // 6 + 1])
# fmt: on


# -- entries -----------------------------------------------------------------------------------------------------------


class Keys(NeighbourTable):
    """Finds entries by a part of the identifier of a node."""

    part: ClassVar[slice]

    def record(self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int) -> Outcome:
        for node_id in self._entries:
            if node_id[self.part] == report.node_id[self.part]:
                report = msgspec.structs.replace(report, node_id=node_id)
                break
        return super().record(report, sender_id, now=now, wall=wall)


keys = attributes(Keys, __name__)
keys("last-three", "SRP-RX-05 SRP-RX-03 DATA-04", "compares only the last three octets of node identifiers",
    part=slice(-3, None))  # fmt: skip
keys("last-four", "SRP-RX-05 SRP-RX-03 DATA-04", "compares only the last four octets of node identifiers",
    part=slice(-4, None))  # fmt: skip


def _apart(report: ExtendedSafetyData, other: ExtendedSafetyData) -> float:
    """Return the largest difference of a numeric field of the safety data."""
    pairs = zip(report.s_data.as_dict().values(), other.s_data.as_dict().values(), strict=True)
    return float(max(abs(one - another) for one, another in pairs if not isinstance(one, bytes)))


class Admits(NeighbourTable):
    """Ignores some reports."""

    def record(self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int) -> Outcome:
        memory: dict[bytes, Any] = self.__dict__.setdefault("memory", {})
        if not self.admits(report, memory, now):
            return "replaced"
        memory[report.node_id] = (report, now)
        return super().record(report, sender_id, now=now, wall=wall)

    def admits(self, report: ExtendedSafetyData, memory: dict[bytes, Any], now: int) -> bool:
        """Return whether a report is stored; ``memory`` has the last stored ones, also of removed entries."""
        return True


# fmt: off
admits = instead(Admits, Admits.admits)
admits("outlier", "SRP-RX-03", "ignores reports that are more than 1,000 m away from the stored one",
    lambda self, report, memory, now: (
        report.node_id not in self._entries or _apart(report, memory[report.node_id][0]) <= 1000))
admits("noise", "SRP-RX-03", "ignores reports that differ from the stored one by less than half a metre",
    lambda self, report, memory, now: (
        report.node_id not in self._entries or not 0 < _apart(report, memory[report.node_id][0]) < 0.5))
admits("no-stamp", "SRP-RX-03", "treats reports with the tStamp 0 as invalid",
    lambda self, report, memory, now: report.t_stamp != 0)
admits("once-gone", "SRP-RX-03", "ignores a neighbour for 5 s after it has removed its entry",
    lambda self, report, memory, now: report.node_id in self._entries or report.node_id not in memory
        or now - memory[report.node_id][1] > 5_000_000_000)
admits("numbers-remembered", "SRP-RX-03 SRP-RX-04",
    "ignores lower sequence numbers of a neighbour whose entry it has removed",
    lambda self, report, memory, now: report.node_id in self._entries or report.node_id not in memory
        or report.seqno > memory[report.node_id][0].seqno)
admits("far-ahead", "SRP-RX-03 SRP-RX-04", "ignores reports whose sequence number is 10,000 or more ahead",
    lambda self, report, memory, now: report.node_id not in self._entries
        or not 10_000 <= report.seqno - memory[report.node_id][0].seqno < 1 << 31)
# fmt: on


# -- own reports -------------------------------------------------------------------------------------------------------


before(StateReporting, StateReporting.update_safety_data)("sixteen-bits", "SRP-SEQ-01 SRP-TYP-01",
    "counts reports modulo 65,536",
    lambda self, data, *, now, wall: assign(self, _seqno=self._seqno % 65_536))  # fmt: skip


class Stamps(StateReporting):
    """Stamps some reports with the time of the report before."""

    def update_safety_data(self, data: Any, *, now: int, wall: int) -> Any:
        waiting = self._bp.query_number_buffered(BP_PROTID_SRP).number
        last: tuple[Any, int, int] | None = self.__dict__.get("last")
        stamp = wall if last is None or not self.stays(bool(waiting), data, last, now) else last[2]
        self.last = (data, now, stamp)
        return super().update_safety_data(data, now=now, wall=stamp)

    def stays(self, waiting: bool, data: Any, last: tuple[Any, int, int], now: int) -> bool:
        """Return whether the stamp stays; ``waiting``: the last report is not sent; ``last``: data, now, stamp."""
        return waiting


attributes(Stamps, __name__)("first-stamp", "SRP-TYP-05",
    "gives a report that replaces one that was not sent the tStamp of it")  # fmt: skip
instead(Stamps, Stamps.stays)("same-data", "SRP-TYP-05", "does not renew tStamp if the safety data are the same",
    lambda self, waiting, data, last, now: data == last[0])  # fmt: skip
