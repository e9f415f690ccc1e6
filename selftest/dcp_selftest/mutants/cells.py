"""VarDis with changed cells in its table of events and states (C.5)."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_stack.vardis.core import Core
from dcp_stack.vardis.state_table import Action, Cell, Event, State

UNKNOWN, PRODUCED, CONSUMED = State.UNKNOWN, State.ALIVE_PRODUCER, State.ALIVE_CONSUMER
DELETED_OWN, DELETED = State.DELETED_PRODUCER, State.DELETED_CONSUMER


class Cells(Core):
    """Changes cells of the table."""

    cells: ClassVar[dict[tuple[Event, State], Cell]] = {}

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        for (event, state), cell in self.cells.items():
            row = list(self._table[event])
            row[state] = cell
            self._table[event] = (row[0], row[1], row[2], row[3], row[4])


def everywhere(event: Event, action: Action) -> dict[tuple[Event, State], Cell]:
    """Return cells with one action in all states."""
    return {(event, state): Cell(action) for state in State}


def within(states: tuple[State, ...], action: Action, *events: Event) -> dict[tuple[Event, State], Cell]:
    """Return cells with one action for some events in some states."""
    return {(event, state): Cell(action) for event in events for state in states}
