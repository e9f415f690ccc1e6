"""Does the implementation process all containers of a payload? Found out at the start of a run.

One that loses a container breaks the extraction rules (VD-RX-02 to VD-RX-04), and cases about them fail it. Many cases
send two containers in a payload for other purposes: what is missing in these cases may have been in the lost container.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.values import VardisRecord

from .traffic import Event

if TYPE_CHECKING:
    from .bench import Bench

OWNERS: Final = frozenset({"VD-RX-02", "VD-RX-03", "VD-RX-04"})
"""The requirements of extraction: a lost container never excuses their failures."""
#: Payloads that are tried before a container counts as lost; octets or records that make the first one the longer.
_ATTEMPTS, _LENGTH = 2, 8


def lost_container(bench: Bench) -> str:
    """Which container of a payload of two leaves no trace though the other one does, in words; empty if neither.

    Sends a VarUpdate and, in the shorter container behind it, a VarSumm, each of a variable that the implementation
    must request (VD-PU-01, VD-PS-01); then the other way round, since one kind of record may bring no request at all.
    Empty also if no identifiers are left for that, or if neither is requested.
    Raises ``LowerTesterError``.
    """
    lost: set[str] = set()
    for attempt in range(_ATTEMPTS):
        if not bench.has_unknown_ids(2):
            return ""
        peer, since = bench.peer(), bench.mark()
        first, second = bench.unknown_ids(2)
        containers: list[list[VardisRecord]]
        if attempt % 2 == 0:
            containers = [[peer.update(first, 1, b"v" * _LENGTH)], [peer.summary(second, 1)]]
        else:
            containers = [[peer.summary(first, 1)] * _LENGTH, [peer.update(second, 1, b"v")]]
        peer.send(*(bench.builder.container(*each) for each in containers))

        def requested(*wanted: int, since: int = since) -> bool:
            return {*wanted} <= {each.var_id for each in bench.instructions(ICType.REQUEST_VARCREATES, since=since)}

        bench.until(lambda _, both=(first, second): requested(*both))  # type: ignore[misc]
        found = requested(first), requested(second)
        if found == (True, True):
            return ""
        lost.add({(True, False): "second", (False, True): "first"}.get(found, ""))
    return lost.pop() if len(lost) == 1 else ""


def sent_several(codec: Codec, events: Iterable[Event]) -> bool:
    """Whether a VarDis payload with several containers is among what the tester has sent."""
    sent = (codec.salvage(each.frame[each.start :]).beacon for each in events if each.direction == "sent")
    return any(len(payload.vardis or ()) > 1 for each in sent if each is not None for payload in each.payloads)
