"""The news in the beacons of all nodes: records other than summaries that repeat the number which a node has stated."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_codec.analysis.ledger import News

from .statements import CREATE, DELETE, SUMMARY, UPDATE, Part, statement


class Numbers:
    """Finds the same news as the ledger, but without previous records, and keeps no states."""

    def __init__(self, most: int) -> None:
        """``most``: maximum number of pairs of node and variable that are followed."""
        self._most = most
        self._pairs = 0
        self._of: dict[bytes, tuple[int, dict[int, int]]] = {}
        """Node -> time since which no beacon is missing, and variable -> the sequence number that it stated last."""

    def feed_parts(
        self, frame: int, time: int, node: bytes, parts: Sequence[Part], unbroken: int
    ) -> tuple[Sequence[News], int]:
        """Process the VarDis records of the next beacon, as :meth:`Ledger.feed_parts` does."""
        since, numbers = self._of.get(node, (-1, {}))
        if since != unbroken:
            self._pairs -= len(numbers)
            numbers = {}
            self._of[node] = unbroken, numbers
        before, count = len(numbers), 0
        news: list[News] = []
        for kind, records, ids, stated, _ in parts:
            if kind is SUMMARY and [*map(numbers.get, ids)] == stated:
                count += len(ids)
                continue
            for index, var_id in enumerate(ids):
                if kind is SUMMARY and numbers.get(var_id) == stated[index]:
                    count += 1
                    continue
                news.append((statement(kind, records[index], frame, time, node), None, None))
                if kind is SUMMARY or kind is UPDATE or kind is CREATE:
                    if var_id in numbers or self._pairs < self._most:
                        numbers[var_id] = stated[index]
                elif kind is DELETE:
                    numbers.pop(var_id, None)
        self._pairs += len(numbers) - before
        return news, count
