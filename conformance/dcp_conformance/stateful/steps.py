"""Steps of a sequence, without the identifiers and times of one run, so that a sequence can be repeated anywhere.

Protocols, variables and neighbours are numbers from 0; :class:`Names` has their identifiers in one run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import msgspec

RecordKind = Literal["create", "delete", "update", "summary", "ask-update", "ask-create"]
Fault = Literal["", "version", "magic", "network", "network-high", "own-sender", "no-length", "no-payloads"]
#: The requirement by which a receiver discards a beacon with each fault.
FAULTS: Final[Mapping[Fault, tuple[str, ...]]] = {
    "version": ("BP-RX-01",), "magic": ("BP-RX-02",), "network": ("BP-RX-05",), "network-high": ("BP-RX-05",),
    "own-sender": ("BP-RX-06",),
    "no-length": ("BP-RX-03",), "no-payloads": ("BP-RX-04",),
}  # fmt: skip
#: Parameter of a call: its octets are those of the call or payload before.
AGAIN: Final = "again"
#: The producer of a record that is the node itself.
OWN: Final = -1


class Call(msgspec.Struct, frozen=True, omit_defaults=True, tag="call"):
    """A service request. ``protId`` and ``varId`` are numbers of this sequence; octets are sizes."""

    method: str
    params: dict[str, Any] = {}
    times: int = 1
    """Number of requests, each with other octets."""


class Records(msgspec.Struct, frozen=True, omit_defaults=True, tag="records"):
    """Records of one kind about ``count`` variables from ``variable`` on."""

    kind: RecordKind
    variable: int
    count: int = 1
    seqno: int = 0
    size: int = 2
    """Octets of the value."""
    descr: int = 3
    repetitions: int = 1
    producer: int = 0
    creation: int = 0
    """Creation times are in the order of these numbers; 8 and more are an hour ahead."""
    timeout: int = 0
    again: bool = False
    """True to send the same octets as in the previous value."""


class Report(msgspec.Struct, frozen=True, omit_defaults=True, tag="report"):
    """State reports of ``count`` neighbours from ``neighbour`` on."""

    neighbour: int
    seqno: int
    count: int = 1
    earlier: bool = False
    """True to send a tStamp that is earlier than in all other reports."""
    excess: int = 0
    """Octets that the payload has more than a record; negative: fewer."""


class Client(msgspec.Struct, frozen=True, omit_defaults=True, tag="client"):
    """``count`` payloads for a client protocol, of ``size`` octets each."""

    protocol: int
    size: int
    count: int = 1
    again: bool = False
    """True to send the same octets as in the previous payload."""


class Beacon(msgspec.Struct, frozen=True, omit_defaults=True, tag="beacon"):
    """A beacon of a neighbour."""

    sender: int
    blocks: tuple[Records | Report | Client, ...]
    fault: Fault = ""


class Wait(msgspec.Struct, frozen=True, omit_defaults=True, tag="wait"):
    """Let time pass, in beacon periods (the initial ones)."""

    periods: float


Step = Call | Beacon | Wait


def text(step: Step) -> str:
    """Return a step as one line."""
    if isinstance(step, Wait):
        return f"wait {step.periods:g} periods"
    if isinstance(step, Call):
        shown = ", ".join(f"{name}={value}" for name, value in step.params.items())
        return f"{step.method}({shown})" + (f" {step.times} times" if step.times > 1 else "")
    blocks = ", ".join(map(_block, step.blocks))
    return f"beacon of neighbour {step.sender}: {blocks}" + (f" (fault: {step.fault})" if step.fault else "")


def _block(block: Records | Report | Client) -> str:
    if isinstance(block, Client):
        several = f"{block.count} times " if block.count > 1 else ""
        return f"{several}{block.size} octets for protocol {block.protocol}{', as before' if block.again else ''}"
    if isinstance(block, Report):
        last = "" if block.count == 1 else f" to {block.neighbour + block.count - 1}"
        who = "the node itself" if block.neighbour == OWN else f"neighbour {block.neighbour}{last}"
        return f"report of {who}, seqno {block.seqno}{', with an earlier tStamp' if block.earlier else ''}" + (
            f", {block.excess:+} octets" if block.excess else ""
        )
    which = f"{block.variable}" if block.count == 1 else f"{block.variable} to {block.variable + block.count - 1}"
    more = "" if block.kind in ("delete", "ask-create") else f", seqno {block.seqno}"
    if block.kind in ("create", "update"):
        more += f", {block.size} octets{', as before' if block.again else ''}"
    if block.kind == "create":
        producer = "the node itself" if block.producer == OWN else f"neighbour {block.producer}"
        more += f", descr {block.descr} octets, repCnt {block.repetitions}, created by {producer} at {block.creation}"
        more += f", timeout {block.timeout} ms" if block.timeout else ""
    return f"{block.kind} of variable {which}{more}"
