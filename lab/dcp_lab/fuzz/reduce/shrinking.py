"""Minimise one frame of a finding; operations with the greatest gain are first, since each attempt may need a restart.

First each anomaly is tried alone in the smallest frame that has it. If no anomaly alone is enough, the frame is reduced
gradually: list elements are removed (delta debugging), anomalies are repaired one at a time, long octet strings are
shortened, and remaining values are replaced by ordinary ones. No attempt adds an anomaly, so that the cause of the
effect does not change during the minimisation.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Final

from dcp_codec.codec import Codec
from dcp_codec.plan.tree import Rest, Scalar, Text
from dcp_codec.views.fields import Field
from dcp_lab.fuzz.generate.samples import TEXT

from .anatomy import Anatomy, Edit
from .anomalies import Anomaly, Kinds, anomalies, kinds_of
from .repairs import Repairs

Attempt = Callable[[bytes], bool]
"""Function that returns whether a frame still shows the effect."""
Change = tuple[str, bytes]
"""Path of a field, and its new octets."""

#: Maximum number of rounds of removing, repairing and shortening; the second one rarely changes anything.
_ROUNDS: Final = 3
#: Maximum number of repairs to get a frame with a single anomaly.
_MOST_REPAIRS: Final = 12
#: Address fields: another value would change how the frame is processed.
_ADDRESSES: Final = ("senderId", "networkId", "nodeId", "prodId")
#: Fields that are not changed.
_KEPT: Final = (*_ADDRESSES, "protocolId", "icType")


class Shrinker:
    """Minimiser of frames of a profile."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self.repairs = Repairs(codec)

    def shrink(self, octets: bytes, attempt: Attempt, valid: bytes = b"") -> bytes:
        """Return the smallest form of a frame for which ``attempt`` returns True.

        ``valid``: the valid message that the frame was mutated from, or empty. Forwards exceptions of ``attempt``,
        which has to store the last frame for which it returned True.
        """
        work = _Work(self, octets, attempt)
        if not work.isolate() and valid:
            work.accept(valid)
        for _ in range(_ROUNDS):
            before = work.octets
            work.fewer_elements()
            work.repair()
            for changes in (self.strings, self.values):
                work.at_once_or_apart(changes(Anatomy(self.codec, work.octets)))
            if work.octets == before:
                break
        return work.octets

    def sound_forms(self, octets: bytes) -> list[bytes]:
        """Return the frame with one anomaly repaired, for each anomaly that can be repaired."""
        found = (self.repairs.repaired(octets, anomaly) for anomaly in anomalies(self.codec, octets))
        return [repaired for repaired in found if repaired is not None]

    def isolated(self, octets: bytes, anomaly: Anomaly) -> bytes | None:
        """Reduce a frame to the smallest one that has only this anomaly. Returns None if that fails."""
        candidate = self._bare(octets, anomaly)
        for _ in range(_MOST_REPAIRS):
            found = anomalies(self.codec, candidate)
            kept = [each for each in found if each.kind == anomaly.kind]
            others = [each for each in found if each.kind != anomaly.kind]
            if not kept:
                return None
            if not others:
                break
            for other in others:
                repaired = self.repairs.repaired(candidate, other)
                if repaired is not None and self.kinds(repaired)[anomaly.kind]:
                    candidate = repaired
                    break
            else:
                return None
        kinds = self.kinds(candidate)
        if set(kinds) != {anomaly.kind}:
            return None
        for plainer in self.plainer(candidate):
            if self.kinds(plainer) == kinds:
                return plainer
        return candidate

    def plainer(self, octets: bytes) -> Iterator[bytes]:
        """Yield the frame with ordinary values and short strings, then the frame with short strings only."""
        anatomy = Anatomy(self.codec, octets)
        strings, values = self.strings(anatomy), self.values(anatomy)
        yield _changed(anatomy, [*strings, *values])
        yield _changed(anatomy, strings)

    def strings(self, anatomy: Anatomy) -> list[Change]:
        """Return the changes that shorten strings and other unstructured octets, the longest first."""
        found: list[tuple[int, Change]] = []
        for field in anatomy.root.walk():
            if not isinstance(field.layout, Text | Rest) or field.name in _ADDRESSES:
                continue
            if isinstance(field.layout, Rest):
                found += [(1 - field.length, (field.path, b"\0"))] * (field.length > 1)
            elif field.value is not None:
                short = self.repairs.part(anatomy, field)
                if short is not None and field.layout.human and not _is_utf8(field.value):
                    short = short.replace(TEXT, b"\xff")
                if short is not None and len(short) < field.length:
                    found.append((len(short) - field.length, (field.path, short)))
            elif (data := field.child("data")) is not None and data.length > 1:
                # The string is truncated and stays so, because its announced length is reduced, too.
                found.append((1 - data.length, (data.path, data.raw[:1])))
        return [change for _, change in sorted(found)]

    def values(self, anatomy: Anatomy) -> list[Change]:
        """Return the changes that set fields to ordinary values, except fields that determine the structure."""
        special = {id(each.field) for each in anatomy.announced}
        found: list[Change] = []
        for field in anatomy.root.walk():
            layout = field.layout
            if not isinstance(layout, Scalar) or field.value is None or id(field) in special:
                continue
            if layout.names is not None or layout.rule is not None or layout.derived is not None:
                continue
            if field.name in _KEPT:
                continue
            plain = self.repairs.part(anatomy, field)
            if plain is not None and len(plain) == field.length and plain != field.raw:
                found.append((field.path, plain))
        return found

    def _bare(self, octets: bytes, anomaly: Anomaly) -> bytes:
        """Return the frame without list elements that do not contain the anomaly; one element of each list stays."""
        anatomy = Anatomy(self.codec, octets)
        around = {id(each) for each in anatomy.around(anatomy.nearest(anomaly.path))}
        cut: list[Field] = []
        gone: set[int] = set()
        for each in anatomy.lists():
            if anomaly.reason.startswith("many-") and each.path == anomaly.path:
                continue
            if not each.children or any(id(outer) in gone for outer in anatomy.around(each)):
                continue
            kept = next((child for child in each.children if id(child) in around), each.children[0])
            cut += [child for child in each.children if child is not kept]
            gone.update(id(child) for child in each.children if child is not kept)
        bare = anatomy.without(cut)
        padding = 0 if anomaly.reason == "trailing-octets" else len(anatomy.dissection.padding)
        return bare[: len(bare) - padding]

    def kinds(self, octets: bytes) -> Kinds:
        """Return the number of anomalies of each kind in a frame."""
        return kinds_of(anomalies(self.codec, octets))


class _Work:
    """State of the minimisation of one frame."""

    def __init__(self, shrinker: Shrinker, octets: bytes, attempt: Attempt) -> None:
        self._shrinker = shrinker
        self._codec = shrinker.codec
        self._attempt = attempt
        self.octets = octets
        self._kinds = shrinker.kinds(octets)

    def accept(self, candidate: bytes | None) -> bool:
        """Try a frame if it is simpler than the current one, and make it the current one if it shows the effect."""
        if candidate is None or candidate == self.octets:
            return False
        kinds = self._shrinker.kinds(candidate)
        if not kinds <= self._kinds or (kinds == self._kinds and len(candidate) > len(self.octets)):
            return False
        if not self._attempt(candidate):
            return False
        self.octets, self._kinds = candidate, kinds
        return True

    def isolate(self) -> bool:
        """Try each anomaly alone. Returns whether one of them is enough."""
        tried: set[str] = set()
        for anomaly in anomalies(self._codec, self.octets):
            if anomaly.kind in tried:
                continue
            tried.add(anomaly.kind)
            isolated = self._shrinker.isolated(self.octets, anomaly)
            if isolated == self.octets or self.accept(isolated):
                return True
        return False

    def fewer_elements(self) -> None:
        """Remove list elements: from outer lists first, halves first."""
        for name in ("payloads", "vardis", "records"):
            place = 0
            while True:
                lists = [each for each in Anatomy(self._codec, self.octets).lists() if each.name == name]
                if place >= len(lists):
                    break
                self._fewer(lists[place].path)
                place += 1
        anatomy = Anatomy(self._codec, self.octets)
        if anatomy.dissection.padding:
            self.accept(self.octets[: -len(anatomy.dissection.padding)])

    def _fewer(self, path: str) -> None:
        size = 0
        while True:
            anatomy = Anatomy(self._codec, self.octets)
            field = anatomy.at(path)
            count = len(field.children) if field is not None else 0
            if field is None or count < 2:
                return
            size = min(size or count // 2, count - 1)
            for start in range(0, count, size):
                chunk = field.children[start : start + size]
                if len(chunk) < count and self.accept(anatomy.without(chunk)):
                    break
            else:
                if size == 1:
                    return
                size //= 2

    def repair(self) -> None:
        """Repair unnecessary anomalies, one at a time."""
        going = True
        while going:
            going = False
            tried: set[str] = set()
            for anomaly in anomalies(self._codec, self.octets):
                if anomaly.path not in tried:
                    tried.add(anomaly.path)
                    if self.accept(self._shrinker.repairs.repaired(self.octets, anomaly)):
                        going = True
                        break

    def at_once_or_apart(self, changes: Sequence[Change]) -> None:
        """Try all changes together, then halves of them, down to single ones."""
        if not changes or self.accept(_changed(Anatomy(self._codec, self.octets), changes)) or len(changes) == 1:
            return
        half = len(changes) // 2
        self.at_once_or_apart(changes[:half])
        self.at_once_or_apart(changes[half:])


@functools.lru_cache(maxsize=8)
def shrinker_of(codec: Codec) -> Shrinker:
    """Return the shrinker of a codec (cached)."""
    return Shrinker(codec)


def _is_utf8(octets: bytes) -> bool:
    try:
        octets.decode()
    except UnicodeDecodeError:
        return False
    return True


def _changed(anatomy: Anatomy, changes: Sequence[Change]) -> bytes:
    edits = []
    for path, new in changes:
        field = anatomy.at(path)
        if field is not None:
            edits.append(Edit(field.offset, field.offset + field.length, new, field))
    return anatomy.edited(edits)
