"""Measurements of a simulation: delay and reception of each value, and the share of nodes with the newest values."""

from .ages import AgeRow, Ages
from .consistency import Consistency, VariableConsistency
from .measurements import Measurements
from .reach import Reach, distances, longest_distance
from .values import DelayRow, Value, ValueLog, ValueTotals

__all__ = [
    "AgeRow",
    "Ages",
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
