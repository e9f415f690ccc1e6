"""Writer of pcapng files: one section, little-endian, one Ethernet interface per number that occurs."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Literal

from dcp_spec.version import __version__

from dcp_codec.capture.bytesink import ByteSink
from dcp_codec.capture.frame import ETHERNET, MAX_FRAME_LENGTH, Frame
from dcp_codec.capture.writer import CaptureWriter, Metadata

from .blocks import (
    ENHANCED_PACKET,
    IF_TSRESOL,
    INTERFACE,
    INTERFACE_OPTIONS,
    SECTION_HEADER,
    SECTION_OPTIONS,
)

#: Interfaces are numbered without gaps, so a frame of interface n costs n + 1 descriptions.
MAX_INTERFACE = 4095

#: Octets of a text option; longer text is cut.
_MAX_TEXT = 1024

_PACKET = struct.Struct("<IIIIIII")
_TRAILER = struct.Struct("<I")
_EXPONENTS = {"ns": 9, "us": 6}


class PcapngWriter(CaptureWriter):
    """Writes a pcapng file.

    Of the metadata it stores ``section`` (hardware, os) and ``interface.N`` (name, description), which are looked up
    when the interface is first used. In microseconds, `lossy` cuts nanoseconds off; otherwise such frames are refused.
    """

    format = "pcapng"

    def __init__(self, sink: ByteSink, resolution: Literal["ns", "us"], metadata: Metadata, *, lossy: bool) -> None:
        super().__init__(sink)
        self._unit = 1 if resolution == "ns" else 1000
        self._exponent = _EXPONENTS[resolution]
        self._metadata = metadata
        self._lossy = lossy
        self._interfaces = 0
        about = {**metadata.get("section", {}), "userappl": f"dcp-codec {__version__}"}
        # Byte-order magic, version 1.0, unknown length of the section.
        fixed = struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1)
        sink.write(_block(SECTION_HEADER, fixed + _texts(SECTION_OPTIONS, about) + _END))

    def _write(self, frame: Frame) -> None:
        stamp, lost = divmod(frame.time_ns, self._unit)
        if lost and not self._lossy:
            raise self._refuse(
                frame,
                f"its last {lost} ns would be lost in microseconds; use nanoseconds (--resolution ns), or permit "
                "the loss (--lossy)",
            )
        if not 0 <= frame.interface <= MAX_INTERFACE:
            raise self._refuse(frame, f"its interface, {frame.interface}, is not within 0..{MAX_INTERFACE}")
        while frame.interface >= self._interfaces:
            self._append(self._describe(self._interfaces))
            self._interfaces += 1
        captured = len(frame.data)
        padding = -captured % 4
        total = 32 + captured + padding
        head = _PACKET.pack(
            ENHANCED_PACKET,
            total,
            frame.interface,
            stamp >> 32,
            stamp & 0xFFFF_FFFF,
            captured,
            frame.orig_len,
        )
        self._append(head + frame.data + bytes(padding) + _TRAILER.pack(total))

    def _describe(self, number: int) -> bytes:
        about = self._metadata.get(f"interface.{number}", {})
        body = struct.pack("<HHI", ETHERNET, 0, MAX_FRAME_LENGTH)
        body += _texts(INTERFACE_OPTIONS, about) + _option(IF_TSRESOL, bytes([self._exponent])) + _END
        return _block(INTERFACE, body)

    def _finish(self) -> None:
        if not self._interfaces:
            # A section without an interface is allowed, but would not name the recorded interface.
            self._append(self._describe(0))
        super()._finish()


def _option(code: int, value: bytes) -> bytes:
    return struct.pack("<HH", code, len(value)) + value + bytes(-len(value) % 4)


_END = _option(0, b"")


def _texts(wanted: Mapping[int, str], values: Mapping[str, str]) -> bytes:
    pieces = []
    for code, name in wanted.items():
        text = values.get(name)
        if text:
            octets = text.encode("utf-8", "replace")[:_MAX_TEXT]
            # Do not cut within a character.
            pieces.append(_option(code, octets.decode("utf-8", "ignore").encode()))
    return b"".join(pieces)


def _block(kind: int, body: bytes) -> bytes:
    total = len(body) + 12
    return struct.pack("<II", kind, total) + body + struct.pack("<I", total)
