"""Reasons why `check` has not found a faulty node: the rules about its requirements, and the different octets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from dcp_conformance.definitions.results import CaseResult
from dcp_spec.constants import ICType

from dcp_codec.codec import Codec

#: Octets of the Ethernet header before the beacon.
_HEADER: Final = 14
#: Record types that are compared, in the order of the report.
_KINDS: Final = tuple(ICType)


def reason(
    requirements: Sequence[str],
    octets: Sequence[bytes],
    usual: Sequence[bytes],
    cases: Sequence[CaseResult],
    codec: Codec,
) -> str:
    """Return the reason in one line: the rules about the requirements of the mutant, then the different octets.

    ``octets`` are the frames of the network with the mutant, ``usual`` those of the same network with the reference
    node, ``cases`` the results of `check` for the former.
    """
    return f"{_rules(requirements, cases)}; {_difference(octets, usual, codec)}"


def _rules(requirements: Sequence[str], cases: Sequence[CaseResult]) -> str:
    """Describe the rules about the requirements, with the number of occasions that each had in the recording."""
    about = [case for case in cases if set(case.requirements) & set(requirements)]
    names = ", ".join(requirements)
    if not about:
        return f"check has no rule about {names}: other nodes, loss or the application may show the same"
    listed = []
    for case in about:
        occasions = max((case.occasions.get(each, 0) for each in requirements), default=0)
        listed.append(
            f"{case.id} {f'found no violation in {occasions:,} occasions' if occasions else 'had no occasion'}"
        )
    return ", ".join(listed)


def _difference(octets: Sequence[bytes], usual: Sequence[bytes], codec: Codec) -> str:
    """Describe the difference: number of beacons, first different field, and numbers of records of each type."""
    first = next((number for number, (mine, ours) in enumerate(zip(octets, usual, strict=False)) if mine != ours), None)
    if first is None:
        return f"the first {min(len(octets), len(usual)):,} frames are the same, and then one network sends more"
    known = Counter(usual)
    differing = sum((Counter(octets) - known).values())
    text = f"{differing:,} of {len(octets):,} beacons differ, the first, frame {first + 1}, in"
    text += f" {_field(octets[first], usual[first], codec)}"
    mine, ours = _counts(octets, codec), _counts(usual, codec)
    changed = [f"{kind.label} {ours[kind]:,} -> {mine[kind]:,}" for kind in _KINDS if mine[kind] != ours[kind]]
    return f"{text}; records: {', '.join(changed) or 'the same number of each type'}"


def _field(mine: bytes, ours: bytes, codec: Codec) -> str:
    """Return the path of the first different field; "sender and time" if another node sends the frame."""
    if mine[:_HEADER] != ours[:_HEADER]:
        return "sender and time"
    leaves = [
        {field.path: field.raw for field in codec.dissect(octets, start=_HEADER).root.walk() if not field.children}
        for octets in (mine, ours)
    ]
    for path in dict.fromkeys([*leaves[1], *leaves[0]]):
        if leaves[0].get(path) != leaves[1].get(path):
            return path
    return "the padding"


def _counts(octets: Sequence[bytes], codec: Codec) -> Counter[ICType]:
    counts: Counter[ICType] = Counter()
    for frame in octets:
        beacon = codec.salvage(frame[_HEADER:]).beacon
        for payload in beacon.payloads if beacon is not None else ():
            for container in payload.vardis or ():
                for record in container.records:
                    if record.IC_TYPE is not None:
                        counts[record.IC_TYPE] += 1
    return counts
