"""Recordings as MCAP files for ROS 2. Needs the extra ``ros2``; docs/mcap.md describes the messages."""

from __future__ import annotations

from .bag import BagReport, write_bag
from .definitions import DEFINITIONS

__all__ = ["DEFINITIONS", "BagReport", "write_bag"]
