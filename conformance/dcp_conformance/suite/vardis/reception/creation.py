"""dcp-vardis.md: Processing ICTYPE-CREATE-VARIABLES Containers."""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import binary_identifiers, longest_description, max_repetitions, teach_variable
from dcp_conformance.test_steps.variable_queries import ask, modulus, own_id, stepped, traces
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

CREATES = ICType.CREATE_VARIABLES
_V2_0 = Needs(since=SpecVersion.V2_0)


def _time(record: VarCreate) -> int:
    """Return the creationTime of a record; 0 if the profile has none."""
    return record.spec.creation_time or 0


def _held(bench: Bench, var_id: int, record: VarCreate, what: str, *requirements: str) -> None:
    held = ask(bench, var_id)
    bench.some(held.record == record, what, *requirements, seen=f"{held}: {held.record}")


# -- forwarded unchanged -----------------------------------------------------------------------------------------------

_Make = Callable[[Bench, Peer, int], VarCreate]


def _plain(bench: Bench, peer: Peer, var_id: int) -> VarCreate:  # noqa: ARG001
    return peer.create(var_id)


def _largest(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    return peer.create(
        var_id,
        value=bytes(range(min(bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), 255))),
        descr=b"d" * min(longest_description(bench), 254),
        seqno=modulus(bench) - 1,
        rep_cnt=max_repetitions(bench),
    )


def _smallest(bench: Bench, peer: Peer, var_id: int) -> VarCreate:  # noqa: ARG001
    return peer.create(var_id, value=b"\0", descr=b"d")


def _umlauts(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    return peer.create(var_id, value=b"\0\xff\0", descr="höhe".encode(), producer=bench.identifiers.node_id())


def _zeros(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    descr = b"d" if bench.profile.types.string.terminated else b"\0"
    return peer.create(var_id, value=b"\0", descr=descr, producer=bytes(len(bench.identifiers.sut_id)))


def _ones(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    longest = min(bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), 255)
    timeout = (1 << 8 * bench.profile.types.var_timeout.width) - 1 if bench.features.creation_time else 0
    return peer.create(
        var_id,
        value=b"\xff" * longest,
        descr=b"\xff",
        seqno=modulus(bench) - 1,
        timeout=timeout,
        producer=b"\xff" * len(bench.identifiers.sut_id),
    )


def _with_timeout(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    return peer.create(var_id, timeout=(1 << 8 * bench.profile.types.var_timeout.width) - 2)


@case(
    "TC_VD_CRT_BV_01",
    "A VarCreate is forwarded unchanged, octet by octet ({variant})",
    requirements="VD-PC-10 VD-TYP-06",
    stimulus="a VarCreate of an unknown variable ({variant})",
    expect="a beacon with exactly the octets of the record",
    variants={
        "plain": Variant(_plain),
        "largest": Variant(_largest),
        "smallest": Variant(_smallest),
        "far-producer": Variant(_umlauts),
        "zeros": Variant(_zeros, requirements="VD-PC-07 VD-PC-10 VD-TYP-06", needs=Needs(when=binary_identifiers)),
        "ones": Variant(_ones, requirements="VD-PC-07 VD-PC-10 VD-TYP-06", needs=Needs(when=binary_identifiers)),
        "timeout": Variant(_with_timeout, requirements="VD-PC-10 VD-TYP-04 VD-TYP-06", needs=_V2_0),
    },
)
def unchanged(bench: Bench, make: _Make) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    record = make(bench, peer, var_id)
    octets = bench.builder.container(record)[bench.builder.container_header_size :]
    peer.send(record)
    found = bench.until(lambda heard: heard.instructions(CREATES, var_id)) or []
    # A node that does not take the values for those of a variable violates the rule about its creation.
    named = bench.case.requirements
    came = bench.required(found, "the VarCreate is forwarded", *({"VD-PC-07"}.intersection(named) or named))
    others = [each for each in named if each != "VD-PC-07"]
    same = octets in came[0].heard.octets
    bench.proved(same, f"the octets {octets.hex()}", came[0].record, *others, frames=came)


# -- creations and creationTime ----------------------------------------------------------------------------------------


@case(
    "TC_VD_CRT_BV_02",
    "A VarCreate with a creationTime one tick later replaces everything stored about the variable",
    requirements="VD-PC-01 VD-PC-07",
    stimulus=(
        "a VarCreate of a known variable by another producer, one tick later, with other contents, a lower "
        "sequence number and another repCnt"
    ),
    expect="the VarCreate unchanged in exactly repCnt beacons, and its contents in the database",
    window=10,
    needs=_V2_0,
)
def replaced(bench: Bench) -> None:
    peer, other, var_id = bench.peer(), bench.peer(), bench.var_id()
    first = bench.learnt(peer, var_id, seqno=9)
    count = min(2, max_repetitions(bench))
    second = other.create(var_id, value=b"other", seqno=3, rep_cnt=count, descr=b"anew", creation_time=_time(first) + 1)
    bench.records.creation_time()
    since = other.stimulate(second)
    found = bench.check_repeated(CREATES, var_id, count, since)
    bench.every(found, second, "the VarCreate unchanged")
    _held(bench, var_id, second, "all contents of the second VarCreate in the database", "VD-PC-07")
    summary = bench.until_instruction(ICType.SUMMARIES, var_id)
    if bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
        bench.equal(summary and summary.seqno, 3, "sequence number in the summaries", "VD-PC-07")


_Offset = Callable[[int], int]


@case(
    "TC_VD_CRT_BO_01",
    "A VarCreate of a known variable that is not later changes nothing ({variant})",
    requirements="VD-PC-01",
    stimulus="a VarCreate of a known variable by another producer; its creationTime is {variant}",
    expect="no forwarded record; the first VarCreate remains in the database",
    needs=_V2_0,
    variants={
        "the-same": lambda stamp: stamp,
        "a-tick-earlier": lambda stamp: stamp - 1,
        "zero": lambda _: 0,
        "without-its-low-octet": lambda stamp: stamp & ~0xFF if stamp & 0xFF else stamp - 256,
    },
)
def not_replaced(bench: Bench, offset: _Offset) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    first = bench.learnt(peer, var_id, value=b"first")
    other = bench.peer()
    since = other.stimulate(other.create(var_id, value=b"next", seqno=9, creation_time=offset(_time(first))))
    bench.require_processed("a VarCreate that is not later")
    bench.none(traces(bench, var_id, since), "no record of the variable")
    _held(bench, var_id, first, "the first VarCreate in the database")


@case(
    "TC_VD_CRT_BV_03",
    "creationTimes are compared as numbers ({variant})",
    requirements="VD-PC-01",
    stimulus=(
        "of each of two unknown variables, VarCreates with the two creationTimes: the earlier one first, then the "
        "later one first"
    ),
    expect="the later one in the database in both cases",
    needs=_V2_0,
    variants={
        "0-1": (0, 1),
        "255-256": (255, 256),
        "65535-65536": (65535, 65536),
        "2p31": ((1 << 31) - 1, 1 << 31),
        "2p32": ((1 << 32) - 1, 1 << 32),
        "2p63": ((1 << 63) - 1, 1 << 63),
        "low-octets": (0x0102030405FF, 0x010203040600),
        "the-greatest": ((1 << 64) - 2, (1 << 64) - 1),
    },
)
def as_numbers(bench: Bench, times: tuple[int, int]) -> None:
    stamp = bench.profile.types.timestamp
    if times[1] >= 1 << (8 * stamp.width - (1 if stamp.signed else 0)):
        bench.verdicts.not_applicable(f"{times[1]} does not fit into a creationTime of the profile")
    peer = bench.peer()
    for order in (times, times[::-1]):
        # These creationTimes are long past, so the variable must never have been created before.
        var_id = bench.unknown_id()
        bench.identifiers.created.add(var_id)
        records = {each: peer.create(var_id, value=str(each)[-5:].encode(), creation_time=each) for each in order}
        for each in order:
            peer.send(records[each])
            found = bench.until_instruction(CREATES, var_id, bench.sut.reaction if each == order[0] else 1.5)
            if each == order[0]:
                bench.some(found, f"the VarCreate with creationTime {each} is forwarded")
        _held(
            bench,
            var_id,
            records[times[1]],
            f"creationTime {times[1]} in the database, after {order[0]} and {order[1]}",
        )


@case(
    "TC_VD_CRT_BV_04",
    "Of two creations that arrive together the later one is stored, whatever their order ({variant})",
    requirements="VD-PC-01",
    stimulus="a payload with two VarCreates of an unknown variable by two producers, creationTimes {variant}",
    expect="the later one is stored and forwarded",
    needs=_V2_0,
    variants={"ascending": False, "descending": True},
)
def together(bench: Bench, descending: bool) -> None:
    peer, other, var_id = bench.peer(), bench.peer(), bench.var_id()
    records = [peer.create(var_id, value=b"early"), other.create(var_id, value=b"later")]
    later = records[1]
    since = peer.stimulate(*(reversed(records) if descending else records))
    found = bench.check_repeated(CREATES, var_id, 1, since)
    bench.proved(
        all(each.record == later for each in found), "only the later one is forwarded", "the other one", frames=found
    )
    _held(bench, var_id, later, "the later one in the database")


@case(
    "TC_VD_CRT_BV_05",
    "A deleted variable that is created again is fully usable",
    requirements="VD-PC-02",
    stimulus="a VarDelete, then a VarCreate with a later creationTime, then a VarUpdate and a VarDelete",
    expect="each of them is forwarded, and the variable is summarised after its creation",
    window=16,
    needs=_V2_0,
)
def revived(bench: Bench) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer, seqno=200)
    peer.send(peer.delete(var_id))
    if bench.until_instruction(ICType.DELETE_VARIABLES, var_id) is None:
        bench.inconclusive("a VarDelete of the variable, which this case needs", "none in time")
    record = peer.create(var_id, value=b"anew")
    for what, kind in (
        (record, CREATES),
        (peer.update(var_id, 1), ICType.UPDATES),
        (peer.delete(var_id), ICType.DELETE_VARIABLES),
    ):
        since = peer.stimulate(what)
        found = bench.check_repeated(kind, var_id, 1, since)
        bench.none([each for each in found if each.record != what], f"the {kind.label} record unchanged")
        if kind is CREATES and bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
            summary = bench.until_instruction(ICType.SUMMARIES, var_id)
            bench.equal(summary and summary.seqno, 0, "sequence number in the summary")


# -- records that are not taken ----------------------------------------------------------------------------------------


@case(
    "TC_VD_CRT_BO_02",
    "A VarCreate with the implementation as producer is ignored, even in answer to its own request (H2)",
    requirements="VD-PC-03",
    stimulus=(
        "a summary of an unknown variable; the request is answered with a VarCreate with the implementation's "
        "identifier as prodId; then the summary again"
    ),
    expect="the VarCreate is not forwarded; the second summary causes a request like the first",
    window=10,
)
def own_producer(bench: Bench) -> None:
    peer, var_id, own = bench.peer(), bench.unknown_id(), own_id(bench)
    since = peer.stimulate(peer.summary(var_id, 1))
    bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    peer.send(peer.create(var_id, producer=own, seqno=1))
    bench.require_processed("a VarCreate with its own identifier as prodId")
    found = traces(bench, var_id, since, set(ICType) - {ICType.REQUEST_VARCREATES})
    bench.none(found, "no record of the variable other than requests")
    peer.send(peer.summary(var_id, 1))
    again = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.some(again, "a request for the variable, which is still unknown")
    bench.info("Does a restarted producer request its own variable without success? (H2)", "yes" if again else "no")


@case(
    "TC_VD_CRT_BO_03",
    "A VarCreate with two different variable identifiers is ignored, or stored under the first (X14)",
    requirements="VD-PC-07",
    stimulus="a VarCreate with one variable identifier in its specification and another one in its update",
    expect="it is ignored, or stored under the identifier of its specification",
)
def two_identifiers(bench: Bench) -> None:
    peer, (spec, upd) = bench.peer(), bench.identifiers.unknown_ids(2)
    bench.identifiers.created.add(spec)
    record = bench.builder.container(peer.create(spec), lies={"records[0].upd.varId": upd})
    since = peer.stimulate(record)
    bench.require_processed("a VarCreate with two identifiers")
    taken = bench.instructions(CREATES, spec, since)
    wrong = traces(bench, upd, since, set(ICType) - {ICType.REQUEST_VARCREATES})
    right = bench.none(wrong, "no record of the variable in the update")
    if right:
        bench.reading("X14", "ignore-update-id" if taken else "drop-mismatch")


@case(
    "TC_VD_CRT_BO_04",
    "Up to 1.3, a VarCreate of a known variable is ignored, whichever node sends it",
    requirements="VD-PC-11 VD-SCP-03",
    stimulus=(
        "VarCreates of a known variable by its producer and by another node, with newer sequence numbers and other "
        "values"
    ),
    expect="no forwarded record; the first VarCreate remains in the database",
    needs=Needs(until=SpecVersion.V1_3),
)
def known_in_1_x(bench: Bench) -> None:
    peer, other, var_id = bench.peer(), bench.peer(), bench.var_id()
    first = bench.learnt(peer, var_id, value=b"first")
    since = bench.mark()
    for each in (peer, other):
        each.send(each.create(var_id, value=b"next", seqno=stepped(bench, 0, 1)))
    bench.require_processed("VarCreates of a known variable")
    bench.none(traces(bench, var_id, since), "no record of the variable")
    _held(bench, var_id, first, "the first VarCreate in the database")
