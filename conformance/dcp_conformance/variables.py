"""What an implementation holds of a variable, asked over the air: no upper tester is needed for it.

A VarReqCreate tells the three states of a variable apart (VD-RC-01 to VD-RC-03): one that is alive is sent with all
that is stored of it, an unknown one is requested in turn, and about a deleted one nothing is said.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from dcp_spec.constants import ICType, seqno_modulus

from dcp_codec.values import VarCreate

from .bench import Bench
from .heard import Instruction
from .peers import Peer

State = Literal["unknown", "alive", "deleted"]
#: Everything that can be said about a single variable, but for summaries, which come again and again.
INSTRUCTIONS = tuple(kind for kind in ICType if kind is not ICType.SUMMARIES)


class Held(NamedTuple):
    """The answer of :func:`ask`."""

    state: State
    record: VarCreate | None
    """Specification, value and sequence number as stored, for a variable that is alive."""

    @property
    def shown(self) -> bool:
        """Whether a record shows the state: that a variable is deleted is concluded from silence."""
        return self.state != "deleted"

    def __str__(self) -> str:
        if self.record is None:
            return f"it is {self.state}"
        upd = self.record.upd
        return f"it is alive with sequence number {upd.seqno} and value {upd.value.hex()}"


def traces(bench: Bench, var_id: int, since: int, kinds: Iterable[ICType] = INSTRUCTIONS) -> list[Instruction]:
    """Records of these kinds about a variable that were heard from a mark on."""
    wanted = set(kinds)
    return [each for heard in bench.heard[since:] for each in heard.instructions(None, var_id) if each.kind in wanted]


def named(found: Iterable[Instruction]) -> str:
    """The kinds of records, for people."""
    return ", ".join(dict.fromkeys(each.kind.label for each in found)) or "nothing"


def ask(bench: Bench, var_id: int) -> Held:
    """Ask with a VarReqCreate what the implementation holds. Stops the case as failed if it does not answer at all."""
    peer, start = bench.peer(), bench.mark()
    peer.send(peer.request_create(var_id))
    bench.require_alive("a VarReqCreate")
    if not traces(bench, var_id, start, (ICType.CREATE_VARIABLES, ICType.REQUEST_VARCREATES)):
        # Where payloads are full, the answer comes a beacon later.
        bench.beacons(1, 1.5)
    answers = bench.instructions(ICType.CREATE_VARIABLES, var_id, start)
    if answers:
        # The last one: a payload that was composed earlier may still have been on its way.
        return Held("alive", answers[-1].record)
    if not bench.features.rerequest_unknown:
        peer.send(peer.summary(var_id, 0))
        bench.require_alive("a VarSumm")
    unknown = bench.instructions(ICType.REQUEST_VARCREATES, var_id, start)
    return Held("unknown" if unknown else "deleted", None)


def own_id(bench: Bench) -> bytes:
    """The implementation's node identifier; a probe makes it speak if nothing was heard of it so far."""
    if bench.session.sut_id is None:
        bench.require_alive("its start")
    return bench.sut_id


def taught_all(bench: Bench, peer: Peer, creates: Iterable[VarCreate]) -> list[VarCreate]:
    """Let the implementation learn several variables with repCnt 1 at once; inconclusive if it does not."""
    creates = list(creates)
    start = bench.mark()
    peer.send_all(creates)
    missing = {create.spec.var_id for create in creates}

    def heard_all() -> bool:
        missing.difference_update(each.var_id for each in bench.instructions(ICType.CREATE_VARIABLES, since=start))
        return not missing

    bench.until(lambda _: heard_all(), max(bench.reaction + len(creates) / 2, bench.sending(2 * len(creates))))
    if not heard_all():
        bench.not_learnt(missing)
    return creates


def modulus(bench: Bench) -> int:
    """SEQNO-MODULUS: variables' sequence numbers count modulo this."""
    return seqno_modulus(bench.profile.types.var_seqno.width)


def stepped(bench: Bench, seqno: int, distance: int) -> int:
    """A variable's sequence number at a distance from another, around the end of the range (X28)."""
    return (seqno + distance) % modulus(bench)
