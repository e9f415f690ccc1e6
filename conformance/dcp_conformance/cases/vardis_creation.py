"""dcp-vardis.md: Processing ICTYPE-CREATE-VARIABLES Containers."""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate
from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, Variant, case
from dcp_conformance.peers import Peer
from dcp_conformance.services import longest_description, max_repetitions, taught
from dcp_conformance.variables import ask, modulus, named, own_id, stepped, traces

CREATES = ICType.CREATE_VARIABLES
_V2_0 = Needs(since=SpecVersion.V2_0)


def _time(record: VarCreate) -> int:
    """The creationTime of a record, in profiles that have it."""
    return record.spec.creation_time or 0


def _held(bench: Bench, var_id: int, record: VarCreate, what: str, *requirements: str) -> None:
    held = ask(bench, var_id)
    bench.check(held.record == record, what, f"{held}: {held.record}", *requirements)


# -- passed on unchanged -----------------------------------------------------------------------------------------------

_Make = Callable[[Bench, Peer, int], VarCreate]


def _plain(bench: Bench, peer: Peer, var_id: int) -> VarCreate:  # noqa: ARG001
    return peer.create(var_id)


def _largest(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    return peer.create(
        var_id,
        value=bytes(range(min(bench.bound("VARDISPAR_MAX_VALUE_LENGTH"), 255))),
        descr=b"d" * min(longest_description(bench), 254),
        seqno=modulus(bench) - 1,
        rep_cnt=max_repetitions(bench),
    )


def _smallest(bench: Bench, peer: Peer, var_id: int) -> VarCreate:  # noqa: ARG001
    return peer.create(var_id, value=b"\0", descr=b"d")


def _umlauts(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    return peer.create(var_id, value=b"\0\xff\0", descr="höhe".encode(), producer=bench.node_id())


def _with_timeout(bench: Bench, peer: Peer, var_id: int) -> VarCreate:
    return peer.create(var_id, timeout=(1 << 8 * bench.profile.types.var_timeout.width) - 2)


@case(
    "TC_VD_CRT_BV_01",
    "A VarCreate is passed on octet by octet as it came ({variant})",
    requirements="VD-PC-10 VD-TYP-06",
    stimulus="a VarCreate of an unknown variable ({variant})",
    expect="a beacon with exactly the octets of the record",
    variants={
        "plain": Variant(_plain),
        "largest": Variant(_largest),
        "smallest": Variant(_smallest),
        "far-producer": Variant(_umlauts),
        "timeout": Variant(_with_timeout, requirements="VD-PC-10 VD-TYP-04 VD-TYP-06", needs=_V2_0),
    },
)
def unchanged(bench: Bench, make: _Make) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    record = make(bench, peer, var_id)
    octets = bench.forge.container(record)[bench.forge.container_header_size :]
    peer.send(record)
    came = bench.until(lambda heard: heard.instructions(CREATES, var_id)) or []
    bench.require(came, "the VarCreate is passed on", "it is not")
    same = octets in came[0].heard.octets
    bench.check(same, f"with the octets {octets.hex()}", f"{came[0].record}", frames=came, shown=True)


# -- creations and creationTime ----------------------------------------------------------------------------------------


@case(
    "TC_VD_CRT_BV_02",
    "A VarCreate with a creationTime later by one tick replaces all that is stored of the variable",
    requirements="VD-PC-01 VD-PC-07",
    stimulus="a VarCreate of a known variable by another producer, one tick later, with other contents, a lower "
    "sequence number and another repCnt",
    expect="it is repeated as it came, in as many beacons as its own repCnt says, and stored",
    window=10,
    needs=_V2_0,
)
def replaced(bench: Bench) -> None:
    peer, other, var_id = bench.peer(), bench.peer(), bench.var_id()
    first = peer.create(var_id, seqno=9)
    bench.learn(peer, first)
    count = min(2, max_repetitions(bench))
    second = other.create(var_id, value=b"other", seqno=3, rep_cnt=count, descr=b"anew", creation_time=_time(first) + 1)
    bench.creation_time()
    since = bench.mark()
    other.send(second)
    found = bench.check_repeated(CREATES, var_id, count, since)
    wrong = [each for each in found if each.record != second]
    bench.check(not wrong, "it is repeated as it came", f"{wrong[0].record if wrong else ''}", frames=wrong, shown=True)
    _held(bench, var_id, second, "it is stored with all of its contents", "VD-PC-07")
    summary = bench.until_instruction(ICType.SUMMARIES, var_id)
    if bench.bound("VARDISPAR_MAX_SUMMARIES"):
        bench.check(
            summary is not None and summary.seqno == 3,
            "summaries carry its number 3",
            f"{summary}",
            "VD-PC-07",
            shown=summary is not None,
        )


_Offset = Callable[[int], int]


@case(
    "TC_VD_CRT_BO_01",
    "A VarCreate of a known variable that is not later changes nothing ({variant})",
    requirements="VD-PC-01",
    stimulus="a VarCreate of another producer for a known variable, whose creationTime is {variant}",
    expect="the first one stays stored, and nothing is repeated",
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
    first = peer.create(var_id, value=b"first")
    bench.learn(peer, first)
    since = bench.mark()
    other = bench.peer()
    other.send(other.create(var_id, value=b"next", seqno=9, creation_time=offset(_time(first))))
    bench.require_alive("the VarCreate")
    bench.beacons(1, 1.5)
    found = traces(bench, var_id, since)
    bench.check(not found, "nothing is repeated", f"{named(found)} came", frames=found, shown=True)
    _held(bench, var_id, first, "the first one stays stored")


@case(
    "TC_VD_CRT_BV_03",
    "creationTimes are compared as numbers: {variant}",
    requirements="VD-PC-01",
    stimulus="VarCreates of an unknown variable with the two creationTimes, the later one first, and the other way "
    "round",
    expect="the later one is stored in both cases",
    needs=_V2_0,
    variants={
        "255-256": (255, 256),
        "65535-65536": (65535, 65536),
        "2p31": ((1 << 31) - 1, 1 << 31),
        "2p32": ((1 << 32) - 1, 1 << 32),
        "low-octets": (0x0102030405FF, 0x010203040600),
    },
)
def as_numbers(bench: Bench, times: tuple[int, int]) -> None:
    stamp = bench.profile.types.timestamp
    if times[1] >= 1 << (8 * stamp.width - (1 if stamp.signed else 0)):
        bench.info("creationTimes", f"{times[1]} does not fit into {stamp.width} octets")
        return
    peer = bench.peer()
    for order in (times, times[::-1]):
        # Times long past: only variables that were never created can have them.
        var_id = bench.unknown_id()
        bench.created.add(var_id)
        records = {each: peer.create(var_id, value=str(each)[-5:].encode(), creation_time=each) for each in order}
        for each in order:
            peer.send(records[each])
            bench.until_instruction(CREATES, var_id, bench.reaction if each == order[0] else 1.5)
        _held(bench, var_id, records[times[1]], f"{times[1]} is stored after {order[0]} and {order[1]}")


@case(
    "TC_VD_CRT_BV_04",
    "Of two creations that arrive together the later one is stored, in whichever order they stand",
    requirements="VD-PC-01",
    stimulus="containers of two VarCreates of one unknown variable, by two producers: earlier before later, and the "
    "other way round",
    expect="the later one is stored and repeated",
    needs=_V2_0,
    variants={"ascending": False, "descending": True},
)
def together(bench: Bench, descending: bool) -> None:
    peer, other, var_id = bench.peer(), bench.peer(), bench.var_id()
    records = [peer.create(var_id, value=b"early"), other.create(var_id, value=b"later")]
    later = records[1]
    since = bench.mark()
    peer.send(*(reversed(records) if descending else records))
    found = bench.check_repeated(CREATES, var_id, 1, since)
    bench.check(
        all(each.record == later for each in found), "the later one is repeated", "the other", frames=found, shown=True
    )
    _held(bench, var_id, later, "the later one is stored")


@case(
    "TC_VD_CRT_BV_05",
    "A deleted variable that is created anew is alive in every respect",
    requirements="VD-PC-02",
    stimulus="a VarDelete, then a VarCreate with a later creationTime, then a VarUpdate and a VarDelete",
    expect="each of them is repeated, and the variable is summarised in between",
    window=16,
    needs=_V2_0,
)
def revived(bench: Bench) -> None:
    peer = bench.peer()
    var_id = taught(bench, peer, seqno=200)
    peer.send(peer.delete(var_id))
    if bench.until_instruction(ICType.DELETE_VARIABLES, var_id) is None:
        bench.inconclusive("the variable is deleted, which this case needs", "there is no VarDelete")
    record = peer.create(var_id, value=b"anew")
    for what, kind in (
        (record, CREATES),
        (peer.update(var_id, 1), ICType.UPDATES),
        (peer.delete(var_id), ICType.DELETE_VARIABLES),
    ):
        since = bench.mark()
        peer.send(what)
        found = bench.check_repeated(kind, var_id, 1, since)
        wrong = [each for each in found if each.record != what]
        bench.check(not wrong, f"the {kind.label} record is repeated as it came", f"{what}", frames=wrong, shown=True)
        if kind is CREATES and bench.bound("VARDISPAR_MAX_SUMMARIES"):
            summary = bench.until_instruction(ICType.SUMMARIES, var_id)
            bench.check(
                summary is not None and summary.seqno == 0,
                "it is summarised with number 0",
                f"{summary}",
                shown=summary is not None,
            )


# -- records that are not taken ----------------------------------------------------------------------------------------


@case(
    "TC_VD_CRT_BO_02",
    "A VarCreate that names the implementation as producer is ignored, also the answer to its own request (H2)",
    requirements="VD-PC-03",
    stimulus="a summary of an unknown variable; the request is answered with a VarCreate whose prodId is the "
    "implementation's; then the summary again",
    expect="the VarCreate is not repeated; the second summary is answered with a request as the first was",
    window=10,
)
def own_producer(bench: Bench) -> None:
    peer, var_id, own = bench.peer(), bench.unknown_id(), own_id(bench)
    since = bench.mark()
    peer.send(peer.summary(var_id, 1))
    bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    peer.send(peer.create(var_id, producer=own, seqno=1))
    bench.require_alive("the VarCreate")
    bench.beacons(1, 1.5)
    found = traces(bench, var_id, since, set(ICType) - {ICType.REQUEST_VARCREATES})
    bench.check(not found, "the VarCreate is ignored", f"{named(found)} came", frames=found, shown=True)
    peer.send(peer.summary(var_id, 1))
    again = bench.until_instruction(ICType.REQUEST_VARCREATES, var_id)
    bench.check(again, "the variable is still unknown, and requested again", "it is not requested")
    bench.info("H2: a restarted producer requests its own variable in vain", "shown" if again else "not shown")


@case(
    "TC_VD_CRT_BO_03",
    "What is done with a VarCreate whose two identifiers differ is reported (X14)",
    requirements="VD-PC-07",
    stimulus="a VarCreate that names one variable in its specification and another one in its update",
    expect="it is ignored, or taken for the variable of the specification",
)
def two_identifiers(bench: Bench) -> None:
    peer, (spec, upd) = bench.peer(), bench.unknown_ids(2)
    bench.created.add(spec)
    record = bench.forge.container(peer.create(spec), lies={"records[0].upd.varId": upd})
    since = bench.mark()
    peer.send(record)
    bench.require_alive("the VarCreate")
    bench.beacons(1, 1.5)
    taken = bench.instructions(CREATES, spec, since)
    wrong = traces(bench, upd, since, set(ICType) - {ICType.REQUEST_VARCREATES})
    right = bench.check(
        not wrong, "the variable of the update does not become known", f"{named(wrong)} came", frames=wrong, shown=True
    )
    if right:
        bench.reading("X14", "ignore-update-id" if taken else "drop-mismatch")


@case(
    "TC_VD_CRT_BO_04",
    "Up to 1.3 a VarCreate of a known variable is ignored, whoever sends it",
    requirements="VD-PC-11 VD-SCP-03",
    stimulus="VarCreates of a known variable by its producer and by another one, with newer numbers and other values",
    expect="nothing is repeated, and the first one stays stored",
    needs=Needs(until=SpecVersion.V1_3),
)
def known_in_1_x(bench: Bench) -> None:
    peer, other, var_id = bench.peer(), bench.peer(), bench.var_id()
    first = peer.create(var_id, value=b"first")
    bench.learn(peer, first)
    since = bench.mark()
    for each in (peer, other):
        each.send(each.create(var_id, value=b"next", seqno=stepped(bench, 0, 1)))
    bench.require_alive("the VarCreates")
    bench.beacons(1, 1.5)
    found = traces(bench, var_id, since)
    bench.check(not found, "nothing is repeated", f"{named(found)} came", frames=found, shown=True)
    _held(bench, var_id, first, "the first one stays stored")
