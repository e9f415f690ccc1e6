"""Judge one frame that cannot be decoded: find the rules that its headers violate.

``Codec.salvage`` locates the parts of the frame, and each header field is compared with the specification. If that is
not sufficient, the frame is decoded under the assumption of each of some common faults: little-endian integers, a node
identifier of another width, a missing field, a structure copied from memory. If the whole block list is consistent with
a fault, the requirement of the fault is reported instead of those that its consequences violate.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import NamedTuple

from dcp_spec.reasons import REASONS, quantity

from dcp_codec.codec import Codec
from dcp_codec.errors import Problem
from dcp_codec.plan.tree import Scalar
from dcp_codec.views.fields import Dissection, Field
from dcp_codec.views.salvage import Salvaged
from dcp_conformance.definitions.broken_rules import broken_by

from .header_faults import REQUIREMENT_OF, explanation, layout_of

__all__ = ["Violation", "judge"]


class Violation(NamedTuple):
    """A rule that the octets of a frame violate.

    ``offset`` and ``length`` are those of the octets that show it, from the start of the bearer payload.
    ``requirement`` is an id of the catalogue; empty if the catalogue has none.
    """

    requirement: str
    expected: str
    observed: str
    offset: int
    length: int
    path: str = ""
    resized: bool = False
    """Whether the headers have another size than in the profile."""

    @property
    def requirements(self) -> tuple[str, ...]:
        """The requirement as a tuple for checks and findings; empty without a requirement."""
        return (self.requirement,) if self.requirement else ()

    def __str__(self) -> str:
        return f"{self.path or 'beacon'} at octet {self.offset}: {self.observed}; expected: {self.expected}"


def judge(
    octets: bytes, codec: Codec, *, network_id: int | None = None, source: bytes | None = None
) -> list[Violation]:
    """Return the violations of the bearer payload ``octets``; empty if it can be decoded. Never raise an exception.

    The most specific violation comes first, violations inside client payloads come last. Valid payloads have none.
    ``network_id`` (default: that of the profile) and ``source`` (the address of the station that sent the frame) help
    to distinguish faults with the same number of octets, such as a node identifier that is two octets too short and a
    missing network identifier.
    """
    salvaged = codec.salvage(octets)
    if not salvaged.problems:
        return []
    tree = codec.dissect(octets)
    # A sender does not send 0 payloads: another field must be at the position of numPayloads.
    nothing = any(each.reason == "zero-count" and not _inside(each) for each in salvaged.problems)
    if salvaged.clear and not nothing:
        header = list(_of_the_header(octets, codec, tree, salvaged))
        if len(header) < 2:
            return [*header, *_of_payloads(salvaged)]
    network_id = codec.profile.bp.network_id if network_id is None else network_id
    fault = explanation(octets, codec, network_id, source)
    if fault is not None:
        field = tree.root.find(f"bp.{fault.field}") or tree.root
        place = (field.offset, field.length, field.path or "bp")
        resized = fault.profile is not None and _start(layout_of(fault.profile).dissect(octets)) != _start(tree)
        return [Violation(each, fault.expected, fault.observed, *place, resized) for each in fault.requirements.split()]
    found = [*_of_the_header(octets, codec, tree, salvaged), *_of_payloads(salvaged)]
    known = {each.path for each in found}
    rest = [_as_violation(each) for each in salvaged.problems if each.path not in known and not _inside(each)]
    return [*found, *rest] or [_as_violation(salvaged.problems[0])]


def _start(tree: Dissection) -> int | None:
    """Return the position of the first payload block."""
    payloads = tree.root.child("payloads")
    return None if payloads is None else payloads.offset


def _inside(problem: Problem) -> bool:
    """Return whether a problem is in a client payload, not in the headers."""
    return ".srp" in problem.path or ".vardis" in problem.path


# -- fields with a known position --------------------------------------------------------------------------------------


def _of_the_header(octets: bytes, codec: Codec, tree: Dissection, salvaged: Salvaged) -> Iterator[Violation]:
    header = tree.root.child("bp")
    fields = {} if header is None else {each.name: each for each in header.children}
    for name in ("version", "magicNo"):
        field = fields.get(name)
        if field is not None and isinstance(field.layout, Scalar) and field.layout.rule is not None:
            right = field.layout.rule.value
            if field.value is not None and right is not None and field.value != right:
                yield _wrong(field, right, _swapped_text(field, right))
    payloads = tree.root.child("payloads")
    if not salvaged.clear or salvaged.beacon is None or payloads is None:
        return
    blocks = len(salvaged.beacon.payloads)
    length, count = fields.get("length"), fields.get("numPayloads")
    if salvaged.reading == "whole":
        first = payloads.children[0]
        place = first.child("length") or first
        text = f"{place.value}: it counts the header of the block as well"
        expected = "length counts the octets of the client payload only"
        yield Violation("BP-FMT-01", expected, text, place.offset, place.length, place.path)
    elif salvaged.reading == "count" and length is not None:
        end = _size_of_blocks(codec, salvaged)
        yield _wrong(length, end, _length_text(length, end, payloads.offset, blocks, codec, octets))
    elif count is not None and count.value != blocks:
        yield _wrong(count, blocks, f"{count.value}: there {'is' if blocks == 1 else 'are'} {blocks}")
    elif length is not None and any(each.path == length.path for each in salvaged.problems):
        # The field has a fixed value in the profile.
        problem = next(each for each in salvaged.problems if each.path == length.path)
        yield _as_violation(problem)


def _wrong(field: Field, right: int, observed: str) -> Violation:
    text = f"{field.name} is {right:#x}" if field.name in ("magicNo", "version") else f"{field.name} is {right}"
    return Violation(REQUIREMENT_OF[field.name], text, observed, field.offset, field.length, field.path)


def _swapped(field: Field) -> int:
    """Return the value of a field with its octets in reverse order."""
    return int.from_bytes(field.raw, "little" if getattr(field.layout, "order", "big") == "big" else "big")


def _swapped_text(field: Field, right: int) -> str:
    value = f"{field.value:#x}" if field.name in ("magicNo", "version") else f"{field.value}"
    return f"{value}: its octets are swapped" if field.length > 1 and _swapped(field) == right else value


def _size_of_blocks(codec: Codec, salvaged: Salvaged) -> int:
    """Return the size of all blocks with their headers, in octets."""
    assert salvaged.beacon is not None
    header = _block_header_size(codec)
    size = 0
    for number, each in enumerate(salvaged.beacon.payloads):
        damaged = salvaged.octets_of(number)
        if damaged is None:
            damaged = each.content if isinstance(each.content, bytes) else _encoded(codec, each.content)
        size += header + len(damaged)
    return size


def _encoded(codec: Codec, content: object) -> bytes:
    return codec.encode_containers(content) if isinstance(content, tuple) else codec.encode_report(content)  # type: ignore[arg-type]


def _length_text(field: Field, right: int, header: int, blocks: int, codec: Codec, octets: bytes) -> str:
    value = field.value
    what = {
        header: "it is the size of the header",
        len(octets): "it is the size of the whole frame",
        right - blocks * _block_header_size(codec): "it does not count the headers of the blocks",
        right + header: "it counts the header of the beacon as well",
    }
    if field.length > 1 and _swapped(field) == right:
        return f"{value}: its octets are swapped"
    text = what.get(value, "")
    return f"{value}: {text}" if text else f"{value}"


@functools.lru_cache(maxsize=64)
def _block_header_size(codec: Codec) -> int:
    """Return ssizeof(BPPayloadHeaderT) in the profile, in octets."""
    types = codec.profile.types
    size = 0
    for member in codec.profile.bp.payload_header:
        if isinstance(member, str):
            size += (types.protocol_id if member == "protocolId" else types.bp_length).width
        else:
            size += member.width or 0
    return size


def _of_payloads(salvaged: Salvaged) -> Iterator[Violation]:
    """Yield the violations inside client payloads."""
    seen = set()
    for problem in (*(each.problem for each in salvaged.damaged), *filter(_inside, salvaged.problems)):
        if problem not in seen:
            seen.add(problem)
            yield _as_violation(problem)


def _as_violation(problem: Problem) -> Violation:
    """Convert a problem of the codec to a violation."""
    requirement = (*broken_by(problem), "")[0]
    numbers = quantity(problem.reason, problem.needed, problem.available)
    observed = f"{REASONS[problem.reason]} ({numbers})" if numbers else REASONS[problem.reason]
    return Violation(requirement, "octets as the profile lays them out", observed, problem.offset, 1, problem.path)
