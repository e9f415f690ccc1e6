"""The sound form of one anomaly of a frame, everything else left as it is: what a cause is proved with."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType

from dcp_codec.codec import Codec
from dcp_codec.plan.tree import Many
from dcp_codec.testing.mutation import generic
from dcp_codec.views.fields import Field
from dcp_conformance.fuzz.generate.samples import Samples

from .anatomy import Anatomy, Edit
from .anomalies import Anomaly, Kinds, anomalies_of, kinds_of

#: The records that take the place of those whose type is not known.
_SMALLEST: Final = ICType.REQUEST_VARCREATES.label
#: Lies that another one may hide.
_HIDDEN: Final = 3
#: Shares of a long list that are tried as a short one.
_SHARES: Final = (2, 4, 8, 16)


class Repairs:
    """Repairs frames of a profile with parts of ordinary beacons."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        beacons = Samples(codec).each()
        self.sound = beacons[0]
        """The smallest ordinary beacon."""
        self._parts: dict[tuple[str, str], bytes] = {}
        """Octets of ordinary beacons, by path without indices and by the type of container or protocol around."""
        for octets in beacons:
            anatomy = Anatomy(codec, octets)
            for field in anatomy.root.walk():
                self._parts.setdefault((generic(field.path), _type_around(anatomy, field)), field.raw)

    def repaired(self, octets: bytes, anomaly: Anomaly) -> bytes | None:
        """The frame without this anomaly and with no new one; None if no such form is known.

        As much of the frame as possible stays as it is, other anomalies included.
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
        """The octets of the same field in an ordinary beacon; None if there is no such field."""
        path = generic(field.path)
        return self._parts.get((path, _type_around(anatomy, field))) or self._parts.get((path, _SMALLEST))

    def _settled(self, octets: bytes, before: Kinds) -> tuple[bytes, Kinds]:
        """A repaired frame, with lengths and counts set right whose lies were hidden by what was repaired."""
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
        """Sound forms, those that change the least first."""
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
                # The element that was counted, and is not there.
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
        """The frame without the last element of a list, whose count then is right."""
        shorter = Anatomy(self.codec, anatomy.without([field.children[-1]]))
        for announced in shorter.announced:
            if announced.kind == "count" and announced.of.path == field.path:
                yield shorter.set_right(announced)

    def _instead_of(self, anatomy: Anatomy, field: Field) -> Iterator[bytes]:
        """The frame with the part of an ordinary beacon instead, or, of several elements of a list, without this."""
        sound = self.part(anatomy, field)
        if sound is not None and sound != field.raw and anatomy.announcement(field) is None:
            yield anatomy.replaced(field, sound)
        inside = anatomy.parent(field)
        if inside is not None and isinstance(inside.layout, Many) and len(inside.children) > 1:
            yield anatomy.without([field])


def _type_around(anatomy: Anatomy, field: Field) -> str:
    """The type of the container that a field is in, or the protocol of its block; empty for neither."""
    for each in anatomy.around(field):
        kind = each.child("icType")
        if kind is not None:
            return kind.label or _SMALLEST
        protocol = each.child("protocolId")
        if protocol is not None:
            known = {int(BP_PROTID_SRP): "srp", int(BP_PROTID_VARDIS): _SMALLEST}
            return known.get(protocol.value, "other")
    return ""


__all__ = ["Repairs"]
