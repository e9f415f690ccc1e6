"""What nodes say of variables, in a form that can be remembered for long."""

from __future__ import annotations

from typing import Any, NamedTuple

from dcp_spec.constants import ICType

from dcp_conformance.heard import Heard, var_id_of


class Said(NamedTuple):
    """A record of a VarDis payload, without the frame around it: what can be remembered for long."""

    kind: ICType
    record: Any
    frame: int
    time: int
    """ns since 1970."""
    sender: bytes

    @property
    def var_id(self) -> int:
        """The variable that it is about."""
        return var_id_of(self.record)


def speaker(heard: Heard) -> bytes:
    """The node that a frame is from; for one without sender the station."""
    return heard.sender or heard.source


def said_in(heard: Heard, sender: bytes) -> tuple[Said, ...]:
    """What a frame of ``sender`` says of variables."""
    return tuple(Said(each.kind, each.record, heard.number, heard.wall, sender) for each in heard.instructions())
