"""Dissection of captured frames: addresses, beacon, problems and padding of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
from dcp_spec.profile.definition import Link

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_codec.jsonform import beacon_json, problem_json
from dcp_codec.views.fields import Dissection, Field

from .locate import Framing, OtherTraffic, bare, locate, mac


@dataclass(slots=True, eq=False)
class DissectedFrame:
    """One DCP frame of a recording. Offsets count from the first octet of the frame."""

    codec: Codec
    frame: Frame
    framing: Framing
    dissection: Dissection
    doubt: str | None = None

    @property
    def header(self) -> Field | None:
        """Return the beacon header; None if the profile sends no header or the frame ends before it."""
        return self.dissection.root.child("bp")

    @property
    def sender(self) -> str | None:
        """Return the sender: the identifier in the beacon, or the source address of the frame if there is no
        identifier.
        """
        header = self.header
        field = header.child("senderId") if header is not None else None
        if field is not None and field.value is not None:
            representation = self.codec.profile.types.node_id.representation
            return mac(field.value) if representation == "mac" else str(field.value.hex())
        if header is None and self.framing.src is not None:
            return mac(self.framing.src)
        return None

    @property
    def payloads(self) -> Sequence[Field]:
        """Return the payload blocks."""
        payloads = self.dissection.root.child("payloads")
        return payloads.children if payloads is not None else ()

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object that ``dcp-codec decode --format jsonl`` prints for this frame."""
        framing = self.framing
        return {
            "frame": self.frame.number,
            "time_ns": self.frame.time_ns,
            "src": mac(framing.src) if framing.src is not None else None,
            "dst": mac(framing.dst) if framing.dst is not None else None,
            "etherType": framing.ether_type,
            **({} if self.doubt is None else {"profileDoubt": self.doubt}),
            **beacon_json(self.codec, self.dissection.root),
            "padding": len(self.dissection.padding),
            "errors": [problem_json(problem) for problem in self.dissection.errors],
            "warnings": [problem_json(problem) for problem in self.dissection.warnings],
        }


class FrameDissector:
    """Dissects captured frames with one codec. ``link`` replaces the EtherType or UDP port of the profile."""

    def __init__(self, codec: Codec, link: Link | None = None, doubt: str | None = None) -> None:
        """``doubt``: the reason why the profile may be wrong; it becomes a member of the JSON object of every frame."""
        self.codec = codec
        self.link = link or codec.profile.link
        self.doubt = doubt

    def dissect(self, frame: Frame) -> DissectedFrame | OtherTraffic:
        """Dissect a frame, or return why it is not DCP. Never raises."""
        framing = locate(frame.data, self.link)
        if isinstance(framing, OtherTraffic):
            return framing
        return self._apart(frame, framing)

    def dissect_bare(self, frame: Frame) -> DissectedFrame:
        """Dissect octets that are a bearer payload without a link-layer header, like :meth:`dissect`."""
        return self._apart(frame, bare(frame.data))

    def _apart(self, frame: Frame, framing: Framing) -> DissectedFrame:
        octets = frame.data if framing.end == len(frame.data) else frame.data[: framing.end]
        found = self.codec.dissect(octets, start=framing.start, base=framing.start)
        return DissectedFrame(self.codec, frame, framing, found, self.doubt)


def with_ether_type(link: Link, ether_type: int) -> Link:
    """Return ``link`` with another EtherType; the result is always a link over Ethernet."""
    return msgspec.structs.replace(link, transport="ethernet", ether_type=ether_type)
