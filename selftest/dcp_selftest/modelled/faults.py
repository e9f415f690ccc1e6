"""Faulty nodes for the model alone: the mutants, and each cell of the state table with each other action."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec
from dcp_conformance.reference.inprocess import MakeNode, plain_node, reference_config

from dcp_codec.codec import Codec, get_codec
from dcp_selftest.mutants import all_mutants
from dcp_selftest.mutants.cells import Cells
from dcp_selftest.mutants.mutant import maker, node_with
from dcp_stack.config import NodeConfig
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

#: Faults that a trial of the suite by an adversary described: no case noticed most of them before there was a model.
DESCRIBED: Final = (
    "M-BP-HDR-08-sixteen-bits", "M-BP-REG-06-former-entries", "M-BP-MGT-04-clears-no-queue",
    "M-BP-RX-13-state-reports", "M-BP-TX-04-too-long-dropped", "M-BP-PTI-02-first-period", "M-BP-LST-01-first-time",
    "M-BP-MGT-04-any-length", "M-BP-RX-01-low-bits", "M-BP-QM-01-at-most-255", "M-BP-LST-01-cut-at-31",
    "M-SRP-RUN-02-timeout-of-reception", "M-SRP-TYP-05-first-stamp", "M-SRP-SEQ-01-sixteen-bits",
    "M-SRP-RX-05-last-three", "M-SRP-PAR-01-ten-seconds", "M-VD-CRE-11-scrubbed-deletion-left",
    "M-VD-DVA-03-no-count-delete", "M-VD-DDB-02-scrubbed-missing", "M-VD-PAR-01-long-description-mute",
    "M-VD-CRE-12-summary-first", "M-VD-CMP-10-deletes-stay", "M-VD-PAY-02-127-records", "M-VD-PAY-02-updates-wait",
    "M-VD-PC-08-pending-update-left", "M-VD-CRE-05-long-refused", "M-VD-PC-04-long-ignored",
    "M-VD-PC-05-long-description-ignored", "M-VD-ROB-01-faulty-sender-ignored", "M-VD-SCR-03-consumer-double",
)  # fmt: skip
_PROTOCOLS: Final = {"BP": "bp", "SRP": "srp", "VD": "vardis"}
#: Faults that only 65,536 steps show, since a counter wraps: too many for a sequence.
LONG: Final = frozenset({"M-BP-HDR-08-sixteen-bits", "M-SRP-SEQ-01-sixteen-bits"})


class Fault(msgspec.Struct, frozen=True):
    """One faulty node on one profile. Its ``id`` leads to it in any process."""

    id: str
    profile: str
    about: str = ""
    """The protocol whose themes a search draws: ``bp``, ``srp`` or ``vardis``; empty for all themes."""
    neighbours: int | None = None
    """Room of the neighbour table, as the profile states it; None: that of the node, which no sequence fills."""

    def config(self) -> NodeConfig:
        """Return the configuration of the node."""
        codec = get_codec(self.profile)
        if self.neighbours is not None:
            limits = msgspec.structs.replace(codec.profile.limits, max_neighbours=self.neighbours)
            codec = Codec(msgspec.structs.replace(codec.profile, limits=limits))
        return reference_config(codec)

    def make(self) -> MakeNode:
        """Return the constructor of the node."""
        if self.id.startswith("change "):
            return plain_node
        if not self.id.startswith("cell "):
            return all_mutants()[self.id].make
        _, event, state, action = self.id.split()
        cells = {(Event[event], State[state]): Cell(Action[action])}
        return maker(node_with(type("Changed", (Cells,), {"cells": cells})))


def mutants(chosen: tuple[str, ...] = ()) -> Iterator[Fault]:
    """Yield all mutants, each on its newest profile, or those of requirements or mutants with these beginnings."""
    for each in all_mutants().values():
        if not chosen or each.requirement.startswith(chosen) or each.id.startswith(chosen):
            yield Fault(each.id, each.profile)


def described() -> Iterator[Fault]:
    """Yield the faults of :data:`DESCRIBED`, for a search with the themes of their protocols."""
    for each in DESCRIBED:
        mutant = all_mutants()[each]
        yield Fault(each, mutant.profile, _PROTOCOLS[mutant.requirement.partition("-")[0]])


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
