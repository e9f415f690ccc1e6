"""Positions: what safety data says about place and motion, the geometry of it, and where a node gets its own from."""

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
