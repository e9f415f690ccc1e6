"""Live capture of the frames of a network interface, with the interface of a capture reader.

Frames that this host sends are captured, too. Linux only.
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

from dcp_spec.profile.definition import Link

from dcp_codec.capture.bytesource import Closing
from dcp_codec.capture.frame import MAX_FRAME_LENGTH, CaptureProblem, Frame

from . import sockets

# From <asm-generic/socket.h>; the socket module does not have it in Python 3.11.
_SO_ATTACH_FILTER = 26

# From <linux/filter.h>: load the 16 bits at k; skip jt or jf instructions; end with k octets of the frame.
_LOAD_16, _JUMP_IF_EQUAL, _RETURN = 0x28, 0x15, 0x06
_VLAN_TAGS = (0x8100, 0x88A8)
_IP = (0x0800, 0x86DD)
_Program = list[tuple[int, int, int, int]]

#: Seconds between checks whether the name belongs to another interface now.
_LOOK = 0.5
#: Errors of a socket whose interface is down or removed.
_AWAY = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.ENETUNREACH)


class LiveError(Exception):
    """Live capture is impossible. The message says what is wrong, where, and what to do."""


class LiveReader(Closing):
    """Frames of one interface; an iterator and a context manager.

    The iteration waits for frames and ends only after :meth:`close`, which may be called from another thread or a
    signal handler. While the interface is down or unplugged it waits for its return.
    """

    format = "live"
    position = 0
    size: int | None = None

    def __init__(self, interface: str, link: Link | None, *, promiscuous: bool = True) -> None:
        """Open ``interface`` for live capture.

        The kernel's filter passes only frames with the EtherType of ``link``; for a UDP link it passes all IP frames,
        without a link all frames. Up to two VLAN tags are skipped. ``promiscuous``: also capture frames to other
        stations.

        Raises :class:`LiveError` if the interface does not exist, is down or is not Ethernet, or if the privilege or
        scapy is missing.
        """
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
        """Return no problems: live frames have none."""
        return []

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Return the metadata of the recording, as ``interface.0`` in a pcapng file."""
        return {"interface.0": {"name": self.name, "linkType": "1", "resolution": "ns"}}

    @property
    def dropped(self) -> int:
        """Return the number of frames that the kernel dropped so far because they were not read in time."""
        self._count_dropped()
        return self._dropped

    def __iter__(self) -> Iterator[Frame]:
        return self

    def close(self) -> None:
        """End the iteration and release the interface. May be called at any time, from any thread, and repeatedly."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")
        # The waiting thread closes the socket itself: a descriptor must not be closed while another thread waits on it.
        if not self._reading:
            self._release()

    def __next__(self) -> Frame:
        self._reading = True
        try:
            # Check after the flag is set: then either this thread sees the close, or close() sees this reader.
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
        """Return the next frame; None if none arrived for a while or the reader was closed."""
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
        # A frame sent on the loopback interface is also received there; capture it once.
        if kind == sockets.OUTGOING and source.loops:
            return None
        tag, length = sockets.tag_of(ancillary)
        # Insert the tag that the kernel removed; it was part of the frame on the medium.
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
        # A missing interface is reported when the socket is opened.
        with contextlib.suppress(OSError):
            self._index = socket.if_nametoindex(self.name)
        self._socket = _listen(self.name, self._filter, promiscuous=self._promiscuous)

    def _look_for_interface(self) -> None:
        """Reopen the socket if the name now belongs to another interface, as after a radio was replugged."""
        try:
            index = socket.if_nametoindex(self.name)
        except OSError:
            # Removed for now; the socket would report the error again and again.
            self._let_go()
            return
        if index != self._index or self._socket is None:
            self._let_go()
            # The interface may disappear while it is opened; the next check finds it then.
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
    """Open a listening socket with a filter and an empty buffer."""
    try:
        opened = sockets.open_ethernet(interface, sockets.EVERY_ETHER_TYPE, promiscuous=promiscuous)
    except sockets.OpeningError as error:
        raise LiveError(f"{interface}: {error}") from None
    except OSError as error:
        raise LiveError(f"{interface}: this interface cannot be listened on ({error.strerror or error})") from None
    try:
        # Block all frames until those that arrived before the filter was installed are discarded.
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
    """Return the EtherTypes to capture, None for all."""
    if link is None:
        return None
    return _IP if link.transport == "udp" else (link.ether_type or 0,)


def _program(ether_types: tuple[int, ...] | None) -> _Program:
    """Return a kernel filter program: frames with one of these EtherTypes, also after one or two VLAN tags.

    The kernel removes the first tag of an incoming frame before the filter runs, so at most one more can follow.
    """
    if ether_types is None:
        return [(_RETURN, 0, 0, MAX_FRAME_LENGTH)]
    program: _Program = []
    each = len(ether_types) + len(_VLAN_TAGS)
    # Per offset: load, compare, refuse. The last instruction of all accepts.
    last = 3 * (1 + each + 1)
    for offset in (12, 16, 20):
        program.append((_LOAD_16, 0, 0, offset))
        for ether_type in ether_types:
            program.append((_JUMP_IF_EQUAL, last - len(program) - 1, 0, ether_type))
        # After a tag the next load is the instruction after this block's refusal.
        for left, tag in zip((1, 0), _VLAN_TAGS, strict=True):
            program.append((_JUMP_IF_EQUAL, left + 1 if offset < 20 else left, 0, tag))
        program.append((_RETURN, 0, 0, 0))
    program.append((_RETURN, 0, 0, MAX_FRAME_LENGTH))
    return program


def _attach(to: socket.socket, program: _Program) -> None:
    octets = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *each) for each in program))
    to.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", len(program), ctypes.addressof(octets)))
