"""Captures as streams of link-layer frames: pcap, pcapng and MCAP, read and written.

The package does not depend on the payload of the frames. All formats are streamed: at most one record or one chunk is
in memory. Reading never raises after a file was opened; damage is listed as problems beside the frames. The mcap
library is imported when the first MCAP file is opened or created.
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
