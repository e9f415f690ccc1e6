"""The instructions that a node has for container types of its profile's own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from .core import Core
from .instructions import Instruction

#: Those of this code base; a new one is added here.
INSTRUCTIONS: Final[tuple[type[Instruction], ...]] = ()


def instructions_of(core: Core) -> Iterator[Instruction]:
    """The instructions that the profile of a node has containers for, in the order of the profile.

    An instruction of the configuration replaces one of this code base for the same container.
    """
    configured: Any = core.config.instructions
    available: tuple[type[Instruction], ...] = (*INSTRUCTIONS, *configured)
    known = {each.container: each for each in available}
    for layout in core.config.profile.vardis.own_containers:
        if layout.name in known:
            yield known[layout.name](core)
