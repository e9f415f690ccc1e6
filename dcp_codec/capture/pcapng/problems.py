"""Problems of single blocks of a pcapng file, with their messages. They are counted and never end the reading."""

from __future__ import annotations

from collections.abc import Callable

from dcp_codec.capture.linktypes import link_type_name
from dcp_codec.capture.reader import counted

from .blocks import BadOptionError, Interface

#: Function that counts a problem, such as :meth:`dcp_codec.capture.reader.CaptureReader._tally`.
Count = Callable[..., None]


class BlockProblems:
    """Records problems; arguments are the offset of the block and the number of the last frame before it."""

    def __init__(self, count: Count) -> None:
        self._count = count

    def unknown_block(self, kind: int, offset: int, frame: int) -> None:
        """Record a block type that the format's registry does not list."""
        self._count(
            "unknown-block",
            lambda times: (
                f"{counted(times, 'block')} of the unknown type {kind:#010x}, the first at octet {offset}, passed over."
            ),
            offset,
            frame,
            kind,
        )

    def unknown_interface(self, offset: int, frame: int) -> None:
        """Record a block for an interface that its section does not describe."""
        self._count(
            "unknown-interface",
            lambda times: (
                f"{counted(times, 'block')}, the first at octet {offset}, for an interface that its section does not "
                "describe, passed over."
            ),
            offset,
            frame,
        )

    def wrong_link_type(self, interface: Interface, offset: int, frame: int) -> None:
        """Record a frame of an interface whose link type is not wanted."""
        index, kind = interface.index, link_type_name(interface.link_type)
        self._count(
            "wrong-link-type",
            lambda times: f"{counted(times, 'frame')} of interface {index} passed over: its link type is {kind}.",
            offset,
            frame,
            index,
        )

    def does_not_fit(self, captured: int, room: int, offset: int, frame: int) -> None:
        """Record a frame that states more octets than its block has."""
        self._count(
            "bad-record",
            lambda times: (
                f"{counted(times, 'frame')} passed over, the first in the block at octet {offset}, which claims "
                f"{captured} octets where its block has {room}."
            ),
            offset,
            frame,
        )

    def no_time(self, offset: int, frame: int) -> None:
        """Record a simple packet block, which has no time of capture."""
        self._count(
            "no-time",
            lambda times: (
                f"{counted(times, 'simple packet block')}, the first at octet {offset}, without a time of capture: "
                "0 stands for it."
            ),
            offset,
            frame,
        )

    def rounded_time(self, interface: Interface, offset: int, frame: int) -> None:
        """Record a time that is not a whole number of nanoseconds."""
        index, unit = interface.index, interface.resolution
        self._count(
            "rounded-time",
            lambda times: (
                f"{counted(times, 'time')} of interface {index}, whose clock counts in {unit}, rounded to the nearest "
                "nanosecond."
            ),
            offset,
            frame,
            index,
        )

    def bad_option(self, error: BadOptionError, offset: int, frame: int) -> None:
        """Record damaged options of a block whose other parts were read."""
        self._count(
            "bad-option",
            lambda times: (
                f"{counted(times, 'block')} with options that are damaged, the first at octet {offset} ({error}); the "
                "rest of such a block was read."
            ),
            offset,
            frame,
        )
