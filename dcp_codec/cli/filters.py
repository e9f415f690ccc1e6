"""Selection of frames by the options of the user."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

import click
import msgspec
from dcp_spec.constants import ICType

from dcp_codec.capture import Frame
from dcp_codec.framing.frames import DissectedFrame
from dcp_codec.views.fields import Field

_PROTOCOLS = {"srp": 1, "vardis": 2}


class Moment(msgspec.Struct, frozen=True):
    """A bound in time: ns since 1970, or ns after the first frame when ``relative``."""

    ns: int
    relative: bool = False


def parse_time(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Moment | None:
    """Parse ``+1.5`` (s after the first frame), ``1795225151.68`` (s since 1970) or an ISO 8601 time (UTC)."""
    if value is None:
        return None
    if match := re.fullmatch(r"(\+?)(\d+)(?:\.(\d{1,9}))?", value):
        ns = int(match[2]) * 10**9 + int((match[3] or "").ljust(9, "0"))
        return Moment(ns, relative=bool(match[1]))
    # Python's ISO parser reads microseconds; recordings have nanoseconds.
    iso, fraction = value, ""
    if match := re.fullmatch(r"(.*:\d\d)\.(\d{1,9})(.*)", value):
        iso, fraction = match[1] + match[3], match[2]
    try:
        moment = datetime.fromisoformat(iso)
    except ValueError:
        raise click.BadParameter(f"{value!r} is not an ISO 8601 time, epoch seconds, or +seconds") from None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return Moment(int(moment.timestamp()) * 10**9 + int(fraction.ljust(9, "0")))


def frame_range(_ctx: click.Context, _param: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Parse ``7``, ``7-12`` or ``7-``."""
    if value is None:
        return None
    match = re.fullmatch(r"(\d+)(?:(-)(\d*))?", value)
    if match is None:
        raise click.BadParameter(f"{value!r} is not a frame number or range such as 7, 7-12 or 7-")
    first = int(match[1])
    last = first if match[2] is None else int(match[3]) if match[3] else 1 << 62
    return first, last


def _container(name: str) -> str:
    """Return the label of a container type, or its number as text."""
    label = name.upper().replace("_", "-").removeprefix("ICTYPE-")
    known = [each.label for each in ICType]
    if label not in known and not label.isdecimal():
        raise click.BadParameter(
            f"{name!r} is not one of {', '.join(known)} or a type number", param_hint="--container"
        )
    return label


class Filter:
    """A filter for frames. All conditions must hold; a condition with several values holds if one value matches."""

    def __init__(
        self,
        *,
        senders: Sequence[str],
        protocols: Sequence[str],
        containers: Sequence[str],
        variables: Sequence[int],
        frames: tuple[int, int] | None,
        start: Moment | None,
        end: Moment | None,
        errors_only: bool,
    ) -> None:
        self.senders = {sender.lower().replace("-", ":") for sender in senders}
        self.protocols = {_protocol(name) for name in protocols}
        self.containers = {_container(name) for name in containers}
        self.variables = set(variables)
        self.frames = frames
        self.start = start
        self.end = end
        self.errors_only = errors_only
        self._first: int | None = None

    def see(self, frame: Frame) -> None:
        """Process a frame, DCP or not: relative times count from the first one."""
        if self._first is None:
            self._first = frame.time_ns

    @property
    def origin(self) -> int:
        """Return the time of the first frame of the recording in ns; 0 before it."""
        return self._first or 0

    def _ns(self, moment: Moment) -> int:
        return moment.ns + self.origin if moment.relative else moment.ns

    def wants(self, found: DissectedFrame) -> bool:
        """Return whether to show this frame."""
        frame = found.frame
        if self.frames is not None and not self.frames[0] <= frame.number <= self.frames[1]:
            return False
        if self.start is not None and frame.time_ns < self._ns(self.start):
            return False
        if self.end is not None and frame.time_ns > self._ns(self.end):
            return False
        if self.errors_only and not found.dissection.errors:
            return False
        if self.senders and found.sender not in self.senders:
            return False
        if self.protocols and not any(_value(p, "protocolId") in self.protocols for p in found.payloads):
            return False
        return not (self.containers or self.variables) or self._wants_records(found)

    def _wants_records(self, found: DissectedFrame) -> bool:
        for payload in found.payloads:
            containers = payload.child("vardis")
            for container in containers.children if containers is not None else ():
                kind = container.child("icType")
                if self.containers and (kind is None or not {kind.label, str(kind.value)} & self.containers):
                    continue
                if not self.variables:
                    return True
                records = container.child("records")
                for record in records.children if records is not None else ():
                    if _value(record.child("spec") or record, "varId") in self.variables:
                        return True
        return False


def _value(record: Field, name: str) -> object:
    field = record.child(name)
    return None if field is None else field.value


def _protocol(name: str) -> int:
    if name.lower() in _PROTOCOLS:
        return _PROTOCOLS[name.lower()]
    try:
        return int(name, 0)
    except ValueError:
        raise click.BadParameter(
            f"{name!r} is neither srp, vardis nor a protocol number", param_hint="--protocol"
        ) from None
