"""The properties of an exploration: of one step, and of the network after rounds without losses."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from .cores import Cores, Held, Value

#: The violations of properties, by their names.
PROPERTIES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "older-value": "A node replaces a value by an older one",
        "taken-over": "A node loses its variable to another producer",
        "repetitions": "A record is sent more often than repCnt",
        "stale": "After lossless rounds a node has an older value than the producer",
        "stale-creation": "After lossless rounds a node has a value of an earlier creation",
        "missing": "After lossless rounds a node lacks a variable that its producer has",
        "deleted": "After lossless rounds a node has marked a variable as deleted that its producer has",
        "undeleted": "After lossless rounds a node has a variable that its producer has deleted",
        "spread": "In lossless rounds a deleted variable reaches a node that does not have it, and stays",
        "orphaned": "After lossless rounds nodes have a variable that its producer has lost by a restart",
        "split": "After lossless rounds nodes have variables of two producers under one identifier",
        "unstable": "In lossless rounds the values of nodes change for ever",
        "no-answer": "Nodes request a variable for ever that no node has",
        "refused": "A node requests a variable for ever and ignores the answers",
    }
)


class Intent(NamedTuple):
    """State of the latest creation at its producer, according to the applications.

    ``state``: none, alive, deleted, or lost (the producer has restarted). ``owner``: the node of the producer.
    """

    state: str = "none"
    value: Value = (0, 0)
    owner: int = 0

    def updated(self, value: Value | None) -> Intent:
        """Return the state after an update to ``value``, which may be one of an earlier creation; None: refused."""
        if value is None or self.state not in ("alive", "lost") or value[0] != self.value[0]:
            return self
        return Intent("alive", value, self.owner)

    def deleted(self, value: Value) -> Intent:
        """Return the state after a deletion of a variable with ``value`` by its producer."""
        return self._replace(state="deleted") if value[0] == self.value[0] else self

    def restarted(self, node: int) -> Intent:
        """Return the state after a restart of a node."""
        return self._replace(state="lost") if self.state == "alive" and node == self.owner else self

    def regained(self, held: Held, node_id: bytes) -> Intent:
        """Return the state if the restarted producer ``node_id`` has the variable again."""
        regained = self.state == "lost" and held.state == "alive" and held.producer == node_id
        return Intent("alive", held.value, self.owner) if regained else self


class End(NamedTuple):
    """The states that lossless rounds lead to: what nodes have in them (None: it changes from round to round).

    ``requested``: the number of rounds up to the last request, None if requests never end. ``rounds``: those before the
    states repeat, ``period``: those until they repeat. ``contents``: one of these states.
    """

    held: tuple[Held, ...] | None
    requested: int | None
    rounds: int
    period: int
    contents: tuple[int, ...]


class Judge:
    """Judges steps, and the states that lossless rounds lead to. In a round each node sends one beacon, in order."""

    def __init__(self, cores: Cores) -> None:
        self._cores = cores
        self._roles = [min(node, cores.space.producers) for node in range(cores.space.nodes)]
        self._rounds: dict[tuple[int, ...], tuple[tuple[int, ...], bool]] = {}
        self._ends: dict[tuple[int, ...], End] = {}
        self._settled: dict[tuple[tuple[int, ...], Intent], tuple[str, ...]] = {}
        self.longest_request = 0

    def heard(self, role: int, before: int, after: int) -> list[str]:
        """Return the properties that a received payload violates at a node."""
        was, now = self._cores.held[before], self._cores.held[after]
        if was.state != "alive" or now.state != "alive":
            return []
        found = ["older-value"] if now.value < was.value else []
        own = self._cores.ids[role]
        if role < self._cores.space.producers and was.producer == own != now.producer:
            found.append("taken-over")
        return found

    def settled(self, contents: tuple[int, ...], intent: Intent) -> tuple[str, ...]:
        """Return the properties that are violated after lossless rounds from these contents."""
        key = (contents, intent)
        if (found := self._settled.get(key)) is None:
            found = self._settled[key] = tuple(sorted(self._violated(contents, intent)))
        return found

    def _violated(self, contents: tuple[int, ...], intent: Intent) -> set[str]:
        end = self.end(contents)
        if end.held is None:
            return {"unstable"}
        alive = any(each.state == "alive" for each in end.held)
        found = set()
        if end.requested is None or end.requested > self._cores.space.rounds:
            found.add("refused" if alive else "no-answer")
        if intent.state != "alive":
            end = self._after_timeouts(end)
        if end.held is None:
            return found | {"unstable"}
        owner = self._cores.ids[self._roles[intent.owner]]
        intent = intent.regained(end.held[intent.owner], owner)
        united = intent.state != "alive" and len(set(end.held)) == 1
        for content, held in zip(contents, end.held, strict=True):
            if held.state == "alive" and held.producer != owner:
                found.add("" if united else "split")
            elif intent.state == "alive":
                found.add(_difference(held, intent.value))
            elif held.state == "alive" and intent.state == "lost":
                found.add("orphaned")
            elif held.state == "alive":
                found.add("undeleted")
                if self._cores.held[content].state != "alive":
                    found.add("spread")
        return found - {""}

    def _after_timeouts(self, end: End) -> End:
        """Return the states after the timeout of a variable without further updates, if it has one."""
        contents = end.contents
        for _ in range(2 if self._cores.space.silences else 0):
            contents = tuple(self._cores.wait(role, each) for role, each in zip(self._roles, contents, strict=True))
        return self.end(contents)

    def end(self, contents: tuple[int, ...]) -> End:
        """Return the states that lossless rounds lead to."""
        path: list[tuple[int, ...]] = []
        places: dict[tuple[int, ...], int] = {}
        while contents not in places and contents not in self._ends:
            places[contents] = len(path)
            path.append(contents)
            contents, _ = self.round(contents)
        if contents not in self._ends:
            cycle = path[places[contents] :]
            held = {tuple(map(self._cores.held.__getitem__, each)) for each in cycle}
            requests = any(self._rounds[each][1] for each in cycle)
            end = End(held.pop() if len(held) == 1 else None, None if requests else 0, 0, len(cycle), cycle[0])
            self._ends |= dict.fromkeys(cycle, end)
            path = path[: places[contents]]
        for each in reversed(path):
            after, requests = self._rounds[each]
            found, requested, rounds, period, last = self._ends[after]
            if requested is not None:
                requested = requested + 1 if requested or requests else 0
                self.longest_request = max(self.longest_request, requested)
            self._ends[each] = End(found, requested, rounds + 1, period, last)
            contents = each
        return self._ends[contents]

    def round(self, contents: tuple[int, ...]) -> tuple[tuple[int, ...], bool]:
        """Return the contents after one lossless round, and whether a request was sent in it."""
        if (found := self._rounds.get(contents)) is None:
            cores, nodes, requests = self._cores, list(contents), False
            wall = cores.wall(0, False)
            for node, role in enumerate(self._roles):
                nodes[node], payload, _ = cores.send(role, nodes[node])
                if payload >= 0:
                    requests = requests or cores.requests[payload]
                    for other, hearer in enumerate(self._roles):
                        if other != node:
                            nodes[other] = cores.hear(hearer, nodes[other], payload, wall)
            found = self._rounds[contents] = (tuple(nodes), requests)
        return found


def _difference(held: Held, value: Value) -> str:
    """Return the property that is violated by a node whose variable is not the one of its producer."""
    if held.state == "unknown":
        return "missing"
    if held.state == "deleted":
        return "deleted"
    if held.value == value:
        return ""
    return "stale" if held.value[0] == value[0] else "stale-creation"
