"""Permitted variants: nodes that use one freedom of the specification each. The suite must not fail any of them."""

from .variant import ALL_VARIANTS, Variant, all_variants

__all__ = ["ALL_VARIANTS", "Variant", "all_variants"]
