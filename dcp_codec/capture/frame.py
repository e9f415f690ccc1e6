"""What every capture format has in common: a frame, what may be wrong with a file, and the one exception."""

from __future__ import annotations

from typing import Literal

import msgspec

#: The link type of everything this package writes, and by default of everything it reads (LINKTYPE_ETHERNET).
ETHERNET = 1

#: Times run from the Unix epoch to 2262-04-11, so that every time fits a signed 64-bit integer downstream.
MAX_TIME_NS = 2**63 - 1

#: The longest frame that is written, in octets, and the largest snap length a pcap header needs to promise.
#: It is libpcap's own limit for Ethernet: Wireshark refuses longer ones.
MAX_FRAME_LENGTH = 262_144

#: The longest record that is read in one piece, in octets, whatever the file itself promises. A length field
#: of a damaged file can say four gigabytes, and a snap length can bless it.
MAX_RECORD_LENGTH = 16 * 1024 * 1024


class Frame(msgspec.Struct, frozen=True, gc=False):
    """One link-layer frame as it was captured.

    Instances hold no references that could form a cycle, so the garbage collector does not track them.
    """

    #: Counts from 1. As in Wireshark, frames that were passed over (another link type) keep their number.
    #: In an MCAP file it is the number that the frame had where it was recorded.
    number: int
    #: Nanoseconds since the Unix epoch, 0..`MAX_TIME_NS`.
    time_ns: int
    #: The octets that were captured, from the destination address on.
    data: bytes
    #: Octets that the frame had on the wire, >= len(data).
    orig_len: int
    #: Counts from 0 through the whole file (in pcapng over all of its sections); 0 where a format has none.
    interface: int = 0
    #: Where the record of the frame starts, in octets from the start of the file; -1 if it has no place of
    #: its own, as inside a compressed chunk.
    offset: int = -1


#: What can be wrong; `CaptureProblem` says what each of them means.
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
    """Something wrong with a capture of which the rest could be read.

    `reason` is one of:

    - ``truncated-header``, ``truncated-record``: the file ends within the header, the body of a record;
    - ``unfinished``: an MCAP file that ends after a whole record, but was never finished;
    - ``zero-filled``: from here on there are only zeros where a record should start, as after a power cut;
    - ``bad-record-length``, ``bad-block-length``: a length that cannot be true;
    - ``bad-record``, ``bad-option``, ``bad-message``: contents that cannot be;
    - ``bad-crc``, ``bad-compression``, ``too-large``: a chunk that was passed over, and why;
    - ``unknown-block``, ``unknown-record``, ``unknown-interface``, ``unknown-version``;
    - ``wrong-link-type``: frames that were passed over;
    - ``rounded-time``, ``time-out-of-range``, ``no-time``: times that are not exactly what the file says;
    - ``trailing-data``: something after the end of the file's own structure;
    - ``read-error``: the operating system or a decompressor stopped us.
    """

    reason: Reason
    #: One sentence: what, where, what was still read. What happens many times is counted in one problem.
    message: str
    #: Octets from the start of the file to where the (first) record concerned starts.
    offset: int = -1
    #: Octets that the record needs, and that there are of it; both 0 where lengths are not the matter.
    needed: int = 0
    available: int = 0
    #: Number of the last frame that was read before it, 0 for none.
    frame: int = 0


class CaptureError(Exception):
    """A capture cannot be read, or not be written, at all. The message names the file and is one for people.

    Reading raises it only from `open_capture`; what is found later becomes a `CaptureProblem`.
    """
