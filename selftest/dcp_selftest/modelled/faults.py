"""Faulty nodes for the model alone: the mutants, and each cell of the state table with each other action."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec
from dcp_conformance.reference.inprocess import MakeNode, reference_config

from dcp_codec.codec import get_codec
from dcp_selftest.mutants import all_mutants
from dcp_selftest.mutants.cells import Cells
from dcp_selftest.mutants.mutant import maker, node_with
from dcp_stack.vardis.state_table import Action, Cell, Event, State, table

#: By the beginning of the name of an event: the actions that a record of its kind can have.
_ACTIONS: Final = {
    "RX_UPDATE": (
        Action.IGNORE, Action.STORE, Action.TEACH, Action.SEND_UPDATE, Action.SEND_CREATE, Action.REQUEST_UPDATE,
        Action.REQUEST_CREATE,
    ),
    "RX_SUMMARY": (
        Action.IGNORE, Action.TEACH, Action.SEND_CREATE, Action.REQUEST_UPDATE, Action.REQUEST_CREATE,
    ),
    "RX_REQUEST": (
        Action.IGNORE, Action.SEND_UPDATE, Action.SEND_CREATE, Action.REQUEST_UPDATE, Action.REQUEST_CREATE,
    ),
    "RX_DELETE": (Action.IGNORE, Action.DELETE),
    "RX_CREATE": (Action.IGNORE, Action.ADOPT),
    "TIMED_OUT": (Action.NONE, Action.DELETE),
}  # fmt: skip
#: Events that need a stored variable, or, before 2.0, cannot occur.
_OF_KNOWN: Final = frozenset({
    Event.RX_CREATE_NOT_LATER, Event.RX_DELETE, Event.RX_UPDATE_EQUAL, Event.RX_UPDATE_OLDER, Event.RX_SUMMARY_EQUAL,
    Event.RX_SUMMARY_OLDER, Event.RX_REQUEST_UPDATE_BEHIND, Event.TIMED_OUT,
})  # fmt: skip
_WITHOUT_TIMES: Final = frozenset({Event.TIMED_OUT, Event.RX_CREATE_LATER})


class Fault(msgspec.Struct, frozen=True):
    """One faulty node on one profile. Its ``id`` leads to it in any process."""

    id: str
    profile: str

    def make(self) -> MakeNode:
        """Return the constructor of the node."""
        if not self.id.startswith("cell "):
            return all_mutants()[self.id].make
        _, event, state, action = self.id.split()
        cells = {(Event[event], State[state]): Cell(Action[action])}
        return maker(node_with(type("Changed", (Cells,), {"cells": cells})))


def mutants(requirements: tuple[str, ...] = ()) -> Iterator[Fault]:
    """Yield all mutants, each on its newest profile, or those of ``requirements`` (beginnings of identifiers)."""
    for each in all_mutants().values():
        if not requirements or each.requirement.startswith(requirements):
            yield Fault(each.id, each.profile)


def cells(profile: str) -> Iterator[Fault]:
    """Yield each received record or timeout in each state with each other action that differs from outside."""
    config = reference_config(get_codec(profile))
    timed = config.features.creation_time
    for event, row in table(config).items():
        actions = next((found for begin, found in _ACTIONS.items() if event.name.startswith(begin)), ())
        if event is Event.RX_CREATE_MISMATCH or (not timed and event is Event.TIMED_OUT):
            continue
        for state in State:
            if state is State.UNKNOWN and event in _OF_KNOWN:
                continue
            if state is not State.UNKNOWN and not timed and event in _WITHOUT_TIMES:
                continue
            for action in actions:
                # Nothing is stored that could be sent or deleted.
                absent = state is State.UNKNOWN and action not in (Action.IGNORE, Action.REQUEST_CREATE, Action.ADOPT)
                # It is answered in both cases; only the queue differs.
                alike = {action, row[state].action} == {Action.TEACH, Action.SEND_UPDATE}
                if action is not row[state].action and not absent and not alike:
                    yield Fault(f"cell {event.name} {state.name} {action.name}", profile)
