"""Model of SRP (dcp-srp.md): the reports of the node, and its neighbour table, whose entries expire.

The time of reception of a report is an interval, and so is the time at which an entry leaves the table. An entry whose
age may have exceeded the timeout at any time may be there or not, until the next report of its node.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import isclose
from typing import Any

import msgspec
from dcp_spec.constants import Features, SpecVersion

from dcp_codec.values import ExtendedSafetyData

from .judgement import MS, Finding, Timing


class Report(msgspec.Struct):
    """A report that a neighbour sent to the node."""

    seqno: int
    t_stamp: int
    first: int
    """Earliest and latest time at which the node may have received it, ns."""
    last: int
    sure: bool
    values: Mapping[str, Any] = {}
    """Its safety data, as :class:`Handed` has it."""


class Handed(msgspec.Struct):
    """Safety data that the tester has submitted."""

    number: int
    values: Any
    before: int
    after: int
    """Times of the call on the node's clock as the tester knows it, ns since 1970."""
    time: int
    sent: int = 0
    seqno: int | None = None
    stamp: int | None = None


class SRPModel:
    """The SRP entity of one node. Times are ns."""

    def __init__(
        self, features: Features, timing: Timing, own_id: bytes, timeout: int, *, alone: bool, room: int | None
    ) -> None:
        """``timeout``: SRPPAR_NEIGHBOUR_TABLE_TIMEOUT, ns. ``alone``: no application of the node submits safety data.

        ``room``: entries of the neighbour table; None if unknown.
        """
        self._once = features.version >= SpecVersion.V1_3
        self.timing = timing
        self._own_id = own_id
        self.timeout = timeout
        self._slow = timeout
        """The longest timeout whose interval of traversal may still run."""
        self._changed = -(1 << 62)
        self._alone = alone
        self._room = room
        self.table: dict[bytes, list[Report]] = {}
        """The reports of each neighbour that the table may show; the newest last."""
        self._doubtful: set[bytes] = set()
        """Neighbours whose entry may have expired since the last report."""
        self._never: dict[bytes, tuple[str, ...]] = {}
        """Nodes that must not be in the table, with the requirements."""
        self.handed: list[Handed] = []
        self._awaited: int | None = None
        """Time of the last submission, ns; None if a beacon after it had its safety data."""
        self._crowded = False
        self._expired = -(1 << 62)

    # -- neighbours --------------------------------------------------------------------------------------------

    def received(
        self, report: ExtendedSafetyData, values: Mapping[str, Any], time: int, forbidden: tuple[str, ...]
    ) -> None:
        """Process a report in a frame to the node.

        ``values``: its safety data; ``forbidden``: why BP must discard the frame.
        """
        node_id = report.node_id
        if node_id == self._own_id:
            forbidden = forbidden or ("SRP-RX-02", "SRP-NT-03")
        self.expire(time)
        if forbidden:
            if node_id not in self.table:
                self._never[node_id] = forbidden
            return
        self._never.pop(node_id, None)
        new = Report(report.seqno, report.t_stamp, time, time + self.timing.late, not self.timing.lossy, values)
        known = self.table.get(node_id, [])
        # SRP-RX-04: a report with a number that is not higher may be filtered.
        filtered = bool(known) and any(report.seqno <= each.seqno for each in known)
        if new.sure and not filtered:
            known = []
            self._doubtful.discard(node_id)
        elif not known:
            self._doubtful.add(node_id)
        else:
            # The age of the entry is unknown now: it may have been renewed.
            known = [msgspec.structs.replace(each, last=new.last) for each in known]
        self.table[node_id] = [*known, new][-8:]
        if self._room is not None and len(self.table) >= self._room:
            self._crowded = True

    def expire(self, time: int) -> None:
        """Let time pass: entries whose age may exceed the timeout are in doubt from then on."""
        if time == self._expired:
            return
        self._expired = time
        for node_id, known in list(self.table.items()):
            if time - min(each.first for each in known) > self.timeout - self._margin:
                self._doubtful.add(node_id)
            traversed = time - self._changed > max(self._slow, self.timeout) // 5 + self._margin + 20 * MS
            if traversed and time - max(each.last for each in known) > self.timeout + self._traversal(time):
                # Gone for certain, whatever the timeout is later.
                del self.table[node_id]
                self._doubtful.discard(node_id)
                self._never[node_id] = ("SRP-RUN-02", "SRP-PAR-01")

    @property
    def _margin(self) -> int:
        """Age before the timeout at which an entry may already be missing: clocks differ."""
        return self.timeout // 1000 + 5 * MS

    def _traversal(self, time: int) -> int:
        """Return the longest delay of the removal after the timeout: a fifth of it, and the tolerance of clocks."""
        interval = self.timeout // 5
        if time - self._changed <= self.timeout + self._slow // 5:
            interval = max(interval, self._slow // 5)
        return interval + self._margin + self.timing.flight + 20 * MS

    def set_timeout(self, timeout: int, time: int) -> None:
        """Record a new SRPPAR_NEIGHBOUR_TABLE_TIMEOUT in ns."""
        self.expire(time)
        self._slow, self.timeout, self._changed = max(self._slow, self.timeout), timeout, time
        self._expired = -(1 << 62)

    def listed(
        self, entries: Sequence[tuple[bytes, Mapping[str, Any]]], time: int, offset: int, only: bytes | None = None
    ) -> Iterator[Finding]:
        """Judge the content of the neighbour table. ``offset``: of the wall clock to ``time``, ns.

        ``only``: the node that was looked up; None for all.
        """
        self.expire(time)
        rows = dict(entries)
        if len(rows) < len(entries):
            twice = next(each for each, count in Counter(node_id for node_id, _ in entries).items() if count > 1)
            yield Finding(("SRP-NT-01",), f"one entry of {_name(twice)}", "several")
        for node_id, known in self.table.items():
            if only not in (None, node_id):
                continue
            name = _name(node_id)
            row = rows.get(node_id)
            if row is None:
                if node_id not in self._doubtful and not self._crowded:
                    age = (time - known[-1].first) // MS
                    which = ("SRP-RX-03", "SRP-RX-05") if age < 500 else ("SRP-PAR-01", "SRP-RUN-02")
                    yield Finding(which, f"an entry of {name}, {age} ms after its report", "no entry")
                    self._doubtful.add(node_id)
                continue
            shown = (row.get("seqno"), row.get("tStamp"))
            fitting = [each for each in known if shown == (each.seqno, each.t_stamp)]
            if None not in shown and not fitting:
                wanted = " or ".join(f"seqno {each.seqno}" for each in known)
                yield Finding(("SRP-RX-03", "SRP-RX-05"), f"{wanted} of {name}", f"seqno {shown[0]}, tStamp {shown[1]}")
            elif fitting:
                yield from self._content(name, row, fitting, offset)
        for node_id, reasons in list(self._never.items()):
            if node_id in rows and node_id not in self.table:
                yield Finding(reasons, f"no entry of {_name(node_id)}", "an entry")
                del self._never[node_id]

    def _content(self, name: str, row: Mapping[str, Any], fitting: list[Report], offset: int) -> Iterator[Finding]:
        """Judge the safety data and the time of reception of an entry."""
        data = row.get("sData")
        if isinstance(data, Mapping) and not any(_alike(data, each.values) for each in fitting):
            yield Finding(("SRP-RX-03",), f"safety data {dict(fitting[-1].values)} of {name}", str(dict(data)))
        stamp, slack = row.get("receptionTime"), self.timing.clock
        if slack is None or type(stamp) is not int:
            return
        if not any(each.first - slack <= stamp - offset <= each.last + slack for each in fitting):
            off = (stamp - offset - fitting[-1].first) // MS
            yield Finding(("SRP-RX-03", "SRP-RUN-02"), f"the time of reception of {name}", f"a time {off} ms later")

    # -- reports of the node -----------------------------------------------------------------------------------

    def submitted(self, values: Any, before: int, after: int, time: int) -> None:
        """Record an SRP-UpdateSafetyData with status OK, between two times of the tester's wall clock."""
        self.handed.append(Handed(len(self.handed), values, before, after, time))
        self._awaited = time

    def sent(
        self, report: ExtendedSafetyData, values: Any, stamp: int | None, sender: bytes | None, time: int
    ) -> Iterator[Finding]:
        """Judge a report in a beacon. ``values``: its safety data; ``stamp``: its tStamp in ns since 1970, if known."""
        if sender is not None and report.node_id != sender:
            known = report.node_id in self.table
            which = ("SRP-RX-06", "SRP-TYP-04") if known else ("SRP-TYP-04",)
            yield Finding(which, f"nodeId {_name(sender)}", _name(report.node_id))
            return
        mine = [each for each in self.handed if each.values == values]
        if not mine or not (self._alone or any(map(_distinct, values.values()))):
            return
        if mine[-1] is self.handed[-1]:
            self._awaited = None
        this = mine[-1]
        if len(mine) > 1:
            # Several submissions have the same data: identify this one by its sequence number.
            before = next((each for each in reversed(self.handed) if each.seqno is not None), None)
            if not self._once or before is None or before.seqno is None:
                return
            if before.seqno == report.seqno and before in mine and this.time < time - self.timing.flight:
                yield Finding(("SRP-TYP-06", "SRP-SEQ-01"), f"another number than {before.seqno}", str(report.seqno))
                return
            number = before.number + (report.seqno - before.seqno) % (1 << 32)
            if number not in {each.number for each in mine}:
                return
            this = self.handed[number]
        newest = [each for each in self.handed if each.number > this.number]
        if any(time - each.time > self.timing.flight for each in newest):
            yield Finding(
                ("SRP-TYP-07",),
                f"the safety data of submission {newest[-1].number + 1}",
                f"the safety data of submission {this.number + 1}",
            )
            return
        this.sent += 1
        if self._once and this.sent > 1:
            yield Finding(("SRP-SRV-04", "SRP-INI-03"), "safety data in one beacon", f"in {this.sent} beacons")
        yield from self._numbered(this, report.seqno)
        if stamp is not None:
            yield from self._stamped(this, stamp)

    def unsent(self, time: int, held: int, period: int) -> Iterator[Finding]:
        """Judge that no beacon had the last safety data by ``time``. ``held``: until when there was no room, ns.

        ``period``: the longest beacon period, ns.
        """
        if self._awaited is None or self.timing.lossy or not self._alone or not self.timing.patience:
            return
        if time - max(self._awaited, held) > max(self.timing.patience, 10 * period):
            self._awaited = None
            yield Finding(("SRP-SRV-03", "SRP-SRV-04"), "the safety data of the last submission in a beacon", "none")

    def _numbered(self, this: Handed, seqno: int) -> Iterator[Finding]:
        for each in reversed(self.handed[: this.number]):
            if each.seqno is None:
                continue
            steps = this.number - each.number
            grown = (seqno - each.seqno) % (1 << 32)
            if grown == 0:
                yield Finding(("SRP-TYP-06", "SRP-SEQ-01"), f"another number than {each.seqno}", str(seqno))
            elif (self._alone and grown != steps) or not steps <= grown < 1 << 31:
                yield Finding(("SRP-SEQ-01",), f"number {(each.seqno + steps) % (1 << 32)}", str(seqno))
            break
        this.seqno = seqno

    def _stamped(self, this: Handed, stamp: int) -> Iterator[Finding]:
        """Judge a time stamp, by the clock if it is known, or by the stamp of an earlier submission."""
        if self.timing.clock is None:
            return
        slack = self.timing.clock
        if not this.before - slack <= stamp <= this.after + slack:
            off = (stamp - this.before) // MS
            yield Finding(("SRP-TYP-05",), "the time of the submission as tStamp", f"a time {off} ms later")
        this.stamp = stamp

    @property
    def watched(self) -> bool:
        """Whether there is anything to query in the table."""
        return bool(self.table or self._never)

    @property
    def known(self) -> list[bytes]:
        """A few nodes that were or are in the table, or must not be in it."""
        return [*list(self._never)[-1:], *list(self.table)[-1:]]

    def state_of(self, node_id: bytes) -> str:
        """A name of the state of an entry, for statistics."""
        if node_id in self.table:
            return "may have expired" if node_id in self._doubtful else "present"
        return "refused or expired" if node_id in self._never else "absent"


def _name(node_id: bytes) -> str:
    return node_id.hex(":") if len(node_id) <= 8 else node_id.decode(errors="replace")


def _distinct(value: Any) -> bool:
    """Return whether an application is unlikely to submit a value by itself: zeros are the initial values of many."""
    return bool(value.strip("0") if isinstance(value, str) else value)


def _alike(shown: Mapping[str, Any], values: Mapping[str, Any]) -> bool:
    """Return whether safety data is the same, as far as an answer in decimal digits shows it."""
    for name, value in values.items():
        given = shown.get(name)
        if isinstance(value, float) and isinstance(given, int | float):
            if not isclose(given, value, rel_tol=1e-5, abs_tol=1e-5):
                return False
        elif type(given) is type(value) and given != value:
            return False
    return True
