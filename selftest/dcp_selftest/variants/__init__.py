"""Permitted variants: nodes that use one freedom of the specification each. The suite must not fail any of them."""

from .variant import Variant, all_variants, chosen

__all__ = ["Variant", "all_variants", "chosen"]
