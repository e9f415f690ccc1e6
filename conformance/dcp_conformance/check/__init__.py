"""Judging recordings of networks without touching them."""

from .judge import RULES, Judge

__all__ = ["RULES", "Judge"]
