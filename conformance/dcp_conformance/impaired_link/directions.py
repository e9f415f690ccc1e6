"""The option ``--impair``: impairment of both directions, or of one."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from dcp_codec.impairment import PERFECT, Impairment, ImpairmentError, parse_impairment, text_of
from dcp_conformance.errors import UsageError


class Directions(NamedTuple):
    """The impairment of frames to the implementation, and of those from it."""

    to: Impairment = PERFECT
    back: Impairment = PERFECT

    def __str__(self) -> str:
        if self.to == self.back:
            return text_of(self.to)
        named = (("to", self.to), ("from", self.back))
        return "; ".join(f"{name}:{text_of(each)}" for name, each in named if not each.perfect)


def parse_directions(texts: Iterable[str]) -> Directions:
    """Parse values of ``--impair``: ``KEY=VALUE,...`` for both directions; the prefix ``to:`` or ``from:`` selects one.

    Raise :class:`UsageError` with the option, the key and the reason.
    """
    found: dict[str, Impairment] = {}
    for text in texts:
        prefix, colon, rest = text.partition(":")
        names = (prefix,) if colon and prefix in ("to", "from") else ("to", "from")
        try:
            impairment = parse_impairment(rest if len(names) == 1 else text)
        except ImpairmentError as error:
            raise UsageError(f"--impair {text}: {error}") from None
        for name in names:
            if name in found:
                raise UsageError(f"--impair {text}: the direction {name!r} was given before")
            found[name] = impairment
    return Directions(found.get("to", PERFECT), found.get("from", PERFECT))
