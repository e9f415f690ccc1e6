"""Faults of SRP: in its state reports, and in the neighbour table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, ClassVar, Literal

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, QueueingMode
from dcp_spec.parameters import Violation
from dcp_spec.status import SRPStatus

from dcp_codec.errors import DecodeError
from dcp_codec.values import Beacon, ExtendedSafetyData, Payload
from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.family import after, around, assign, attributes, before, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_selftest.mutants.port import Port
from dcp_selftest.mutants.unseen import NO_MODE
from dcp_stack.bp_port import BPPort
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect
from dcp_stack.srp.entity import StateReporting, UpdateSafetyDataConfirm
from dcp_stack.srp.neighbour_table import NeighbourTable, NeighbourTableEntry

# -- reports -----------------------------------------------------------------------------------------------------------


# fmt: off
report = instead(Air, Air.report)
report("other-id", "SRP-TYP-04 SRP-INI-06", "sends reports with the nodeId of another node",
    lambda self, report: msgspec.structs.replace(report, node_id=report.node_id[:-1] + b"\x77"))
report("when-sent", "SRP-TYP-05", "stamps reports with the time of their transmission",
    lambda self, report: msgspec.structs.replace(report, t_stamp=self.wall))
report("srp-milliseconds", "DATA-05 SRP-TYP-05", "stamps reports in ms although the profile has ns",
    lambda self, report: msgspec.structs.replace(report, t_stamp=report.t_stamp // 1_000_000))
report("srp-swapped-time", "DATA-01", "sends the time of reports little-endian",
    lambda self, report: (
        msgspec.structs.replace(report, t_stamp=int.from_bytes(report.t_stamp.to_bytes(8, "big"), "little"))))
report("srp-swapped-seqno", "DATA-01 SRP-SEQ-01", "sends the sequence number of reports little-endian",
    lambda self, report: (
        msgspec.structs.replace(report, seqno=int.from_bytes(report.seqno.to_bytes(4, "big"), "little"))))
report("constant", "SRP-TYP-06 SRP-SEQ-01", "gives all reports the same sequence number",
    lambda self, report: msgspec.structs.replace(report, seqno=7))
report("from-one", "SRP-SEQ-01", "starts the sequence numbers of reports at 1",
    lambda self, report: msgspec.structs.replace(report, seqno=report.seqno + 1))
report("four-bits", "SRP-SEQ-01 SRP-TYP-01", "counts reports modulo 16",
    lambda self, report: msgspec.structs.replace(report, seqno=report.seqno % 16))
report("eight-bits", "SRP-SEQ-01 SRP-TYP-01", "counts reports modulo 256",
    lambda self, report: msgspec.structs.replace(report, seqno=report.seqno % 256))
report("by-two", "SRP-SEQ-01", "increases the sequence number of reports by two",
    lambda self, report: msgspec.structs.replace(report, seqno=2 * report.seqno))
# fmt: on


@mutant(
    "sent-again", "SRP-SEQ-01 SRP-SRV-03 SRP-SRV-04", "sends its last report again with new numbers and times",
)  # fmt: skip
class SentAgain(Air):
    _last: Any = None

    def handle_timeout(self, now: int, wall: int) -> None:
        super().handle_timeout(now, wall)
        if self._last is not None and self.srp is not None:
            self.srp.update_safety_data(self._last, now=now, wall=wall)

    def report(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        self._last = report.s_data
        return report


@mutant("exchanged-again", "SRP-TYP-03 SRP-SRV-03",
    "exchanges the first two fields of safety data, and sends its last report again with new numbers")  # fmt: skip
class ExchangedAgain(SentAgain):
    def report(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        report = super().report(report)
        first, second, *others = report.s_data.as_dict().values()
        return msgspec.structs.replace(report, s_data=type(report.s_data)(second, first, *others))


instead(StateReporting, StateReporting.update_safety_data)(
    "mute", "SRP-SRV-03", "confirms safety data with OK, and sends no state reports",
    lambda self, data, *, now, wall: UpdateSafetyDataConfirm(SRPStatus.OK),
)  # fmt: skip


@mutant("beacon-number", "SRP-SEQ-01", "uses the sequence number of the beacon for the report in it")
class NumberOfBeacon(Air):
    count = 0

    def report(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        return msgspec.structs.replace(report, seqno=self.count)

    def blocks(self, beacon: Beacon) -> Iterable[Payload]:
        self.count = 0 if beacon.bp is None else beacon.bp.seqno
        return beacon.payloads


class Reporting(StateReporting):
    """Changes calls to BP."""

    port: type[Port] = Port
    registration: ClassVar[dict[str, Any]] = {}
    """Changed arguments of the registration."""
    doubled: ClassVar[bool] = False
    """Whether twice the size of a report is registered."""

    def __init__(self, config: NodeConfig, bp: BPPort, *, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        port: Any = self.port(bp, self.registration, payload=self.payload, factor=1 + self.doubled)
        super().__init__(config, port, emit=emit, now=now, wall=wall)

    def payload(self, payload: bytes) -> bytes:
        """Return the octets to be submitted."""
        return payload


# fmt: off
reporting = attributes(Reporting, __name__)
reporting("repeat", "SRP-INI-03 SRP-SRV-04", "registers with mode REPEAT instead of ONCE",
    registration={"mode": QueueingMode.REPEAT})
reporting("once", "SRP-INI-08", "registers with mode ONCE instead of REPEAT, as in later versions",
    registration={"mode": QueueingMode.ONCE})
reporting("queue", "SRP-TYP-07 SRP-INI-03", "registers with a queue, and therefore sends old reports before new ones",
    unseen=NO_MODE, registration={"mode": QueueingMode.QUEUE_DROPTAIL, "entries": 10})
reporting("other-name", "SRP-INI-01", "registers under the name of VarDis",
    registration={"name": "VarDis -- Variable Dissemination Protocol V2.0"})
# fmt: on


@mutant(
    "small", "SRP-INI-02", "registers with less than the size of a report, which it sends in two parts", unseen=NO_MODE
)
class Small(Reporting):
    class port(Port):  # noqa: N801 - as above
        def register(self, *args: Any, **times: int) -> Any:
            small = (*args[:2], args[2] // 2 + 1, QueueingMode.QUEUE_DROPTAIL, 2, *args[5:])
            return self.bp.register(*small, **times)

        def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> Any:
            half = len(payload) // 2
            self.bp.transmit_payload(prot_id, payload[:half], now=now)
            return self.bp.transmit_payload(prot_id, payload[half:], now=now)


payload = instead(Reporting, Reporting.payload)
payload("filled-up", "SRP-FMT-01 DATA-02", "pads reports to a multiple of eight octets",
    lambda self, payload: payload + bytes(8 - len(payload) % 8), doubled=True)  # fmt: skip
payload("two-more", "SRP-FMT-01", "appends two octets to each report",
    lambda self, payload: payload + b"\xa5\x5a", doubled=True)  # fmt: skip
payload("test-pattern", "SRP-FMT-01", "sends a test pattern of 40 octets instead of each report",
    lambda self, payload: bytes(range(0xA0, 0xA0 + 40)))  # fmt: skip
payload("two", "SRP-FMT-01", "sends each report twice in one payload", lambda self, payload: payload * 2, doubled=True)


@mutant("half", "SRP-SRV-04 SRP-SRV-03", "sends only every other report")
class EveryOther(Reporting):
    class port(Port):  # noqa: N801 - as above
        count = 0

        def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> Any:
            self.count += 1
            return self.bp.transmit_payload(prot_id, payload, now=now) if self.count % 2 else None


@mutant("next-time", "SRP-SRV-03 SRP-TYP-07", "sends a report only when the next one is submitted")
class NextTime(Reporting):
    class port(Port):  # noqa: N801 - as above
        kept = b""

        def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> Any:
            kept, self.kept = self.kept, payload
            return self.bp.transmit_payload(prot_id, kept, now=now) if kept else None


after(StateReporting, StateReporting.update_safety_data)("ok", "SRP-SRV-01",
    "confirms safety data with OK while it is not registered with BP",
    lambda self, confirm, *data, now, wall: UpdateSafetyDataConfirm(SRPStatus.OK))  # fmt: skip


@mutant("number-survives", "SRP-INI-05", "continues the sequence numbers of reports after a reset")
class NumberSurvives(Air):
    def reset(self, now: int, wall: int) -> None:
        seqno = 0 if self.srp is None else self.srp._seqno
        super().reset(now, wall)
        if self.srp is not None:
            self.srp._seqno = seqno


@mutant("table-survives", "SRP-INI-05", "keeps its neighbours across a reset")
class TableSurvives(Air):
    def reset(self, now: int, wall: int) -> None:
        known = {} if self.srp is None else dict(self.srp._table._entries)
        super().reset(now, wall)
        if self.srp is not None:
            self.srp._table._entries.update(known)


@mutant("forwarded", "SRP-RX-06", "forwards the reports of its neighbours")
class Forwards(Air):
    heard: Payload | None = None

    def hears(self, octets: bytes) -> Iterator[bytes]:
        try:
            for block in self.config.codec.decode_envelope(octets)[0].payloads:
                if block.protocol_id == BP_PROTID_SRP and isinstance(block.content, bytes):
                    self.heard = Payload(block.protocol_id, self.config.codec.decode_report(block.content))
        except DecodeError:
            self.heard = None
        yield octets

    def blocks(self, beacon: Beacon) -> Iterable[Payload]:
        heard, self.heard = self.heard, None
        return beacon.payloads if heard is None else (*beacon.payloads, heard)


# -- the neighbour table -----------------------------------------------------------------------------------------------


@mutant("own", "SRP-NT-03 SRP-RX-02", "enters itself into its neighbour table")
class OwnNode(StateReporting):
    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        node_id, self._node_id = self._node_id, b""
        super().handle_payload(payload, sender_id, now=now, wall=wall)
        self._node_id = node_id


@mutant("sender-own", "SRP-RX-02 SRP-RX-05", "uses the sender of the beacon to recognise its own reports")
class OwnSender(StateReporting):
    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        node_id = self._node_id
        self._node_id = node_id if sender_id == node_id else b""
        super().handle_payload(payload, sender_id, now=now, wall=wall)
        self._node_id = node_id


around(StateReporting, StateReporting.handle_payload)("longer", "SRP-RX-01",
    "accepts reports followed by further octets",
    lambda self, proceed, payload, sender_id, *, now, wall: (
        proceed(payload[: self.record_size], sender_id, now=now, wall=wall)))  # fmt: skip


@mutant("shorter", "SRP-RX-01", "accepts truncated reports")
class TakesShorter(StateReporting):
    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        filled = payload if len(payload) > self.record_size else payload.ljust(self.record_size, b"\0")
        super().handle_payload(filled, sender_id, now=now, wall=wall)


class Table(NeighbourTable):
    """Changes the entries of neighbours."""

    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        old = self._entries.get(report.node_id)
        outcome = super().record(report, sender_id, now=now, wall=wall)
        self._entries[report.node_id] = self.entry(old, self._entries[report.node_id])
        return outcome

    def entry(self, old: NeighbourTableEntry | None, new: NeighbourTableEntry) -> NeighbourTableEntry:
        """Return the entry to be stored instead of ``new``."""
        return new if old is None else old


# fmt: off
entry = instead(Table, Table.entry)
entry("first-stays", "SRP-RX-03", "keeps the first report of a neighbour",
    lambda self, old, new: new if old is None else msgspec.structs.replace(new, ext_sd=old.ext_sd))
entry("time-stays", "SRP-RX-03 SRP-RUN-02", "computes the age of a neighbour from its first report",
    lambda self, old, new: (
        new if old is None
        else msgspec.structs.replace(new, received_at=old.received_at, reception_time=old.reception_time)))
entry("equal-time-stays", "SRP-RX-03 SRP-RUN-02",
    "does not renew the reception time of a neighbour for a report with the number of the stored one",
    lambda self, old, new: (
        new if old is None or old.ext_sd.seqno != new.ext_sd.seqno
        else msgspec.structs.replace(new, received_at=old.received_at, reception_time=old.reception_time)))
around(NeighbourTable, NeighbourTable.record)("sender", "SRP-RX-05",
    "uses the sender of the beacon as the key of neighbours",
    lambda self, proceed, report, sender_id, *, now, wall: (
        proceed(msgspec.structs.replace(report, node_id=sender_id), sender_id, now=now, wall=wall)))
before(NeighbourTable, NeighbourTable.record)("one", "SRP-RX-03 SRP-NT-02", "stores only one neighbour",
    lambda self, report, sender_id, *, now, wall: (
        assign(self, _entries={node_id: each for node_id, each in self._entries.items() if node_id == report.node_id})))
after(NeighbourTable, NeighbourTable.lookup)("anybody", "SRP-NT-01",
    "answers a query for an unknown neighbour with another neighbour",
    lambda self, entry, node_id: entry or next(iter(self), None))
# fmt: on


@mutant("two-listed", "SRP-NT-02", "lists at most two neighbours")
class TwoListed(NeighbourTable):
    def __iter__(self) -> Iterator[NeighbourTableEntry]:
        return iter(tuple(super().__iter__())[:2])


instead(NeighbourTable, NeighbourTable.expire)("never", "SRP-RUN-02 SRP-RUN-01", "never removes a neighbour",
    lambda self, now, timeout: [])  # fmt: skip
around(NeighbourTable, NeighbourTable.expire)("half", "SRP-RUN-02 SRP-PAR-01",
    "removes a neighbour after half of the timeout",
    lambda self, proceed, now, timeout: proceed(now, timeout // 2))  # fmt: skip


@mutant("stamp", "SRP-RUN-02", "computes the age of a neighbour from the tStamp of its report")
class ByStamp(NeighbourTable):
    wall = 0

    def record(
        self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int
    ) -> Literal["new", "replaced", "full"]:
        made = now - (wall - self.stamps.wall(report.t_stamp, near=wall))
        outcome = super().record(report, sender_id, now=now, wall=wall)
        self._entries[report.node_id] = msgspec.structs.replace(self._entries[report.node_id], received_at=made)
        return outcome


@mutant("lazy", "SRP-RUN-01", "checks for old neighbours only once per timeout")
class Lazy(StateReporting):
    def poll_timeout(self) -> int | None:
        return self._traversed + self._timeout if self._table else None

    def handle_timeout(self, now: int, wall: int) -> None:
        if now >= self._traversed + self._timeout:
            super().handle_timeout(now, wall)


@mutant("fixed", "SRP-PAR-01", "accepts a new timeout, but keeps using the old one")
class FixedTimeout(StateReporting):
    told: object = None

    def set_parameter(self, name: str, value: object) -> Violation | None:
        before = self.__dict__.get("_timeout_ms", 0)
        violation = super().set_parameter(name, value)
        if before and violation is None:
            self.told, self._timeout_ms = value, before
        return violation

    def parameters(self) -> dict[str, float]:
        shown = super().parameters()
        return shown if self.told is None else dict.fromkeys(shown, self.told)  # type: ignore[arg-type]
