"""Why `check` has not found a faulty node: what differs on the air, and which rules could have spoken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_conformance.frames.received import KIND_OF
from dcp_conformance.model.results import CaseResult

#: Octets of a frame before the beacon: the header of Ethernet.
_HEADER: Final = 14
#: Kinds of records that are compared, in the order in which they are told.
_KINDS: Final = tuple(ICType)


def reason(
    requirements: Sequence[str],
    octets: Sequence[bytes],
    usual: Sequence[bytes],
    cases: Sequence[CaseResult],
    codec: Codec,
) -> str:
    """The reason in one line: rules about the requirements of the mutant, then what differs from our node.

    ``octets`` are the frames of the network with the mutant, ``usual`` those of the same network with our node,
    ``cases`` what `check` says about the former.
    """
    return f"{_rules(requirements, cases)}; {_difference(octets, usual, codec)}"


def _rules(requirements: Sequence[str], cases: Sequence[CaseResult]) -> str:
    """Which rules are about the requirements, and how many occasions the recording gave them."""
    about = [case for case in cases if set(case.requirements) & set(requirements)]
    names = ", ".join(requirements)
    if not about:
        return f"check has no rule about {names}: other nodes, loss or the application may show the same"
    told = []
    for case in about:
        occasions = max((case.occasions.get(each, 0) for each in requirements), default=0)
        told.append(
            f"{case.id} {f'had {occasions:,} occasions and nothing against it' if occasions else 'had no occasion'}"
        )
    return ", ".join(told)


def _difference(octets: Sequence[bytes], usual: Sequence[bytes], codec: Codec) -> str:
    """What differs: the first field, how many beacons, and how often each kind of record is sent by all nodes."""
    first = next((number for number, (mine, ours) in enumerate(zip(octets, usual, strict=False)) if mine != ours), None)
    if first is None:
        return f"the first {min(len(octets), len(usual)):,} frames are the same, and then one network sends more"
    known = Counter(usual)
    differing = sum((Counter(octets) - known).values())
    text = f"{differing:,} of {len(octets):,} beacons differ, the first, frame {first + 1}, in"
    text += f" {_field(octets[first], usual[first], codec)}"
    mine, ours = _counts(octets, codec), _counts(usual, codec)
    changed = [f"{kind.label} {ours[kind]:,} -> {mine[kind]:,}" for kind in _KINDS if mine[kind] != ours[kind]]
    return f"{text}; records: {', '.join(changed) or 'as many of each kind'}"


def _field(mine: bytes, ours: bytes, codec: Codec) -> str:
    """The first field that differs, by its path; "the sender" where another node sends."""
    if mine[:_HEADER] != ours[:_HEADER]:
        return "who sends it and when"
    leaves = [
        {field.path: field.raw for field in codec.dissect(octets, start=_HEADER).root.walk() if not field.children}
        for octets in (mine, ours)
    ]
    for path in dict.fromkeys([*leaves[1], *leaves[0]]):
        if leaves[0].get(path) != leaves[1].get(path):
            return path
    return "its padding"


def _counts(octets: Sequence[bytes], codec: Codec) -> Counter[ICType]:
    counts: Counter[ICType] = Counter()
    for frame in octets:
        beacon = codec.salvage(frame[_HEADER:]).beacon
        for payload in beacon.payloads if beacon is not None else ():
            for container in payload.vardis or ():
                for record in container.records:
                    if type(record) in KIND_OF:
                        counts[KIND_OF[type(record)]] += 1
    return counts
