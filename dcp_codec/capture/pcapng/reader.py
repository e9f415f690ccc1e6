"""pcapng files: draft-ietf-opsawg-pcapng, any number of sections in either byte order, any clock."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

from dcp_codec.capture.bytesource import ByteSource
from dcp_codec.capture.frame import ETHERNET, MAX_RECORD_LENGTH, MAX_TIME_NS, Frame
from dcp_codec.capture.linktypes import link_type_name, wrong_link_type
from dcp_codec.capture.reader import CaptureReader

from .blocks import (
    BYTE_ORDERS,
    ENHANCED_PACKET,
    INTERFACE,
    INTERFACE_OPTIONS,
    ISB_IFDROP,
    ISB_OSDROP,
    LEAST_LENGTH,
    PACKET,
    SECTION_HEADER,
    SECTION_OPTIONS,
    SIMPLE_PACKET,
    SKIPPED,
    STATISTICS,
    BadOptionError,
    Interface,
    block_name,
    options,
)

#: Maximum number of interfaces in one file; a file with more counts as damaged.
MAX_INTERFACES = 65_536

#: Maximum number of metadata records kept from one file.
MAX_METADATA = 1_000

_LEAST = 12
_PACKET_HEADS = {order: struct.Struct(order + "IIIII").unpack_from for order in "<>"}
_LEAST_PACKET = LEAST_LENGTH[ENHANCED_PACKET]
_FIXED = 28  # of an enhanced packet block, before the octets of the frame
# By byte order: the head of an enhanced packet block. Its length includes the length field that ends every block.
_BLOCK_HEADS = {order: struct.Struct(order + "IIIIIII").unpack_from for order in "<>"}
_TRAILERS = {order: struct.Struct(order + "I").unpack_from for order in "<>"}


class PcapngReader(CaptureReader):
    """Reads a pcapng file; the window of `source` starts with its first section header.

    Opening reads up to the first interface of an accepted link type, so that a file without one is refused.
    """

    format = "pcapng"

    def __init__(self, source: ByteSource, link_types: frozenset[int]) -> None:
        super().__init__(source, link_types)
        self._order = "<"
        self._sections = 0
        self._interface_count = 0
        self._interfaces: list[Interface] = []
        self._accepted = False
        self._unpack_packet = _PACKET_HEADS["<"]
        self._pending: Frame | None = None
        self._going = self._block()
        if not self._sections:
            raise self._refuse(self._log.found[-1].message)
        refused = ETHERNET
        while self._going and not self._accepted:
            self._going = self._block()
            if self._interfaces:
                refused = self._interfaces[-1].link_type
        if not self._accepted and self._interface_count:
            raise self._refuse(f"has {wrong_link_type(refused, link_types)}")

    @property
    def big_endian(self) -> bool:
        """Return whether the current section is big-endian."""
        return self._order == ">"

    @property
    def interfaces(self) -> Sequence[Interface]:
        """Return the interfaces of the current section that have been described so far."""
        return self._interfaces

    @property
    def number(self) -> int:
        """Return the number of the last frame, including skipped ones."""
        return self._number

    def step(self, position: int, number: int, frames: int) -> tuple[bool, Frame | None]:
        """Read the block at octet `position`, after frame `number` and `frames` yielded frames.

        For callers that find most frames themselves, moving forward, instead of iterating. Returns whether there is
        more to read, and the frame of the block if it has one.
        """
        self._source.skip(position - self._source.position)
        self._number, self._frames_read = number, frames
        self._pending = None
        if self._going:
            self._going = self._block()
        if not self._going:
            self._log.settle()
        return self._going, self._pending

    def _records(self) -> Iterator[Frame]:
        source = self._source
        head, trailer = _BLOCK_HEADS["<"], _TRAILERS["<"]
        order = ""
        while self._going:
            if order != self._order:
                order = self._order
                head, trailer = _BLOCK_HEADS[order], _TRAILERS[order]
            buffer, start, base = source.buffer, source.start, source.base
            interfaces, end = self._interfaces, len(source.buffer)
            # Fast path for nearly every block: a frame that is completely in the window.
            while end - start >= _FIXED:
                kind, total, which, high, low, captured, length = head(buffer, start)
                stop, body = start + total, start + _FIXED
                if (
                    kind != ENHANCED_PACKET
                    or stop > end
                    or total < _LEAST_PACKET
                    or total % 4
                    or trailer(buffer, stop - 4)[0] != total
                ):
                    break
                self._position = base + stop
                if (
                    which < len(interfaces)
                    and (interface := interfaces[which]).accepted
                    and interface.divide == 1
                    and 0 <= total - _LEAST_PACKET - captured <= 3
                    and 0 <= (time_ns := (high << 32 | low) * interface.multiply + interface.shift_ns) <= MAX_TIME_NS
                ):
                    self._number = number = self._number + 1
                    data = buffer[body : body + captured]
                    octets = length if length > captured else captured
                    frame: Frame | None = Frame(number, time_ns, data, octets, interface.index, base + start)
                else:
                    frame = self._packet(kind, buffer, start, total)
                start = stop
                if frame is not None:
                    self._frames_read += 1
                    yield frame
            source.start = start
            # All other blocks, the end of the window, and all errors.
            self._pending = None
            self._going = self._block()
            if self._pending is not None:
                self._frames_read += 1
                yield self._pending

    def _block(self) -> bool:
        """Read one block of any kind; its frame, if it has one, is then `_pending`. Return False at the end."""
        source = self._source
        offset = source.position
        have = source.need(_LEAST)
        if have < _LEAST:
            if have:
                self._cut("truncated-header", offset, _LEAST, have, "the header of a block")
            return False
        if source.buffer.startswith(b"\x0a\x0d\x0d\x0a", source.start):
            order = BYTE_ORDERS.get(source.buffer[source.start + 8 : source.start + 12])
            if order is None:
                return self._damaged("bad-record", offset, "a section header without its byte-order magic")
            self._order = order
        kind, total = struct.unpack_from(self._order + "II", source.buffer, source.start)
        if total < LEAST_LENGTH.get(kind, _LEAST) or total % 4:
            if not any(source.buffer[source.start : source.start + _LEAST]):
                return self._damaged("zero-filled", offset, "only zeros, as after a power cut,")
            return self._damaged("bad-block-length", offset, f"{block_name(kind)} that claims {total} octets")
        known = kind in LEAST_LENGTH
        if known and total > MAX_RECORD_LENGTH:
            return self._damaged("bad-block-length", offset, f"{block_name(kind)} that claims {total} octets")
        body = source.need(total) if known else source.skip(total - 4) + source.need(4)
        if body < total:
            self._cut("truncated-record", offset, total, body, block_name(kind))
            return False
        at = source.start if known else source.start - total + 4
        if struct.unpack_from(self._order + "I", source.buffer, at + total - 4)[0] != total:
            return self._damaged("bad-block-length", offset, f"{block_name(kind)} whose two lengths differ")
        going = self._take(kind, source.buffer, at, total) if known else self._pass_over(kind, offset)
        source.start = at + total
        self._position = source.position
        return going

    def _take(self, kind: int, buffer: bytes, start: int, total: int) -> bool:
        if kind == SECTION_HEADER:
            return self._section(buffer, start, total)
        if kind == INTERFACE:
            return self._interface(buffer, start, total)
        if kind == STATISTICS:
            self._statistics(buffer, start, total)
        elif kind == SIMPLE_PACKET:
            self._pending = self._simple_packet(buffer, start, total)
        else:
            self._pending = self._packet(kind, buffer, start, total)
        return True

    def _pass_over(self, kind: int, offset: int) -> bool:
        if kind not in SKIPPED:
            text = f" of the unknown type {kind:#010x}, the first at octet {offset}, passed over."
            self._tally("unknown-block", "block", text, offset, of=kind)
        return True

    def _section(self, buffer: bytes, start: int, total: int) -> bool:
        major, minor = struct.unpack_from(self._order + "HH", buffer, start + 12)
        if major != 1:
            what = f"a section of pcapng version {major}.{minor}, which is not 1.x,"
            return self._damaged("unknown-version", self._source.base + start, what)
        # The section length, 8 octets, is not needed for reading in order.
        name = f"section.{self._sections}" if self._sections else "section"
        self._sections += 1
        self._unpack_packet = _PACKET_HEADS[self._order]
        self._interfaces = []
        self._describe(name, SECTION_OPTIONS, buffer, start, start + 24, start + total - 4)
        return True

    def _interface(self, buffer: bytes, start: int, total: int) -> bool:
        if self._interface_count == MAX_INTERFACES:
            return self._damaged("bad-record", self._source.base + start, f"interface {MAX_INTERFACES}")
        link_type, _, snap = struct.unpack_from(self._order + "HHI", buffer, start + 8)
        accepted = link_type in self._link_types
        interface = Interface(self._interface_count, link_type, snap, accepted=accepted)
        self._interface_count += 1
        self._interfaces.append(interface)
        name = f"interface.{interface.index}"
        self._describe(name, INTERFACE_OPTIONS, buffer, start, start + 16, start + total - 4, interface)
        if name in self._metadata:
            self._metadata[name] |= {"linkType": str(link_type), "resolution": interface.resolution}
        self._accepted = self._accepted or accepted
        return True

    def _describe(
        self,
        name: str,
        wanted: dict[int, str],
        buffer: bytes,
        block: int,
        start: int,
        stop: int,
        interface: Interface | None = None,
    ) -> None:
        """Keep the options of a block as the metadata record `name`, and apply them to the interface."""
        record: dict[str, str] = {}
        try:
            for code, value in options(buffer, start, stop, self._order):
                if code in wanted:
                    record[wanted[code]] = value.rstrip(b"\0").decode("utf-8", "replace")
                if interface is not None:
                    interface.apply(code, value, self._order)
        except BadOptionError as error:
            self._bad_option(error, block)
        if len(self._metadata) < MAX_METADATA and (record or interface is not None):
            self._metadata[name] = record

    def _statistics(self, buffer: bytes, start: int, total: int) -> None:
        which = struct.unpack_from(self._order + "I", buffer, start + 8)[0]
        if which >= len(self._interfaces):
            self._unknown_interface(self._source.base + start)
        elif self._interfaces[which].accepted:
            self._check_options(buffer, start + 20, start + total - 4, start, counters=(ISB_IFDROP, ISB_OSDROP))

    def _packet(self, kind: int, buffer: bytes, start: int, total: int) -> Frame | None:
        """Return the frame of an enhanced, or obsolete, packet block."""
        which, high, low, captured, length = self._unpack_packet(buffer, start + 8)
        self._number = number = self._number + 1
        if kind == PACKET:
            # Two 16-bit numbers share the field: the interface, and the number of drops before this frame.
            which = struct.unpack_from(self._order + "H", buffer, start + 8)[0]
        interface = self._interfaces[which] if which < len(self._interfaces) else None
        if interface is None or not interface.accepted:
            self._not_wanted(interface, start)
            return None
        body = start + _FIXED
        room = total - _FIXED - 4
        if captured > room:
            self._does_not_fit(captured, room, start)
            return None
        if room > captured + 3:
            self._check_options(buffer, body + captured + -captured % 4, body + room, start)
        time_ns: int = (high << 32 | low) * interface.multiply
        if interface.divide != 1:
            time_ns = self._rounded(time_ns, interface, start)
        time_ns += interface.shift_ns
        if not 0 <= time_ns <= MAX_TIME_NS:
            time_ns = self._clamped(time_ns, self._source.base + start)
        return Frame(
            number,
            time_ns,
            buffer[body : body + captured],
            length if length > captured else captured,
            interface.index,
            self._source.base + start,
        )

    def _simple_packet(self, buffer: bytes, start: int, total: int) -> Frame | None:
        """Return the frame of a simple packet block: of the first interface, and without a time."""
        self._number += 1
        interface = self._interfaces[0] if self._interfaces else None
        if interface is None or not interface.accepted:
            self._not_wanted(interface, start)
            return None
        length: int = struct.unpack_from(self._order + "I", buffer, start + 8)[0]
        room = total - 16
        captured = min(length, interface.snap) if interface.snap else length
        if captured > room:
            self._does_not_fit(captured, room, start)
            return None
        offset = self._source.base + start
        text = f", the first at octet {offset}, without a time of capture: 0 stands for it."
        self._tally("no-time", "simple packet block", text, offset, self._number - 1)
        body = start + 12
        return Frame(self._number, 0, buffer[body : body + captured], length, interface.index, offset)

    def _unknown_interface(self, offset: int) -> None:
        text = f", the first at octet {offset}, for an interface that its section does not describe, passed over."
        self._tally("unknown-interface", "block", text, offset)

    def _not_wanted(self, interface: Interface | None, start: int) -> None:
        """Count a frame of an unknown interface, or of one with another link type."""
        offset = self._source.base + start
        if interface is None:
            self._unknown_interface(offset)
            return
        index, kind = interface.index, link_type_name(interface.link_type)
        text = f" of interface {index} passed over: its link type is {kind}."
        self._tally("wrong-link-type", "frame", text, offset, self._number - 1, index)

    def _does_not_fit(self, captured: int, room: int, start: int) -> None:
        """Count a frame that states more octets than its block has."""
        offset = self._source.base + start
        place = f"the first in the block at octet {offset}"
        text = f" passed over, {place}, which claims {captured} octets where its block has {room}."
        self._tally("bad-record", "frame", text, offset, self._number - 1)

    def _check_options(
        self, buffer: bytes, start: int, stop: int, block: int, *, counters: tuple[int, ...] = ()
    ) -> None:
        """Count damaged options, and ``counters`` that have not 8 octets."""
        try:
            for code, value in options(buffer, start, stop, self._order):
                if code in counters and len(value) != 8:
                    raise BadOptionError(f"a drop counter has {len(value)} octets, not 8")
        except BadOptionError as error:
            self._bad_option(error, block)

    def _bad_option(self, error: BadOptionError, start: int) -> None:
        """Count damaged options of a block whose other parts were read."""
        offset = self._source.base + start
        place = f"the first at octet {offset} ({error})"
        text = f" with options that are damaged, {place}; the rest of such a block was read."
        self._tally("bad-option", "block", text, offset)

    def _rounded(self, scaled: int, interface: Interface, start: int) -> int:
        """Return `scaled` / `divide`, rounded to the nearest nanosecond."""
        time_ns, rest = divmod(scaled, interface.divide)
        if not rest:
            return time_ns
        index, unit = interface.index, interface.resolution
        text = f" of interface {index}, whose clock counts in {unit}, rounded to the nearest nanosecond."
        self._tally("rounded-time", "time", text, self._source.base + start, self._number - 1, index)
        return time_ns + (2 * rest >= interface.divide)
