"""Captures as streams of link-layer frames: pcap, pcapng and MCAP, read and written.

Nothing here knows what the frames carry. Everything streams: one record, one chunk at most, is in memory.
"""

from dcp_codec.capture.frame import CaptureError, CaptureProblem, Frame
from dcp_codec.capture.opening import open_capture
from dcp_codec.capture.reader import CaptureReader

__all__ = [
    "CaptureError",
    "CaptureProblem",
    "CaptureReader",
    "Frame",
    "open_capture",
]
