"""Find the anomalies of a frame: problems and warnings of the dissector, and extreme but valid sizes.

Findings are named after anomalies and grouped by them. Frames with an anomaly that causes crashes are not sent again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Final

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS
from dcp_spec.reasons import REASONS, WARNINGS

from dcp_codec.codec import Codec
from dcp_codec.errors import Problem
from dcp_codec.texts import PROTOCOLS
from dcp_lab.testing.mutation import generic

from .anatomy import Anatomy

#: Number of elements of a list above which it is an anomaly: valid, but more than a small node may expect.
_MANY: Final = {"payloads": 8, "vardis": 16, "records": 63}
_LEVELS: Final = {"payloads": "many-blocks", "vardis": "many-containers", "records": "many-records"}
#: Anomalies beyond those of ``dcp_spec.reasons``.
_EXTREMES: Final = {
    "empty-frame": "the frame carries no octet",
    "trailing-octets": "octets follow the beacon",
    "many-blocks": f"more than {_MANY['payloads']} blocks in a beacon",
    "many-containers": f"more than {_MANY['vardis']} containers in a payload",
    "many-records": f"more than {_MANY['records']} records in a container",
}
_LIST: Final = "[]"
Kinds = Counter[str]


class Anomaly(msgspec.Struct, frozen=True):
    """One anomaly of one frame."""

    reason: str
    """Reason of ``dcp_spec.reasons``, or a key of ``_EXTREMES``."""
    path: str
    """Path of the field, with indices."""
    kind: str
    """Reason and path without indices: equal for anomalies that an implementation probably treats alike."""
    group: str
    """As ``kind``, but equal for all fields of a truncated record."""
    requirements: tuple[str, ...]
    """Requirements that a receiver violates if it does not survive the anomaly."""

    @property
    def meaning(self) -> str:
        """Description of the reason."""
        return REASONS.get(self.reason) or WARNINGS.get(self.reason) or _EXTREMES[self.reason]


def anomalies(codec: Codec, octets: bytes) -> list[Anomaly]:
    """Return the anomalies of a frame, errors first; none for an ordinary beacon."""
    return anomalies_of(Anatomy(codec, octets))


def anomalies_of(anatomy: Anatomy) -> list[Anomaly]:
    """Return the anomalies of a dissected frame, errors first."""
    if not anatomy.octets:
        return [Anomaly("empty-frame", "", "empty-frame", "empty-frame", ("BP-RX-16",))]
    found = [_anomaly(anatomy, problem) for problem in _once(anatomy.dissection.problems)]
    if anatomy.dissection.padding and not anatomy.dissection.errors:
        found.append(_extreme(anatomy, "trailing-octets", ""))
    for each in anatomy.lists():
        if len(each.children) > _MANY.get(each.name, len(each.children)):
            found.append(_extreme(anatomy, _LEVELS[each.name], each.path))
    return found


def kinds_of(found: list[Anomaly]) -> Kinds:
    """Return the number of anomalies of each kind."""
    return Counter(each.kind for each in found)


def _once(problems: list[Problem]) -> Iterator[Problem]:
    """Yield the first problem of each field, and only the first repeated variable of each container."""
    seen: set[str] = set()
    for problem in problems:
        place = problem.path
        if problem.reason == "duplicate-variable":
            place = place.rpartition("]")[0].rpartition("[")[0]
        if place not in seen:
            seen.add(place)
            yield problem


def _anomaly(anatomy: Anatomy, problem: Problem) -> Anomaly:
    where = generic(problem.path) or "beacon"
    reason = problem.reason
    kind = f"{reason} at {where}{_protocol(anatomy, problem.path)}"
    group = f"{reason} in {_region(where)}" if reason == "truncated" else kind
    return Anomaly(reason, problem.path, kind, group, _violated(anatomy, reason, problem.path))


def _extreme(anatomy: Anatomy, reason: str, path: str) -> Anomaly:
    kind = f"{reason} at {generic(path)}" if path else reason
    return Anomaly(reason, path, kind, kind, _violated(anatomy, reason, path))


def _region(where: str) -> str:
    """Return the path of the record, container or block of a field; the header for a field outside of them."""
    inside, found, _ = where.rpartition(_LIST)
    return inside + found if found else where.partition(".")[0]


def _protocol(anatomy: Anatomy, path: str) -> str:
    """Return the protocol of the block with a problem, if the path does not contain it, as the end of a text."""
    block = path.partition(".")[0]
    if not block.startswith("payloads[") or ".vardis" in path or ".srp" in path:
        return ""
    field = anatomy.at(f"{block}.protocolId")
    if field is None or field.value is None:
        return ""
    return f" of {PROTOCOLS.get(field.value, 'another protocol')}"


def _violated(anatomy: Anatomy, reason: str, path: str) -> tuple[str, ...]:
    """Return the requirements that a receiver violates if it does not survive an anomaly.

    Other reactions to an anomaly are mostly undefined.
    """
    if reason == "beacon-overrun":
        return ("BP-RX-15",)
    if ".vardis" in path:
        return ("VD-ROB-01",)
    # BP delivers an empty payload to VarDis, and either of them may crash on it.
    in_vardis = reason == "empty-payload" and _protocol(anatomy, path) == f" of {PROTOCOLS[int(BP_PROTID_VARDIS)]}"
    return ("BP-RX-16", "VD-ROB-01") if in_vardis else ("BP-RX-16",)
