"""Payloads that are filled to the last octet, whether or not parameters of VarDis can be set.

If they cannot be set, the maximum payload size is that of the PIXIT, and the lengths of the records are chosen to fit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_ATTEMPTS: Final = 6
_OURS_ONLY: Final = "payloads with the records of this case only, which it needs"
PAYLOAD_SIZE: Final = "VARDISPAR_MAX_PAYLOAD_SIZE"


def settable(bench: Bench) -> bool:
    """Return whether parameters of VarDis can be set, and restored by a reset."""
    return bench.services.offers("UT-Reset", "VD-SetParameter")


def longest(bench: Bench) -> tuple[bytes, bytes]:
    """Return the longest value and description that the implementation accepts, of at most 200 octets."""
    value = min(bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), 200)
    description = min(bench.sut.bound("VARDISPAR_MAX_DESCRIPTION_LENGTH"), 200)
    # The parameter of 1.0 counts the NUL after the text.
    return b"v" * max(1, value), b"d" * max(1, description - (bench.features.string_format == "nul-terminated"))


def undisturbed(bench: Bench, kind: ICType, attempt: Callable[[], list[ReceivedBeacon]]) -> list[ReceivedBeacon]:
    """Repeat ``attempt`` until the beacons that it returns have records of the variables of the case only.

    An application on the node may update a variable of its own, whose records take room. Stops as inconclusive if they
    do so each time. Only records count that are composed before those of ``kind`` or with them.
    """
    for _ in range(_ATTEMPTS):
        frames = attempt()
        if not (strange := _of_applications(bench, kind, frames)):
            break
    else:
        bench.inconclusive(_OURS_ONLY, f"{strange} in each of {_ATTEMPTS} attempts")
    return frames


def require_undisturbed(bench: Bench, kind: ICType, frames: Iterable[ReceivedBeacon]) -> None:
    """Stop as inconclusive if records of an application took room from those of ``kind`` in these beacons."""
    if strange := _of_applications(bench, kind, frames):
        bench.inconclusive(_OURS_ONLY, strange)


def _of_applications(bench: Bench, kind: ICType, frames: Iterable[ReceivedBeacon]) -> str:
    """Name the variables of applications with records that are composed before those of ``kind`` or with them."""
    order = bench.features.container_order
    earlier = order[: order.index(kind) + 1]
    records = [each for heard in frames for each in heard.instructions() if each.kind in earlier]
    strange = {each.var_id for each in records if bench.identifiers.is_applications(each.var_id)}
    return f"records of variable {', '.join(map(str, sorted(strange)))}" if strange else ""


def filling(bench: Bench, peer: Peer, kind: ICType, octets: int, *, seqno: int = 9) -> list[VarCreate] | None:
    """Return VarCreates of new variables whose records of a kind have exactly ``octets`` octets in total.

    ``kind``: CREATE-VARIABLES or UPDATES. Uses as few records as possible, of about equal length; None if impossible.
    Raise ``CouldNotAskError`` beside other cases.
    """
    bench.control.needs_whole_beacons()
    value, description = longest(bench)

    def made(var_id: int, value_length: int, length: int) -> VarCreate:
        return peer.create(var_id, value=value[:value_length], descr=description[:length], seqno=seqno)

    def size(create: VarCreate) -> int:
        return bench.builder.record_size(create if kind is ICType.CREATE_VARIABLES else create.upd)

    least = size(made(0, 1, 1))
    most = size(made(0, len(value), len(description)))
    count = -(-octets // most)
    if count < 1 or octets < count * least:
        return None
    creates = []
    for place, var_id in enumerate(bench.identifiers.var_ids(count)):
        more = octets // count + (place < octets % count) - least
        in_value = min(more, len(value) - 1)
        creates.append(made(var_id, 1 + in_value, 1 + more - in_value))
    assert sum(map(size, creates)) == octets
    return creates
