"""An independent model of what a node may, must and must not say of variables."""

from .knowledge import Complaint, Limits, Owed, Variable, Version
from .vardis import Oracle
from .waiting import Waiting

__all__ = ["Complaint", "Limits", "Oracle", "Owed", "Variable", "Version", "Waiting"]
