"""One VarDis over a BP that keeps a single payload, in virtual time; what it sends is decoded again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec
from dcp_spec.constants import ICType, QueueingMode
from dcp_spec.status import BPStatus, VardisStatus

from dcp_codec import get_codec
from dcp_codec.values import (
    Container,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)
from dcp_stack.config import BPConfig, NodeConfig, VardisConfig
from dcp_stack.effects import Dropped, Effect, VariableChanged
from dcp_stack.vardis.entity import Vardis

MS = 1_000_000
WALL = 1_700_000_000_000_000_000
ME = bytes.fromhex("020000000001")
OTHER = bytes.fromhex("020000000002")
THIRD = bytes.fromhex("020000000003")
VERSIONS = ("1.0", "1.1", "1.2", "1.3", "2.0")


class Answer(msgspec.Struct):
    """A confirm of BP."""

    status: BPStatus = BPStatus.OK
    own_node_identifier: bytes | None = None
    number: int | None = None


@dataclass
class OneSlot:
    """BP as VarDis sees it: one place for a payload. ``refuse`` are statuses for the next registrations."""

    own_id: bytes
    tells_own_id: bool = True
    registration: tuple[Any, ...] | None = None
    registrations: list[tuple[Any, ...]] = field(default_factory=list)
    deregistrations: int = 0
    queries: int = 0
    slot: bytes | None = None
    refuse: list[BPStatus] = field(default_factory=list)
    query_status: BPStatus = BPStatus.OK
    submitted: list[bytes] = field(default_factory=list)
    beacon: int | None = None
    """When the next beacon is prepared; None: BP does not say."""

    def next_beacon(self) -> int | None:
        return self.beacon

    def register(
        self,
        prot_id: int,
        name: str,
        max_payload_size: int,
        queueing_mode: QueueingMode,
        max_entries: int,
        allow_multiple_payloads: bool,
        *,
        now: int,
        wall: int,
    ) -> Answer:
        if self.refuse:
            return Answer(self.refuse.pop(0))
        if self.registration is not None:
            return Answer(BPStatus.PROTOCOL_ALREADY_REGISTERED)
        self.registration = (prot_id, name, max_payload_size, queueing_mode, max_entries, allow_multiple_payloads)
        self.registrations.append(self.registration)
        return Answer(own_node_identifier=self.own_id if self.tells_own_id else None)

    def deregister(self, prot_id: int) -> Answer:
        self.deregistrations += 1
        if self.registration is None:
            return Answer(BPStatus.UNKNOWN_PROTOCOL)
        self.registration = self.slot = None
        return Answer()

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> Answer:
        assert self.registration is not None
        assert prot_id == self.registration[0] == 2
        assert 0 < len(payload) <= self.registration[2], "a payload that BP refuses"
        self.slot = payload
        self.submitted.append(payload)
        return Answer()

    def query_number_buffered(self, prot_id: int) -> Answer:
        self.queries += 1
        if self.registration is None:
            return Answer(BPStatus.UNKNOWN_PROTOCOL)
        return Answer(self.query_status, number=int(self.slot is not None))

    def take(self) -> bytes | None:
        """Take the payload for the next beacon."""
        taken, self.slot = self.slot, None
        return taken


class Rig:
    """A VarDis at virtual time ``now`` (ns); every method leaves its invariants checked."""

    def __init__(
        self,
        version: str = "2.0",
        *,
        node_id: bytes = ME,
        profile: str | None = None,
        readings: dict[str, str] | None = None,
        codec: Any = None,
        start: bool = True,
        packet: int | None = None,
        **settings: Any,
    ) -> None:
        self.codec = codec or get_codec(profile or f"dcp-{version}")
        self.config = NodeConfig(
            node_id=node_id,
            codec=self.codec,
            bp=BPConfig(max_packet_size=packet),
            vardis=VardisConfig(**settings),
            readings=readings or {},
        )
        self.effects: list[Effect] = []
        self.now = 0
        self.wall_offset = WALL
        self.bp = OneSlot(node_id)
        self.numbers = self.config.profile.vardis.container_types.by_name()
        self.vardis = Vardis(self.config, self.bp, emit=self.effects.append, now=0, wall=WALL)
        if start:
            assert self.vardis.start(0, WALL) is BPStatus.OK

    @property
    def wall(self) -> int:
        return self.now + self.wall_offset

    # -- services -----------------------------------------------------------------------------------------------

    def create(
        self,
        var_id: int = 7,
        value: bytes = b"ABCD",
        *,
        rep_cnt: int = 2,
        descr: bytes = b"pos",
        timeout: int = 0,
        prod_id: bytes | None = None,
    ) -> VardisStatus:
        found = self.vardis.create(var_id, prod_id, rep_cnt, descr, value, timeout, now=self.now, wall=self.wall)
        self.vardis.check_invariants()
        return found.status

    def update(self, var_id: int = 7, value: bytes = b"EFGH") -> VardisStatus:
        found = self.vardis.update(var_id, value, now=self.now, wall=self.wall)
        self.vardis.check_invariants()
        return found.status

    def delete(self, var_id: int = 7) -> VardisStatus:
        found = self.vardis.delete(var_id, now=self.now, wall=self.wall)
        self.vardis.check_invariants()
        return found.status

    def read(self, var_id: int = 7) -> bytes | VardisStatus:
        """The value, or why there is none."""
        found = self.vardis.read(var_id)
        return found.status if found.value is None else found.value

    def entry(self, var_id: int = 7) -> Any:
        """``DBEntry`` of a variable, None if it is not known."""
        return self.vardis.describe_variable(var_id).entry

    # -- octets -------------------------------------------------------------------------------------------------

    def octets(self, *containers: tuple[Any, ...]) -> bytes:
        """A payload; a container is a tuple of records of one type."""
        return self.codec.encode_containers(tuple(self.container(*records) for records in containers))

    def container(self, *records: Any) -> Container:
        kind = {
            VarCreate: ICType.CREATE_VARIABLES,
            VarDelete: ICType.DELETE_VARIABLES,
            VarUpdate: ICType.UPDATES,
            VarSumm: ICType.SUMMARIES,
            VarReqUpdate: ICType.REQUEST_VARUPDATES,
            VarReqCreate: ICType.REQUEST_VARCREATES,
        }[type(records[0])]
        return Container(self.numbers[kind.label], records)

    def receive(self, *containers: tuple[Any, ...] | Any) -> list[Effect]:
        """Receive one payload of containers (a bare record is a container of its own); returns what that did."""
        groups = [group if isinstance(group, tuple) else (group,) for group in containers]
        return self.receive_octets(self.octets(*groups))

    def receive_octets(self, payload: bytes) -> list[Effect]:
        before = len(self.effects)
        self.vardis.handle_payload(payload, now=self.now, wall=self.wall)
        self.vardis.check_invariants()
        return self.effects[before:]

    def vc(
        self,
        var_id: int = 7,
        value: bytes = b"ABCD",
        *,
        seqno: int = 0,
        prod_id: bytes = OTHER,
        rep_cnt: int = 2,
        descr: bytes = b"pos",
        created: int = WALL,
        timeout: int = 0,
        upd_id: int | None = None,
    ) -> VarCreate:
        """A VarCreate in the layout of the version."""
        later = self.config.features.creation_time
        spec = VarSpec(
            var_id=var_id,
            prod_id=prod_id,
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=created if later else None,
            timeout=timeout if later else None,
        )
        return VarCreate(spec, VarUpdate(var_id if upd_id is None else upd_id, seqno, value))

    # -- time ---------------------------------------------------------------------------------------------------

    def wait(self, ms: float) -> None:
        """Let time pass with nothing taken from BP, waking VarDis whenever it asks for it."""
        end = self.now + int(ms * MS)
        while (due := self.vardis.poll_timeout()) is not None and due <= end:
            self.now = max(self.now, due)
            self.vardis.handle_timeout(self.now, self.wall)
            self.vardis.check_invariants()
        self.now = end

    def sent(self) -> tuple[Container, ...]:
        """The payload that VarDis composes now: at its next check of the empty buffer of BP."""
        self.bp.take()
        self.wait(self.vardis.parameters()["VARDISPAR_BUFFER_CHECK_PERIOD"])
        payload = self.bp.take()
        if payload is None:
            return ()
        assert len(payload) <= self.vardis.parameters()["VARDISPAR_MAX_PAYLOAD_SIZE"]
        return self.codec.decode_containers(payload)

    def records(self, kind: type | None = None) -> list[Any]:
        """All records of the next payload, or those of one type."""
        found = [record for container in self.sent() for record in container.records]
        return found if kind is None else [record for record in found if isinstance(record, kind)]

    def drain(self, limit: int = 64) -> None:
        """Send until there is nothing left but summaries."""
        for _ in range(limit):
            if all(isinstance(record, VarSumm) for record in self.records()):
                return
        raise AssertionError("still sending")

    # -- looking ------------------------------------------------------------------------------------------------

    def queue(self, name: str) -> list[int]:
        """The identifiers in a queue, by the specification's name."""
        return self.vardis.snapshot()["queues"][name]

    def drops(self) -> list[str]:
        """Reasons of everything that was ignored so far."""
        return [effect.reason for effect in self.effects if isinstance(effect, Dropped)]

    def changes(self) -> list[tuple[str, int]]:
        """Events of variables so far."""
        return [(effect.event, effect.var_id) for effect in self.effects if isinstance(effect, VariableChanged)]

    def count(self, kind: type, var_id: int = 7, payloads: int = 20) -> int:
        """Number of the next payloads with a record of this type for a variable; never twice in one."""
        found = 0
        for _ in range(payloads):
            ids = [
                record.spec.var_id if isinstance(record, VarCreate) else record.var_id for record in self.records(kind)
            ]
            assert ids.count(var_id) <= 1
            found += ids.count(var_id)
        return found


__all__ = [
    "ME",
    "MS",
    "OTHER",
    "THIRD",
    "VERSIONS",
    "WALL",
    "Answer",
    "OneSlot",
    "Rig",
    "VarCreate",
    "VarDelete",
    "VarReqCreate",
    "VarReqUpdate",
    "VarSumm",
    "VarUpdate",
    "VardisStatus",
]
