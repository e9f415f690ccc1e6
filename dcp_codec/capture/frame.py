"""Types for all capture formats: a frame, the problems of a file, and the exception."""

from __future__ import annotations

from typing import Literal

import msgspec

#: Link type of all written and, by default, all read frames (LINKTYPE_ETHERNET).
ETHERNET = 1

#: Times are within the Unix epoch and 2262-04-11, so that each fits a signed 64-bit integer.
MAX_TIME_NS = 2**63 - 1

#: The longest frame that is written, in octets, and the largest snap length in a pcap header. It is libpcap's limit for
#: Ethernet; Wireshark refuses longer frames.
MAX_FRAME_LENGTH = 262_144

#: The longest record that is read in one piece, in octets, whatever the file itself states. In a damaged file the
#: length field can state four gigabytes, and the snap length can permit it.
MAX_RECORD_LENGTH = 16 * 1024 * 1024


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One captured link-layer frame.

    Instances hold no references that could form a cycle, so the garbage collector does not track them.
    """

    #: Counts from 1. As in Wireshark, skipped frames (of another link type) keep their number. In an MCAP file it is
    #: the number of the frame in the original recording.
    number: int
    #: Nanoseconds since the Unix epoch, 0..`MAX_TIME_NS`.
    time_ns: int
    #: The captured octets, from the destination address on.
    data: bytes
    #: Length of the frame on the wire in octets, >= len(data).
    orig_len: int
    #: Counts from 0 through the whole file (in pcapng over all sections); 0 for formats without interfaces.
    interface: int = 0
    #: Offset of the frame's record in octets from the start of the file; -1 if it has none, as inside a compressed
    #: chunk.
    offset: int = -1


#: Kinds of problems, which `CaptureProblem` explains.
Reason = Literal[
    "truncated-header",
    "truncated-record",
    "unfinished",
    "zero-filled",
    "bad-record-length",
    "bad-block-length",
    "bad-record",
    "bad-option",
    "bad-message",
    "bad-crc",
    "bad-compression",
    "too-large",
    "unknown-block",
    "unknown-record",
    "unknown-interface",
    "unknown-version",
    "wrong-link-type",
    "rounded-time",
    "time-out-of-range",
    "no-time",
    "trailing-data",
    "read-error",
]


class CaptureProblem(msgspec.Struct, frozen=True):
    """A problem of a capture whose remaining parts could be read.

    `reason` is one of:

    - ``truncated-header``, ``truncated-record``: the file ends within the header or the body of a record;
    - ``unfinished``: an MCAP file that ends after a whole record, but was never finished;
    - ``zero-filled``: only zeros from here on, where a record should start, as after a power cut;
    - ``bad-record-length``, ``bad-block-length``: an impossible length;
    - ``bad-record``, ``bad-option``, ``bad-message``: invalid contents;
    - ``bad-crc``, ``bad-compression``, ``too-large``: a skipped chunk, with the reason;
    - ``unknown-block``, ``unknown-record``, ``unknown-interface``, ``unknown-version``;
    - ``wrong-link-type``: skipped frames;
    - ``rounded-time``, ``time-out-of-range``, ``no-time``: times that differ from those in the file;
    - ``trailing-data``: data after the end of the file's structure;
    - ``read-error``: an error of the operating system or a decompressor.
    """

    reason: Reason
    #: One sentence: the problem, its place, and how much was read. Repeated problems are counted in one entry.
    message: str
    #: Offset in octets from the start of the file to the (first) record concerned.
    offset: int = -1
    #: Length of the record and length of the present part, in octets; both 0 for problems of another kind.
    needed: int = 0
    available: int = 0
    #: Number of the last frame that was read before the problem, 0 for none.
    frame: int = 0


class CaptureError(Exception):
    """A capture cannot be read, or cannot be written, at all. The message names the file and is meant for the user.

    Reading raises it only from `open_capture`; later problems become a `CaptureProblem`.
    """
