"""Mutants and variants as implementations of ``dcp-conformance interop``: entry points ``dcp_conformance.nodes``."""

from __future__ import annotations

from dcp_conformance.errors import UsageError
from dcp_conformance.reference.surroundings import Setup
from dcp_lab.interop.implementations import OfferedNode

from .mutants.mutant import ALL_MUTANTS
from .variants.variant import ALL_VARIANTS, setup


def mutant(identifier: str) -> OfferedNode:
    """Return a mutant. Raises ``UsageError`` for an unknown identifier."""
    found = ALL_MUTANTS.get(identifier)
    made = found.make
    return OfferedNode(
        found.what, found.profile, lambda profile: setup(profile, make=made), ("dcp_selftest.mutants", identifier)
    )


def variant(identifier: str) -> OfferedNode:
    """Return a permitted variant. Raises ``UsageError`` for an unknown identifier."""
    found = ALL_VARIANTS.get(identifier)

    def build(profile: str) -> Setup:
        if not found.applies_to(profile):
            raise UsageError(f"{identifier} does not exist in {profile}")
        return found.build(profile)

    return OfferedNode(found.what, "dcp-2.0", build)
