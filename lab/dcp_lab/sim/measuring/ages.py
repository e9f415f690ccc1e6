"""The age of the newest state report that a node has of each neighbour, as a mean over time. Times are virtual ns."""

from __future__ import annotations

import msgspec


class AgeRow(msgspec.Struct, frozen=True):
    """The mean age of the reports of one neighbour, over the ``seconds`` in which the node had one."""

    node: int
    neighbour: int
    seconds: float
    mean_ms: float


class _Pair:
    """The newest report: when it was received, and its age then; and the integrals so far."""

    __slots__ = ("age", "area", "known", "received", "time")

    def __init__(self) -> None:
        self.known = False
        self.received = self.age = self.time = self.area = 0


class Ages:
    """Integrates the ages. Call its methods in order of time."""

    def __init__(self, warm_up: int) -> None:
        """``warm_up``: start of the measurement."""
        self._warm_up = warm_up
        self._pairs: dict[tuple[int, int], _Pair] = {}

    def heard(self, now: int, node: int, neighbour: int, age: int) -> None:
        """Note that a node received a report whose content is ``age`` old."""
        pair = self._pairs.get((node, neighbour))
        if pair is None:
            pair = self._pairs[node, neighbour] = _Pair()
        self._settle(pair, now)
        pair.known, pair.received, pair.age = True, now, age

    def lost(self, now: int, node: int, neighbour: int | None = None) -> None:
        """Note that a node no longer has a report of a neighbour; None: of any."""
        for (each, other), pair in self._pairs.items():
            if each == node and neighbour in (None, other):
                self._settle(pair, now)
                pair.known = False

    def found(self, now: int) -> list[AgeRow]:
        """Return the mean ages up to now, sorted by node and neighbour."""
        rows = []
        for (node, neighbour), pair in sorted(self._pairs.items()):
            self._settle(pair, now)
            if pair.time:
                rows.append(AgeRow(node, neighbour, pair.time / 1e9, pair.area / pair.time / 1e6))
        return rows

    def _settle(self, pair: _Pair, now: int) -> None:
        """Integrate up to now; the report then counts as received now, at its present age."""
        if not pair.known:
            return
        begin = max(pair.received, self._warm_up)
        if now > begin:
            elapsed, age = now - begin, pair.age + begin - pair.received
            pair.time += elapsed
            pair.area += elapsed * age + elapsed * elapsed // 2
        pair.age += now - pair.received
        pair.received = now
