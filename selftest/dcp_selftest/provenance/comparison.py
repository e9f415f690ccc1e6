"""Alignment of two versions of a specification, statement by statement."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Final, Literal

from .statements import Statement, distance

Change = Literal["unchanged", "renumbered", "moved", "changed", "gone", "new"]

#: Bits of 64 in which the sketches of two wordings of one statement may differ: in the same gap of a section, and
#: anywhere in the file. Unrelated statements differ in 32 bits on average, with a standard deviation of 4.
_NEAR: Final = 24
_VERY_NEAR: Final = 14
#: Share of its statements that a section or a file must have in common with the one that it became.
_SAME: Final = 0.4

Place = tuple[str, str]


@dataclass(frozen=True, slots=True)
class Pair:
    """A statement in the older version, in the newer one, or in both."""

    old: Statement | None
    new: Statement | None

    @property
    def change(self) -> Change:
        """The kind of the change. ``moved``: same wording, other section; ``renumbered``: same section, other step."""
        if self.old is None:
            return "new"
        if self.new is None:
            return "gone"
        if self.old.fingerprint != self.new.fingerprint:
            return "changed"
        if self.old.place != self.new.place:
            return "moved"
        return "renumbered" if self.old.step != self.new.step else "unchanged"


def align(old: Sequence[Statement], new: Sequence[Statement]) -> list[Pair]:
    """Pair the statements of two versions; in the order of ``old``, then what only ``new`` has, in its order."""
    return _Alignment(old, new).pairs()


class _Alignment:
    def __init__(self, old: Sequence[Statement], new: Sequence[Statement]) -> None:
        self._old = old
        self._new = new
        self._partner: dict[int, int] = {}
        """Position in ``new`` by position in ``old``."""
        self._taken: set[int] = set()

    def pairs(self) -> list[Pair]:
        successors = self._successors()
        old_sections, new_sections = _by_place(self._old), _by_place(self._new)
        sections = [
            (old_sections[place], new_sections[successors[place]]) for place in old_sections if place in successors
        ]
        for left, right in sections:
            self._match_equal(left, right)
        self._match_moved()
        for left, right in sections:
            self._match_reworded(left, right)
        self._match_reworded_elsewhere()
        found = [Pair(each, self._new[self._partner[number]] if number in self._partner else None)
                 for number, each in enumerate(self._old)]  # fmt: skip
        return found + [Pair(None, each) for number, each in enumerate(self._new) if number not in self._taken]

    # -- sections -----------------------------------------------------------------------------------------------------

    def _successors(self) -> dict[Place, Place]:
        """The section that each section became: the one with its name, else the one with most of its statements."""
        files = self._renamed_files()
        old, new = _by_place(self._old), _by_place(self._new)
        found = {place: (files.get(place[0], place[0]), place[1]) for place in old}
        found = {place: successor for place, successor in found.items() if successor in new}
        free = {place: Counter(self._new[each].fingerprint for each in new[place]) for place in new}
        for successor in found.values():
            free.pop(successor, None)
        for place, numbers in old.items():
            if place in found:
                continue
            wording = Counter(self._old[each].fingerprint for each in numbers)
            best = max(free, key=lambda each: (wording & free[each]).total(), default=None)
            if best is not None and (wording & free[best]).total() > _SAME * wording.total():
                found[place] = best
                del free[best]
        _pair_by_order(list(old), list(new), found)
        return found

    def _renamed_files(self) -> dict[str, str]:
        old, new = _wording_by_file(self._old), _wording_by_file(self._new)
        found: dict[str, str] = {}
        free = {file: wording for file, wording in new.items() if file not in old}
        for file, wording in old.items():
            if file in new or not free:
                continue
            best = max(free, key=lambda each: (wording & free[each]).total())
            if (wording & free[best]).total() > _SAME * wording.total():
                found[file] = best
                del free[best]
        return found

    # -- statements ---------------------------------------------------------------------------------------------------

    def _pair(self, left: int, right: int) -> None:
        self._partner[left] = right
        self._taken.add(right)

    def _match_equal(self, left: Sequence[int], right: Sequence[int]) -> None:
        """Same wording, same order, same section."""
        matcher = SequenceMatcher(
            None,
            [self._old[each].fingerprint for each in left],
            [self._new[each].fingerprint for each in right],
            autojunk=False,
        )
        for block in matcher.get_matching_blocks():
            for number in range(block.size):
                self._pair(left[block.a + number], right[block.b + number])

    def _match_moved(self) -> None:
        """Same wording elsewhere, where it is plain which is which: in one section first, then in one file."""
        for depth in (2, 1, 0):
            left: dict[tuple[str, ...], list[int]] = defaultdict(list)
            right: dict[tuple[str, ...], list[int]] = defaultdict(list)
            for number, each in enumerate(self._old):
                if number not in self._partner:
                    left[each.fingerprint, *each.place[:depth]].append(number)
            for number, each in enumerate(self._new):
                if number not in self._taken:
                    right[each.fingerprint, *each.place[:depth]].append(number)
            for name, numbers in left.items():
                if len(numbers) == 1 == len(right.get(name, ())):
                    self._pair(numbers[0], right[name][0])

    def _match_reworded(self, left: Sequence[int], right: Sequence[int]) -> None:
        """Similar wording between the same neighbours."""
        position = {number: place for place, number in enumerate(right)}
        gap_start = 0
        run: list[int] = []
        for number in [*left, None]:
            if number is not None and number not in self._partner:
                run.append(number)
                continue
            end = len(right) if number is None else position.get(self._partner[number])
            if end is None or end < gap_start:
                continue  # Its partner is not in this section, or out of order: no boundary.
            self._match_gap(run, [each for each in right[gap_start:end] if each not in self._taken])
            run, gap_start = [], end
        # Statements that changed their order.
        self._match_gap([each for each in left if each not in self._partner],
                        [each for each in right if each not in self._taken])  # fmt: skip

    def _match_gap(self, left: Iterable[int], right: Iterable[int], limit: int = _NEAR) -> None:
        close = sorted(
            (distance(self._old[a].sketch, self._new[b].sketch), self._old[a].step != self._new[b].step, a, b)
            for a in left
            for b in right
            if (self._old[a].kind == "sentence") == (self._new[b].kind == "sentence")
        )
        for bits, _, a, b in close:
            if bits <= limit and a not in self._partner and b not in self._taken:
                self._pair(a, b)

    def _match_reworded_elsewhere(self) -> None:
        by_file: dict[str, list[int]] = defaultdict(list)
        for number, each in enumerate(self._new):
            if number not in self._taken:
                by_file[each.file].append(number)
        left: dict[str, list[int]] = defaultdict(list)
        for number, each in enumerate(self._old):
            if number not in self._partner:
                left[each.file].append(number)
        for file, numbers in left.items():
            self._match_gap(numbers, by_file[file], _VERY_NEAR)


def _pair_by_order(old: Sequence[Place], new: Sequence[Place], found: dict[Place, Place]) -> None:
    """Pair sections that lie between the same neighbours, where there are equally many in both versions."""
    position = {place: number for number, place in enumerate(new)}
    taken = set(found.values())
    run: list[Place] = []
    start = 0
    for place in [*old, None]:
        if place is not None and place not in found:
            run.append(place)
            continue
        end = len(new) if place is None else position[found[place]]
        between = [each for each in new[start:end] if each not in taken]
        if len(between) == len(run):
            found.update(zip(run, between, strict=True))
        run, start = [], max(start, end + 1)


def _by_place(statements: Iterable[Statement]) -> dict[Place, list[int]]:
    found: dict[Place, list[int]] = defaultdict(list)
    for number, each in enumerate(statements):
        found[each.place].append(number)
    return dict(found)


def _wording_by_file(statements: Iterable[Statement]) -> dict[str, Counter[str]]:
    found: dict[str, Counter[str]] = defaultdict(Counter)
    for each in statements:
        found[each.file][each.fingerprint] += 1
    return dict(found)
