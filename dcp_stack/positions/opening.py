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
from dcp_stack.options import Options

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
    given = Options(request.rest, _COMMON | _TRACKS[shape])
    place = (given.number("x", 0.0), given.number("y", 0.0), given.number("z", 0.0))
    speed = given.number("speed", 5.0)
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

    given = Options(request.rest, ("speed", "loop"), of_a_file=True)
    samples = read_csv(Path(given.head), request.fields)
    return Replay(request.spec, samples, speed=given.number("speed", 1.0), loop=given.flag("loop", default=False))


def _capture(request: _Request) -> PositionSource:
    """Open a replay of the state reports in a recording."""
    from .replay import Replay, read_capture

    given = Options(request.rest, ("node", "profile", "speed", "loop"), of_a_file=True)
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
    given = Options(request.rest, ("system", "frame", "origin"))
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
