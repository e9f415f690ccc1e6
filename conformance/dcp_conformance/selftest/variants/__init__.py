"""Permitted nodes: our node with one freedom of the specification used; the suite must not fail any of them."""

from .variant import Setup, Variant, all_variants, chosen

__all__ = ["Setup", "Variant", "all_variants", "chosen"]
