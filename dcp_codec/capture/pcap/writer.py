"""Writer of classic pcap files, little-endian, of link type Ethernet."""

from __future__ import annotations

import struct
from typing import Literal

from dcp_codec.capture.bytesink import ByteSink
from dcp_codec.capture.frame import ETHERNET, MAX_FRAME_LENGTH, Frame
from dcp_codec.capture.writer import CaptureWriter

_MAGICS = {"ns": 0xA1B23C4D, "us": 0xA1B2C3D4}
_RECORD = struct.Struct("<IIII")
_SECOND = 1_000_000_000
_MAX_SECONDS = 2**32 - 1


class PcapWriter(CaptureWriter):
    """Writes a pcap file.

    `lossy` drops what the format cannot hold: the number of the interface, and in microseconds the nanoseconds (cut,
    not rounded). Without it, such frames are refused.
    """

    format = "pcap"

    def __init__(self, sink: ByteSink, resolution: Literal["ns", "us"], *, lossy: bool) -> None:
        super().__init__(sink)
        self._unit = 1 if resolution == "ns" else 1000
        self._lossy = lossy
        sink.write(struct.pack("<IHHiIII", _MAGICS[resolution], 2, 4, 0, 0, MAX_FRAME_LENGTH, ETHERNET))

    def _write(self, frame: Frame) -> None:
        seconds, rest = divmod(frame.time_ns, _SECOND)
        fraction, lost = divmod(rest, self._unit)
        if seconds > _MAX_SECONDS:
            raise self._refuse(frame, "its time is after 2106, where pcap ends; pcapng and MCAP have no such end")
        if not self._lossy and (lost or frame.interface):
            raise self._refuse(frame, _describe_loss(frame, lost))
        if not (seconds or fraction or frame.orig_len):
            raise self._refuse(frame, "a frame without length at time 0 cannot be told from a file's zeroed end")
        self._append(_RECORD.pack(seconds, fraction, len(frame.data), frame.orig_len) + frame.data)


def _describe_loss(frame: Frame, nanoseconds: int) -> str:
    if nanoseconds:
        return (
            f"its last {nanoseconds} ns would be lost in microseconds; use nanoseconds (--resolution ns), or permit "
            "the loss (--lossy)"
        )
    return f"pcap cannot store its interface number, {frame.interface}; use pcapng, or permit the loss (--lossy)"
