"""Containers of a payload that the implementation loses, and the failures that follow from that.

An implementation that loses a container breaks the extraction rules (VD-RX-02 to VD-RX-04), and the cases about them
fail. Many other cases send two containers in a payload: something missing in these cases may have been in the lost
container.
"""

from __future__ import annotations

from typing import Final

from dcp_spec.constants import ICType

from dcp_codec.values import VardisRecord
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.known import Failure
from dcp_conformance.test_system.traffic import payloads

OWNERS: Final = frozenset({"VD-RX-02", "VD-RX-03", "VD-RX-04"})
"""The requirements of extraction: a lost container never excuses their failures."""
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


def excuse(lost: str, failure: Failure) -> str:
    """Return why something missing follows from the lost container; empty if it counts."""
    if not lost or OWNERS & failure.requirements:
        return ""
    if not any(len(payload.vardis or ()) > 1 for payload in payloads(failure.codec, failure.events)):
        return ""
    return f"it loses the {lost} of two containers in a payload (VD-RX-04), and this case has sent such payloads"
