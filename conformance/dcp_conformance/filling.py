"""Payloads that are filled to the last octet, whether or not parameters of VarDis can be set.

Where they cannot be, the maximum payload size is that of the PIXIT, and the records are made as long as it takes.
"""

from __future__ import annotations

from typing import Final

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate

from .bench import Bench
from .peers import Peer

PAYLOAD_SIZE: Final = "VARDISPAR_MAX_PAYLOAD_SIZE"


def settable(bench: Bench) -> bool:
    """Whether parameters of VarDis can be set, and a reset brings them back."""
    upper = bench.session.upper
    return upper is not None and {"UT-Reset", "VD-SetParameter"} <= upper.methods


def longest(bench: Bench) -> tuple[bytes, bytes]:
    """The longest value and description that the implementation takes, of 200 octets at most."""
    value = min(bench.bound("VARDISPAR_MAX_VALUE_LENGTH"), 200)
    description = min(bench.bound("VARDISPAR_MAX_DESCRIPTION_LENGTH"), 200)
    # The parameter of 1.0 counts the NUL behind the text.
    nul = bench.features.string_format == "nul-terminated"
    return b"v" * max(1, value), b"d" * max(1, description - nul)


def filling(bench: Bench, peer: Peer, kind: ICType, octets: int, *, seqno: int = 9) -> list[VarCreate] | None:
    """VarCreates of new variables of which the records of a kind have exactly so many octets together.

    ``kind``: CREATE-VARIABLES or UPDATES. As few records as possible, all about as long; None if there are none.
    """
    value, description = longest(bench)

    def made(var_id: int, value_length: int, length: int) -> VarCreate:
        return peer.create(var_id, value=value[:value_length], descr=description[:length], seqno=seqno)

    def size(create: VarCreate) -> int:
        return bench.forge.record_size(create if kind is ICType.CREATE_VARIABLES else create.upd)

    least = size(made(0, 1, 1))
    most = size(made(0, len(value), len(description)))
    count = -(-octets // most)
    if count < 1 or octets < count * least:
        return None
    creates = []
    for place, var_id in enumerate(bench.var_ids(count)):
        more = octets // count + (place < octets % count) - least
        in_value = min(more, len(value) - 1)
        creates.append(made(var_id, 1 + in_value, 1 + more - in_value))
    assert sum(map(size, creates)) == octets
    return creates
