"""Errors of the codec, with their details as data."""

from __future__ import annotations

from typing import Any, Literal

import msgspec
from dcp_spec.reasons import REASONS, WARNINGS, quantity


class Problem(msgspec.Struct, frozen=True):
    """One problem found in octets.

    ``path`` names the field with indices. ``offset`` is the octet where the field starts, counted from the caller's
    base; the command line counts from the start of the frame. ``needed`` and ``available`` are numbers of octets or,
    for reasons that compare numbers, the two numbers (see ``dcp_spec.reasons``). ``requirement`` is an id of the
    catalogue.
    """

    reason: str
    path: str
    offset: int
    needed: int | None = None
    available: int | None = None
    requirement: str | None = None
    severity: Literal["error", "warning"] = "error"

    def __str__(self) -> str:
        text = f"{self.path or 'beacon'} at octet {self.offset}: {self.reason}"
        if numbers := quantity(self.reason, self.needed, self.available):
            text += f" ({numbers})"
        meaning = REASONS.get(self.reason) or WARNINGS.get(self.reason)
        text += f": {meaning}" if meaning else ""
        return f"{text} [{self.requirement}]" if self.requirement else text

    def moved(self, by: int) -> Problem:
        """Return the same problem with ``by`` added to its offset."""
        return msgspec.structs.replace(self, offset=self.offset + by) if by else self


class CodecError(ValueError):
    """Base class of the codec's exceptions."""


class DecodeError(CodecError):
    """Octets are not a message of the profile. ``problem`` says where and why.

    ``partial`` is the part that was complete before the problem (a Beacon with its first payloads, the first
    containers), or None. The specification lets receivers use it in some cases (BP-RX-09, VD-RX-05 to VD-RX-07).
    ``indices`` are the numbers in ``problem.path``: the index in each list around the problem, the outermost list
    first.
    """

    def __init__(self, problem: Problem, partial: Any = None, indices: tuple[int, ...] = ()) -> None:
        super().__init__(problem, partial, indices)
        self.problem = problem
        self.partial = partial
        self.indices = indices

    def __str__(self) -> str:
        return str(self.problem)


class EncodeError(CodecError):
    """A value cannot be encoded in the profile. ``path`` names the field, ``why`` says what is wrong."""

    def __init__(self, path: str, why: str) -> None:
        super().__init__(path, why)
        self.path = path
        self.why = why

    def __str__(self) -> str:
        return f"{self.path or 'beacon'}: {self.why}"
