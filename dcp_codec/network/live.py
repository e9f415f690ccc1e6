"""Frames as they come in on a network interface, in the shape of a capture reader.

Frames that this host sends are seen, too. Linux only.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import select
import socket
import struct
import threading
import time
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Self

from dcp_spec.profile.definition import Link

from dcp_codec.capture.frame import MAX_FRAME_LENGTH, CaptureProblem, Frame

from . import sockets

# Of <asm-generic/socket.h>; the socket module does not have it in Python 3.11.
_SO_ATTACH_FILTER = 26

# Of <linux/filter.h>: load the 16 bits at k; skip jt or jf instructions; end with k octets of the frame.
_LOAD_16, _JUMP_IF_EQUAL, _RETURN = 0x28, 0x15, 0x06
_VLAN_TAGS = (0x8100, 0x88A8)
_IP = (0x0800, 0x86DD)
_Program = list[tuple[int, int, int, int]]

#: Seconds between looks at whether the interface has become another one.
_LOOK = 0.5
#: What a socket says of an interface that is down, or gone.
_AWAY = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.ENETUNREACH)


class LiveError(Exception):
    """Live capture is not possible. The message says what is wrong, where, and what to do; it is for people."""


def open_live(interface: str, link: Link | None, *, promiscuous: bool = True) -> LiveReader:
    """Listen on ``interface``.

    Only frames with the EtherType of ``link`` pass the kernel's filter, for a UDP link all IP frames, and without a
    link everything; up to two VLAN tags are stepped over. ``promiscuous``: also take frames for other stations.

    Raises :class:`LiveError`: no such interface, one that is down or no Ethernet, no privilege, no scapy.
    """
    return LiveReader(interface, link, promiscuous=promiscuous)


class LiveReader:
    """Frames of one interface; an iterator and a context manager. Made by :func:`open_live`.

    The iteration waits for frames and ends only after :meth:`close`, which may be called from another thread or a
    signal handler. While the interface is down or unplugged it waits for its return.
    """

    format = "live"
    resolution = "ns"
    position = 0
    size: int | None = None

    def __init__(self, interface: str, link: Link | None, *, promiscuous: bool) -> None:
        self.name = interface
        self.frames_read = 0
        self._filter = _program(_ether_types(link))
        self._promiscuous = promiscuous
        self._dropped = 0
        self._closed = False
        self._reading = False
        self._released = threading.Lock()
        self._index = 0
        self._socket: sockets.EthernetSocket | None = None
        self._open()
        self._wake, self._waker = socket.socketpair()
        self._waker.setblocking(False)

    # -- the shape of a capture reader ------------------------------------------------------------------------------

    @property
    def problems(self) -> list[CaptureProblem]:
        """Nothing can be wrong with frames that come in."""
        return []

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """What is known of the recording, as ``interface.0`` in a pcapng file."""
        return {"interface.0": {"name": self.name, "linkType": "1", "resolution": "ns"}}

    @property
    def dropped(self) -> int:
        """Frames that the kernel dropped so far because they were not read in time."""
        self._count_dropped()
        return self._dropped

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the iteration and let go of the interface. May be called at any time, from anywhere, and again."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")
        # Whoever waits for frames lets go itself: a descriptor must not be closed while another thread waits on it.
        if not self._reading:
            self._release()

    def __next__(self) -> Frame:
        self._reading = True
        try:
            # Looked at after the mark is set, so that either we see that it is closed or close() sees us.
            while not self._closed:
                frame = self._wait()
                if frame is not None:
                    return frame
        finally:
            self._reading = False
            if self._closed:
                self._release()
        raise StopIteration

    # -- receiving --------------------------------------------------------------------------------------------------

    def _wait(self) -> Frame | None:
        """The next frame, or None when there was none for a while, or the reader was closed."""
        current = self._socket
        waiting = [self._wake] if current is None else [self._wake, current.raw]
        ready = select.select(waiting, [], [], _LOOK)[0]
        if self._wake in ready:
            return None
        if current is None or not ready:
            self._look_for_interface()
            return None
        try:
            return self._receive(current)
        except OSError as error:
            if error.errno not in (*_AWAY, errno.EINTR, errno.EAGAIN):
                raise
            self._look_for_interface()
            return None

    def _receive(self, source: sockets.EthernetSocket) -> Frame | None:
        octets, ancillary, _, (_, _, kind, _, _) = source.raw.recvmsg(sockets.LONGEST, sockets.ANCILLARY)
        # What goes out on the loopback interface comes in there right away: once is enough.
        if kind == sockets.OUTGOING and source.loops:
            return None
        tag, length = sockets.tag_of(ancillary)
        # The kernel took it out; it belongs to what was on the air.
        octets = octets[:12] + tag + octets[12:] if tag else octets
        self.frames_read += 1
        time_ns = sockets.stamp_of(ancillary) or time.time_ns()
        return Frame(self.frames_read, time_ns, octets, max(length + len(tag), len(octets)))

    def _count_dropped(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._dropped += self._socket.lost()

    # -- the interface ----------------------------------------------------------------------------------------------

    def _open(self) -> None:
        # If there is none, opening says so.
        with contextlib.suppress(OSError):
            self._index = socket.if_nametoindex(self.name)
        self._socket = _listen(self.name, self._filter, promiscuous=self._promiscuous)

    def _look_for_interface(self) -> None:
        """Open anew if the name now belongs to another interface, as after a radio was unplugged and plugged in."""
        try:
            index = socket.if_nametoindex(self.name)
        except OSError:
            # Gone for now: the socket would say so again and again.
            self._let_go()
            return
        if index != self._index or self._socket is None:
            self._let_go()
            # It may go again while we open it; then the next look finds it.
            with contextlib.suppress(OSError, LiveError):
                self._open()

    def _let_go(self) -> None:
        self._count_dropped()
        current, self._socket = self._socket, None
        if current is not None:
            current.close()

    def _release(self) -> None:
        if self._released.acquire(blocking=False):
            self._let_go()
            self._wake.close()
            self._waker.close()


# -- opening ------------------------------------------------------------------------------------------------------


def _listen(interface: str, program: _Program, *, promiscuous: bool) -> sockets.EthernetSocket:
    """A listening socket with a filter, and nothing in it."""
    try:
        opened = sockets.open_ethernet(interface, sockets.EVERY_ETHER_TYPE, promiscuous=promiscuous)
    except sockets.OpeningError as error:
        raise LiveError(f"{interface}: {error}") from None
    except OSError as error:
        raise LiveError(f"{interface}: this interface cannot be listened on ({error.strerror or error})") from None
    try:
        # Nothing passes until what came in before the filter was there is thrown away.
        _attach(opened.raw, [(_RETURN, 0, 0, 0)])
        with contextlib.suppress(BlockingIOError):
            while True:
                opened.raw.recv(1)
        opened.lost()
        _attach(opened.raw, program)
    except OSError as error:
        opened.close()
        raise LiveError(f"{interface}: this interface cannot be listened on ({error.strerror or error})") from None
    return opened


def _ether_types(link: Link | None) -> tuple[int, ...] | None:
    """The EtherTypes to take, None for all."""
    if link is None:
        return None
    return _IP if link.transport == "udp" else (link.ether_type or 0,)


def _program(ether_types: tuple[int, ...] | None) -> _Program:
    """A filter program of the kernel: frames with one of these EtherTypes, also behind one or two VLAN tags.

    The first tag of a frame that comes in is no longer in it when the filter looks, so there may be one more.
    """
    if ether_types is None:
        return [(_RETURN, 0, 0, MAX_FRAME_LENGTH)]
    program: _Program = []
    each = len(ether_types) + len(_VLAN_TAGS)
    # Per offset: load, compare, refuse. Taking is the last instruction of all.
    last = 3 * (1 + each + 1)
    for offset in (12, 16, 20):
        program.append((_LOAD_16, 0, 0, offset))
        for ether_type in ether_types:
            program.append((_JUMP_IF_EQUAL, last - len(program) - 1, 0, ether_type))
        # Behind a tag the next load is the one after this block's refusal.
        for left, tag in zip((1, 0), _VLAN_TAGS, strict=True):
            program.append((_JUMP_IF_EQUAL, left + 1 if offset < 20 else left, 0, tag))
        program.append((_RETURN, 0, 0, 0))
    program.append((_RETURN, 0, 0, MAX_FRAME_LENGTH))
    return program


def _attach(to: socket.socket, program: _Program) -> None:
    octets = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *each) for each in program))
    to.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(program), ctypes.addressof(octets)))
