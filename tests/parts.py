"""Parameters of tests that belong to another part than the test itself."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def also(part: str, *values: Any) -> list[Any]:
    """Parameters that only this part uses, after those that the part of the test uses, too.

    ``@parametrize("profile", ["dcp-2.0", *also("suite", "dcp-1.3", "dcp-1.0")])`` runs one profile in the core and two
    more in ``make test-suite``. A tuple has the values of several parameters.
    """
    return [
        pytest.param(*(each if isinstance(each, tuple) else (each,)), marks=pytest.mark.part(part)) for each in values
    ]


def every(step: int, values: Iterable[Any], part: str = "suite") -> list[Any]:
    """``values``, of which each ``step``-th belongs to the part of the test, and the others to ``part``."""
    # Parameters that have a mark keep it.
    return [
        each if number % step == 0 or hasattr(each, "marks") else also(part, each)[0]
        for number, each in enumerate(values)
    ]
