"""Statistics on frames with valid headers and block lists, independent of the content of the blocks."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.rules import srp_record_size

from dcp_codec.codec import Codec
from dcp_conformance.lower_tester import Arrival

__all__ = ["blocks_in", "counted", "nearest", "sound"]


def nearest(names: Sequence[str], by_name: Mapping[str, Codec], frames: Sequence[Arrival]) -> str:
    """Return the profile whose state reports are nearest in size to the received SRP payloads; the first of several."""
    sizes = [
        len(each.octets)
        for frame in frames
        for each in by_name[names[0]].salvage(frame.octets).damaged
        if each.problem.path.find(".srp") >= 0
    ]
    if not sizes:
        return names[0]
    seen = statistics.mode(sizes)
    return min(names, key=lambda name: abs((srp_record_size(by_name[name].profile) or 0) - seen))


def sound(codec: Codec, arrivals: Iterable[Arrival]) -> int:
    """Return the number of frames with headers and block list of the profile, whatever the content of the blocks."""
    count = 0
    for arrival in arrivals:
        found = codec.salvage(arrival.octets)
        outside = [each for each in found.problems if ".srp" not in each.path and ".vardis" not in each.path]
        count += found.beacon is not None and found.clear and not outside
    return count


def blocks_in(codec: Codec, arrival: Arrival) -> Counter[int]:
    """Count the blocks of a frame for each protocol; empty if its headers are not those of the profile."""
    beacon = codec.salvage(arrival.octets).beacon if sound(codec, [arrival]) else None
    return Counter() if beacon is None else Counter(each.protocol_id for each in beacon.payloads)


def counted(codec: Codec, arrivals: Iterable[Arrival]) -> str:
    """Describe how many blocks of SRP and VarDis can be decoded, and the first error of the others."""
    total, bad = Counter[int](), Counter[int]()
    why: dict[int, str] = {}
    for arrival in arrivals:
        found = codec.salvage(arrival.octets)
        for number, payload in enumerate(found.beacon.payloads if found.beacon is not None else ()):
            total[payload.protocol_id] += 1
            if found.octets_of(number) is not None:
                bad[payload.protocol_id] += 1
                problem = next(each.problem for each in found.damaged if each.payload == number)
                why.setdefault(payload.protocol_id, f"{problem}")
    named = {BP_PROTID_SRP: "SRP", BP_PROTID_VARDIS: "VarDis"}
    parts = []
    for number, name in named.items():
        if not total[number]:
            parts.append(f"none is for {name}")
            continue
        text = f"{total[number] - bad[number]} of {total[number]} for {name} can be read"
        parts.append(f"{text} ({why[number]})" if bad[number] else text)
    return ", ".join(parts)
