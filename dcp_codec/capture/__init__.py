"""Captures as streams of link-layer frames: pcap, pcapng and MCAP, read and written.

Nothing here knows what the frames carry. Everything streams: one record, one chunk at most, is in memory. Nothing
of a file that can be opened makes reading raise; what is wrong with it is a list of problems beside the frames.
The mcap library is imported when the first MCAP file is opened or created.
"""

from .convert import ConvertReport, convert
from .frame import (
    ETHERNET,
    MAX_FRAME_LENGTH,
    MAX_TIME_NS,
    CaptureError,
    CaptureProblem,
    Frame,
    Reason,
)
from .mcap.attachments import Attachment, attachments, extract_attachment
from .opening import FORMATS, SUFFIXES, create_capture, open_capture
from .reader import CaptureReader
from .writer import CaptureWriter, ChannelMessage, MessageSource

__all__ = [
    "ETHERNET",
    "FORMATS",
    "MAX_FRAME_LENGTH",
    "MAX_TIME_NS",
    "SUFFIXES",
    "Attachment",
    "CaptureError",
    "CaptureProblem",
    "CaptureReader",
    "CaptureWriter",
    "ChannelMessage",
    "ConvertReport",
    "Frame",
    "MessageSource",
    "Reason",
    "attachments",
    "convert",
    "create_capture",
    "extract_attachment",
    "open_capture",
]
