"""Errors of the start of a node."""

from __future__ import annotations


class NodeError(Exception):
    """The node cannot be started; the message names the cause."""
