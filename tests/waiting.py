"""Waiting for what happens in other processes, for as long as a busy machine may take."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import pytest

T = TypeVar("T")
#: Seconds after which a test gives up. Nothing takes that long, not even on a busy machine: it only ends a test that
#: would hang.
PATIENCE = 300.0


def eventually(look: Callable[[], T], what: str, pause: float = 0.02) -> T:
    """Call ``look`` until what it returns is true, and return that; ``pause`` is in s.

    Fails the test after ``PATIENCE`` s; ``what`` says then what has not happened.
    """
    deadline = time.monotonic() + PATIENCE
    while not (found := look()):
        if time.monotonic() > deadline:
            pytest.fail(f"not within {PATIENCE:g} s: {what}")
        time.sleep(pause)
    return found
