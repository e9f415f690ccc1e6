"""Errors of the codec, as data."""

from __future__ import annotations

from typing import Any, Literal

import msgspec
from dcp_spec.reasons import REASONS, WARNINGS, quantity


class Problem(msgspec.Struct, frozen=True):
    """One thing that is wrong with octets.

    ``path`` names the field with indices, ``offset`` is the octet where it starts (counted as the caller asked, in
    the command line tool from the start of the frame), ``needed`` and ``available`` are octets or, for reasons that
    compare numbers, the two numbers (see ``dcp_spec.reasons``), ``requirement`` is an id of the catalogue.
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
        """The same problem with its offset counted from ``by`` octets earlier."""
        return msgspec.structs.replace(self, offset=self.offset + by) if by else self


class CodecError(ValueError):
    """Base of what the codec raises."""


class DecodeError(CodecError):
    """Octets are not a message of the profile. ``problem`` says where and why.

    ``partial`` is what was complete before the problem (a Beacon with its first payloads, the first containers), or
    None; the specification lets receivers use it in some cases (BP-RX-09, VD-RX-05 to VD-RX-07). ``indices`` are the
    numbers in ``problem.path``: the element of each list that the problem lies in, the outermost list first.
    """

    def __init__(self, problem: Problem, partial: Any = None, indices: tuple[int, ...] = ()) -> None:
        super().__init__(problem, partial, indices)
        self.problem = problem
        self.partial = partial
        self.indices = indices

    def __str__(self) -> str:
        return str(self.problem)


class EncodeError(CodecError):
    """A value cannot be put on the wire in the profile. ``path`` names the field, ``why`` says what is wrong."""

    def __init__(self, path: str, why: str) -> None:
        super().__init__(path, why)
        self.path = path
        self.why = why

    def __str__(self) -> str:
        return f"{self.path or 'beacon'}: {self.why}"
