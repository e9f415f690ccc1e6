"""Find out at the start of a run whether the implementation processes all containers of a payload."""

from __future__ import annotations

from typing import Final

from dcp_spec.constants import ICType

from dcp_codec.values import VardisRecord
from dcp_conformance.test_system.bench import Bench

#: Number of payloads to send before a container counts as lost.
_ATTEMPTS: Final = 2
#: Octets of the value, or number of records, that make the first container longer than the second one.
_LENGTH: Final = 8


def lost_container(bench: Bench) -> str:
    """Return which of the two containers of a payload has no effect although the other one has: "first" or "second".

    Sends a VarUpdate and, in a shorter container after it, a VarSumm, each about a variable that the implementation
    must request (VD-PU-01, VD-PS-01); then the other way round, since one kind of record may cause no request at all.
    Empty if no container is lost, if neither variable is requested, or if no identifiers are left for the test.
    Raises ``LowerTesterError``.
    """
    lost: set[str] = set()
    for attempt in range(_ATTEMPTS):
        if not bench.identifiers.has_unknown_ids(2):
            return ""
        peer, since = bench.peer(), bench.mark()
        first, second = bench.identifiers.unknown_ids(2)
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
