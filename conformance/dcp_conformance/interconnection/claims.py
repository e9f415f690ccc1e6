"""Contradictions of the claims of PICS and PIXIT to what is heard of the implementation, or what it reports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from statistics import median
from typing import Any, Final

from dcp_conformance.model.pics import Pics
from dcp_conformance.test_system.bench import Bench

_PERIOD, _NETWORK, _NODE = "BPPAR_BEACON_PERIOD", "BPPAR_NETWORK_ID", "BPPAR_OWN_NODE_IDENTIFIER"
#: Number of intervals that show a period, and factor from which on it contradicts the claim.
_INTERVALS: Final = 4
_FACTOR: Final = 1.6
_THOUSAND: Final = 1000
#: End of the reason for ignoring a frame with the own node identifier, in the drops of UT-Status.
_OWN: Final = "own-beacon"


def contradictions(pics: Pics, bench: Bench, parameters: Mapping[str, Any], about: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each claim that is contradicted.

    ``bench``: one that has heard beacons; ``parameters`` and ``about``: what the upper tester reports, both may be
    empty.
    """
    claimed = pics.pixit.node_id
    reported = about.get("nodeId")
    if claimed is not None and isinstance(reported, str) and _plain(reported) != _plain(claimed):
        yield f"pixit.node_id is {claimed}, but UT-Hello reports {reported}: the PICS is for another node"
    elif claimed is not None and not bench.heard and bench.receiver.others:
        others = sorted({each.sender.hex(":") for each in bench.receiver.others if each.sender is not None})
        yield f"pixit.node_id is {claimed}, but only beacons of {', '.join(others[:3])} are heard"
    yield from _period(pics.pixit.beacon_period_ms, bench, parameters.get(_PERIOD))


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
