"""Nodes with a fast path for known beacons, with the same outcome as :class:`~dcp_stack.node.Node`.

Most received beacons change only statistics: they come from a known neighbour, and their VarDis records have the
values that the node already has. In a large network they cause nearly all of the work. Such a beacon is decoded once
for all its receivers (:class:`Parsed`), and each receiver only appends it to a list. The node updates loss estimates,
neighbour table and counters from the list when they are read, or when the list becomes long.

A VarDis payload is known after it was processed once and all its records were ignored: the same octets are ignored
again until the database changes. ``tests/stack/sim/test_hearing.py`` compares these nodes with plain ones.
"""

from __future__ import annotations

import functools
import random
from collections import Counter
from collections.abc import Callable
from itertools import chain
from typing import Any, Final

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import ExtendedSafetyData, VarSumm
from dcp_stack.bp.client_port import ClientPort
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.statistics import NeighbourLoss
from dcp_stack.bp.wire import BPWire
from dcp_stack.bp_port import BPPort
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, VariableChanged
from dcp_stack.node import Node
from dcp_stack.srp.entity import StateReporting
from dcp_stack.srp.neighbour_table import NeighbourTable, NeighbourTableEntry
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.entity import Vardis, VardisState
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Action, Cell

#: Maximum number of waiting beacons of one sender before a node adds them to its statistics.
MOST_WAITING: Final = 64
#: Maximum number of known payloads of a node.
MOST_KNOWN: Final = 1024
#: Readings that have no effect on beacons without an effect: what VarDis ignores once it ignores again.
VARDIS_READINGS: Final = frozenset(
    "X14 X17 X20 X21 X23 X26 X27 X28 X34 X36 X37 X38 X39 X41 X54".split()  # noqa: SIM905 - a list of identifiers
)
#: Number of parsed frames kept: enough for those in flight at a time.
_PARSED: Final = 4096


class Parsed(msgspec.Struct, frozen=True, gc=False):
    """A valid beacon with at most one report of its sender, at most one VarDis payload, and no other payloads.

    ``octets``: length of the frame. ``blocks``: protocol identifiers of its payloads.
    """

    sender_id: bytes
    seqno: int
    network_id: int | None
    report: ExtendedSafetyData | None
    vardis: bytes | None
    octets: int
    blocks: tuple[int, ...]


class ReceivedBeacon(msgspec.Struct, frozen=True, gc=False):
    """The arrival of a :class:`Parsed` beacon; ``now`` is monotonic, ``wall`` since 1970, in ns."""

    beacon: Parsed
    now: int
    wall: int


class Parser:
    """Parses each beacon once for all receivers.

    ``parse`` returns None for a beacon that does not fit :class:`Parsed`; each receiver then processes it completely.
    """

    def __init__(self, config: NodeConfig) -> None:
        """``config``: the configuration of any node of the network."""
        self._codec: Codec = config.codec
        self._wire = BPWire(config)
        self.parse = functools.lru_cache(_PARSED)(self._parse)

    def _parse(self, octets: bytes) -> Parsed | None:
        """Parse a frame, without the cache."""
        found = self._wire.parse(octets)
        header = found.header
        if header is None or found.fault is not None or not found.count_agrees:
            return None
        payloads = {block.protocol_id: block.payload for block in found.blocks}
        if len(payloads) != len(found.blocks) or payloads.keys() - {BP_PROTID_SRP, BP_PROTID_VARDIS}:
            return None
        report = None
        if BP_PROTID_SRP in payloads:
            try:
                report = self._codec.decode_report(payloads[BP_PROTID_SRP])
            except DecodeError:
                return None
            if report.node_id != header.sender_id:
                return None
        if not all(payloads.values()):
            return None
        return Parsed(
            header.sender_id,
            header.seqno,
            header.network_id,
            report,
            payloads.get(BP_PROTID_VARDIS),
            len(octets),
            tuple(block.protocol_id for block in found.blocks),
        )


class HearingBP(BeaconingProtocol):
    """BP whose statistics include the waiting beacons of its node."""

    node: HearingNode | None = None

    def settle(self, sender_id: bytes, heard: list[ReceivedBeacon]) -> None:
        """Add beacons of one sender to the statistics, in the order of their arrival."""
        count, record = self._counters.count, self._losses.record
        count("frames-received", len(heard))
        count("beacons-received", len(heard))
        count("octets-received", sum(each.beacon.octets for each in heard))
        for protocol_id, number in Counter(chain.from_iterable(each.beacon.blocks for each in heard)).items():
            count(f"payloads-received/{protocol_id}", number)
        for each in heard:
            record(sender_id, each.beacon.seqno, each.now)

    def counters(self) -> dict[str, int]:
        """Return the same as :meth:`BeaconingProtocol.counters`, waiting beacons included."""
        self._settle()
        return super().counters()

    def losses(self) -> tuple[NeighbourLoss, ...]:
        """Return the same as :meth:`BeaconingProtocol.losses`, waiting beacons included."""
        self._settle()
        return tuple(sorted(super().losses(), key=lambda entry: entry.heard))

    def _settle(self) -> None:
        """Add all waiting beacons to the statistics."""
        if self.node is not None:
            self.node.settle_all()


class HearingTable(NeighbourTable):
    """A neighbour table that includes the reports in the waiting beacons of its node."""

    node: HearingNode | None = None

    def settle(self, sender_id: bytes, heard: list[ReceivedBeacon]) -> None:
        """Record the reports of one neighbour, in the order of their arrival."""
        for each in heard:
            if each.beacon.report is not None:
                super().record(each.beacon.report, sender_id, now=each.now, wall=each.wall)

    def __iter__(self) -> Any:
        if self.node is not None:
            self.node.settle_all()
        return super().__iter__()

    def lookup(self, node_id: bytes) -> NeighbourTableEntry | None:
        """Return the same as :meth:`NeighbourTable.lookup`, waiting reports included."""
        if self.node is not None:
            self.node.settle_one(node_id)
        return super().lookup(node_id)

    def record(self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int) -> Any:
        """Record a report as :meth:`NeighbourTable.record` does, after the waiting ones."""
        if self.node is not None:
            if len(self) >= self.capacity:
                self.node.settle_all()
            else:
                self.node.settle_one(report.node_id)
        return super().record(report, sender_id, now=now, wall=wall)

    def expire(self, now: int, timeout: int) -> list[bytes]:
        """Remove entries as :meth:`NeighbourTable.expire` does, with regard to waiting reports."""
        gone = []
        for node_id, entry in list(self._entries.items()):
            if now - entry.received_at <= timeout:
                continue
            if self.node is not None:
                # The time of the last waiting report suffices; the reports need not be recorded for it.
                last = self.node.last_report(node_id)
                if last is not None and now - last.now <= timeout:
                    continue
                self.node.forget(node_id)
            self._remove(node_id)
            gone.append(node_id)
        return gone

    def _remove(self, node_id: bytes) -> None:
        """Remove an entry as :meth:`NeighbourTable._remove` does."""
        super()._remove(node_id)
        if self.node is not None:
            # Its next beacon is that of an unknown node and has to be processed completely.
            self.node.waiting.pop(node_id, None)

    def clear(self) -> None:
        """Clear the table as :meth:`NeighbourTable.clear` does."""
        if self.node is not None:
            self.node.forget_all()
        super().clear()


class HearingSRP(StateReporting):
    """SRP with a :class:`HearingTable`."""

    def __init__(self, config: NodeConfig, *args: Any, **more: Any) -> None:
        super().__init__(config, *args, **more)
        usual = self._table
        self._table = self.hearing_table = HearingTable(
            config.profile, capacity=usual.capacity, stamps=usual.stamps, fields=usual.fields
        )


class HearingReceiver(Receiver):
    """A receiver that notes whether a payload had any effect."""

    quiet = True
    """Whether all records of the current payload were ignored so far."""

    def _summary(self, record: VarSumm, offset: int) -> None:
        """Process a VarSumm as :meth:`Receiver._summary` does, without the effect that reports an equal number.

        Nearly all summaries have the stored number. Nodes have the fast path only while nothing listens to drops.
        """
        entry = self._database.lookup(record.var_id)
        if (
            entry is not None
            and entry.seqno == record.seqno
            and not entry.is_deleted
            and entry.spec.prod_id != self._core.own_id
        ):
            self._core.delivery.has(record.var_id)
        else:
            super()._summary(record, offset)

    def _answer(self, cell: Cell, entry: DBEntry | None, var_id: int, offset: int) -> None:
        """Execute a cell as :meth:`Receiver._answer` does, and note whether the record has an effect."""
        if cell.action is not Action.IGNORE:
            self.quiet = False
        super()._answer(cell, entry, var_id, offset)


class HearingVardis(Vardis):
    """VarDis that notes the payloads whose records were all ignored."""

    def __init__(self, config: NodeConfig, bp: BPPort, *, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        def note(effect: Effect) -> None:
            if type(effect) is VariableChanged:
                self.forget()
            emit(effect)

        super().__init__(config, bp, emit=note, now=now, wall=wall)
        self.known: set[bytes | None] = {None}
        """Payloads without an effect while VarDis is active; None represents a beacon without a VarDis payload."""
        self._size = 0
        self._receiver = self._hearing = HearingReceiver(self._core)

    def forget(self) -> None:
        """Clear the known payloads after a change of the state: all payloads have to be processed again."""
        self._hearing.quiet = False
        self.known.clear()
        self.known.add(None)

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        """Process a payload as :meth:`Vardis.handle_payload` does, and note it if it had no effect."""
        self._hearing.quiet = self.active
        super().handle_payload(payload, now=now, wall=wall)
        if self._hearing.quiet:
            if len(self.known) >= MOST_KNOWN:
                self.forget()
            self.known.add(payload)

    def asked_by(self, neighbour: bytes) -> bool:
        """Return whether a request of a neighbour is open; its payloads then have to be processed."""
        return self._core.delivery.asked_by(neighbour)

    def look(self) -> None:
        """Clear the known payloads if entries left the database: up to 1.3 the last VarDelete removes its entry."""
        size = len(self._database)
        if size != self._size:
            self._size = size
            self.forget()

    def start(self, now: int, wall: int) -> BPStatus:
        """Start as :meth:`Vardis.start` does, and clear the known payloads."""
        self.forget()
        return super().start(now, wall)

    def restore(self, state: VardisState) -> None:
        """Restore as :meth:`Vardis.restore` does, and clear the known payloads."""
        super().restore(state)
        self.forget()

    def shutdown(self) -> None:
        """Shut down as :meth:`Vardis.shutdown` does, and clear the known payloads."""
        super().shutdown()
        self.forget()

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """Change a parameter as :meth:`Vardis.set_parameter` does, and clear the known payloads."""
        self.forget()
        return super().set_parameter(name, value)


class HearingNode(Node):
    """A node whose method :meth:`hear` is the fast path for known beacons."""

    def __init__(self, config: NodeConfig, *, rng: random.Random, now: int, wall: int) -> None:
        self.waiting: dict[bytes, list[ReceivedBeacon]] = {}
        """Beacons by sender that the statistics do not include yet. Only senders on the fast path have a key."""
        self.ready = False
        """Whether the fast path may be used for new senders; see :meth:`look`."""
        super().__init__(config, rng=rng, now=now, wall=wall)

    def _build(self, now: int, wall: int) -> None:
        """Create the protocol entities of the fast path."""
        config, emit = self.config, self._pending.append
        self.ready = False
        self.waiting.clear()
        self.bp = self._bp = HearingBP(config, rng=self._rng, emit=emit, now=now, wall=wall)
        self._srp_port, self._vardis_port = ClientPort(self.bp), ClientPort(self.bp)
        self.srp = self._srp = self.vardis = self._vardis = None
        if config.srp:
            self.srp = self._srp = HearingSRP(config, self._srp_port, emit=emit, now=now, wall=wall)
            self._srp.hearing_table.node = self
        if config.vardis:
            self.vardis = self._vardis = HearingVardis(config, self._vardis_port, emit=emit, now=now, wall=wall)
        self._bp.node = self
        self.known: set[bytes | None] = {None} if self._vardis is None else self._vardis.known

    def handle_timeout(self, now: int, wall: int) -> None:
        """Process timeouts as :meth:`Node.handle_timeout` does, and note removed database entries."""
        super().handle_timeout(now, wall)
        if self._vardis is not None:
            self._vardis.look()

    def look(self) -> None:
        """Determine whether the fast path may be used. Call it after services and after the start.

        It may not while a protocol is inactive or has lost its registration with BP, nor if the configuration has
        readings that concern BP or SRP: the node then processes each beacon completely.
        """
        srp, vardis = self._srp, self._vardis
        ready = (
            self.bp.active
            and VARDIS_READINGS.issuperset(self.config.readings)
            and (srp is None or (srp.registered and self._srp_port.holds))
            and (vardis is None or (vardis.active and self._vardis_port.holds))
        )
        if self.ready and not ready:
            self.forget_all()
        self.ready = ready
        if vardis is not None:
            vardis.look()
        self.network_id = self.bp.parameters().get("BPPAR_NETWORK_ID")

    def hear(self, heard: ReceivedBeacon) -> bool:
        """Append a beacon to the waiting ones if it changes only statistics.

        Returns False if the beacon has to be processed completely.
        """
        beacon = heard.beacon
        if beacon.vardis not in self.known or beacon.network_id != self.network_id:
            return False
        waiting = self.waiting.get(beacon.sender_id)
        if waiting is None:
            return self._hear_newcomer(heard)
        waiting.append(heard)
        if len(waiting) >= MOST_WAITING:
            self.settle_one(beacon.sender_id)
        return True

    def _hear_newcomer(self, heard: ReceivedBeacon) -> bool:
        """Take a new sender into the fast path; returns False if its beacon has to be processed completely.

        It has to be if a request of the sender is open, or if its report could change a timer or displace a neighbour.
        """
        beacon = heard.beacon
        if not self.ready or (self._vardis is not None and self._vardis.asked_by(beacon.sender_id)):
            return False
        if self._srp is not None:
            table = self._srp.hearing_table
            if beacon.report is None or not 0 < len(table) < table.capacity:
                return False
        self.waiting[beacon.sender_id] = [heard]
        self.settle_one(beacon.sender_id)
        return True

    def handled(self, beacon: Parsed) -> None:
        """Take the sender of a completely processed beacon into the fast path, unless a request of it is open."""
        if self._vardis is not None and self._vardis.asked_by(beacon.sender_id):
            self.forget(beacon.sender_id)
        elif self.ready and (self._srp is None or beacon.sender_id in self._srp.hearing_table):
            self.waiting.setdefault(beacon.sender_id, [])

    def settle_one(self, sender_id: bytes) -> None:
        """Add the waiting beacons of one sender to the statistics."""
        waiting = self.waiting.get(sender_id)
        if waiting:
            self.waiting[sender_id] = []
            self._bp.settle(sender_id, waiting)
            if self._srp is not None:
                self._srp.hearing_table.settle(sender_id, waiting)

    def settle_all(self) -> None:
        """Add all waiting beacons to the statistics."""
        for sender_id, waiting in self.waiting.items():
            if waiting:
                self.settle_one(sender_id)

    def last_report(self, sender_id: bytes) -> ReceivedBeacon | None:
        """Return the last waiting beacon of a sender with a report, None without one."""
        waiting = self.waiting.get(sender_id, ())
        return next((heard for heard in reversed(waiting) if heard.beacon.report is not None), None)

    def forget(self, sender_id: bytes) -> None:
        """Settle the waiting beacons of a sender, and remove it from the fast path."""
        self.settle_one(sender_id)
        self.waiting.pop(sender_id, None)

    def forget_all(self) -> None:
        """Settle all waiting beacons, and remove all senders from the fast path."""
        self.settle_all()
        self.waiting.clear()
