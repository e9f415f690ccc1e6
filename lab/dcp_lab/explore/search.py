"""Breadth-first search over the states of a network. Equal states are visited once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import combinations
from typing import Final, NamedTuple

import msgspec

from .cores import Cores
from .properties import Intent, Judge
from .space import KINDS, Space

_INDEX: Final = {kind: number for number, kind in enumerate(KINDS)}
#: States between two calls of the function that reports progress.
_EVERY: Final = 2048


class Step(NamedTuple):
    """One event: a service of ``node``, a beacon of it that ``hearers`` receive, or a change of the network.

    ``kind``: ``create``, ``update``, ``delete``, ``restart``, ``clock``, ``beacon``, ``silence``, ``partition`` or
    ``heal``. ``hearers`` of a partition are the nodes of its second group.
    """

    kind: str
    node: int = 0
    hearers: tuple[int, ...] = ()


class State(NamedTuple):
    """A state of the network. Nodes without a role as producer are in the order of their contents.

    ``used``: events so far, by the position of their kind in :data:`KINDS`. ``creators``, ``ahead`` and ``group`` have
    a bit for each node: it has created the variable, its clock is ahead, it is in the second group of a partition.
    """

    contents: tuple[int, ...]
    intent: Intent
    used: tuple[int, ...]
    creators: int = 0
    ahead: int = 0
    group: int = 0


class Violation(msgspec.Struct, frozen=True):
    """A violated property, with the kinds of events that are its cause, and its first sequence of steps.

    ``order``: for each node of the steps the node of the network; see :meth:`Search.steps`.
    """

    name: str
    kinds: frozenset[str]
    steps: tuple[Step, ...]


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an exploration. ``seconds``: CPU time. ``calls``: steps executed by real cores.

    ``complete``: all states of the space were visited. ``longest_request``: rounds until the last request ends, of all
    states in which requests end.
    """

    space: Space
    states: int
    transitions: int
    depth: int
    calls: int
    seconds: float
    complete: bool
    longest_request: int
    violations: tuple[Violation, ...]


class Search:
    """An exploration of a space. ``states`` are numbered in the order of their discovery."""

    def __init__(self, space: Space) -> None:
        """Raises ValueError for a space whose nodes cannot be created."""
        self.space = space
        self.cores = Cores(space)
        self.judge = Judge(self.cores)
        self.roles = [min(node, space.producers) for node in range(space.nodes)]
        contents = tuple(self.cores.fresh[role] for role in self.roles)
        self.states = [State(contents, Intent(), (0,) * len(KINDS))]
        self.parents: list[tuple[int, Step]] = [(0, Step(""))]
        self.depths = [0]
        self.transitions = 0
        self.complete = False
        self._first: dict[str, dict[frozenset[str], tuple[int, Step | None]]] = {}
        self._subsets: dict[tuple[int, ...], list[tuple[int, ...]]] = {}

    # -- searching -----------------------------------------------------------------------------------------------------

    def run(self, progress: Callable[[Search], None] | None = None) -> Result:
        """Visit all states, or those until an interruption (Ctrl-C) or ``max_states``.

        ``progress`` is called now and then.
        """
        begun = time.process_time()
        numbers = {self.states[0]: 0}
        number = 0
        try:
            while number < len(self.states) <= self.space.max_states:
                self._visit(number, numbers)
                number += 1
                if progress is not None and number % _EVERY == 0:
                    progress(self)
            self.complete = number == len(self.states)
        except KeyboardInterrupt:
            pass
        return Result(
            space=self.space,
            states=len(self.states),
            transitions=self.transitions,
            depth=self.depths[-1],
            calls=self.cores.calls,
            seconds=time.process_time() - begun,
            complete=self.complete,
            longest_request=self.judge.longest_request,
            violations=self.violations(),
        )

    def _visit(self, number: int, numbers: dict[State, int]) -> None:
        """Execute all steps that are possible in a state."""
        state = self.states[number]
        for step in self.possible(state):
            found = self.after(state, step)
            if found is None:
                continue
            after, broken = found
            self.transitions += 1
            for name in broken:
                self._note(name, after, number, step)
            after, _ = self.ordered(after)
            new = len(self.states)
            if numbers.setdefault(after, new) == new:
                self.states.append(after)
                self.parents.append((number, step))
                self.depths.append(self.depths[number] + 1)
                for name in self.judge.settled(after.contents, after.intent):
                    self._note(name, after, new, None)

    def _note(self, name: str, state: State, number: int, step: Step | None) -> None:
        """Note a violation, unless one of the same property with fewer kinds of events is known."""
        kinds = frozenset(kind for kind, count in zip(KINDS, state.used, strict=True) if count)
        known = self._first.setdefault(name, {})
        if not any(other <= kinds for other in known):
            for other in [other for other in known if other > kinds]:
                del known[other]
            known[kinds] = (number, step)

    def violations(self) -> tuple[Violation, ...]:
        """Return the violations found so far: for each property and cause the first one."""
        found = [
            Violation(name, kinds, self.steps(number, step))
            for name, causes in self._first.items()
            for kinds, (number, step) in causes.items()
        ]
        return tuple(sorted(found, key=lambda each: (len(each.steps), each.name, sorted(each.kinds))))

    # -- steps ---------------------------------------------------------------------------------------------------------

    def possible(self, state: State) -> Iterator[Step]:
        """Yield the steps that the space permits in a state; nodes may refuse some of them."""
        space, used = self.space, dict(zip(KINDS, state.used, strict=True))
        producers = range(space.producers)
        if used["create"] + used["again"] + used["other"] < space.creations:
            yield from (Step("create", node) for node in producers)
        if used["update"] < space.updates:
            yield from (Step("update", node) for node in producers)
        if used["delete"] < space.deletions:
            yield from (Step("delete", node) for node in producers)
        if used["restart"] < space.restarts:
            yield from (Step("restart", node) for node in range(space.nodes))
        if used["clock"] < space.clock_steps:
            yield from (Step("clock", node) for node in producers)
        if used["silence"] < space.silences:
            yield Step("silence")
        if state.group:
            yield Step("heal")
        elif used["partition"] < space.partitions:
            for mask in range(2, 1 << space.nodes, 2):
                yield Step("partition", 0, tuple(node for node in range(space.nodes) if mask >> node & 1))
        for node in range(space.nodes):
            sets = self._hearers(node, state.group)
            for hearers in sets:
                if space.losses is None or used["loss"] + len(sets[0]) - len(hearers) <= space.losses:
                    yield Step("beacon", node, hearers)

    def _hearers(self, node: int, group: int) -> list[tuple[int, ...]]:
        """Return the sets of nodes that may hear a node: subsets of its group, the largest first."""
        key = (node, group)
        if key not in self._subsets:
            others = [each for each in range(self.space.nodes) if each != node and self._same(each, node, group)]
            self._subsets[key] = [each for size in range(len(others), -1, -1) for each in combinations(others, size)]
        return self._subsets[key]

    @staticmethod
    def _same(one: int, other: int, group: int) -> bool:
        return not (group >> one ^ group >> other) & 1

    def after(self, state: State, step: Step) -> tuple[State, tuple[str, ...]] | None:
        """Return the state after a step, nodes in the same order, and the properties that the step violates.

        None if a node refuses the service or the step has no effect.
        """
        if step.kind == "beacon":
            return self._beacon(state, step)
        node, cores = step.node, self.cores
        role, content, intent = self.roles[node], state.contents[node], state.intent
        contents: int | None = content
        kind = step.kind
        if kind == "create":
            number = sum(state.used[:3]) + 1
            wall = cores.wall(number, bool(state.ahead >> node & 1))
            contents = cores.create(role, content, (number, 0), wall)
            kind = "again" if state.creators >> node & 1 else "other" if state.creators else "create"
            state = state._replace(creators=state.creators | 1 << node)
            intent = Intent("alive", (number, 0), node)
        elif kind == "update":
            contents = cores.update(role, content)
            intent = intent.updated(None if contents is None else cores.held[contents].value)
        elif kind == "delete":
            contents = cores.delete(role, content)
            intent = intent.deleted(cores.held[content].value)
        elif kind == "restart":
            if content == cores.fresh[role]:
                return None
            contents = cores.fresh[role]
            intent = intent.restarted(node)
        elif kind == "clock":
            state = state._replace(ahead=state.ahead ^ 1 << node)
        elif kind == "silence":
            return self._silence(state)
        else:
            state = state._replace(group=sum(1 << each for each in step.hearers))
        if contents is None:
            return None
        new = (*state.contents[:node], contents, *state.contents[node + 1 :])
        used = state.used if kind == "heal" else _counted(state.used, kind)
        return state._replace(contents=new, intent=intent, used=used), ()

    def _beacon(self, state: State, step: Step) -> tuple[State, tuple[str, ...]] | None:
        """Return the state after a beacon, and the properties that it violates."""
        node, cores, roles = step.node, self.cores, self.roles
        sent, payload, miscounted = cores.send(roles[node], state.contents[node])
        if payload < 0:
            return None
        contents = list(state.contents)
        contents[node] = sent
        broken = ["repetitions"] if miscounted else []
        wall = sum(state.used[:3])
        for hearer in step.hearers:
            before = contents[hearer]
            ahead = bool(state.ahead >> hearer & 1)
            contents[hearer] = after = cores.hear(roles[hearer], before, payload, cores.wall(wall, ahead))
            if after != before:
                broken += self.judge.heard(roles[hearer], before, after)
        used = state.used
        if lost := len(self._hearers(node, state.group)[0]) - len(step.hearers):
            # Without a limit the state notes only that there was a loss.
            used = (*used[:-1], 1 if self.space.losses is None else used[-1] + lost)
        return state._replace(contents=tuple(contents), used=used), tuple(broken)

    def _silence(self, state: State) -> tuple[State, tuple[str, ...]] | None:
        """Return the state after a silence: nodes delete what has timed out."""
        contents = tuple(self.cores.wait(role, each) for role, each in zip(self.roles, state.contents, strict=True))
        if contents == state.contents:
            return None
        intent = state.intent
        if intent.state == "alive" and self.cores.held[contents[intent.owner]].state == "deleted":
            intent = intent.deleted(self.cores.held[contents[intent.owner]].value)
        return state._replace(contents=contents, intent=intent, used=_counted(state.used, "silence")), ()

    # -- symmetry and sequences ----------------------------------------------------------------------------------------

    def ordered(self, state: State) -> tuple[State, list[int]]:
        """Return the state with the exchangeable nodes in order, and the previous position of each node."""
        first, group = self.space.producers, state.group
        order = list(range(self.space.nodes))
        order[first:] = sorted(order[first:], key=lambda each: (state.contents[each], group >> each & 1))
        if order == sorted(order):
            return state, order
        moved = sum((group >> each & 1) << place for place, each in enumerate(order))
        return state._replace(contents=tuple(state.contents[each] for each in order), group=moved), order

    def steps(self, number: int, last: Step | None = None) -> tuple[Step, ...]:
        """Return the first sequence of steps to a state, and the step ``last`` after it.

        Nodes have the numbers that they have in the last state.
        """
        path: list[Step] = [] if last is None else [last]
        while number:
            number, step = self.parents[number]
            path.append(step)
        state = self.states[0]
        # For each place in the current state the node, numbered as in the initial state.
        nodes = list(range(self.space.nodes))
        found: list[Step] = []
        for place, step in enumerate(reversed(path)):
            found.append(_renamed(step, nodes))
            after = self.after(state, step)
            assert after is not None
            if place == len(path) - 1 and last is not None:
                break
            state, order = self.ordered(after[0])
            nodes = [nodes[each] for each in order]
        last_place = {node: place for place, node in enumerate(nodes)}
        return tuple(_renamed(step, last_place) for step in found)


def _renamed(step: Step, nodes: list[int] | dict[int, int]) -> Step:
    """Return a step with other numbers of the nodes."""
    return Step(step.kind, nodes[step.node], tuple(sorted(nodes[each] for each in step.hearers)))


def _counted(used: tuple[int, ...], kind: str) -> tuple[int, ...]:
    """Return the numbers of events with one more of a kind."""
    place = _INDEX[kind]
    return (*used[:place], used[place] + 1, *used[place + 1 :])
