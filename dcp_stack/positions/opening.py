"""Opening of position sources by text: ``open_source("track:circle,radius=50,speed=5")``."""

from __future__ import annotations

import difflib
import math
import random
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from dcp_codec.codec import Codec, get_codec

from .base import PositionSource, SourceError
from .fields import SafetyFields
from .geometry import Vector

#: Kind of a source -> its syntax, for usage texts.
SOURCES: Final = {
    "track": (
        "track:line|circle|waypoints|walk,KEY=VALUE,... with rate (per s, 20), speed (m/s), x, y, z (m); line: course,"
        " climb, length; circle: radius, phase; waypoints: points=X/Y/Z;X/Y/Z, loop; walk: extent, turn"
    ),
    "csv": "csv:FILE[,speed=FACTOR][,loop=yes] with a header such as time,x,y,z",
    "capture": "capture:FILE[,node=ID][,profile=NAME][,speed=FACTOR][,loop=yes], a pcap, pcapng or MCAP file",
    "stdin": "stdin, one JSON object per line",
    "mavlink": (
        "mavlink:udpin:HOST:PORT|tcp:HOST:PORT|serial:DEVICE:BAUD[,system=N][,frame=enu|ned][,origin=LAT/LON/ALT]"
    ),
}


def open_source(spec: str, codec: Codec, *, rng: random.Random, stdin: int | None = None) -> PositionSource:
    """Open the source that ``spec`` describes (see :data:`SOURCES`) for a node of ``codec``'s profile.

    ``rng``: generator for random tracks. ``stdin``: the descriptor for the source ``stdin`` (default: standard input).
    Raises SourceError with the problem and the valid choices.
    """
    kind, _, rest = spec.partition(":")
    fields = SafetyFields(codec.profile)
    if kind not in _OPENERS:
        near = difflib.get_close_matches(kind, SOURCES, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known sources are {', '.join(SOURCES)}"
        raise SourceError(f"{spec}: no position source {kind!r}; {hint}")
    if not fields.numbers():
        raise SourceError(f"{spec}: profile {codec.profile.name} has no safety data that could hold a position")
    try:
        return _OPENERS[kind](_Request(spec, rest, codec, fields, rng, stdin))
    except ValueError as error:
        # SourceError, FieldError and ProfileError are ValueErrors; their messages get the source here.
        raise SourceError(f"{spec}: {error}") from None


class _Request(NamedTuple):
    """The arguments of :func:`open_source`; ``rest`` is the part of ``spec`` after the kind."""

    spec: str
    rest: str
    codec: Codec
    fields: SafetyFields
    rng: random.Random
    stdin: int | None


class _Options:
    """The options of a spec: ``key=value`` parts after the first part, which may itself contain commas."""

    def __init__(self, rest: str, known: frozenset[str]) -> None:
        """Split ``rest`` into :attr:`head` and options with ``known`` keys. Raises SourceError for a repeated key."""
        parts = rest.split(",")
        first = len(parts)
        while first > 1 and parts[first - 1].partition("=")[0].strip() in known and "=" in parts[first - 1]:
            first -= 1
        self.head = ",".join(parts[:first])
        self._values: dict[str, str] = {}
        for part in parts[first:]:
            key, _, value = part.partition("=")
            if key.strip() in self._values:
                raise SourceError(f"{key.strip()} is given twice")
            self._values[key.strip()] = value.strip()

    def text(self, key: str) -> str | None:
        """Return the value of an option, None if it is not given."""
        return self._values.get(key)

    def number(self, key: str, default: float) -> float:
        """Return an option as a finite number. Raises SourceError for any other text."""
        text = self._values.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise SourceError(f"{key} takes a number, not {text!r}")
        return value

    def integer(self, key: str, low: int, high: int) -> int | None:
        """Return an option as an integer within bounds, None if it is not given. Raises SourceError."""
        text = self._values.get(key)
        if text is None:
            return None
        if not text.isdecimal() or not low <= int(text) <= high:
            raise SourceError(f"{key} takes an integer from {low} to {high}, not {text!r}")
        return int(text)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return an option as yes or no. Raises SourceError for any other text."""
        text = self._values.get(key)
        if text is None:
            return default
        if text.lower() not in ("yes", "no", "1", "0", "true", "false"):
            raise SourceError(f"{key} takes yes or no, not {text!r}")
        return text.lower() in ("yes", "1", "true")

    def place(self) -> Vector:
        """Return the options x, y and z as a position in m; 0 for an option that is not given."""
        return (self.number("x", 0.0), self.number("y", 0.0), self.number("z", 0.0))


def _options(rest: str, known: frozenset[str]) -> _Options:
    """Return the options of a spec whose first part has no commas. Raises SourceError for an unknown option."""
    for part in rest.split(",")[1:]:
        key, equals, _ = part.partition("=")
        if not equals:
            raise SourceError(f"{part!r} is not of the form key=value")
        if key.strip() not in known:
            raise SourceError(f"no option {key.strip()!r}; known options are {', '.join(sorted(known))}")
    return _Options(rest, known)


_COMMON: Final = frozenset({"rate", "speed", "x", "y", "z"})
#: Track -> its options in addition to the common ones.
_TRACKS: Final = {
    "line": frozenset({"course", "climb", "length"}),
    "circle": frozenset({"radius", "phase"}),
    "waypoints": frozenset({"points", "loop"}),
    "walk": frozenset({"extent", "turn"}),
}


def _track(request: _Request) -> PositionSource:
    """Open a simulated track."""
    from . import tracks

    shape = request.rest.partition(",")[0]
    if shape not in _TRACKS:
        raise SourceError(f"no track {shape!r}; known tracks are {', '.join(_TRACKS)}")
    if not request.fields.has_position:
        raise SourceError(f"profile {request.codec.profile.name} has no fields for a position")
    given = _options(request.rest, _COMMON | _TRACKS[shape])
    place, speed = given.place(), given.number("speed", 5.0)
    path: tracks.Path
    match shape:
        case "line":
            length = given.number("length", 0.0) if given.text("length") is not None else None
            course, climb = given.number("course", 0.0), given.number("climb", 0.0)
            path = tracks.Line(place, course=course, speed=speed, climb=climb, length=length)
        case "circle":
            radius, phase = given.number("radius", 50.0), given.number("phase", 0.0)
            path = tracks.Circle(place, radius=radius, speed=speed, phase=phase)
        case "waypoints":
            points = [_triple("points", point) for point in (given.text("points") or "").split(";")]
            path = tracks.Waypoints(points, speed=speed, loop=given.flag("loop", default=True))
        case _:
            extent, turn = given.number("extent", 100.0), given.number("turn", 30.0)
            path = tracks.RandomWalk(place, speed=speed, extent=extent, turn=turn, rng=request.rng)
    return tracks.Track(request.spec, path, request.fields, rate=given.number("rate", tracks.RATE))


def _triple(key: str, text: str) -> Vector:
    """Return three numbers that are separated by slashes. Raises SourceError for any other text."""
    try:
        x, y, z = (float(part) for part in text.split("/"))
    except ValueError:
        x = y = z = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise SourceError(f"{key} takes three numbers separated by /, not {text!r}")
    return (x, y, z)


def _csv(request: _Request) -> PositionSource:
    """Open a replay of a CSV file."""
    from .replay import Replay, read_csv

    given = _Options(request.rest, frozenset({"speed", "loop"}))
    samples = read_csv(Path(given.head), request.fields)
    return Replay(request.spec, samples, speed=given.number("speed", 1.0), loop=given.flag("loop", default=False))


def _capture(request: _Request) -> PositionSource:
    """Open a replay of the state reports in a recording."""
    from .replay import Replay, read_capture

    given = _Options(request.rest, frozenset({"node", "profile", "speed", "loop"}))
    profile = given.text("profile")
    recorded = request.codec if profile is None else get_codec(profile)
    samples = read_capture(Path(given.head), recorded, given.text("node"), request.fields)
    return Replay(request.spec, samples, speed=given.number("speed", 1.0), loop=given.flag("loop", default=False))


def _stdin(request: _Request) -> PositionSource:
    """Open standard input, or the given descriptor, for JSON lines."""
    from .jsonlines import JsonLines

    if request.rest:
        raise SourceError("stdin takes no options")
    fd = sys.stdin.fileno() if request.stdin is None else request.stdin
    return JsonLines(request.spec, request.fields, fd=fd)


def _mavlink(request: _Request) -> PositionSource:
    """Open a MAVLink stream."""
    from .mavlink import MavlinkStream

    if not request.fields.has_position:
        raise SourceError(f"profile {request.codec.profile.name} has no fields for a position")
    given = _options(request.rest, frozenset({"system", "frame", "origin"}))
    frame = given.text("frame") or "enu"
    if frame not in ("enu", "ned"):
        raise SourceError(f"frame is enu or ned, not {frame!r}")
    origin = None if (text := given.text("origin")) is None else _triple("origin", text)
    if origin is not None and not (abs(origin[0]) < 90 and abs(origin[1]) <= 180):
        raise SourceError("origin takes a latitude between -90 and 90, a longitude and an altitude (degrees and m)")
    return MavlinkStream(
        request.spec,
        request.fields,
        given.head,
        system=given.integer("system", 1, 255),
        frame="ned" if frame == "ned" else "enu",
        origin=origin,
    )


_OPENERS: Final[dict[str, Callable[[_Request], PositionSource]]] = {
    "track": _track,
    "csv": _csv,
    "capture": _capture,
    "stdin": _stdin,
    "mavlink": _mavlink,
}
