"""Fast generation of damaged beacons: seeded mutations of a pool of valid messages.

Every message of the pool is dissected once; a mutation then only joins octets and takes microseconds. Field mutations
keep the number of octets: a field becomes 0, 1, the highest value or the one below, one more, one less, a value without
a name, the other byte order, or one bit is inverted. Structural mutations cut at any octet, append octets, and repeat,
remove, exchange or import whole elements, or set every count wrong at once.

Each mutation reports its changes as ``(path without indices, class)``. These pairs are the coverage of a campaign
(:attr:`Mutator.possible`, :attr:`Mutator.reached`); pairs that were not reached yet are preferred.

The generator is passed in (``random.Random``), so that the same seed makes the same octets.
"""

from __future__ import annotations

import functools
import random
import re
import sys
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from dcp_codec.codec import Codec
from dcp_codec.plan.layout import references, walk
from dcp_codec.plan.tree import Many, Node, Scalar, Select
from dcp_codec.views.dissector import generate_dissector
from dcp_codec.views.fields import Field

from .draws import Draws

Touch = tuple[str, str]
"""A field (its path without indices) and the class of the change."""

FIELD_CLASSES: Final = ("0", "1", "max-1", "max", "+1", "-1", "unknown", "swapped", "bit")
"""Classes of changes to a field; ``swapped`` needs two octets, ``unknown`` a field with named values."""
STRUCTURE_CLASSES: Final = ("cut", "trail", "twice", "drop", "reorder", "splice", "bomb")
"""Classes of changes to structure: at an octet (cut), after the message (trail), to elements of lists, to all
counts.
"""

#: Probabilities: of a further field, of structural damage, of a pair not reached yet, of structural damage only.
_MORE_FIELDS, _STRUCTURE, _PREFERENCE, _ONLY_STRUCTURE = 0.3, 0.25, 0.25, 0.15
#: Maximum number of repetitions of an element in a bomb.
_BOMB = 64
#: Maximum number of messages in the pool.
_MOST_SOURCES = 4096
_INDEX = re.compile(r"\[\d+\]")


class Place(NamedTuple):
    """A field of a message of the pool."""

    path: str
    """The path without indices: ``payloads[].vardis[].records[].seqno``."""
    start: int
    stop: int
    options: Mapping[str, bytes]
    """Class -> the new octets of the field; those of ``bit`` are drawn."""
    names: tuple[str, ...]
    """The classes, including ``bit``."""


class Source(NamedTuple):
    """A dissected message of the pool."""

    octets: bytes
    places: tuple[Place, ...]
    starts: tuple[int, ...]
    """The offsets of the fields, ascending, in the order of ``places``."""
    elements: tuple[tuple[str, int, int], ...]
    """The elements of lists: path, start, end."""
    counts: tuple[Place, ...]
    """The fields that count elements or octets."""


class Mutation(NamedTuple):
    """Mutated octets, the valid message from which they were made, and the changes."""

    octets: bytes
    source: bytes
    touched: tuple[Touch, ...]


class Mutator:
    """Draws mutations of a pool of messages."""

    def __init__(self, codec: Codec, rng: random.Random, pool: Iterable[bytes]) -> None:
        """``pool``: bearer payloads, which need not be valid. Raises ValueError for a pool without any octets."""
        self._rng = rng
        self._chance = Draws(rng)
        self._dissect = generate_dissector(codec.beacon_plan, "of a pool")
        self.sources = [_taken_apart(self._dissect(each, 0, 0).root, each) for each in pool if each]
        if not self.sources:
            raise ValueError("there is nothing to mutate: the pool is empty")
        self.reached: Counter[Touch] = Counter()
        """Number of times that each pair was generated."""
        self._where: dict[Touch, list[tuple[Source, Place]]] = {}
        for source in self.sources:
            for place in source.places:
                for name in place.names:
                    self._where.setdefault((place.path, name), []).append((source, place))
        paths = {path for path, _ in self._where}
        listed = {path for source in self.sources for path, _, _ in source.elements}
        self.possible: frozenset[Touch] = frozenset(self._where) | {
            *((path, "cut") for path in paths),
            *((path, name) for path in listed for name in ("twice", "drop", "reorder", "splice")),
            ("", "trail"),
            ("", "bomb"),
        }
        """The pairs that the pool allows."""
        self._missing = sorted(self._where)
        self._structure: dict[str, Callable[[Source, bytes], tuple[bytes, Touch | None]]] = {
            "cut": self._cut,
            "trail": self._trail,
            "twice": self._twice,
            "drop": self._drop,
            "reorder": self._reorder,
            "splice": self._splice,
            "bomb": self._bomb,
        }

    def add(self, octets: bytes) -> None:
        """Add a message to the pool; if the pool is full, it replaces another one."""
        if not octets:
            return
        source = _taken_apart(self._dissect(octets, 0, 0).root, octets)
        if len(self.sources) < _MOST_SOURCES:
            self.sources.append(source)
        else:
            self.sources[self._chance.below(len(self.sources))] = source

    def mutate(self) -> Mutation:
        """Return the next mutation."""
        rng = self._rng
        chance = rng.random
        if self._missing and chance() < _PREFERENCE:
            touch = self._missing.pop(self._chance.below(len(self._missing)))
            if not self.reached[touch]:
                source, place = self._chance.one_of(self._where[touch])
                octets = _replaced(source.octets, place, self._new(source, place, touch[1]))
                self.reached[touch] += 1
                return Mutation(octets, source.octets, (touch,))
        source = self.sources[int(chance() * len(self.sources))]
        octets = source.octets
        touched: list[Touch] = []
        if source.places and chance() >= _ONLY_STRUCTURE:
            while True:
                place = source.places[int(chance() * len(source.places))]
                name = place.names[int(chance() * len(place.names))]
                octets = _replaced(octets, place, self._new(source, place, name))
                touched.append((place.path, name))
                if chance() >= _MORE_FIELDS:
                    break
        if not touched or chance() < _STRUCTURE:
            octets, touch_or_none = self._structure[self._chance.one_of(STRUCTURE_CLASSES)](source, octets)
            if touch_or_none is not None:
                touched.append(touch_or_none)
        for touch in touched:
            self.reached[touch] += 1
        return Mutation(octets, source.octets, tuple(touched))

    def _new(self, source: Source, place: Place, name: str) -> bytes:
        if name != "bit":
            return place.options[name]
        raw = bytearray(source.octets[place.start : place.stop])
        raw[self._chance.below(len(raw))] ^= 1 << self._chance.below(8)
        return bytes(raw)

    # -- structure ---------------------------------------------------------------------------------------------

    def _cut(self, source: Source, octets: bytes) -> tuple[bytes, Touch | None]:
        end = self._chance.below(len(octets))
        found = bisect_right(source.starts, end) - 1
        return octets[:end], (source.places[found].path, "cut") if found >= 0 else None

    def _trail(self, source: Source, octets: bytes) -> tuple[bytes, Touch]:
        behind = self._chance.one_of((b"\0", bytes(20), b"\xff" * 4, source.octets, self._rng.randbytes(8)))
        return octets + behind, ("", "trail")

    def _element(self, source: Source) -> tuple[str, int, int] | None:
        return self._chance.one_of(source.elements) if source.elements else None

    def _twice(self, source: Source, octets: bytes) -> tuple[bytes, Touch | None]:
        if (element := self._element(source)) is None:
            return octets, None
        path, start, stop = element
        return octets[:stop] + octets[start:], (path, "twice")

    def _drop(self, source: Source, octets: bytes) -> tuple[bytes, Touch | None]:
        if (element := self._element(source)) is None:
            return octets, None
        path, start, stop = element
        return octets[:start] + octets[stop:], (path, "drop")

    def _reorder(self, source: Source, octets: bytes) -> tuple[bytes, Touch | None]:
        """Exchange two elements of which neither contains the other."""
        if len(source.elements) < 2:
            return octets, None
        one, other = sorted(self._rng.sample(source.elements, 2), key=lambda each: each[1])
        (path, a, b), (_, c, d) = one, other
        if b > c:
            return octets, None
        return octets[:a] + octets[c:d] + octets[b:c] + octets[a:b] + octets[d:], (path, "reorder")

    def _splice(self, source: Source, octets: bytes) -> tuple[bytes, Touch | None]:
        """Replace an element by one of another message."""
        other = self._chance.one_of(self.sources)
        mine, theirs = self._element(source), self._element(other)
        if mine is None or theirs is None:
            return octets, None
        path, start, stop = mine
        return octets[:start] + other.octets[theirs[1] : theirs[2]] + octets[stop:], (path, "splice")

    def _bomb(self, source: Source, octets: bytes) -> tuple[bytes, Touch]:
        """Set all counts, or all lengths too, to their maximum, and repeat an element many times."""
        for place in source.counts:
            if self._rng.random() < 0.8:
                octets = _replaced(octets, place, place.options[self._chance.one_of(("max", "max-1"))])
        if (element := self._element(source)) is not None:
            _, start, stop = element
            octets = octets[:stop] + octets[start:stop] * (1 + self._chance.below(_BOMB - 1)) + octets[stop:]
        return octets[:65_507], ("", "bomb")


def _replaced(octets: bytes, place: Place, new: bytes) -> bytes:
    return octets[: place.start] + new + octets[place.stop :]


def generic(path: str) -> str:
    """Return a field path without its indices; all fields with that path share one string, since a pool has
    thousands.
    """
    return sys.intern(_INDEX.sub("[]", path))


def _taken_apart(root: Field, octets: bytes) -> Source:
    places: list[Place] = []
    elements: list[tuple[str, int, int]] = []
    counts: list[Place] = []
    referred = references(root.layout)
    keys = _keys(root.layout)
    for field in root.walk():
        if isinstance(field.layout, Many):
            path = generic(field.path) + "[]"
            elements += [(path, each.offset, each.offset + each.length) for each in field.children if each.length]
        if field.children or not field.length:
            continue
        layout = field.layout
        order = layout.order if isinstance(layout, Scalar) else "big"
        known = keys.get(field.name, frozenset()) if isinstance(layout, Scalar) else frozenset()
        if isinstance(layout, Scalar) and layout.names is not None:
            known |= frozenset(layout.names)
        options, names = _options(field.raw, order, known)
        place = Place(generic(field.path), field.offset, field.offset + field.length, options, names)
        places.append(place)
        if isinstance(layout, Scalar) and (layout.derived is not None or field.name in referred):
            counts.append(place)
    return Source(octets, tuple(places), tuple(place.start for place in places), tuple(elements), tuple(counts))


def _keys(layout: Node) -> dict[str, frozenset[int]]:
    """Return the fields that select a content -> the values for which there is one."""
    return {each.key.rsplit(".", 1)[-1]: frozenset(each.cases) for each in walk(layout) if isinstance(each, Select)}


@functools.lru_cache(maxsize=1024)
def _options(raw: bytes, order: Any, known: frozenset[int]) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """Return other octets of the same length by class, and all classes; long fields are changed as numbers, too.

    The result is cached: most fields of a pool have equal contents.
    """
    size = len(raw)
    top = (1 << (8 * size)) - 1
    value = int.from_bytes(raw, order)
    numbers = {"0": 0, "1": 1, "max-1": top - 1, "max": top, "+1": (value + 1) & top, "-1": (value - 1) & top}
    if known and size <= 2:
        unknown = next((number for number in range(max(known) + 1, top + 1) if number not in known), None)
        if unknown is not None:
            numbers["unknown"] = unknown
    found = {name: number.to_bytes(size, order) for name, number in numbers.items()}
    if size > 1:
        found["swapped"] = raw[::-1]
    return found, (*found, "bit")


def drawn_pool(codec: Codec, rng: random.Random, count: int = 200, recorded: Sequence[bytes] = ()) -> list[bytes]:
    """Return a pool for :class:`Mutator`: valid beacons of the profile, and the recorded ones."""
    from .mutation_values import valid_beacons

    return [*valid_beacons(codec, rng, count), *recorded]
