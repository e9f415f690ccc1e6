"""Transitions of one node: a saved content is restored into a real VarDis core, which executes one step.

Contents and payloads are numbered, and each transition is executed once. Contents are canonical: what has no effect on
later behaviour (diagnostic signs, times of deleted variables) is removed from them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from dcp_spec.status import BPStatus

from dcp_codec.values import VarCreate, VarDelete, VarReqCreate, VarReqUpdate, VarUpdate
from dcp_stack.bp_port import NumberConfirm, RegisterConfirm, StatusConfirm
from dcp_stack.config import NodeConfig
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.delivery import DeliveryState
from dcp_stack.vardis.entity import Vardis, VardisState
from dcp_stack.virtual.world import EPOCH, node_id

from .proposals import REGAINED, Proposal, proposal
from .space import Space

VARIABLE: Final = 7
#: Wall time in ns between two creations.
TICK: Final = 1_000_000_000
#: Wall time in ns by which a wrong clock is ahead.
AHEAD: Final = 3600 * TICK
#: A silence in timeouts of the variable: two of them exceed a timeout, one does not.
SILENCE: Final = 0.6

#: Records that are repeated, in the order of the counters in a content.
_REPEATED: Final = (VarUpdate, VarCreate, VarDelete)

#: Number and position of a value: of the creation since the start, and of the update since the creation.
Value = tuple[int, int]


class Held(NamedTuple):
    """The variable at a node: ``state`` is unknown, alive or deleted."""

    state: str
    producer: bytes = b""
    value: Value = (0, 0)

    @property
    def text(self) -> str:
        """The value if the variable is alive, otherwise the state."""
        return f"{self.value[0]}.{self.value[1]}" if self.state == "alive" else self.state


_UNKNOWN: Final = Held("unknown")


class Sent(NamedTuple):
    """A beacon: the content afterwards, the number of the payload (-1: none), whether repetitions were miscounted."""

    content: int
    payload: int
    miscounted: bool


class Bearer:
    """BP for one VarDis: it accepts each payload and holds the last one. It schedules no beacons."""

    def __init__(self, own_id: bytes) -> None:
        self._own_id = own_id
        self.payload: bytes | None = None

    def register(self, *_: Any, now: int, wall: int) -> RegisterConfirm:  # noqa: ARG002 - the signature of BPPort
        """Accept the registration."""
        return RegisterConfirm(BPStatus.OK, self._own_id)

    def deregister(self, prot_id: int) -> StatusConfirm:  # noqa: ARG002 - the signature of BPPort
        """Accept the deregistration."""
        return StatusConfirm(BPStatus.OK)

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> StatusConfirm:  # noqa: ARG002 - as above
        """Hold the payload."""
        self.payload = payload
        return StatusConfirm(BPStatus.OK)

    def query_number_buffered(self, prot_id: int) -> NumberConfirm:  # noqa: ARG002 - as above
        """Return 1: VarDis never finds the buffer empty, and composes after the indication of a beacon only."""
        return NumberConfirm(BPStatus.OK, 1)

    def next_beacon(self) -> int | None:
        """Return None: the payload is composed at once."""
        return None


class Cores:
    """The transitions of all nodes of a space. ``role``: the number of a producer, or ``producers`` for any other."""

    def __init__(self, space: Space) -> None:
        """Raises ValueError for a profile, readings or parameters that the nodes refuse."""
        self.space = space
        self.proposal: Proposal = proposal(space.proposal)
        self.codec = self.proposal.codec(space.profile)
        self.ids = [node_id(self.codec.profile, role) for role in range(space.producers + 1)]
        self._bearers = [Bearer(each) for each in self.ids]
        self._cores = [self._core(role) for role in range(space.producers + 1)]
        self.calls = 0
        """Number of steps that real cores have executed."""
        self.contents: list[VardisState] = []
        self.held: list[Held] = []
        self.payloads: list[bytes] = []
        self.requests: list[bool] = []
        """For each payload whether it has a request."""
        self._numbers: dict[VardisState, int] = {}
        self._payload_numbers: dict[bytes, int] = {}
        self._sent: dict[tuple[int, int], Sent] = {}
        self._heard: dict[tuple[int, int, int, int], int] = {}
        self._bound_to_clock = self.proposal.settings(space.vardis).max_creation_ahead_s is not None
        self.fresh = [self.number(core.save()) for core in self._cores]
        """The content of a node without variables, by role."""

    def _core(self, role: int) -> Vardis:
        config = NodeConfig(
            node_id=self.ids[role],
            codec=self.codec,
            srp=None,
            vardis=self.proposal.settings(self.space.vardis),
            readings={**self.space.readings, **self.proposal.readings},
        )
        core = self.proposal.core(config, self._bearers[role])
        core.start(0, EPOCH)
        return core

    def wall(self, tick: int, ahead: bool) -> int:
        """Return the wall time of a node after ``tick`` creations."""
        return EPOCH + tick * TICK + ahead * AHEAD

    # -- steps of one node ---------------------------------------------------------------------------------------------

    def send(self, role: int, content: int) -> Sent:
        """Compose a payload."""
        key = (role, content)
        if (found := self._sent.get(key)) is None:
            bearer = self._bearers[role]
            bearer.payload = None
            after = self._execute(role, content, lambda core: core.payload_transmitted(0, EPOCH))
            payload = -1 if bearer.payload is None else self._payload(bearer.payload)
            found = self._sent[key] = Sent(after, payload, self._miscounts(content, after, payload))
        return found

    def hear(self, role: int, content: int, payload: int, wall: int) -> int:
        """Process a payload; returns the content afterwards."""
        key = (role, content, payload, wall if self._bound_to_clock else 0)
        if (found := self._heard.get(key)) is None:
            octets = self.payloads[payload]
            found = self._execute(role, content, lambda core: core.handle_payload(octets, now=0, wall=wall))
            self._heard[key] = found
        return found

    def create(self, role: int, content: int, value: Value, wall: int) -> int | None:
        """Create the variable; returns the content afterwards, None if the node refuses. So do the next two."""
        octets, space = _octets(value), self.space
        return self._serve(
            role,
            content,
            lambda core: core.create(
                VARIABLE, None, space.repetitions, b"v", octets, space.timeout_ms, now=0, wall=wall
            ),
        )

    def update(self, role: int, content: int) -> int | None:
        """Update the variable with the next value."""
        creation, number = self.held[content].value
        octets = _octets((creation, number + 1))
        return self._serve(role, content, lambda core: core.update(VARIABLE, octets, now=0, wall=EPOCH))

    def delete(self, role: int, content: int) -> int | None:
        """Delete the variable."""
        return self._serve(role, content, lambda core: core.delete(VARIABLE, now=0, wall=EPOCH))

    def wait(self, role: int, content: int) -> int:
        """Let a silence pass, with the scrubbing at its end."""
        passed = round(SILENCE * self.space.timeout_ms) * 1_000_000
        return self._execute(role, content, lambda core: core.handle_timeout(passed, EPOCH + passed), passed)

    def _serve(self, role: int, content: int, service: Callable[[Vardis], Confirm]) -> int | None:
        served: list[bool] = []
        after = self._execute(role, content, lambda core: served.append(service(core).status.is_ok))
        return after if served[0] else None

    def _execute(self, role: int, content: int, step: Callable[[Vardis], Any], passed: int = 0) -> int:
        """Execute a step on a core with this content; ``passed``: ns until now, subtracted from the times."""
        core = self._cores[role]
        core.restore(self.contents[content])
        step(core)
        self.calls += 1
        if self.proposal.keeps_invariants:
            core.check_invariants()
        return self.number(core.save(), passed)

    # -- contents ------------------------------------------------------------------------------------------------------

    def number(self, state: VardisState, passed: int = 0) -> int:
        """Return the number of a content in canonical form; ``passed``: ns until now, subtracted from the times."""
        entries, queues = state.database
        kept = []
        for spec, value, seqno, _stamp, refreshed, update, create, delete, is_deleted, own in entries:
            since = 0 if is_deleted or not self.space.silences else refreshed - passed
            kept.append(
                (
                    spec,
                    value,
                    seqno,
                    0,
                    since,
                    update,
                    create,
                    delete,
                    is_deleted,
                    tuple(each for each in own if each[0] == REGAINED),
                )
            )
        delivery = DeliveryState(state.delivery.created)
        state = VardisState(state.active, (tuple(kept), queues), delivery, (0, 0, False, EPOCH))
        number = self._numbers.setdefault(state, len(self.contents))
        if number == len(self.contents):
            self.contents.append(state)
            self.held.append(_held(state))
        return number

    def _payload(self, octets: bytes) -> int:
        number = self._payload_numbers.setdefault(octets, len(self.payloads))
        if number == len(self.payloads):
            self.payloads.append(octets)
            self.requests.append(any(isinstance(each, VarReqCreate | VarReqUpdate) for each in self.records(number)))
        return number

    def records(self, payload: int) -> list[Any]:
        """Return the records of a payload."""
        return [each for part in self.codec.decode_containers(self.payloads[payload]) for each in part.records]

    def _miscounts(self, before: int, after: int, payload: int) -> bool:
        """Return whether a payload has a repeated record whose counter was 0 or has not been decremented."""
        records = self.records(payload) if payload >= 0 else []
        for kind, was, now in zip(_REPEATED, self._counters(before), self._counters(after), strict=True):
            if was > self.space.repetitions or now != was - any(isinstance(each, kind) for each in records):
                return True
        return False

    def _counters(self, content: int) -> tuple[int, int, int]:
        """Return the repetitions left of update, create and delete."""
        entries = self.contents[content].database[0]
        return entries[0][5:8] if entries else (0, 0, 0)


def _octets(value: Value) -> bytes:
    return f"{value[0]}.{value[1]}".encode()


def _held(state: VardisState) -> Held:
    """Return the variable in a content."""
    entries = state.database[0]
    if not entries:
        return _UNKNOWN
    spec, value, *_ = entries[0]
    creation, _, number = value.partition(b".")
    return Held("deleted" if entries[0][8] else "alive", spec.prod_id, (int(creation), int(number)))
