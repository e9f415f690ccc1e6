"""Variants of the node's behaviour: number, order and time of payloads, and the processing of doubtful beacons."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
from dcp_conformance.definitions.pics import Capabilities
from dcp_conformance.reference.surroundings import Setup
from dcp_spec.constants import BP_PROTID_VARDIS, SpecVersion

from dcp_codec.values import Container
from dcp_selftest.mutants.family import after, around, assign, before, skips
from dcp_stack.bp.clients import Chosen, ClientList
from dcp_stack.bp.parameters import PERIOD, BPParameters
from dcp_stack.bp.receive import Receiver
from dcp_stack.bp.statistics import LossTable
from dcp_stack.bp.timing import BeaconSchedule
from dcp_stack.bp.wire import Block
from dcp_stack.config import MS, BPConfig, VardisConfig
from dcp_stack.effects import Effect, PayloadReceived, PayloadTransmitted
from dcp_stack.node import Node
from dcp_stack.srp.entity import StateReporting
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.core import Core
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.instructions import Instruction

from .variant import Variant, has_srp, setup

_V = SpecVersion

# -- the content of beacons --------------------------------------------------------------------------------------------


class TwoContainers(Composer):
    """Splits the records of a type into two containers if the payload has room for another container header."""

    def compose(self, room: int) -> tuple[Container, ...]:
        containers = super().compose(room)
        codec = self._database_codec
        used = len(codec.encode_containers(containers)) if containers else 0
        made: list[Container] = []
        for each in containers:
            if len(each.records) < 2 or used + self._sizes.ic_header > room:
                made.append(each)
                continue
            used += self._sizes.ic_header
            made += [
                msgspec.structs.replace(each, records=each.records[:1]),
                msgspec.structs.replace(each, records=each.records[1:]),
            ]
        return tuple(made)

    def __init__(self, core: Core, instructions: Mapping[str, Instruction] | None = None) -> None:
        super().__init__(core, instructions)
        self._database_codec = core.config.codec


# -- times -------------------------------------------------------------------------------------------------------------


class CoarsePeriod(BeaconSchedule):
    """Sends beacons only at multiples of 10 ms."""

    def _place(self) -> None:
        super()._place()
        tick = 10 * MS
        self.due = -(-self.due // tick) * tick


class OneIndicationPerBeacon(Node):
    """Sends one BP-PayloadTransmitted.indication for each client and beacon, whatever the number of its payloads."""

    def take_effects(self) -> list[Effect]:
        indicated: set[int] = set()
        kept: list[Effect] = []
        for effect in super().take_effects():
            if isinstance(effect, PayloadTransmitted):
                if effect.protocol_id in indicated:
                    continue
                indicated.add(effect.protocol_id)
            else:
                indicated.clear()
            kept.append(effect)
        return kept


# -- received beacons --------------------------------------------------------------------------------------------------


class CountChecked(Receiver):
    """Discards a beacon whose numPayloads is not the number of blocks that can be extracted."""

    def receive(self, octets: bytes, now: int) -> None:
        found = self._wire.parse(octets)
        if not found.refused and (not found.count_agrees or found.fault is not None):
            self.drop("empty-payload")
            return
        super().receive(octets, now)


class EmptyDelivered(Receiver):
    """Delivers empty payload blocks to registered clients."""

    def _deliver(self, block: Block, sender: bytes) -> None:
        if block.payload or block.protocol_id not in self._clients:
            super()._deliver(block, sender)
            return
        self._emit(PayloadReceived(block.protocol_id, b"", sender))


class NewestReport(StateReporting):
    """Ignores a report whose sequence number is before that of the stored one, modulo 2^32."""

    def handle_payload(self, payload: bytes, sender_id: bytes, *, now: int, wall: int) -> None:
        try:
            report = self._config.codec.decode_report(payload)
        except Exception:
            report = None
        known = self._table.lookup(report.node_id) if report is not None else None
        if report is not None and known is not None:
            behind = (known.ext_sd.seqno - report.seqno) % (1 << 32)
            if 0 < behind < 1 << 31:
                return
        super().handle_payload(payload, sender_id, now=now, wall=wall)


# -- VarDis ------------------------------------------------------------------------------------------------------------


# --------------------------------------------------------------------------------------------------------------------


def _part(part: type, **more: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, part=part, **more)


def _serving(rank: Callable[[int], int] | None = None, payloads: int = 1 << 16) -> Callable[[str], Setup]:
    """Return nodes that put at most ``payloads`` into a beacon; ``rank`` of a protocol identifier: the lowest first."""

    class Serving(ClientList):
        def take(self, room: int, size: Callable[[bytes], int], most: int) -> Chosen:
            if rank is not None:
                self._order.sort(key=lambda client: rank(client.protocol_id))
            return super().take(room, size, min(most, payloads))

    return _part(Serving)


_DERIVED_VALUE = after(BPParameters, BPParameters.as_dict).part(
    lambda self, found: {**found, "beaconsPerSecond": 1000 / found["BPPAR_BEACON_PERIOD"]}
)
_COARSE_VALUE = around(BPParameters, BPParameters.set).part(
    lambda self, proceed, name, value: proceed(
        name, max(20, value // 20 * 20) if name == PERIOD and isinstance(value, int) and value > 0 else value
    )
)
_SORTED_BLOCKS = after(ClientList, ClientList.take).part(
    lambda self, chosen, room, size, most: sorted(chosen, key=lambda block: block[0])
)
_SCRUBS_WHILE_ACTIVE = skips(Vardis, Vardis._scrub).part(lambda self, now: not self.active)
_NO_LOSSES = before(Receiver, Receiver.receive).part(lambda self, octets, now: assign(self, _losses=LossTable()))
_creation_time = around(Vardis, Vardis._creation_time)
_LITERAL_TIME = _creation_time.part(lambda self, proceed, entry, wall: proceed(None, wall))
_MILLISECONDS = _creation_time.part(lambda self, proceed, entry, wall: proceed(entry, wall // MS * MS))


def _bp(**changes: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, bp=BPConfig(**changes))


_MANY = "dcp-bp.md, Transmit Path: the implementation chooses number and order of payloads"
_ORDER = "dcp-bp.md: the order of clients is free, and BP does not guarantee that a payload is sent (BP-GEN-02)"
_INTERVALS = "dcp-bp.md, Transmit Path: the mean interval tends to the period (BP-TX-01, BP-TX-02)"
#: Before 1.2 BP cannot be deactivated, so that no two payloads can be submitted between two triggered beacons.
_NO_GAP = r"submission (of|and counting of) .* between two beacons: a beacon in between in each attempt"
#: Two beacons can be so close together that no request of the tester fits between them; the second then has room.
_TOO_CLOSE = "payloads full of VarCreates, which this case needs: room for a VarReqUpdate"
#: With intervals that vary so much, a reliable mean needs more beacons than a case waits for.
_TOO_FEW = r"^TC_BP_TX_TI_0[12].*: too few beacons for their variance"

VARIANTS = (
    Variant("V-BP-TX-one-block", "puts one payload into each beacon", _MANY, _serving(payloads=1)),
    Variant("V-BP-TX-two-blocks", "puts at most two payloads into a beacon", _MANY, _serving(payloads=2)),
    Variant("V-BP-TX-ten-blocks", "puts at most ten payloads into a beacon", _MANY, _serving(payloads=10)),
    Variant("V-BP-TX-lowest-first", "serves clients by protocol identifier, the lowest first", _ORDER,
        _serving(lambda protocol: protocol)),
    Variant("V-BP-TX-highest-first", "serves clients by protocol identifier, the highest first", _ORDER,
        _serving(lambda protocol: -protocol)),
    Variant("V-BP-TX-vardis-first", "serves VarDis before other clients", _ORDER,
        _serving(lambda protocol: protocol != BP_PROTID_VARDIS)),
    Variant("V-BP-TX-vardis-last", "serves VarDis after other clients", _ORDER,
        _serving(lambda protocol: protocol == BP_PROTID_VARDIS)),
    Variant(
        "V-BP-TX-priority-one-block",
        "puts one payload into each beacon, that of the lowest protocol identifier",
        _ORDER,
        _serving(lambda protocol: protocol, payloads=1),
        # Up to 1.2 SRP repeats its reports, so that other clients would never be served.
        since=_V.V1_3,
    ),
    Variant("V-BP-PAR-derived", "reports a further value that is computed from one of its parameters",
        "UPPER-TESTER.md: answers may have further members", _part(_DERIVED_VALUE)),
    Variant("V-BP-PAR-ticks", "rounds beacon periods down to multiples of 20 ms",
        "dcp-bp.md: the resolution of time values is system-dependent", _part(_COARSE_VALUE)),
    Variant("V-BP-TX-sorted", "orders the blocks of a beacon by protocol identifier", _ORDER, _part(_SORTED_BLOCKS)),
    Variant("V-BP-TX-triggered", "sends a new payload at once", "BP-TXP-07", _bp(triggered=True), explains=(_NO_GAP,)),
    Variant("V-BP-TX-triggered-denied", "sends a new payload at once, and its PICS claims it", "BP-TXP-07",
        lambda profile: setup(profile, bp=BPConfig(triggered=True), pics=Capabilities(triggered_beacons=True)),
        explains=(_NO_GAP,)),
    Variant("V-BP-TX-jitter-0", "has no jitter", _INTERVALS, _bp(jitter=0.0)),
    Variant("V-BP-TX-jitter-0-denied", "has no jitter, and its PICS denies it", _INTERVALS,
        lambda profile: setup(profile, bp=BPConfig(jitter=0.0), pics=Capabilities(jitter=False))),
    Variant("V-BP-TX-jitter-25", "varies intervals by a quarter to either side", _INTERVALS, _bp(jitter=0.25)),
    Variant("V-BP-TX-jitter-50", "varies intervals by half to either side", _INTERVALS, _bp(jitter=0.5),
        explains=(_TOO_FEW,)),
    Variant("V-BP-TX-jitter-95", "varies intervals between almost zero and twice the period", _INTERVALS,
        _bp(jitter=0.95), explains=(_TOO_FEW, _TOO_CLOSE)),
    Variant("V-BP-TX-ticks", "sends beacons at multiples of 10 ms",
        "dcp-bp.md: the resolution of time values is system-dependent", _part(CoarsePeriod)),
    Variant("V-BP-PTI-per-beacon", "sends one BP-PayloadTransmitted.indication for each client and beacon", "BP-PTI-01",
        _part(OneIndicationPerBeacon)),
    Variant("V-BP-RX-count-checked", "discards a beacon whose numPayloads is not the number of its blocks",
        "dcp-bp.md, Receive Path: an implementation may check it and react (BP-RX-12)", _part(CountChecked),
        since=_V.V1_1),
    Variant("V-BP-RX-empty-delivered", "delivers payload blocks without octets", "dcp-bp.md, Receive Path, step 3",
        _part(EmptyDelivered)),
    Variant("V-BP-RX-no-losses", "does not estimate losses", "BP-RX-11",
        _part(_NO_LOSSES, pics=Capabilities(loss_estimation=False))),
    Variant("V-SRP-RX-newest", "keeps the report with the highest sequence number", "SRP-RX-04",
        _part(NewestReport, pics=Capabilities(srp_seqno_filter=True)), where=has_srp),
    Variant("V-SRP-RX-newest-silent", "keeps the report with the highest sequence number; its PICS does not declare it",
        "SRP-RX-04", _part(NewestReport), where=has_srp),
    Variant("V-VD-IC-two-containers", "sends two containers of a type instead of one", "VD-IC-04", _part(TwoContainers),
        since=_V.V1_2, where=lambda profile: profile.behaviour.containers_per_type == "several"),
    Variant("V-VD-IC-two-containers-claimed", "sends two containers of a type, and its PICS claims it", "VD-IC-04",
        _part(TwoContainers, pics=Capabilities(several_containers=True)), since=_V.V1_2,
        where=lambda profile: profile.behaviour.containers_per_type == "several"),
    Variant("V-VD-RUN-just-before", "composes a VarDis payload 2 ms before its beacon",
        "VD-RUN-01: the indication announces the next beacon, so that payloads can be composed just before it",
        lambda profile: setup(profile, vardis=VardisConfig(buffer_check_period_ms=150, compose_lead_ms=2.0))),
    Variant("V-VD-RUN-early", "composes a VarDis payload 60 ms before its beacon",
        "X54: the time between composing a payload and its beacon is open",
        lambda profile: setup(profile, vardis=VardisConfig(compose_lead_ms=60.0))),
    Variant("V-VD-SCR-while-active", "scrubs only while VarDis is active",
        "dcp-vardis.md, Deactivate: scrubbing is not mentioned", _part(_SCRUBS_WHILE_ACTIVE), since=_V.V2_0),
    Variant("V-VD-CRE-literal-time", "uses the current time as creation time, also for a second creation", "VD-CRE-09",
        _part(_LITERAL_TIME), since=_V.V2_0),
    Variant("V-VD-CRE-ms-clock", "has a clock with a resolution of 1 ms", "dcp-data-types.md: TimeStampT",
        _part(_MILLISECONDS), since=_V.V2_0),
)  # fmt: skip
