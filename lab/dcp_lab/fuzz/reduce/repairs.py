"""Repair one anomaly of a frame without changing anything else, to prove that the anomaly is the cause."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.plan.tree import Many
from dcp_codec.views.fields import Field
from dcp_lab.fuzz.generate.samples import Samples
from dcp_lab.testing.mutation import generic

from .anatomy import Anatomy, Edit
from .anomalies import Anomaly, Kinds, anomalies_of, kinds_of

#: Type of the records that replace records of unknown type.
_SMALLEST: Final = ICType.REQUEST_VARCREATES.label
#: Maximum number of wrong lengths or counts that a repair may reveal and that are then corrected.
_HIDDEN: Final = 3
#: Divisors of the length of a long list for shorter forms of it.
_SHARES: Final = (2, 4, 8, 16)


class Repairs:
    """Repairs frames of a profile, using parts of ordinary beacons."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        beacons = Samples(codec).each()
        self.sound = beacons[0]
        """The smallest ordinary beacon."""
        self._parts: dict[tuple[str, str], bytes] = {}
        """Octets of fields of ordinary beacons, by path without indices and enclosing container type or protocol."""
        for octets in beacons:
            anatomy = Anatomy(codec, octets)
            for field in anatomy.root.walk():
                self._parts.setdefault((generic(field.path), _type_around(anatomy, field)), field.raw)

    def repaired(self, octets: bytes, anomaly: Anomaly) -> bytes | None:
        """Return the frame without this anomaly and without a new one; None if no such form is known.

        As much of the frame as possible stays unchanged, including other anomalies.
        """
        anatomy = Anatomy(self.codec, octets)
        before = kinds_of(anomalies_of(anatomy))
        best: bytes | None = None
        most = -1
        for repaired in self._candidates(anatomy, anomaly):
            candidate, after = self._settled(repaired, before)
            if after[anomaly.kind] < before[anomaly.kind] and after <= before and after.total() > most:
                best, most = candidate, after.total()
                if most == before.total() - 1:
                    break
        return best

    def part(self, anatomy: Anatomy, field: Field) -> bytes | None:
        """Return the octets of the same field in an ordinary beacon; None if there is no such field."""
        path = generic(field.path)
        return self._parts.get((path, _type_around(anatomy, field))) or self._parts.get((path, _SMALLEST))

    def _settled(self, octets: bytes, before: Kinds) -> tuple[bytes, Kinds]:
        """Correct the wrong lengths and counts that a repair has revealed. Returns the frame and its anomalies."""
        for _ in range(_HIDDEN):
            anatomy = Anatomy(self.codec, octets)
            found = anomalies_of(anatomy)
            after = kinds_of(found)
            new = next((each for each in found if after[each.kind] > before[each.kind]), None)
            announced = None if new is None else anatomy.announcement(anatomy.nearest(new.path))
            if announced is None or announced.truth == announced.field.value:
                return octets, after
            octets = anatomy.set_right(announced)
        return octets, kinds_of(anomalies_of(Anatomy(self.codec, octets)))

    def _candidates(self, anatomy: Anatomy, anomaly: Anomaly) -> Iterator[bytes]:
        """Yield possible repairs, those that change the least first."""
        if anomaly.reason == "trailing-octets":
            yield anatomy.octets[: -len(anatomy.dissection.padding)]
            return
        field = anatomy.nearest(anomaly.path)
        if anomaly.reason.startswith("many-"):
            for share in _SHARES:
                yield anatomy.without(field.children[max(1, len(field.children) // share) :])
            yield anatomy.without(field.children[1:])
        announced = anatomy.announcement(field)
        if announced is not None and announced.truth != field.value:
            yield anatomy.set_right(announced)
            element = self._parts.get((f"{generic(announced.of.path)}[]", _SMALLEST))
            if announced.kind == "count" and field.value == announced.truth + 1 and element is not None:
                # Add the element that is counted but missing.
                end = announced.of.offset + announced.of.length
                yield anatomy.edited([Edit(end, end, element, announced.of)])
        if anomaly.reason == "id-mismatch":
            first = anatomy.at(anomaly.path.replace(".upd.", ".spec."))
            if first is not None:
                yield anatomy.replaced(field, first.raw)
        for each in anatomy.around(field):
            if isinstance(each.layout, Many) and len(each.children) > 1:
                yield from self._counted(anatomy, each)
            if each is not anatomy.root:
                yield from self._instead_of(anatomy, each)
        yield self.sound

    def _counted(self, anatomy: Anatomy, field: Field) -> Iterator[bytes]:
        """Yield the frame without the last element of a list, and with the count of the list corrected."""
        shorter = Anatomy(self.codec, anatomy.without([field.children[-1]]))
        for announced in shorter.announced:
            if announced.kind == "count" and announced.of.path == field.path:
                yield shorter.set_right(announced)

    def _instead_of(self, anatomy: Anatomy, field: Field) -> Iterator[bytes]:
        """Yield the frame with a field replaced by that of an ordinary beacon, or, in a longer list, removed."""
        sound = self.part(anatomy, field)
        if sound is not None and sound != field.raw and anatomy.announcement(field) is None:
            yield anatomy.replaced(field, sound)
        inside = anatomy.parent(field)
        if inside is not None and isinstance(inside.layout, Many) and len(inside.children) > 1:
            yield anatomy.without([field])


def _type_around(anatomy: Anatomy, field: Field) -> str:
    """Return the type of the container of a field, or the protocol of its block; empty for a field outside of both."""
    for each in anatomy.around(field):
        kind = each.child("icType")
        if kind is not None:
            return kind.label or _SMALLEST
        protocol = each.child("protocolId")
        if protocol is not None:
            known = {int(BP_PROTID_SRP): "srp", int(BP_PROTID_VARDIS): _SMALLEST}
            return known.get(protocol.value, "other")
    return ""
