"""dcp-vardis.md: Construction of Payloads, to the last octet.

If VARDISPAR_MAX_PAYLOAD_SIZE cannot be set, the records are made to fit the size given in the PIXIT.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.definitions.case import FILLS, Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.suite.vardis.reception.payload import all_of, request, size_of
from dcp_conformance.test_steps.full_payloads import PAYLOAD_SIZE, filling, longest, settable, undisturbed
from dcp_conformance.test_steps.services import OK, create_request, produced, settled
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

from .summaries import SUMMARIES, summarises

_CREATE, _UPDATE, _SUMMARY = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.SUMMARIES
_DELETE, _ASK = ICType.DELETE_VARIABLES, ICType.REQUEST_VARCREATES
_ASK_UPDATE = ICType.REQUEST_VARUPDATES

#: Number of variables taught at a time.
_FEW = 6


def _fillable(bench: Bench) -> str | None:
    """Return why no payload can be filled to the last octet, or None; for ``Needs.when``."""
    if settable(bench) or bench.sut.parameter(PAYLOAD_SIZE) >= 2 * largest_create(bench):
        return None
    return f"{PAYLOAD_SIZE} cannot be set (VD-SetParameter, UT-Reset), and is too small for two VarCreates"


def largest_create(bench: Bench) -> int:
    """Return the size in octets of a container with one VarCreate of the longest value and description."""
    value, description = longest(bench)
    return bench.builder.container_header_size + bench.builder.record_size(
        bench.records.sample(value=value, descr=description)
    )


@case(
    "TC_VD_PAY_BV_07",
    ("Records that exactly fill a payload share it; with one octet less the last one is sent separately ({variant})"),
    requirements="VD-PAY-02 VD-IC-05",
    alone=FILLS,
    stimulus=(
        "in one beacon, requests for records that need exactly VARDISPAR_MAX_PAYLOAD_SIZE octets; the parameter is "
        "set if possible"
    ),
    expect="all records in one payload; with one octet less the last of them in a second one",
    window=10,
    needs=Needs(when=_fillable),
    variants={
        "creates": (_CREATE, 0),
        "creates-less": (_CREATE, 1),
        "updates": (_UPDATE, 0),
        "updates-less": (_UPDATE, 1),
    },
)
def to_the_last_octet(bench: Bench, variant: tuple[ICType, int]) -> None:
    kind, less = variant
    peer = bench.peer()
    creates, limit = (_two if settable(bench) else _as_many_as_fit)(bench, peer, kind, less)
    frames = undisturbed(bench, kind, lambda: all_of(bench, kind, creates, request(bench, peer, kind, creates)))
    counts = [len(each.instructions(kind)) for each in frames]
    right = [len(creates) - 1, 1] if less else [len(creates)]
    what = f"records in payloads of at most {limit} octets"
    bench.none(max(counts) > max(right), what, "VD-PAY-02", seen=counts, frames=frames)
    bench.some(counts == right, f"{what}: {right}", "VD-PAY-02", seen=counts, frames=frames)
    largest = max(size_of(bench, each) for each in frames)
    bench.proved(largest <= limit, f"payloads of at most {limit} octets", largest, "VD-IC-05", frames=frames)


def _two(bench: Bench, peer: Peer, kind: ICType, less: int) -> tuple[Sequence[VarCreate], int]:
    """Teach two variables and set the payload size to that of two records of them, minus ``less`` octets."""
    value, description = longest(bench)
    creates = [peer.create(each, value=value, descr=description, seqno=9) for each in bench.identifiers.var_ids(2)]
    bench.learn(peer, *creates)
    records = creates if kind is _CREATE else [each.upd for each in creates]
    return creates, lower(bench, sum(map(bench.builder.record_size, records)) - less)


def _as_many_as_fit(bench: Bench, peer: Peer, kind: ICType, less: int) -> tuple[Sequence[VarCreate], int]:
    """Teach variables whose records fill a payload of the known size, plus ``less`` octets."""
    limit = bench.sut.bound(PAYLOAD_SIZE)
    creates = _learnt(bench, peer, kind, lambda before: limit - before + less)
    return creates, limit


def _learnt(bench: Bench, peer: Peer, kind: ICType, octets: Callable[[int], int]) -> list[VarCreate]:
    """Teach variables whose records of a kind have a given total size, and return their VarCreates.

    ``octets`` returns this size in octets; its argument is the size of the container headers and earlier containers in
    the payload.
    """
    before = bench.builder.container_header_size
    if kind is _UPDATE and bench.features.container_order.index(_SUMMARY) < bench.features.container_order.index(kind):
        before += _summaries(bench, peer)
    creates = filling(bench, peer, kind, octets(before))
    if creates is None:
        bench.inconclusive(
            "records that exactly fill a payload", "impossible with the lengths that the implementation accepts"
        )
    # A few at a time: how a full payload is composed is tested when the records are requested.
    for start in range(0, len(creates), _FEW):
        bench.learn(peer, *creates[start : start + _FEW])
    return creates


def _summaries(bench: Bench, peer: Peer) -> int:
    """Return the size in octets of the SUMMARIES container after teaching as many variables as it can hold."""
    most = bench.sut.bound(SUMMARIES)
    if not most:
        return 0
    bench.learn(peer, *(peer.create(each, value=b"v", descr=b"d") for each in bench.identifiers.var_ids(most)))
    return len(bench.builder.container(*[peer.summary(0, 0)] * most))


@case(
    "TC_VD_SUM_BV_05",
    "Summaries after a VarCreate need room for their container and one summary ({variant})",
    requirements="VD-CMP-01 VD-IC-05",
    alone=FILLS,
    stimulus=(
        "requests for VarCreates that leave room for exactly one summary, or one octet less, in a payload of "
        "VARDISPAR_MAX_PAYLOAD_SIZE octets; the parameter is set if possible"
    ),
    expect="one summary along with the VarCreates; with one octet less no SUMMARIES container",
    window=8,
    needs=Needs(when=lambda bench: summarises(bench) or _fillable(bench)),
    variants={"room": 0, "no-room": 1},
)
def room_for_a_summary(bench: Bench, less: int) -> None:
    builder, peer = bench.builder, bench.peer()
    summary = builder.container_header_size + builder.record_size(peer.summary(0, 0))
    if settable(bench):
        value, description = longest(bench)
        creates = [peer.create(bench.var_id(), value=value, descr=description)]
        other = peer.create(bench.var_id(), value=b"v", descr=b"d")
        bench.learn(peer, *creates, other)
        limit = builder.container_header_size + builder.record_size(creates[0]) + summary - less
        bench.must("VD-SetParameter", name=SUMMARIES, value=1)
        bench.must("VD-SetParameter", name=PAYLOAD_SIZE, value=limit)
        bench.wait(3)
    else:
        limit = bench.sut.bound(PAYLOAD_SIZE)
        creates = _learnt(bench, peer, _CREATE, lambda before: limit - before - summary + less)
    peer.send(*(peer.request_create(each) for each in {each.spec.var_id for each in creates}))
    heard = bench.required(
        until_all(bench, creates), "the requested VarCreates in one payload", seen="no payload with all of them"
    )
    # 1.0 composes updates and summaries in another order, but VarCreates come first in every version.
    bench.answered(len(heard.instructions(_SUMMARY)), 1 - less, "summaries after the VarCreates", frames=[heard])
    octets = size_of(bench, heard)
    bench.proved(octets <= limit, f"a payload of at most {limit} octets", octets, "VD-IC-05", frames=[heard])


def until_all(bench: Bench, creates: Sequence[VarCreate]) -> ReceivedBeacon | None:
    """Wait for a beacon with VarCreates of all these variables."""
    wanted = {each.spec.var_id for each in creates}
    return bench.until(lambda heard: heard if wanted <= {each.var_id for each in heard.instructions(_CREATE)} else None)


def _never_fits(bench: Bench) -> str | None:
    """Return why no VarCreate can be larger than a payload, or None; for ``Needs.when``."""
    if settable(bench) or largest_create(bench) > bench.sut.parameter(PAYLOAD_SIZE):
        return None
    return (
        f"{PAYLOAD_SIZE} cannot be set (VD-SetParameter, UT-Reset), and with the maximum sizes in the PIXIT no "
        "VarCreate is larger than a payload"
    )


@case(
    "TC_VD_CMP_BV_12",
    "If the record at the head of a queue does not fit, its container is omitted and others follow",
    requirements="VD-CMP-08",
    alone=FILLS,
    stimulus=(
        "requests for a VarCreate larger than VARDISPAR_MAX_PAYLOAD_SIZE (set if possible), and a summary of an "
        "unknown variable"
    ),
    expect="a request for the unknown variable, no VarCreate of the other one, no container without records",
    window=10,
    needs=Needs(when=_never_fits),
)
def head_does_not_fit(bench: Bench) -> None:
    peer, (value, description) = bench.peer(), longest(bench)
    large, unknown = bench.var_id(), bench.unknown_id()
    create = peer.create(large, value=value, descr=description)
    limit = bench.builder.container_header_size + bench.builder.record_size(create) - 1
    if settable(bench):
        bench.learn(peer, create)
        for name, least in (
            (SUMMARIES, 1),
            ("VARDISPAR_MAX_DESCRIPTION_LENGTH", 2),
            ("VARDISPAR_MAX_VALUE_LENGTH", 8),
            (PAYLOAD_SIZE, limit),
        ):
            bench.must("VD-SetParameter", name=name, value=least)
    else:
        limit = bench.sut.bound(PAYLOAD_SIZE)
        # Whether the implementation learnt it cannot be observed: a forwarded VarCreate would be the only sign.
        peer.send(create)
    bench.wait(3)
    mark = peer.stimulate(peer.request_create(large), peer.summary(unknown, 1))
    bench.some(
        bench.until_instruction(ICType.REQUEST_VARCREATES, unknown),
        "other containers, although the VarCreate at the head of createQ does not fit",
        seen="no request for the unknown variable",
    )
    bench.beacons(3)
    if bench.instructions(ICType.REQUEST_VARCREATES, large, mark):
        bench.inconclusive("an implementation that knows the variable, which this case needs", "a request for it")
    bench.none(bench.instructions(_CREATE, large, mark), f"no VarCreate of more than {limit} octets")
    bench.every(bench.heard[mark:], lambda each: not each.vardis_problems, "no container without records")


@case(
    "TC_VD_PAY_BV_09",
    "A single record that exactly fills a payload is sent ({variant})",
    requirements="VD-PAY-02 VD-CMP-13",
    stimulus=(
        "VARDISPAR_MAX_PAYLOAD_SIZE is set to the size of a container with one {variant}, which a peer then requests"
    ),
    expect="a payload with this record only",
    window=8,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter")),
    variants={"VarCreate": _CREATE, "VarUpdate": _UPDATE},
)
def alone_to_the_last_octet(bench: Bench, kind: ICType) -> None:
    peer, (value, description) = bench.peer(), longest(bench)
    create = bench.learnt(peer, bench.var_id(), value=value, descr=description, seqno=9)
    lower(bench, bench.builder.record_size(create if kind is _CREATE else create.upd))
    mark = request(bench, peer, kind, [create])
    bench.some(bench.until_instruction(kind, create.spec.var_id), "the record, which exactly fills a payload")
    frames = [each for each in bench.heard[mark:] if each.instructions(kind)]
    others = [named for each in frames for named in each.containers if named.ic_type != bench.builder.ic_type(kind)]
    bench.none(others, "no other container in its payload", frames=frames)


def lower(bench: Bench, octets: int, periods: int = 3) -> int:
    """Set the payload size to that of a container with ``octets`` octets of records, without summaries; return it.

    Waits for the end of payloads that were composed before.
    """
    limit = bench.builder.container_header_size + octets
    # The limits of other parameters depend on the size of a payload.
    for name, value in ((SUMMARIES, 0), ("VARDISPAR_MAX_DESCRIPTION_LENGTH", 2), (PAYLOAD_SIZE, limit)):
        bench.must("VD-SetParameter", name=name, value=value)
    bench.wait(periods)
    return limit


@case(
    "TC_VD_PAY_BV_10",
    (
        "Records without a value share a payload they exactly fill; with one octet less the last is sent "
        "separately ({variant})"
    ),
    requirements="VD-PAY-02 VD-IC-05",
    stimulus=(
        "VARDISPAR_MAX_PAYLOAD_SIZE is set to the size of a container with eight records, or one octet less; a "
        "stimulus causes all eight records"
    ),
    expect="all records in one payload; with one octet less the last of them in a second one",
    window=10,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter")),
    variants={
        "deletes": (_DELETE, 0),
        "deletes-less": (_DELETE, 1),
        "create-requests": (_ASK, 0),
        "create-requests-less": (_ASK, 1),
        "update-requests": (_ASK_UPDATE, 0),
        "update-requests-less": (_ASK_UPDATE, 1),
    },
)
def without_values(bench: Bench, variant: tuple[ICType, int]) -> None:
    (kind, less), peer, number = variant, bench.peer(), 8
    names = bench.identifiers.unknown_ids(number) if kind is _ASK else bench.identifiers.var_ids(number)
    if kind is not _ASK:
        bench.learn(peer, *(peer.create(each, seqno=5) for each in names))
    sample: VardisRecord = peer.request_create(names[0])
    stimuli: list[VardisRecord] = [peer.summary(each, 6) for each in names]
    if kind is _DELETE:
        stimuli = [peer.delete(each) for each in names]
        sample = stimuli[0]
    elif kind is _ASK_UPDATE:
        sample = peer.request_update(names[0], 5)
    lower(bench, number * bench.builder.record_size(sample) - less)

    def caused() -> list[ReceivedBeacon]:
        mark = peer.stimulate(*stimuli)
        return bench.until_quiet(lambda heard: heard.instructions(kind), since=mark)

    # Deletions have an effect only once, and requests each time.
    frames = caused() if kind is _DELETE else undisturbed(bench, kind, caused)
    counts = [len(each.instructions(kind)) for each in frames]
    right = [number - 1, 1] if less else [number]
    # One of two payloads alone may be what is left after a loss.
    bench.in_order(counts, right, f"payloads with {right} records", frames=frames)


@case(
    "TC_VD_CRE_BV_09",
    "RTDB-Create accepts a variable whose VarCreate exactly fills a payload ({variant})",
    requirements="VD-CRE-14 VD-PAY-02",
    stimulus=(
        "VARDISPAR_MAX_PAYLOAD_SIZE is set to the size of a container with one VarCreate (value: {variant}); "
        "RTDB-Create of that variable"
    ),
    expect="VARDIS-STATUS-OK, and the VarCreate",
    window=8,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter", "RTDB-Create")),
    variants={"one-octet": 1, "the-longest": 0},
)
def created_to_the_last_octet(bench: Bench, length: int) -> None:
    longest_value, _ = longest(bench)
    value, var_id = longest_value[: length or len(longest_value)], bench.var_id()
    sample = bench.records.sample(value=value, descr=b"d")
    lower(bench, bench.builder.record_size(sample))
    bench.expect_status(OK, "RTDB-Create", **create_request(bench, var_id, descr="d", value=value))
    bench.some(bench.until_instruction(_CREATE, var_id), "its VarCreate, which exactly fills a payload", "VD-PAY-02")


@case(
    "TC_VD_UPD_BV_08",
    "RTDB-Update accepts a value whose VarUpdate exactly fills a payload",
    requirements="VD-UPD-07 VD-PAY-02",
    stimulus=(
        "RTDB-Create with a short value; VARDISPAR_MAX_PAYLOAD_SIZE is set to the size of a container with one "
        "VarUpdate of the longest value; RTDB-Update with that value"
    ),
    expect="VARDIS-STATUS-OK, and the VarUpdate",
    window=8,
    needs=Needs(ut=("UT-Reset", "VD-SetParameter", "RTDB-Create", "RTDB-Update")),
)
def updated_to_the_last_octet(bench: Bench) -> None:
    value, _ = longest(bench)
    var_id = produced(bench)
    settled(bench, var_id)
    lower(bench, bench.builder.record_size(bench.records.sample(value=value).upd))
    bench.expect_status(OK, "RTDB-Update", varId=var_id, value=value.hex())
    found = bench.until_instruction(_UPDATE, var_id)
    bench.some(found and found.value == value, "its VarUpdate, which exactly fills a payload", "VD-PAY-02")
