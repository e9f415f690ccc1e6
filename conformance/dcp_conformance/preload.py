"""What every lane needs, imported once: lanes are forked from a process that has this module (:mod:`.lanes`)."""

from __future__ import annotations

from . import plugin
from .case import all_cases
from .reference import process

__all__ = ["plugin", "process"]

all_cases()
