"""How long each case takes at our node, and the smoke plan, which was chosen by that (``data/case-times.json``)."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import msgspec

FILE: Final = "case-times.json"
_ABOUT: Final = "Made by `dcp-selftest smoke-plan`; do not edit."
#: Seconds that a case takes which is too new to have been measured.
_USUAL: Final = 1.0


class Times(msgspec.Struct, frozen=True, kw_only=True):
    """The content of ``case-times.json``."""

    about: str = _ABOUT
    smoke: dict[str, int]
    """The cases of the smoke plan, in their order, each with the number of faults that no earlier one notices."""
    seconds: dict[str, float]
    """By case: how long it takes at our node with a beacon every 100 ms, one case after the other. Cases that are not
    applicable to our node are not here."""

    def of(self, case: str) -> float:
        """Seconds that a case takes, or the usual time of a case that was not measured."""
        return self.seconds.get(case, _USUAL)


@cache
def load() -> Times:
    """The times that come with this version. Without the file, none are known."""
    return msgspec.json.decode(files("dcp_conformance").joinpath("data", FILE).read_bytes(), type=Times)


def encode(times: Times) -> bytes:
    """The octets of the file, one case in a line: the same for the same times."""
    text = msgspec.json.format(msgspec.json.encode(times), indent=1)
    return text + b"\n"
