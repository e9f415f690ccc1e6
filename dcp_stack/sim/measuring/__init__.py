"""What a simulation measures: where each value went and how long it took, and who has the newest."""

from .consistency import Consistency, VariableConsistency
from .measurements import Measurements
from .reach import Reach, distances, longest_distance
from .values import DelayRow, Value, ValueLog, ValueTotals

__all__ = [
    "Consistency",
    "DelayRow",
    "Measurements",
    "Reach",
    "Value",
    "ValueLog",
    "ValueTotals",
    "VariableConsistency",
    "distances",
    "longest_distance",
]
