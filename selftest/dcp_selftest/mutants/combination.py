"""Several mutants in one node."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_conformance.reference.inprocess import MakeNode

from .mutant import Mutant, maker, node_with, part_of


def combined(mutants: Sequence[Mutant]) -> MakeNode:
    """Make nodes with the faults of all ``mutants``. Raises ``ValueError`` for a mutant that does not change a node."""
    changed: dict[type, type] = {}
    for mutant in mutants:
        if mutant.part is None:
            raise ValueError(f"{mutant.id} cannot be combined with others")
        part = part_of(mutant.part)
        before = changed.get(part)
        changed[part] = mutant.part if before is None else type(part.__name__, (mutant.part, before), {})
    return maker(node_with(*changed.values()))
