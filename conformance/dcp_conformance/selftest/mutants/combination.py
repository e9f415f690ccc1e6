"""Several mutants in one node."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_conformance.reference.inprocess import MakeNode
from dcp_stack.node import Node

from .mutant import _PLACES, Mutant, maker


def combined(mutants: Sequence[Mutant]) -> MakeNode:
    """Make nodes with the faults of all ``mutants``. Raises ``ValueError`` for a mutant that is no part of a node."""
    changed: dict[type, type] = {}
    for mutant in mutants:
        if mutant.part is None:
            raise ValueError(f"{mutant.id} cannot be combined with others")
        base = next((base for base, _, _ in _PLACES if issubclass(mutant.part, base)), Node)
        before = changed.get(base)
        changed[base] = mutant.part if before is None else type(base.__name__, (mutant.part, before), {})
    for base, owner, name in _PLACES:
        if base in changed:
            changed[owner] = type(owner.__name__, (changed.get(owner, owner),), {name: changed[base]})
    return maker(changed[Node])
