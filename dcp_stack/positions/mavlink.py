"""A source of positions from the MAVLink stream of an autopilot. Requires pymavlink, imported on opening.

pymavlink only parses messages: its connections wait, sleep and print. Axes: the local position of MAVLink is north,
east, down (LOCAL_POSITION_NED). Safety data here is east, north, up, like the simulated tracks: x = y_ned, y = x_ned,
z = -z_ned, and the same for velocities; ``frame=ned`` leaves the axes unchanged. With an ``origin``, which gives all
nodes the same local frame, the source uses GLOBAL_POSITION_INT instead: each vehicle has its own origin of the local
position.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import math
import os
import socket
from collections.abc import Callable
from typing import Any, Final, Literal

from dcp_codec.common.extras import advice

from .base import PositionSource, Sample, SourceError
from .fields import FieldError, SafetyFields
from .geometry import NS_PER_S, Vector
from .tracks import as_sample

RECONNECT_NS: Final = NS_PER_S
SILENCE_NS: Final = 5 * NS_PER_S
"""Time in ns without a position after which the source complains."""
_LARGEST: Final = 65_536
_READS_PER_POLL: Final = 256

# WGS 84.
_SEMI_MAJOR: Final = 6_378_137.0
_ECCENTRICITY_2: Final = 6.69437999014e-3

Origin = tuple[float, float, float]
"""Latitude and longitude in degrees, altitude above mean sea level in m."""


class _SocketPort:
    """A UDP socket bound to an address, or a TCP connection to one. It never waits."""

    def __init__(self, kind: socket.SocketKind, host: str, port: int) -> None:
        family, _, _, _, address = socket.getaddrinfo(host or "0.0.0.0", port, type=kind)[0]  # noqa: S104 - as asked
        self._socket = socket.socket(family, kind)
        self._stream = kind == socket.SOCK_STREAM
        try:
            self._socket.setblocking(False)
            if not self._stream:
                self._socket.bind(address)
            elif (code := self._socket.connect_ex(address)) not in (0, errno.EINPROGRESS):
                raise OSError(code, os.strerror(code))
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        return self._socket.fileno()

    def recv(self) -> bytes:
        octets = self._socket.recv(_LARGEST)
        if not octets and not self._stream:
            # An empty datagram is not the end of a stream.
            raise BlockingIOError
        return octets

    def close(self) -> None:
        self._socket.close()


class _SerialPort:
    """A serial line in raw mode. It never waits."""

    def __init__(self, device: str, baud: int) -> None:
        import termios
        import tty

        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise OSError(f"this system does not support {baud} baud")
        self._fd = os.open(device, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(self._fd)
            attributes = termios.tcgetattr(self._fd)
            attributes[4] = attributes[5] = speed
            termios.tcsetattr(self._fd, termios.TCSANOW, attributes)
        except termios.error as error:
            os.close(self._fd)
            raise OSError(f"is not a serial line ({error})") from None

    def fileno(self) -> int:
        return self._fd

    def recv(self) -> bytes:
        return os.read(self._fd, _LARGEST)

    def close(self) -> None:
        os.close(self._fd)


_Port = _SocketPort | _SerialPort
"""An open connection. Its method ``recv`` returns the octets that have arrived, an empty string at the end of the
stream; it raises BlockingIOError if no octets have arrived, OSError if the connection fails."""


def port_opener(connection: str) -> Callable[[], _Port]:
    """Return a function that opens ``udpin:HOST:PORT``, ``tcp:HOST:PORT`` or ``serial:DEVICE:BAUD``.

    Raises SourceError for any other text. The function raises OSError.
    """
    kind, _, rest = connection.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udpin", "tcp", "serial") or not place or not number.isdecimal():
        raise SourceError(f"a connection is udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD, not {connection!r}")
    if kind == "serial":
        return lambda: _SerialPort(place, int(number))
    if not 0 < int(number) < 65_536:
        raise SourceError(f"a port is 1 to 65535, not {number}")
    how = socket.SOCK_DGRAM if kind == "udpin" else socket.SOCK_STREAM
    return lambda: _SocketPort(how, place.strip("[]"), int(number))


def _parser() -> Any:
    """Return a new MAVLink parser. Raises SourceError with advice if pymavlink is not installed."""
    try:
        # Imported by name, because the package is optional and has no type information.
        common = importlib.import_module("pymavlink.dialects.v20.common")
    except ImportError:
        raise SourceError(advice("pymavlink")) from None
    made = common.MAVLink(None)
    made.robust_parsing = True
    return made


class MavlinkStream(PositionSource):
    """Provides position and velocity of one vehicle. After a failure it reopens the connection, once per second."""

    def __init__(
        self,
        name: str,
        fields: SafetyFields,
        connection: str,
        *,
        system: int | None = None,
        frame: Literal["enu", "ned"] = "enu",
        origin: Origin | None = None,
    ) -> None:
        """``system``: MAVLink system id of the vehicle; None for the first one received.

        Raises SourceError if pymavlink is not installed or the connection cannot be opened. A TCP server that does not
        answer yet is not an error.
        """
        super().__init__(name)
        self._fields, self._system, self._frame, self._origin = fields, system, frame, origin
        self._open = port_opener(connection)
        self._mav = _parser()
        self._port: _Port | None = None
        self._retry: int | None = None
        self._quiet_until: int | None = None
        try:
            self._port = self._open()
        except OSError as error:
            raise SourceError(f"cannot be opened ({error.strerror or error})") from None
        self._closed = False

    @property
    def finished(self) -> bool:
        """Whether :meth:`close` was called; until then the vehicle may send again at any time."""
        return self._closed

    def fileno(self) -> int:
        """Return the descriptor of the connection, -1 while there is none. It changes when the source reconnects."""
        return self._port.fileno() if self._port is not None else -1

    def poll_timeout(self) -> int | None:
        """Return when to reopen the connection or to complain about silence; 0 before the first poll."""
        if self._closed:
            return None
        if self._port is None:
            return self._retry
        return 0 if self._quiet_until is None and "silent" not in self.counts else self._quiet_until

    def poll(self, now: int, wall: int) -> list[Sample]:  # noqa: ARG002 - the same call for every source
        """Return the positions in the messages that have arrived."""
        if self._closed:
            return []
        if self._port is None and not self._reopen(now):
            return []
        found: list[Sample] = []
        for _ in range(_READS_PER_POLL):
            octets = self._receive(now)
            if octets is None:
                break
            for message in self._parse(octets):
                self._take(message, found)
        self._watch_silence(now, heard=bool(found))
        return found

    def _reopen(self, now: int) -> bool:
        """Open the connection again if it is time to; returns whether it is open."""
        if self._retry is not None and now < self._retry:
            return False
        try:
            self._port = self._open()
        except OSError as error:
            self._broken(now, str(error))
            return False
        self._mav = _parser()
        return True

    def _receive(self, now: int) -> bytes | None:
        """Return the octets that have arrived, None if there are none or the connection failed."""
        if self._port is None:
            return None
        try:
            octets = self._port.recv()
        except BlockingIOError:
            return None
        except OSError as error:
            self._broken(now, str(error))
            return None
        if not octets:
            self._broken(now, "the other end closed the connection")
            return None
        return octets

    def _broken(self, now: int, why: str) -> None:
        """Close a failed connection, schedule the next attempt, and complain."""
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
        self._port = None
        self._retry = now + RECONNECT_NS
        self.complain("disconnected", f"there is no connection ({why}); trying again every second")

    def _parse(self, octets: bytes) -> list[Any]:
        """Return the messages in received octets; complain about invalid ones."""
        try:
            return self._mav.parse_buffer(octets) or []
        except Exception as error:
            # pymavlink does not check everything before it unpacks. Any exception here is caused by received octets.
            self.complain("bad-data", f"data that is not valid MAVLink was ignored ({error})")
            self._mav = _parser()
            return []

    def _take(self, message: Any, found: list[Sample]) -> None:
        """Append the sample of a position message of the vehicle to ``found``; ignore other messages."""
        kind = message.get_type()
        if kind == "BAD_DATA":
            self.complain("bad-data", "data that is not valid MAVLink was ignored")
            return
        if kind != ("LOCAL_POSITION_NED" if self._origin is None else "GLOBAL_POSITION_INT"):
            return
        system = message.get_srcSystem()
        if self._system is None:
            self._system = system
        if system != self._system:
            self.complain(
                "other-system", f"positions of system {system} are ignored; the source uses system {self._system}"
            )
            return
        try:
            position, velocity = self._local(message) if self._origin is None else self._global(message, self._origin)
            # An autopilot sends NaN for unknown values.
            if not all(map(math.isfinite, position)):
                raise FieldError("the autopilot does not know its position")
            moving = velocity if all(map(math.isfinite, velocity)) else None
            found.append(self._fields.from_sample(as_sample(position, moving)))
        except FieldError as error:
            self.complain("out-of-range", f"a position was ignored: {error}")

    def _local(self, message: Any) -> tuple[Vector, Vector]:
        """Return position and velocity of a LOCAL_POSITION_NED message."""
        return (
            self._turned((message.x, message.y, message.z)),
            self._turned((message.vx, message.vy, message.vz)),
        )

    def _turned(self, ned: Vector) -> Vector:
        """Convert a vector from north, east, down to the axes of this source."""
        north, east, down = ned
        return ned if self._frame == "ned" else (east, north, -down)

    def _global(self, message: Any, origin: Origin) -> tuple[Vector, Vector]:
        """Return position (relative to ``origin``) and velocity of a GLOBAL_POSITION_INT message."""
        # Units of the message: 1e-7 degrees, mm, cm/s.
        east, north, up = local(message.lat / 1e7, message.lon / 1e7, message.alt / 1e3, origin)
        velocity = (message.vx / 100, message.vy / 100, message.vz / 100)
        return self._turned((north, east, -up)), self._turned(velocity)

    def _watch_silence(self, now: int, *, heard: bool) -> None:
        """Complain if no position has arrived for :data:`SILENCE_NS`; ``heard``: one has arrived now."""
        if heard:
            self._quiet_until = now + SILENCE_NS
        elif self._quiet_until is None:
            if "silent" not in self.counts:
                self._quiet_until = now + SILENCE_NS
        elif now >= self._quiet_until:
            wanted = "LOCAL_POSITION_NED" if self._origin is None else "GLOBAL_POSITION_INT"
            self.complain("silent", f"no {wanted} for {SILENCE_NS // NS_PER_S} s; does the autopilot stream it here?")
            self._quiet_until = None

    def close(self) -> None:
        """Close the connection."""
        if self._port is not None:
            self._port.close()
        self._port = None
        self._closed = True


def local(latitude: float, longitude: float, altitude: float, origin: Origin) -> Vector:
    """Convert latitude and longitude (degrees) and altitude (m) to east, north and up of ``origin`` in m.

    The result is in the plane that is tangent to the WGS 84 ellipsoid at the origin. The error of this approximation
    is less than 0.1 % within 10 km of the origin, up to latitudes of 80 degrees.
    """
    at, meridian, height = origin
    sine = math.sin(math.radians(at))
    across = _SEMI_MAJOR / math.sqrt(1 - _ECCENTRICITY_2 * sine * sine)
    along = across * (1 - _ECCENTRICITY_2) / (1 - _ECCENTRICITY_2 * sine * sine)
    turn = (longitude - meridian + 180) % 360 - 180
    east = math.radians(turn) * (across + height) * math.cos(math.radians(at))
    return (east, math.radians(latitude - at) * (along + height), altitude - height)
