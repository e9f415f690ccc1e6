"""The selection of instructions for the additional container types of a profile."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from .core import Core
from .instructions import Instruction

#: Instructions of this code base; add new ones here.
INSTRUCTIONS: Final[tuple[type[Instruction], ...]] = ()


def instructions_of(core: Core) -> Iterator[Instruction]:
    """Yield an instruction for each additional container of the profile that has one, in the order of the profile.

    An instruction of the configuration replaces one of this code base for the same container.
    """
    configured: Any = core.config.instructions
    available: tuple[type[Instruction], ...] = (*INSTRUCTIONS, *configured)
    known = {each.container: each for each in available}
    for layout in core.config.profile.vardis.own_containers:
        if layout.name in known:
            yield known[layout.name](core)
