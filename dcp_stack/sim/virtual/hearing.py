"""Nodes that take in known beacons cheaply, with the same outcome as :class:`~dcp_stack.node.Node`.

Most of what a node hears changes nothing but statistics: the beacon of a known neighbour whose VarDis records say what
the node has. In a large network that is nearly all of the work. Such a beacon is decoded once for all its receivers
(:class:`Heard`), and each of them only keeps it in a list; loss estimates, neighbour table and counters are brought up
to date from the list when somebody looks at them, or when it becomes long.

Whether a VarDis payload says nothing new is found out by processing it: if every record of it was ignored, the same
octets will be ignored until the database changes. ``tests/stack/test_sim_hearing.py`` compares these nodes with plain
ones.
"""

from __future__ import annotations

import functools
import random
from collections.abc import Callable
from typing import Any, Final

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import ExtendedSafetyData
from dcp_stack.bp.client_port import ClientPort
from dcp_stack.bp.entity import BeaconingProtocol, NeighbourLoss
from dcp_stack.bp.wire import BPWire
from dcp_stack.bp_port import BPPort
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, VariableChanged
from dcp_stack.node import Node
from dcp_stack.srp.entity import StateReporting
from dcp_stack.srp.neighbour_table import NeighbourTable, NeighbourTableEntry
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Action, Cell

#: Beacons of one sender that a node keeps before it works them into its statistics.
MOST_WAITING: Final = 64
#: Payloads that a node remembers as known.
MOST_KNOWN: Final = 1024
#: Frames remembered as parsed: those under way at a time.
_PARSED: Final = 4096


class Parsed(msgspec.Struct, frozen=True, gc=False):
    """A beacon with a header, at most one report of its sender and at most one VarDis payload, and nothing wrong."""

    sender_id: bytes
    seqno: int
    network_id: int | None
    report: ExtendedSafetyData | None
    vardis: bytes | None
    octets: int
    blocks: tuple[int, ...]


class ReceivedBeacon(msgspec.Struct, frozen=True, gc=False):
    """One arrival of such a beacon; ``now`` is monotonic, ``wall`` since 1970, in ns."""

    beacon: Parsed
    now: int
    wall: int


class Parser:
    """Takes beacons apart once for all receivers. None for any beacon that is not plain: nodes then do it all."""

    def __init__(self, config: NodeConfig) -> None:
        """``config`` is that of any node of the network."""
        self._codec: Codec = config.codec
        self._wire = BPWire(config)
        self.parse = functools.lru_cache(_PARSED)(self._parse)

    def _parse(self, octets: bytes) -> Parsed | None:
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
    """BP whose statistics include beacons that still wait in the lists of its node."""

    node: HearingNode | None = None

    def settle(self, sender_id: bytes, heard: list[ReceivedBeacon]) -> None:
        """Work in beacons of one sender, in the order of their arrival."""
        count, record = self._counters.count, self._losses.record
        count("frames-received", len(heard))
        count("beacons-received", len(heard))
        count("octets-received", sum(each.beacon.octets for each in heard))
        for each in heard:
            record(sender_id, each.beacon.seqno, each.now)
            for protocol_id in each.beacon.blocks:
                count(f"payloads-received/{protocol_id}")

    def counters(self) -> dict[str, int]:
        """As :meth:`BeaconingProtocol.counters`."""
        self._settle()
        return super().counters()

    def losses(self) -> tuple[NeighbourLoss, ...]:
        """As :meth:`BeaconingProtocol.losses`."""
        self._settle()
        return tuple(sorted(super().losses(), key=lambda entry: entry.heard))

    def _settle(self) -> None:
        if self.node is not None:
            self.node.settle_all()


class HearingTable(NeighbourTable):
    """A neighbour table that knows of reports that still wait in the lists of its node."""

    node: HearingNode | None = None

    def settle(self, sender_id: bytes, heard: list[ReceivedBeacon]) -> None:
        """Work in the reports of one neighbour, in the order of their arrival."""
        for each in heard:
            if each.beacon.report is not None:
                super().record(each.beacon.report, sender_id, now=each.now, wall=each.wall)

    def __iter__(self) -> Any:
        if self.node is not None:
            self.node.settle_all()
        return super().__iter__()

    def lookup(self, node_id: bytes) -> NeighbourTableEntry | None:
        """As :meth:`NeighbourTable.lookup`."""
        if self.node is not None:
            self.node.settle_one(node_id)
        return super().lookup(node_id)

    def record(self, report: ExtendedSafetyData, sender_id: bytes, *, now: int, wall: int) -> Any:
        """As :meth:`NeighbourTable.record`."""
        if self.node is not None:
            if len(self) >= self.capacity:
                self.node.settle_all()
            else:
                self.node.settle_one(report.node_id)
        return super().record(report, sender_id, now=now, wall=wall)

    def expire(self, now: int, timeout: int) -> list[bytes]:
        """As :meth:`NeighbourTable.expire`."""
        gone = []
        for node_id, entry in list(self._entries.items()):
            if now - entry.received_at <= timeout:
                continue
            if self.node is not None:
                # Reports of a neighbour that goes on need not be worked in to know that it does.
                last = self.node.last_report(node_id)
                if last is not None and now - last.now <= timeout:
                    continue
                self.node.forget(node_id)
            self._remove(node_id)
            gone.append(node_id)
        return gone

    def _remove(self, node_id: bytes) -> None:
        super()._remove(node_id)
        if self.node is not None:
            # The next beacon of this node is that of a stranger.
            self.node.waiting.pop(node_id, None)

    def clear(self) -> None:
        """As :meth:`NeighbourTable.clear`."""
        if self.node is not None:
            self.node.forget_all()
        super().clear()


class HearingSRP(StateReporting):
    """SRP with such a table."""

    def __init__(self, config: NodeConfig, *args: Any, **more: Any) -> None:
        super().__init__(config, *args, **more)
        usual = self._table
        self._table = self.hearing_table = HearingTable(
            config.profile, capacity=usual.capacity, stamps=usual.stamps, fields=usual.fields
        )


class HearingReceiver(Receiver):
    """Notes records that set something off."""

    quiet = True
    """Whether all records of the payload in work were ignored so far."""

    def _answer(self, cell: Cell, entry: DBEntry | None, var_id: int, offset: int) -> None:
        if cell.action is not Action.IGNORE:
            self.quiet = False
        super()._answer(cell, entry, var_id, offset)


class HearingVardis(Vardis):
    """VarDis that remembers the payloads in which nothing is new to it."""

    def __init__(self, config: NodeConfig, bp: BPPort, *, emit: Callable[[Effect], None], now: int, wall: int) -> None:
        def note(effect: Effect) -> None:
            if type(effect) is VariableChanged:
                self.forget()
            emit(effect)

        super().__init__(config, bp, emit=note, now=now, wall=wall)
        self.known: set[bytes | None] = {None}
        """Payloads that change nothing while VarDis is active; None stands for a beacon without one."""
        self._size = 0
        self._receiver = self._hearing = HearingReceiver(self._core)

    def forget(self) -> None:
        """Something is different: look at all payloads again."""
        self._hearing.quiet = False
        self.known.clear()
        self.known.add(None)

    def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
        """As :meth:`Vardis.handle_payload`."""
        self._hearing.quiet = self.active
        super().handle_payload(payload, now=now, wall=wall)
        if self._hearing.quiet:
            if len(self.known) >= MOST_KNOWN:
                self.forget()
            self.known.add(payload)

    def asked_by(self, neighbour: bytes) -> bool:
        """Whether a neighbour has asked for something and not shown that it has it: then its payloads are looked at."""
        return self._core.delivery.asked_by(neighbour)

    def look(self) -> None:
        """Forget what is known if entries have left the database, which up to 1.3 they do with the last VarDelete."""
        size = len(self._database)
        if size != self._size:
            self._size = size
            self.forget()

    def start(self, now: int, wall: int) -> BPStatus:
        """As :meth:`Vardis.start`."""
        self.forget()
        return super().start(now, wall)

    def shutdown(self) -> None:
        """As :meth:`Vardis.shutdown`."""
        super().shutdown()
        self.forget()

    def set_parameter(self, name: str, value: object) -> Violation | None:
        """As :meth:`Vardis.set_parameter`."""
        self.forget()
        return super().set_parameter(name, value)


class HearingNode(Node):
    """A node that can be told of known beacons by :meth:`hear`."""

    def __init__(self, config: NodeConfig, *, rng: random.Random, now: int, wall: int) -> None:
        self.waiting: dict[bytes, list[ReceivedBeacon]] = {}
        """Beacons by sender that are in no statistics yet; a key for each sender that is known well enough."""
        self.ready = False
        """Whether :meth:`hear` can be used at all: see :meth:`look`."""
        super().__init__(config, rng=rng, now=now, wall=wall)

    def _build(self, now: int, wall: int) -> None:
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
        """As :meth:`Node.handle_timeout`."""
        super().handle_timeout(now, wall)
        if self._vardis is not None:
            self._vardis.look()

    def look(self) -> None:
        """Find out whether known beacons can be taken in the cheap way; call it after services and after the start.

        They cannot where a protocol is not active or has lost its registration with BP, or where a reading was chosen:
        then each beacon is handled as by any node.
        """
        srp, vardis = self._srp, self._vardis
        ready = (
            self.bp.active
            and not self.config.readings
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
        """Take in a beacon if it changes nothing but statistics; False: it has to be handled."""
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
        """As :meth:`hear` for a sender that is new, if it asks for nothing, changes no timer and displaces nobody."""
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
        """A beacon was handled in the ordinary way: the next ones of its sender may be heard, unless it asks."""
        if self._vardis is not None and self._vardis.asked_by(beacon.sender_id):
            self.forget(beacon.sender_id)
        elif self.ready and (self._srp is None or beacon.sender_id in self._srp.hearing_table):
            self.waiting.setdefault(beacon.sender_id, [])

    def settle_one(self, sender_id: bytes) -> None:
        """Bring the statistics about one sender up to date."""
        waiting = self.waiting.get(sender_id)
        if waiting:
            self.waiting[sender_id] = []
            self._bp.settle(sender_id, waiting)
            if self._srp is not None:
                self._srp.hearing_table.settle(sender_id, waiting)

    def settle_all(self) -> None:
        """Bring all statistics up to date."""
        for sender_id, waiting in self.waiting.items():
            if waiting:
                self.settle_one(sender_id)

    def last_report(self, sender_id: bytes) -> ReceivedBeacon | None:
        """The last report of a sender that is not in the neighbour table yet."""
        waiting = self.waiting.get(sender_id, ())
        return next((heard for heard in reversed(waiting) if heard.beacon.report is not None), None)

    def forget(self, sender_id: bytes) -> None:
        """Settle what waits of a sender, and handle its next beacon in the ordinary way."""
        self.settle_one(sender_id)
        self.waiting.pop(sender_id, None)

    def forget_all(self) -> None:
        """As :meth:`forget` for all senders."""
        self.settle_all()
        self.waiting.clear()
