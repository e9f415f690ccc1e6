"""An independent model of the instructions that a node may, must and must not send about variables."""

from .knowledge import Complaint, Limits, Owed, Variable, Version
from .vardis import Oracle
from .waiting import Waiting

__all__ = ["Complaint", "Limits", "Oracle", "Owed", "Variable", "Version", "Waiting"]
