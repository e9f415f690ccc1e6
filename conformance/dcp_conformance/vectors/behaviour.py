"""Behaviour vectors: what a node receives and is asked, and what must, may and must not come out of it.

A unit test replays a vector on a new node without network or threads: it sets the clock of the node to the time of each
step, hands over a frame or calls a service, and notes what the node sends and indicates. Times are intervals. What a
vector does not list, of the kinds of :class:`Event`, must not come.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from typing import Any, Final, NamedTuple

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.plan.tree import Many
from dcp_codec.views.fields import Field

#: Services that show lists: the member with the list, and the member that identifies a row.
LISTS: Final = {
    "BP-ListRegisteredProtocols": ("protocols", "protocolId"),
    "SRP-NeighbourTable": ("neighbours", "nodeId"),
    "RTDB-DescribeDatabase": ("variables", "varId"),
}


class Event(NamedTuple):
    """Something that came out of a node."""

    time: float
    """Milliseconds since the node was started."""
    kind: str
    """``beacon`` (its header), ``payload`` (of a client protocol), ``record`` (of a container), ``indication`` (of a
    received payload), ``transmitted`` (BP-PayloadTransmitted.indication)."""
    number: int
    """Protocol identifier, or the type of the container; 0 for a beacon."""
    octets: str
    """Hex."""


class Step(msgspec.Struct, frozen=True, omit_defaults=True, rename="camel"):
    """A frame that the node receives (``receive``), or a service that is called."""

    at: int
    """Milliseconds since the node was started."""
    receive: str | None = None
    """Octets of the frame in hex, without the header of the link."""
    call: str | None = None
    params: Mapping[str, Any] = {}
    status: Sequence[str] = ()
    """Statuses of which the confirm has one; empty: any, or none."""
    result: Mapping[str, Any] = {}
    """Values of the confirm by path: ``number``, ``variable.seqno``, ``protocols[16385].maxEntries``; None: there is
    no such row."""
    requirement: str = ""


class Expect(msgspec.Struct, frozen=True, omit_defaults=True):
    """Number of occurrences of an event in an interval; outside of it, it does not come."""

    kind: str
    number: int
    octets: str
    """Hex; ``?`` stands for any digit."""
    after: int
    """First millisecond."""
    before: int
    """Last millisecond."""
    least: int = 0
    most: int | None = None
    requirement: str = ""


class Vector(msgspec.Struct, frozen=True, omit_defaults=True, rename="camel"):
    """One behaviour vector."""

    tc_id: str
    comment: str
    flags: Sequence[str]
    requirements: Sequence[str]
    """The requirements that it is about."""
    end: int
    """Milliseconds at which it ends."""
    steps: Sequence[Step]
    expect: Sequence[Expect]


class Settings(msgspec.Struct, frozen=True, rename="camel"):
    """The node that the vectors are for."""

    node_id: str
    wall_clock: int
    """Its clock when it is started, in ns since 1970."""
    parameters: Mapping[str, Any]


class BehaviourGroup(msgspec.Struct, frozen=True):
    """All behaviour vectors of a node with these settings."""

    settings: Settings
    tests: Sequence[Vector]


def load(profile: str) -> BehaviourGroup | None:
    """Return the behaviour vectors of a profile; None if there are none."""
    path = resources.files("dcp_conformance").joinpath("data", f"behaviour-{profile}.json.gz")
    return msgspec.json.decode(gzip.decompress(path.read_bytes()), type=BehaviourGroup) if path.is_file() else None


def profiles() -> list[str]:
    """Return the names of the profiles that have behaviour vectors, the newest version first."""
    names = (path.name for path in resources.files("dcp_conformance").joinpath("data").iterdir())
    found = [re.fullmatch(r"behaviour-(.+)\.json\.gz", name) for name in names]
    return sorted((each[1] for each in found if each is not None), reverse=True)


# -- what came ---------------------------------------------------------------------------------------------------------


def events_of(codec: Codec, octets: bytes, time: float) -> Iterator[Event]:
    """Yield the events in a beacon of the node."""
    try:
        envelope, _ = codec.decode_envelope(octets)
    except DecodeError as error:
        yield Event(time, "beacon", 0, f"{octets.hex()} is none: {error}")
        return
    root = codec.dissect(octets).root
    header = root.child("bp")
    if header is not None:
        yield Event(time, "beacon", 0, _masked(octets, header, ("seqno", "length", "numPayloads")))
    for payload in envelope.payloads:
        if payload.protocol_id != BP_PROTID_VARDIS:
            yield Event(time, "payload", payload.protocol_id, (payload.data or b"").hex())
    for field in root.walk():
        if field.name == "icType":
            kind = field.value
        elif field.name == "records" and isinstance(field.layout, Many):
            for each in field.children:
                yield Event(time, "record", kind, _masked(octets, each, ()))


def _masked(octets: bytes, record: Field, names: tuple[str, ...]) -> str:
    """Return a record in hex, with ``?`` for the fields of these names."""
    text = octets[record.offset : record.offset + record.length].hex()
    for each in record.walk():
        if each.name in names and not each.children:
            start, size = 2 * (each.offset - record.offset), 2 * each.length
            text = text[:start] + "?" * size + text[start + size :]
    return text


def matches(pattern: str, octets: str) -> bool:
    """Return whether octets in hex have the form of a pattern; ``?`` is any digit."""
    return len(pattern) == len(octets) and all(
        one in ("?", other) or other == "?" for one, other in zip(pattern, octets, strict=True)
    )


def flat(method: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the members of a confirm by path; rows of lists are named by what identifies them."""
    name, key = LISTS.get(method, ("", ""))
    found: dict[str, Any] = {}
    for member, value in result.items():
        if member == name:
            for row in value:
                found |= {f"{name}[{row.get(key)}]": True}
                found |= {f"{name}[{row.get(key)}].{each}": shown for each, shown in row.items()}
        elif isinstance(value, Mapping):
            found |= {f"{member}.{each}": shown for each, shown in value.items()}
        elif member != "status":
            found[member] = value
    return found


# -- judging ---------------------------------------------------------------------------------------------------------


def answered(step: Step, status: str, result: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is wrong with the answer to a service call."""
    assert step.call is not None
    if step.status and status not in step.status:
        yield f"{step.at} ms {step.call}: status {status}, not {' or '.join(step.status)} [{step.requirement}]"
        return
    shown = flat(step.call, result)
    for path, value in step.result.items():
        # An implementation need not show each member.
        absent = None if path.endswith("]") or value is None else value
        if shown.get(path, absent) != value:
            yield f"{step.at} ms {step.call}: {path} is {shown.get(path)}, not {value} [{step.requirement}]"


def judged(vector: Vector, events: Iterable[Event]) -> Iterator[str]:
    """Yield what is wrong with the events of a vector."""
    counts = [0] * len(vector.expect)
    by_kind: dict[tuple[str, int], list[int]] = {}
    for place, each in enumerate(vector.expect):
        by_kind.setdefault((each.kind, each.number), []).append(place)
    why = " ".join(vector.requirements[:3])
    for event in events:
        for place in by_kind.get((event.kind, event.number), ()):
            each = vector.expect[place]
            if each.after <= event.time <= each.before and matches(each.octets, event.octets):
                counts[place] += 1
                break
        else:
            yield f"{event.time:g} ms: {event.kind} {event.number} {event.octets} must not come [{why}]"
    for each, count in zip(vector.expect, counts, strict=True):
        if count < each.least or (each.most is not None and count > each.most):
            wanted = f"{each.least} to {each.most}" if each.most is not None else f"at least {each.least}"
            what = f"{each.kind} {each.number} {each.octets} from {each.after} to {each.before} ms"
            yield f"{what}: {count} times, not {wanted} [{each.requirement or why}]"


# -- the form for languages without JSON -------------------------------------------------------------------------------


def lines(found: BehaviourGroup) -> Iterator[str]:
    """Yield the vectors as lines of fields that end with tabs.

    ``N`` node identifier, wall clock; ``T`` identifier, end; ``F`` time, frame; ``C`` time, statuses, request of the
    upper tester; ``R`` path and value in its answer; ``E`` kind, number, octets, after, before, least, most.
    """
    yield f"N\t{found.settings.node_id.replace(':', '')}\t{found.settings.wall_clock}"
    for vector in found.tests:
        yield f"T\t{vector.tc_id}\t{vector.end}"
        for number, step in enumerate(vector.steps, 1):
            if step.receive is not None:
                yield f"F\t{step.at}\t{step.receive}"
                continue
            request = {"jsonrpc": "2.0", "id": number, "method": step.call, "params": step.params}
            yield f"C\t{step.at}\t {' '.join(step.status)} \t{msgspec.json.encode(request).decode()}"
            for path, value in step.result.items():
                yield f"R\t{path}\t{msgspec.json.encode(value).decode()}"
        for each in vector.expect:
            most = "-" if each.most is None else each.most
            counts = f"{each.after}\t{each.before}\t{each.least}\t{most}"
            yield f"E\t{each.kind}\t{each.number}\t{each.octets or '-'}\t{counts}"
