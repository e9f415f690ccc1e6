"""The state of a variable at an implementation, queried over the link: no upper tester is needed.

A VarReqCreate distinguishes the three states of a variable (VD-RC-01 to VD-RC-03): the implementation answers with the
stored contents if it is alive, requests it if it is unknown, and does not react if it is deleted.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from dcp_spec.constants import ICType, seqno_modulus

from dcp_codec.values import VarCreate
from dcp_conformance.frames.received import Instruction
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

State = Literal["unknown", "alive", "deleted"]
#: All records about a single variable except summaries, which are sent repeatedly.
INSTRUCTIONS = tuple(kind for kind in ICType if kind is not ICType.SUMMARIES)


class Held(NamedTuple):
    """The result of :func:`ask`."""

    state: State
    record: VarCreate | None
    """Specification, value and sequence number as stored, for a variable that is alive."""

    @property
    def answered(self) -> bool:
        """Whether a record proves the state: a deleted variable is inferred from the missing answer."""
        return self.state != "deleted"

    def __str__(self) -> str:
        if self.record is None:
            return f"state: {self.state}"
        upd = self.record.upd
        return f"state: alive, with sequence number {upd.seqno} and value {upd.value.hex()}"


def traces(bench: Bench, var_id: int, since: int, kinds: Iterable[ICType] = INSTRUCTIONS) -> list[Instruction]:
    """Return records of these kinds about a variable, received since a mark."""
    wanted = set(kinds)
    return [each for heard in bench.heard[since:] for each in heard.instructions(None, var_id) if each.kind in wanted]


def named(found: Iterable[Instruction]) -> str:
    """Return the kinds of records for a message."""
    return ", ".join(dict.fromkeys(each.kind.label for each in found)) or "nothing"


def ask(bench: Bench, var_id: int) -> Held:
    """Query the state of a variable with a VarReqCreate; fails and stops the case without an answer to a probe."""
    peer, start = bench.peer(), bench.mark()
    peer.send(peer.request_create(var_id))
    bench.require_alive("a VarReqCreate")
    if not traces(bench, var_id, start, (ICType.CREATE_VARIABLES, ICType.REQUEST_VARCREATES)):
        # If payloads are full, the answer is sent one beacon later.
        bench.beacons(1, 1.5)
    answers = bench.instructions(ICType.CREATE_VARIABLES, var_id, start)
    if answers:
        # The last one: an earlier payload may have been composed before the request.
        return Held("alive", answers[-1].record)
    if not bench.features.rerequest_unknown:
        peer.send(peer.summary(var_id, 0))
        bench.require_alive("a VarSumm")
    unknown = bench.instructions(ICType.REQUEST_VARCREATES, var_id, start)
    return Held("unknown" if unknown else "deleted", None)


def check_state(bench: Bench, held: Held, state: str, what: str, /, *requirements: str) -> bool:
    """Check the state of a variable."""
    return bench.equal(held.state, state, what, *requirements, given=held.answered)


def check_stored(
    bench: Bench, held: Held, seqno: int, value: bytes, what: str, /, *requirements: str, given: object = True
) -> bool:
    """Check the stored sequence number and value. ``given``: see :class:`.Matchers`."""
    found = held.record and (held.record.upd.seqno, held.record.upd.value)
    return bench.equal(found, (seqno, bench.records.value(value)), what, *requirements, given=given)


def own_id(bench: Bench) -> bytes:
    """Return the implementation's node identifier; a probe makes it send a beacon if none was received so far."""
    if bench.session.sut_id is None:
        bench.require_alive("its start")
    return bench.identifiers.sut_id


def teach_variables(bench: Bench, peer: Peer, creates: Iterable[VarCreate]) -> list[VarCreate]:
    """Teach the implementation several variables with repCnt 1 at once; inconclusive if it does not forward them."""
    creates = list(creates)
    start = bench.mark()
    peer.send_all(creates)
    missing = {create.spec.var_id for create in creates}

    def await_all() -> bool:
        missing.difference_update(each.var_id for each in bench.instructions(ICType.CREATE_VARIABLES, since=start))
        return not missing

    bench.until(
        lambda _: await_all(), max(bench.sut.reaction + len(creates) / 2, bench.teaching.periods(2 * len(creates)))
    )
    if not await_all():
        bench.teaching.not_learnt(missing)
    return creates


def modulus(bench: Bench) -> int:
    """Return SEQNO-MODULUS, the modulus of the sequence numbers of variables."""
    return seqno_modulus(bench.profile.types.var_seqno.width)


def stepped(bench: Bench, seqno: int, distance: int) -> int:
    """Return the sequence number at a distance from another, modulo SEQNO-MODULUS (X28)."""
    return (seqno + distance) % modulus(bench)
