"""Check recordings of networks against the specification, offline."""

from .judge import RULES, Judge

__all__ = ["RULES", "Judge"]
