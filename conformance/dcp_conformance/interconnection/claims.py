"""Contradictions of the claims of PICS and PIXIT to what is heard of the implementation, or what it reports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from statistics import median
from typing import Any, Final

from dcp_spec.constants import BP_PROTID_VARDIS

from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sut_properties import PIXIT

from .settings import suspect

_PERIOD: Final = "BPPAR_BEACON_PERIOD"
#: Number of intervals that show a period, and factor from which on it contradicts the claim.
_INTERVALS: Final = 4
_FACTOR: Final = 1.6
_THOUSAND: Final = 1000
#: End of the reason for ignoring a frame with the own node identifier, in the drops of UT-Status.
_OWN: Final = "own-beacon"


def contradictions(pics: Pics, bench: Bench, parameters: Mapping[str, Any], about: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each claim that is contradicted.

    ``bench``: one that has heard beacons; ``parameters`` and ``about``: what the upper tester reports, both may be
    empty. If no claim is contradicted, yield which setting of the tester does not fit what is heard.
    """
    found = [*_node_id(pics, bench, about), *_period(pics.pixit.beacon_period_ms, bench, parameters.get(_PERIOD))]
    found += [*_reported(pics.pixit, parameters), *_heard(pics.pixit, bench)]
    yield from found
    if not found and (setting := suspect(bench)):
        yield setting


def _node_id(pics: Pics, bench: Bench, about: Mapping[str, Any]) -> Iterator[str]:
    claimed = pics.pixit.node_id
    reported = about.get("nodeId")
    if claimed is not None and isinstance(reported, str) and _plain(reported) != _plain(claimed):
        yield f"pixit.node_id is {claimed}, but UT-Hello reports {reported}: the PICS is for another node"
    elif claimed is not None and not bench.heard and bench.receiver.others:
        others = sorted({each.sender.hex(":") for each in bench.receiver.others if each.sender is not None})
        yield f"pixit.node_id is {claimed}, but only beacons of {', '.join(others[:3])} are heard"


def _reported(pixit: Testing, parameters: Mapping[str, Any]) -> Iterator[str]:
    """Yield the limits and identifiers in the PIXIT that differ from the parameters that the upper tester reports."""
    for name, key in {**PIXIT, "BPPAR_NETWORK_ID": "network_id"}.items():
        claimed, reported = getattr(pixit, key), parameters.get(name)
        if None not in (claimed, reported) and claimed != reported:
            yield f"pixit.{key} is {claimed:g}, but {name} is reported as {reported}: the tester uses the latter"


def _heard(pixit: Testing, bench: Bench) -> Iterator[str]:
    """Yield the claims that beacons contradict: network identifier, and sizes of packets and payloads."""
    headers = [each.beacon.bp for each in bench.heard if each.beacon is not None and each.beacon.bp is not None]
    networks = {header.network_id for header in headers if header.network_id is not None}
    if pixit.network_id is not None and networks and pixit.network_id not in networks:
        listed = ", ".join(map(str, sorted(networks)))
        yield f"pixit.network_id is {pixit.network_id}, but beacons carry networkId {listed}"
    blocks = [len(octets) for each in bench.heard for number, octets in each.blocks if number == BP_PROTID_VARDIS]
    longest = {
        "max_packet_size": max((len(each.octets) for each in bench.heard), default=0),
        "max_payload_size": max(blocks, default=0),
    }
    for key, most in longest.items():
        if (claimed := getattr(pixit, key)) is not None and most > claimed:
            what = "a beacon" if key == "max_packet_size" else "a payload of VarDis"
            yield f"pixit.{key} is {claimed}, but {what} of {most} octets is heard"


def ignored(drops: object) -> Iterator[str]:
    """Yield a sentence if the implementation has ignored frames because of its own identifier.

    ``drops``: that member of UT-Status, which has numbers of ignored frames and records by reason.
    """
    reasons = drops if isinstance(drops, Mapping) else {}
    count = sum(number for why, number in reasons.items() if why.endswith(_OWN) and isinstance(number, int))
    if count:
        frames = "frame" if count == 1 else "frames"
        yield (
            f"the implementation has ignored {count} {frames} with its own node identifier (UT-Status): another node "
            "on the link uses the same one"
        )


def _period(claimed: float, bench: Bench, reported: object) -> Iterator[str]:
    if isinstance(reported, int | float) and reported != claimed:
        if reported in (claimed * _THOUSAND, claimed / _THOUSAND):
            yield f"{_PERIOD} is reported as {reported:g}; the contract has ms (UPPER-TESTER.md, Values)"
        else:
            yield f"the beacon period is {claimed:g} ms for the tester, but {_PERIOD} is reported as {reported:g}"
    intervals = [(after.time - before.time) / 1e6 for before, after in pairwise(bench.heard)]
    if len(intervals) >= _INTERVALS and median(intervals) * _FACTOR < claimed:
        yield (
            f"the beacon period is {claimed:g} ms for the tester, but beacons are heard every {median(intervals):.0f} "
            "ms: set pixit.beacon_period_ms, or --beacon-period"
        )


def _plain(identifier: str) -> str:
    return identifier.replace(":", "").lower()
