"""What is odd about a frame: every problem and warning of the dissector, and extremes that are legal.

A finding is named after anomalies, findings are grouped by them, and frames that have a deadly one are not sent again.
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
from dcp_codec.plan.tree import Many
from dcp_codec.testing.mutation import generic
from dcp_codec.texts import PROTOCOLS
from dcp_codec.views.fields import Field

from .anatomy import Anatomy

#: More elements in a list than this are an anomaly. Senders may do so; no table of a small node expects it.
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
    """One oddity of one frame."""

    reason: str
    """Of ``dcp_spec.reasons``, or an extreme of this module."""
    path: str
    """The field, with indices."""
    kind: str
    """Reason and field without indices: equal for what an implementation most likely treats alike."""
    group: str
    """As ``kind``, but the same for all fields of a record that is cut off."""
    requirements: tuple[str, ...]
    """What a receiver violates that does not survive it."""

    @property
    def is_damage(self) -> bool:
        """Whether a frame with it is no message of the profile."""
        return self.reason in REASONS or self.reason == "empty-frame"

    @property
    def meaning(self) -> str:
        """What the reason stands for."""
        return REASONS.get(self.reason) or WARNINGS.get(self.reason) or _EXTREMES[self.reason]


def anomalies(codec: Codec, octets: bytes) -> list[Anomaly]:
    """Everything that is odd about a frame, errors first; nothing for an ordinary beacon."""
    return anomalies_of(Anatomy(codec, octets))


def anomalies_of(anatomy: Anatomy) -> list[Anomaly]:
    """The same for a frame that was taken apart."""
    if not anatomy.octets:
        return [Anomaly("empty-frame", "", "empty-frame", "empty-frame", ("BP-RX-16",))]
    found = [_anomaly(anatomy, problem) for problem in _once(anatomy.dissection.problems)]
    if anatomy.dissection.padding and not anatomy.dissection.errors:
        found.append(_extreme(anatomy, "trailing-octets", ""))
    found += [_extreme(anatomy, _LEVELS[each.name], each.path) for each in anatomy.lists() if _is_long(each)]
    return found


def kinds_of(found: list[Anomaly]) -> Kinds:
    """How often each kind is there."""
    return Counter(each.kind for each in found)


def _once(problems: list[Problem]) -> Iterator[Problem]:
    """The first problem of each field; of variables that come again and again in a container, the first one."""
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


def _is_long(field: Field) -> bool:
    return isinstance(field.layout, Many) and len(field.children) > _MANY.get(field.name, len(field.children))


def _region(where: str) -> str:
    """The record, container or block that a field is in; the header for what is in none."""
    inside, found, _ = where.rpartition(_LIST)
    return inside + found if found else where.partition(".")[0]


def _protocol(anatomy: Anatomy, path: str) -> str:
    """Whose block a problem is about, where the path does not tell."""
    block = path.partition(".")[0]
    if not block.startswith("payloads[") or ".vardis" in path or ".srp" in path:
        return ""
    field = anatomy.at(f"{block}.protocolId")
    if field is None or field.value is None:
        return ""
    return f" of {PROTOCOLS.get(field.value, 'another protocol')}"


def _violated(anatomy: Anatomy, reason: str, path: str) -> tuple[str, ...]:
    """What is violated by a receiver that does not survive an anomaly; how it reacts otherwise is most often open."""
    if reason == "beacon-overrun":
        return ("BP-RX-15",)
    if ".vardis" in path:
        return ("VD-ROB-01",)
    # BP delivers an empty payload, and either of the two may die of it.
    in_vardis = reason == "empty-payload" and _protocol(anatomy, path) == f" of {PROTOCOLS[int(BP_PROTID_VARDIS)]}"
    return ("BP-RX-16", "VD-ROB-01") if in_vardis else ("BP-RX-16",)


__all__ = ["Anomaly", "Kinds", "anomalies", "anomalies_of", "kinds_of"]
