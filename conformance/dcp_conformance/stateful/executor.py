"""The interface between a sequence and an implementation, and the names of one run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import msgspec

from dcp_codec.codec import Codec
from dcp_conformance.oracle.judgement import Timing
from dcp_conformance.upper_tester import Answer

from .steps import ZERO


class Event(msgspec.Struct, frozen=True, gc=False):
    """A beacon of the node (``octets``), or a notification (``method``, ``params``). ``time``: ns of the tester."""

    time: int
    octets: bytes = b""
    method: str = ""
    params: dict[str, Any] = {}


#: The number of a neighbour whose identifier differs from that of the node itself in one octet.
TWIN = 3


def twin(node_id: bytes) -> tuple[bytes, bytes]:
    """Return identifier and address of a node that differ from ``node_id`` in one of the first octets."""
    other = bytes((node_id[0], node_id[1] ^ 0x40, *node_id[2:]))
    return other, other


def special(node_id: bytes, number: int) -> bytes:
    """Return the identifier of ``GROUP`` or ``ZERO`` with the width of ``node_id``."""
    return bytes(len(node_id)) if number == ZERO else bytes((node_id[0] | 1, *node_id[1:]))


class Names(Protocol):
    """The identifiers of one run, for the numbers of a sequence."""

    def protocol(self, number: int) -> int:
        """Return a protocol identifier."""
        ...

    def variable(self, number: int) -> int:
        """Return an identifier of a variable that the node does not know when the sequence begins."""
        ...

    def neighbour(self, number: int) -> tuple[bytes, bytes]:
        """Return node identifier and link-layer address of a neighbour.

        0 and 1 differ in the first octets only, and ``TWIN`` from the node itself, where identifiers are addresses.
        Where they are addresses, ``GROUP`` and ``ZERO`` are special ones.
        """
        ...

    def creation(self, number: int) -> int:
        """Return a creation time in ticks of the profile's clock."""
        ...


class Executor(Protocol):
    """An implementation on which a sequence is executed, from a state that is initial for its names."""

    codec: Codec
    methods: frozenset[str]
    own_id: bytes
    timing: Timing
    alone: bool
    """Whether only this sequence uses the services of the node, and changes its parameters."""
    looks: bool
    """Whether calls are quick, so that the state can be queried after each step."""
    confirms: bool
    """Whether BP-TransmitPayload is confirmed with its status, which is optional (BP-TXP-08)."""
    hears_vardis: bool
    """Whether the node has VarDis."""
    crowds: int
    """Maximum number of variables of a sequence."""
    lossy_services: bool
    """Whether an unanswered call is a fault of the connection."""
    readings: Mapping[str, str]

    @property
    def names(self) -> Names:
        """The identifiers of this sequence."""
        ...

    def parameters(self) -> dict[str, Any]:
        """Return the values of all parameters, by the names of the specification."""
        ...

    def now(self) -> int:
        """Return monotonic ns."""
        ...

    def wall(self) -> int:
        """Return ns since 1970."""
        ...

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a service."""
        ...

    def send(self, octets: bytes, source: bytes, blocks: int) -> None:
        """Send a beacon of so many blocks."""
        ...

    def wait(self, duration: int) -> list[Event]:
        """Let time pass (ns), and return what came since the last call, in order."""
        ...

    def died(self) -> str:
        """Return why the node does not run any more; empty if it does."""
        ...
