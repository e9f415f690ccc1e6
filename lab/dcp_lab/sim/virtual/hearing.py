"""Nodes with a fast path for known beacons, with the same outcome as :class:`~dcp_stack.node.Node`.

Most received beacons change only statistics: they come from a known neighbour, and their VarDis records have the
numbers that the node already has. In a large network they cause nearly all of the work. A beacon with updates and
summaries is decoded once for all its receivers (:class:`Parsed`), and each receiver appends it to a list and processes
the records that have other numbers than its own variables. The node updates loss estimates, neighbour table and
counters from the list when they are read, or when the list becomes long. ``tests/sim/test_hearing.py`` compares
these nodes with plain ones.
"""

from __future__ import annotations

import functools
import random
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import chain, islice
from typing import Any, Final

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, IC_MAX_RECORDS, ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import ExtendedSafetyData, OwnRecord, VardisRecord, VarSumm, VarUpdate
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
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.database import IdQueue
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.wire import ContainerType

#: Maximum number of waiting beacons of one sender before a node adds them to its statistics.
MOST_WAITING: Final = 64
#: Readings that have no effect on the fast path: whatever they are, VarDis ignores records with the stored number.
VARDIS_READINGS: Final = frozenset(
    "X14 X17 X20 X21 X23 X26 X27 X28 X34 X36 X37 X38 X39 X41 X54".split()  # noqa: SIM905 - a list of identifiers
)
#: Number of parsed frames kept: enough for those in flight at a time.
_PARSED: Final = 4096


#: A variable and a sequence number.
Number = tuple[int, int]


class Parsed(msgspec.Struct, frozen=True, gc=False):
    """A valid beacon with at most one report of its sender, at most one VarDis payload, and no other payloads.

    The payload has no other ``records`` than updates and summaries, here with their numbers in the order in which they
    are processed; ``numbers`` are all of these. Both are empty without a payload. ``octets``: length of the frame.
    ``blocks``: protocol identifiers of its payloads.
    """

    sender_id: bytes
    seqno: int
    network_id: int | None
    report: ExtendedSafetyData | None
    records: list[tuple[Number, VarUpdate | VarSumm]]
    numbers: frozenset[Number]
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

    def __init__(self, config: NodeConfig, shared: Codec) -> None:
        """``config``: that of any node of the network. ``shared`` has the containers that the nodes have encoded."""
        self._codec, self._shared = config.codec, shared
        self._wire = BPWire(config)
        self._numbered = [config.container_numbers[kind] for kind in (ICType.UPDATES, ICType.SUMMARIES)]
        """The container types of :attr:`Parsed.records`, in the order in which they are processed."""
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
        payload = payloads.get(BP_PROTID_VARDIS)
        records = [] if payload is None else self._records(payload)
        if records is None:
            return None
        return Parsed(
            header.sender_id,
            header.seqno,
            header.network_id,
            report,
            records,
            frozenset([number for number, _ in records]),
            len(octets),
            tuple([block.protocol_id for block in found.blocks]),
        )

    def _records(self, payload: bytes) -> list[tuple[Number, VarUpdate | VarSumm]] | None:
        """Return the records of a payload; None if it is invalid or has other records than updates and summaries."""
        try:
            containers = self._shared.decode_containers(payload)
        except DecodeError:
            return None
        if any(each.ic_type not in self._numbered for each in containers):
            return None
        ordered = [each.records for kind in self._numbered for each in containers if each.ic_type == kind]
        return [((each.var_id, each.seqno), each) for records in ordered for each in records]


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
    """A receiver that can process single records."""

    def process_one(self, record: VarUpdate | VarSumm, now: int, wall: int) -> None:
        """Process a record as :meth:`Receiver.process` does. Nothing listens to drops, so these have no offset."""
        if type(record) is VarUpdate:
            self._update(record, -1, now, wall)
        elif type(record) is VarSumm:
            self._summary(record, -1)


class HearingComposer(Composer):
    """A composer that takes all summaries at once: in most payloads there is nothing else."""

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        """Return the same as :meth:`Composer._fitting`.

        All summaries have one size: a division replaces the loop, as long as one container holds them.
        """
        size = self._sizes.fixed.get(kind)
        if kind is ICType.SUMMARIES and size is not None and size <= largest:
            header = self._sizes.ic_header
            most = min(self._parameters.max_summaries, max((room - header) // size, 0))
            if min(most, len(queue)) <= IC_MAX_RECORDS:
                chosen = list(islice(queue, most))
                return chosen, header + size * len(chosen) if chosen else 0
        return super()._fitting(kind, queue, room, largest)

    def _take_all(self, kind: ContainerType, chosen: list[int]) -> Sequence[VardisRecord | OwnRecord]:
        """Return the same as :meth:`Composer._take_all`."""
        if kind is not ICType.SUMMARIES or self._own_fields:
            return super()._take_all(kind, chosen)
        entries, queue = self._database.entries, self._database.summary_q
        # Moving all of them to the tail, in their order, changes nothing.
        if len(chosen) < len(queue):
            for var_id in chosen:
                queue.rotate(var_id)
        return [VarSumm(var_id, entries[var_id].seqno) for var_id in chosen]


class HearingVardis(Vardis):
    """VarDis with the numbers of records that have no effect."""

    def __init__(self, config: NodeConfig, bp: BPPort, *, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        def note(effect: Effect) -> None:
            if type(effect) is VariableChanged:
                self._follow(effect.var_id)
            emit(effect)

        super().__init__(config, bp, emit=note, now=now, wall=wall)
        self.quiet: set[Number] = set()
        """The numbers with which updates and summaries have no effect while VarDis is active: the stored ones, without
        deleted variables, and without those whose update by this node waits for such a summary."""
        self._stored: dict[int, Number] = {}
        """The same by variable."""
        self._receiver = self._hearing = HearingReceiver(self._core, self.instructions)
        self._composer = HearingComposer(self._core, self.instructions)

    def _follow(self, var_id: int) -> None:
        """Set the number of a variable that may have changed."""
        before = self._stored.pop(var_id, None)
        if before is not None:
            self.quiet.discard(before)
        entry = self._database.lookup(var_id)
        if entry is not None and not entry.is_deleted and not self._core.delivery.awaits(var_id):
            self._stored[var_id] = number = (var_id, entry.seqno)
            self.quiet.add(number)

    def look(self) -> None:
        """Set the numbers of all variables."""
        for var_id in [*self._stored, *self._database.entries]:
            self._follow(var_id)

    def learn(self, beacon: Parsed, new: frozenset[Number], now: int, wall: int) -> None:
        """Process the records with ``new`` numbers as :meth:`Vardis.handle_payload` does, in their order."""
        self.hears(beacon.sender_id)
        for number, record in beacon.records:
            # The record before it may have been the update with this number.
            if number in new and number not in self.quiet:
                self._hearing.process_one(record, now, wall)
                if number[0] not in self._stored:
                    self._follow(number[0])

    def asked_by(self, neighbour: bytes) -> bool:
        """Return whether a request of a neighbour is open; its payloads then have to be processed."""
        return self._core.delivery.asked_by(neighbour)

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        """Process a payload as :meth:`Vardis.handle_payload` does."""
        super().handle_payload(payload, now=now, wall=wall)
        self.look()


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

    def hear(self, heard: ReceivedBeacon) -> Sequence[Effect] | None:
        """Append a beacon to the waiting ones, and process the records whose numbers are not those of the database.

        Returns the effects; None if the beacon has to be processed completely.
        """
        beacon = heard.beacon
        waiting, vardis = self.waiting.get(beacon.sender_id), self._vardis
        if beacon.network_id != self.network_id or (vardis is None and beacon.records):
            return None
        if waiting is None and not self._takes_newcomer(beacon):
            return None
        if waiting is None:
            self.waiting[beacon.sender_id] = [heard]
            self.settle_one(beacon.sender_id)
        else:
            waiting.append(heard)
            if len(waiting) >= MOST_WAITING:
                self.settle_one(beacon.sender_id)
        if vardis is not None and (new := beacon.numbers - vardis.quiet):
            vardis.learn(beacon, new, heard.now, heard.wall)
            self.settle(heard.now, heard.wall)
            return self.take_effects()
        return ()

    def _takes_newcomer(self, beacon: Parsed) -> bool:
        """Return whether a new sender can be taken into the fast path.

        It cannot if a request of the sender is open, or if its report could change a timer or displace a neighbour.
        """
        if not self.ready or (self._vardis is not None and self._vardis.asked_by(beacon.sender_id)):
            return False
        if self._srp is None:
            return True
        table = self._srp.hearing_table
        return beacon.report is not None and 0 < len(table) < table.capacity

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
