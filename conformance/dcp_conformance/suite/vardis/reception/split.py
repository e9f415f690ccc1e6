"""dcp-vardis.md: Receive Path, Extraction Step: several containers in a payload.

Implementations that process only a part of a payload, stop one record early or lose the last container still work with
simple payloads. Here every container ends with a record that causes a reaction of its own, and the boundary between two
containers moves through the payload.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import FILLS, Needs, Variant, case
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_SEVERAL = Needs(since=SpecVersion.V1_1)
#: Number of payloads sent before the tester waits for the reactions to their first containers.
_BURST = 4


class Split(NamedTuple):
    """A payload of two containers, and the variables that must become known or be requested."""

    where: str
    containers: tuple[bytes, bytes]
    first: tuple[int, ...]
    second: tuple[int, ...]


def play(bench: Bench, peer: Peer, splits: Sequence[Split], kinds: Iterable[ICType], *requirements: str) -> None:
    """Send the payloads and check that each of their variables causes a record of one of these kinds.

    Payloads without all reactions are sent again: frames may be lost, and a receiver may have buffers for few payloads.
    The first container is the control: a payload without a reaction to it is sent again on its own before it is judged.
    """
    wanted = set(kinds)
    since = bench.mark()
    seen: set[int] = set()

    def traced(var_ids: Iterable[int]) -> bool:
        seen.update(
            each.var_id for heard in bench.heard[since:] for each in heard.instructions() if each.kind in wanted
        )
        return seen.issuperset(var_ids)

    def missing() -> list[Split]:
        return [each for each in splits if not traced(each.first + each.second)]

    for attempt in range(2):
        left = missing()
        alone = [each for each in left if not traced(each.first)] if attempt else []
        for burst in (*_bursts([each for each in left if each not in alone]), *([each] for each in alone)):
            for split in burst:
                peer.send(*split.containers)
            controls = [var_id for split in burst for var_id in split.first]
            bench.until(lambda _, controls=controls: traced(controls))  # type: ignore[misc]
        if missing():
            # The answers may need many payloads.
            count = sum(len(each.first + each.second) for each in left)
            bench.until(lambda _: not missing(), max(bench.sut.reaction + count / 4, bench.teaching.periods(2 * count)))
        if not missing():
            break
    names = "/".join(sorted(kind.label for kind in wanted))
    for which, lost in (
        ("first", [each.where for each in splits if not traced(each.first)]),
        ("second", [each.where for each in splits if not traced(each.second)]),
    ):
        bench.complete(
            lost,
            f"all records of the {which} container are processed in all {len(splits)} payloads (reaction: {names})",
            *requirements,
        )


def _bursts(splits: Sequence[Split]) -> Iterable[Sequence[Split]]:
    for start in range(0, len(splits), _BURST):
        yield splits[start : start + _BURST]


# -- every octet -------------------------------------------------------------------------------------------------------


def _update(bench: Bench, peer: Peer, var_id: int, length: int) -> bytes:
    return bench.builder.container(peer.update(var_id, 1, b"v" * length))


@case(
    "TC_VD_SPLIT_BV_01",
    "Two containers in a payload are both processed, whatever the boundary between them",
    requirements="VD-RX-04 VD-RX-03",
    stimulus=(
        "payloads of equal length with two UPDATES containers of one unknown variable each; the boundary moves by "
        "one octet from payload to payload"
    ),
    expect="a request for each of the variables",
    window=6,
    needs=_SEVERAL,
)
def every_octet(bench: Bench) -> None:
    peer, longest = bench.peer(), min(max(2, bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH")), 40)
    ids = bench.identifiers.unknown_ids(2 * longest)
    splits = []
    for length in range(1, longest + 1):
        one, two = ids[2 * length - 2 : 2 * length]
        containers = (_update(bench, peer, one, length), _update(bench, peer, two, longest + 1 - length))
        splits.append(Split(f"{len(containers[0])} + {len(containers[1])} octets", containers, (one,), (two,)))
    play(bench, peer, splits, (ICType.REQUEST_VARCREATES,))


# -- every record ------------------------------------------------------------------------------------------------------

_Make = Callable[[Peer, int, int], VardisRecord]
#: Builders of a record about a variable, given its index in the container. Sizes depend on the index, not on the
#: identifier, which differs in each run.
_MAKE: dict[ICType, _Make] = {
    ICType.SUMMARIES: lambda peer, var_id, _: peer.summary(var_id, 1),
    ICType.UPDATES: lambda peer, var_id, place: peer.update(var_id, 1, b"v" * (1 + place % 5)),
    ICType.REQUEST_VARUPDATES: lambda peer, var_id, _: peer.request_update(var_id, 1),
    ICType.REQUEST_VARCREATES: lambda peer, var_id, _: peer.request_create(var_id),
    ICType.CREATE_VARIABLES: lambda peer, var_id, place: peer.create(var_id, value=b"v" * (1 + place % 5)),
}
_REQUESTS = (ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES)


def _short(kind: ICType) -> str:
    return kind.label.lower().replace("request-", "").replace("-variables", "")


def _pairs() -> dict[str, Variant]:
    """Return summaries, updates and creates in all orders, and requests in some."""
    pairs = list(itertools.product((ICType.SUMMARIES, ICType.UPDATES, ICType.CREATE_VARIABLES), repeat=2))
    pairs += [(each, each) for each in _REQUESTS]
    pairs += [_REQUESTS, _REQUESTS[::-1]]
    pairs += [pair for each in _REQUESTS for pair in ((ICType.SUMMARIES, each), (each, ICType.CREATE_VARIABLES))]
    # Version 1.0 allows one container of each type, and ignores requests for unknown variables.
    return {
        f"{_short(one)}+{_short(two)}": Variant(
            (one, two), needs=_SEVERAL if one is two or {one, two} & set(_REQUESTS) else Needs()
        )
        for one, two in pairs
    }


@case(
    "TC_VD_SPLIT_BV_02",
    "No record of two containers is lost, however the records are divided between them ({variant})",
    requirements="VD-RX-04",
    stimulus=(
        "payloads of six records in two containers (1 + 5, 2 + 4, ... 5 + 1), each of a variable that the "
        "implementation does not know"
    ),
    expect="every variable is requested, or forwarded if it was created",
    window=6,
    variants=_pairs(),
)
def every_record(bench: Bench, pair: tuple[ICType, ICType]) -> None:
    peer, total = bench.peer(), 6
    splits = []
    for count in range(1, total):
        numbers = [count, total - count]
        made = [_ids(bench, kind, number) for kind, number in zip(pair, numbers, strict=True)]
        containers = [
            bench.builder.container(*(_MAKE[kind](peer, var_id, place) for place, var_id in enumerate(ids)))
            for kind, ids in zip(pair, made, strict=True)
        ]
        where = f"{numbers[0]} + {numbers[1]} records"
        splits.append(Split(where, (containers[0], containers[1]), tuple(made[0]), tuple(made[1])))
    play(bench, peer, splits, (ICType.REQUEST_VARCREATES, ICType.CREATE_VARIABLES))


def _ids(bench: Bench, kind: ICType, count: int) -> list[int]:
    return bench.identifiers.var_ids(count) if kind is ICType.CREATE_VARIABLES else bench.identifiers.unknown_ids(count)


# -- long payloads -----------------------------------------------------------------------------------------------------


def _filled(bench: Bench, peer: Peer, octets: int, filler: int, last: int) -> bytes:
    """Return an UPDATES container of exactly ``octets`` octets, with one variable in all records but the last."""
    builder = bench.builder
    least = builder.record_size(peer.update(last, 1, b"v"))
    most = least - 1 + max(1, min(bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH"), 200))
    rest = octets - builder.container_header_size
    count = max(1, -(-rest // most))
    sizes = [rest // count + (index < rest % count) for index in range(count)]
    ids = [filler] * (count - 1) + [last]
    return builder.container(
        *(peer.update(var_id, 1, b"v" * (size - least + 1)) for var_id, size in zip(ids, sizes, strict=True))
    )


def _borders(total: int, least: int) -> list[int]:
    """Return offsets of the second container: at both ends, around the middle and powers of two, and in between."""
    around = [total // 2, *(1 << exponent for exponent in range(4, 16))]
    near = {border + step for border in around for step in (-1, 0, 1)}
    ends = {least + step for step in (0, 1, 2)} | {total - least - step for step in (0, 1, 2)}
    evenly = {total * part // 8 for part in range(1, 8)}
    return sorted(border for border in near | ends | evenly if least <= border <= total - least)


@case(
    "TC_VD_SPLIT_BV_03",
    "Payloads of maximum size are processed to their end, wherever the second container begins",
    requirements="VD-RX-04 VD-RX-03",
    alone=FILLS,
    stimulus=(
        "payloads of maximum size with two UPDATES containers; the boundary is at both ends, around the middle, "
        "around powers of two and in between"
    ),
    expect="a request for the variable of the last record of each container",
    window=8,
    needs=_SEVERAL,
)
def long_payloads(bench: Bench) -> None:
    peer = bench.peer()
    total = largest_payload(bench, peer)
    least = len(_update(bench, peer, 0, 1))
    borders = _borders(total, least)
    filler, *ids = bench.identifiers.unknown_ids(1 + 2 * len(borders))
    splits = []
    for index, border in enumerate(borders):
        one, two = ids[2 * index : 2 * index + 2]
        containers = (_filled(bench, peer, border, filler, one), _filled(bench, peer, total - border, filler, two))
        splits.append(Split(f"{border} + {total - border} octets", containers, (one,), (two,)))
    play(bench, peer, splits, (ICType.REQUEST_VARCREATES,))


def largest_payload(bench: Bench, peer: Peer) -> int:
    """Return the size in octets of the largest VarDis payload that the implementation could send and that fits into a
    frame of the tester.
    """
    empty = len(peer.beacon(bench.builder.vardis(peer.request_create(0))))
    room = min(bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE") or 1000, 1400) - empty
    return min(bench.sut.bound("VARDISPAR_MAX_PAYLOAD_SIZE") or 1000, room)


@case(
    "TC_VD_SPLIT_BV_04",
    "A short container after a long one is processed, and so are many successive containers",
    requirements="VD-RX-03 VD-RX-04",
    alone=FILLS,
    stimulus=(
        "a payload with a long UPDATES container and a SUMMARIES container of one record; then a payload with "
        "forty containers of one record each"
    ),
    expect="a request for the variable of the last container, and for all of the forty",
    window=6,
    needs=_SEVERAL,
)
def many_containers(bench: Bench) -> None:
    peer = bench.peer()
    filler, one, two, *ids = bench.identifiers.unknown_ids(43)
    short = bench.builder.container(peer.summary(two, 1))
    long = _filled(bench, peer, largest_payload(bench, peer) - len(short), filler, one)
    split = Split(f"{len(long)} + {len(short)} octets", (long, short), (one,), (two,))
    play(bench, peer, [split], (ICType.REQUEST_VARCREATES,), "VD-RX-04")
    kinds = [each for each in _MAKE if each is not ICType.CREATE_VARIABLES]
    since = peer.stimulate(
        *(
            bench.builder.container(_MAKE[kinds[index % len(kinds)]](peer, each, index))
            for index, each in enumerate(ids)
        )
    )
    missing = set(ids)

    def all_requested() -> bool:
        missing.difference_update(each.var_id for each in bench.instructions(ICType.REQUEST_VARCREATES, since=since))
        return not missing

    bench.until(lambda _: all_requested())
    lost = ", ".join(str(ids.index(each) + 1) for each in sorted(missing, key=ids.index))
    bench.some(
        all_requested(), "all forty containers are processed", "VD-RX-03", seen=f"containers {lost} not processed"
    )


@case(
    "TC_VD_SPLIT_BV_05",
    "A container may have up to 255 records (records: {variant})",
    requirements="VD-RX-04",
    stimulus="a SUMMARIES container with {variant} records; the first and the last are of different unknown variables",
    expect="a request for the first, the last, and the variable of all others",
    variants={str(count): count for count in (2, 127, 128, 129, 254, 255)},
)
def many_records(bench: Bench, count: int) -> None:
    peer = bench.peer()
    filler, first, last = bench.identifiers.unknown_ids(3)
    container = bench.builder.container(*(peer.summary(each, 1) for each in (first, *[filler] * (count - 2), last)))
    if len(container) > largest_payload(bench, peer):
        bench.info("Can a container have many records?", f"unknown: {count} summaries do not fit into a payload")
        return
    since = peer.stimulate(container)
    for name, var_id in {"first": first, **({"middle": filler} if count > 2 else {}), "last": last}.items():
        if not bench.instructions(ICType.REQUEST_VARCREATES, var_id, since):
            bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
        came = bench.instructions(ICType.REQUEST_VARCREATES, var_id, since)
        bench.some(came, f"a request for the variable of the {name} of {count} records")
