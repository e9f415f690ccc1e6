"""Permitted variants: nodes that use one freedom of the specification each. The suite must not fail any of them."""

from .variant import Setup, Variant, all_variants, chosen

__all__ = ["Setup", "Variant", "all_variants", "chosen"]
