"""An independent model of the instructions that a node may, must and must not send about variables."""

from .knowledge import Complaint, Limits, Obligation, Variable, Version
from .vardis import Oracle
from .waiting import Waiting

__all__ = ["Complaint", "Limits", "Obligation", "Oracle", "Variable", "Version", "Waiting"]
