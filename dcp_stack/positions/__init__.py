"""Positions: access to the safety data of a profile, geometry of moving points, and sources of a node's position."""

from .base import PositionSource, SourceError
from .fields import FieldError, SafetyFields
from .geometry import Approach, Motion, Vector, closest_approach
from .opening import SOURCES, open_source

__all__ = [
    "SOURCES",
    "Approach",
    "FieldError",
    "Motion",
    "PositionSource",
    "SafetyFields",
    "SourceError",
    "Vector",
    "closest_approach",
    "open_source",
]
