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
Trait = Literal[
    "", "seqno 0", "seqno largest", "seqno as before", "padded", "padded far",
    "last block too long", "last block into the padding", "last block after the end",
    "last block after the end, counted",
]  # fmt: skip
"""Unusual traits of beacons that a receiver must process like any other (BP-RX-10, BP-RX-14), or up to their ends."""
#: Traits of the end of a beacon of payloads for clients, and the requirement by which its last block is not delivered.
ENDS: Final[Mapping[Trait, tuple[str, ...]]] = {
    "last block too long": ("BP-RX-09",), "last block into the padding": ("BP-RX-09", "BP-RX-14"),
    "last block after the end": ("BP-RX-14",),
    "last block after the end, counted": ("BP-RX-14",),
}  # fmt: skip
Data = Literal["", "again", "near", "zeros", "far"]
"""Safety data: new ones, those before, nearly those before, all 0, or large and negative ones."""
Fill = Literal["", "zeros", "ones"]
"""Octets of a value: all 0x00 (also one in the middle of the description), or all 0xFF."""
#: Parameters of a call: its octets are those of the call or payload before, or all the same.
AGAIN: Final = "again"
FILL: Final = "fill"
#: Parameter of SRP-UpdateSafetyData: its data.
DATA: Final = "data"
#: The producer of a record that is the node itself.
OWN: Final = -1
#: Neighbours whose identifier is that of a group of addresses, and all zero.
GROUP: Final = -2
ZERO: Final = -3
#: The creation time 0.
EPOCH: Final = -1


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
    fill: Fill = ""
    uneven: bool = False
    """True if only every third value is of this size, and the others are of one octet."""


class Report(msgspec.Struct, frozen=True, omit_defaults=True, tag="report"):
    """State reports of ``count`` neighbours from ``neighbour`` on."""

    neighbour: int
    seqno: int
    count: int = 1
    earlier: bool = False
    """True to send a tStamp that is earlier than in all other reports."""
    excess: int = 0
    """Octets that the payload has more than a record; negative: fewer."""
    data: Data = ""


class Client(msgspec.Struct, frozen=True, omit_defaults=True, tag="client"):
    """``count`` payloads for a client protocol, of ``size`` octets each."""

    protocol: int
    size: int
    count: int = 1
    again: bool = False
    """True to send the same octets as in the previous payload."""
    fill: Fill = ""


class Damaged(msgspec.Struct, frozen=True, omit_defaults=True, tag="damaged"):
    """A payload for VarDis that begins with a container of an unknown type."""


Content = Records | Report | Client | Damaged
"""The contents of blocks."""


class Beacon(msgspec.Struct, frozen=True, omit_defaults=True, tag="beacon"):
    """A beacon of a neighbour."""

    sender: int
    blocks: tuple[Content, ...]
    fault: Fault = ""
    trait: Trait = ""


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
    notes = [f"fault: {step.fault}"] * bool(step.fault) + [step.trait] * bool(step.trait)
    return f"beacon of {_node(step.sender)}: {blocks}" + (f" ({', '.join(notes)})" if notes else "")


def _node(number: int) -> str:
    names = {OWN: "the node itself", GROUP: "a neighbour with a group address as its identifier"}
    names[ZERO] = "a neighbour with the identifier 0"
    return names.get(number, f"neighbour {number}")


def _block(block: Content) -> str:
    if isinstance(block, Damaged):
        return "a damaged payload of VarDis"
    if isinstance(block, Client):
        several = f"{block.count} times " if block.count > 1 else ""
        return f"{several}{block.size} octets for protocol {block.protocol}{_octets(block)}"
    if isinstance(block, Report):
        last = "" if block.count == 1 else f" to {block.neighbour + block.count - 1}"
        more = ", with an earlier tStamp" if block.earlier else ""
        more += f", {block.excess:+} octets" if block.excess else ""
        more += f", safety data: {block.data}" if block.data else ""
        return f"report of {_node(block.neighbour)}{last}, seqno {block.seqno}{more}"
    which = f"{block.variable}" if block.count == 1 else f"{block.variable} to {block.variable + block.count - 1}"
    more = "" if block.kind in ("delete", "ask-create") else f", seqno {block.seqno}"
    if block.kind in ("create", "update"):
        more += f", {block.size} octets{_octets(block)}{', of which two of three have one' if block.uneven else ''}"
    if block.kind == "create":
        by = f"created by {_node(block.producer)} at {block.creation}"
        more += f", descr {block.descr} octets, repCnt {block.repetitions}, {by}"
        more += f", timeout {block.timeout} ms" if block.timeout else ""
    return f"{block.kind} of variable {which}{more}"


def _octets(block: Records | Client) -> str:
    return f"{', as before' if block.again else ''}{f', all {block.fill}' if block.fill else ''}"
