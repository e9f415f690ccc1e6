"""An independent model of what a node may, must and must not say of variables."""

from .vardis import Limits, Oracle, Owed, Variable

__all__ = ["Limits", "Oracle", "Owed", "Variable"]
