"""dcp-vardis.md: Data Types, Instruction Containers, Real-Time Database."""

from __future__ import annotations

from collections import Counter
from typing import Any

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_codec.errors import Problem
from dcp_codec.values import VarCreate
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.services import (
    create_request,
    entry_of,
    listed,
    longest_description,
    produced,
    teach_variable,
)
from dcp_conformance.test_steps.time_stamps import stamp_in
from dcp_conformance.test_steps.variable_queries import ask, teach_variables
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.sending.peers import Peer

_DESCRIBE = Needs(ut=("RTDB-DescribeVariable",))
_SINCE_1_1 = SpecVersion.V1_1


def _everything(bench: Bench, peer: Peer) -> int:
    """Make the implementation send containers of all six types; return the mark before them."""
    known = [peer.create(var_id, seqno=5) for var_id in bench.identifiers.var_ids(3)]
    since = bench.mark()
    teach_variables(bench, peer, known)
    updated, behind, doomed = (create.spec.var_id for create in known)
    unknown = bench.unknown_id()
    # In separate payloads: an implementation that loses a second container must not be reported for containers that it
    # therefore does not send.
    for records in (
        [peer.delete(doomed)],
        [peer.update(updated, 6)],
        [peer.summary(behind, 6), peer.summary(unknown, 1)],
    ):
        peer.send(*records)
    wanted = {
        (ICType.DELETE_VARIABLES, doomed),
        (ICType.UPDATES, updated),
        (ICType.REQUEST_VARUPDATES, behind),
        (ICType.REQUEST_VARCREATES, unknown),
    }
    if bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
        wanted.add((ICType.SUMMARIES, behind))

    def complete() -> bool:
        return all(bench.instructions(kind, var_id, since) for kind, var_id in wanted)

    bench.until(lambda _: complete(), 2 * bench.sut.reaction)
    missing = ", ".join(sorted({kind.label for kind, var_id in wanted if not bench.instructions(kind, var_id, since)}))
    bench.complete(missing, "records of all six types", "VD-TYP-07 VD-IC-02")
    return since


def _blocks(heard: ReceivedBeacon) -> list[bytes]:
    """Return the VarDis payloads of a beacon as octets."""
    return heard.data(BP_PROTID_VARDIS)


def _faults(heard: ReceivedBeacon) -> list[Problem]:
    """Return the problems in the VarDis payloads of a beacon, other than containers without a record."""
    return [each for each in heard.vardis_problems if each.reason != "zero-count"]


def _has_empty_container(heard: ReceivedBeacon) -> bool:
    return any(each.reason == "zero-count" for each in heard.vardis_problems)


@case(
    "TC_VD_TYP_BV_01",
    "Containers and records of all six types have the layout of the profile",
    requirements="VD-TYP-01 VD-TYP-05 VD-TYP-07 VD-IC-01 VD-IC-02 VD-IC-03",
    stimulus="records that cause a container of each type",
    expect=(
        "all beacons can be decoded completely with the profile; no container is empty, and each type has its number"
    ),
    window=10,
)
def layout(bench: Bench) -> None:
    since = _everything(bench, bench.peer())
    frames = bench.heard[since:]
    broken = [heard for heard in frames if _faults(heard)]
    problem = _faults(broken[0])[0] if broken else None
    for requirement in ("VD-TYP-01", "VD-TYP-07", "VD-IC-01"):
        bench.none(broken, "beacons with the layout of the profile", requirement, seen=problem)
    if bench.features.creation_time:
        specs = bench.instructions(ICType.CREATE_VARIABLES, since=since)
        bench.some(specs, "varId, prodId, repCnt, creationTime, timeout and descr in each VarSpecT", "VD-TYP-05")
    empty = [heard for heard in frames if _has_empty_container(heard)]
    empty += [heard for heard in frames if any(not each.records for each in heard.containers)]
    bench.none(empty, "a record in every container", "VD-IC-03")
    types = {each.ic_type for heard in frames for each in heard.containers}
    bench.none(types - bench.profile.vardis.container_names().keys(), "one of the six types as icType", "VD-IC-02")


@case(
    "TC_VD_TYP_BV_02",
    "Length and content of a value may change with every update",
    requirements="VD-TYP-02 VD-PU-07",
    stimulus=(
        "VarUpdates of a variable with values of 1 octet, the maximum, 2 octets, one less than the maximum, and 1 "
        "octet; of an octet 0, of octets 0xFF, and the same again"
    ),
    expect="each is forwarded with its value, and the last one is stored",
    window=16,
)
def lengths(bench: Bench) -> None:
    peer, most = bench.peer(), min(bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), 255)
    var_id = teach_variable(bench, peer)
    values = [
        bytes(0x40 + index % 64 for index in range(length)) for length in (1, most, min(2, most), max(1, most - 1), 1)
    ]
    for seqno, value in enumerate([*values, b"\0", b"\xff" * most, b"\xff" * most], 1):
        peer.send(peer.update(var_id, seqno, value))
        came = bench.until_instruction(ICType.UPDATES, var_id)
        observed = came and (came.value, came.seqno)
        bench.equal(observed, (value, seqno), f"value {value.hex()} and its number {seqno}, forwarded unchanged")
    held = ask(bench, var_id)
    upd = held.record and held.record.upd
    bench.equal(upd and (upd.value, upd.seqno), (value, seqno), "the last value in the database", given=came)


@case(
    "TC_VD_TYP_BV_03",
    "A VarCreate has the timeout that the application requested",
    requirements="VD-TYP-04",
    stimulus="RTDB-Create with timeout 0, with 1000 ms (or longer if beacons are rare), and with the largest timeout",
    expect="VarCreates with these timeouts",
    needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create",)),
)
def timeouts(bench: Bench) -> None:
    # The variable must not time out before its VarCreate is sent.
    medium = max(1000, round(2 * bench.sut.reaction * bench.period / MS))
    for timeout in (
        0,
        *([medium] if medium < bench.sut.longest_timeout else []),
        min(bench.sut.longest_timeout, 0xFFFFFFFF),
    ):
        var_id = produced(bench, timeout=timeout)
        came = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
        observed = came.spec.timeout if isinstance(came, VarCreate) else None
        bench.equal(observed, timeout, "timeout of the VarCreate", given=came)


@case(
    "TC_VD_IC_BV_01",
    "No VarDis payload is larger than VARDISPAR_MAX_PAYLOAD_SIZE, even with many records to send",
    requirements="VD-IC-05",
    stimulus="simultaneous requests for so many VarCreates with the longest values that they need three payloads",
    expect="payloads of at most VARDISPAR_MAX_PAYLOAD_SIZE octets, with all VarCreates",
    window=12,
)
def payload_size(bench: Bench) -> None:
    peer, limit = bench.peer(), bench.sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE")
    value = b"v" * min(bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), 200)
    descr = b"d" * min(longest_description(bench), 200)
    size = bench.builder.record_size(bench.records.sample(value=value, descr=descr))
    count = min(64, 5 * limit // (2 * size) + 1)
    since = bench.mark()
    creates = teach_variables(
        bench, peer, (peer.create(each, value=value, descr=descr) for each in bench.identifiers.var_ids(count))
    )
    peer.send(*(peer.request_create(each.spec.var_id) for each in creates))
    wanted = {each.spec.var_id for each in creates}
    start = bench.mark()
    bench.until(
        lambda _: wanted <= {each.var_id for each in bench.instructions(ICType.CREATE_VARIABLES, since=start)},
        bench.sut.reaction + 6,
    )
    came = {each.var_id for each in bench.instructions(ICType.CREATE_VARIABLES, since=start)}
    bench.some(wanted <= came, f"all {count} VarCreates", seen=f"{len(wanted - came)} missing")
    blocks = [(heard, len(block)) for heard in bench.heard[since:] for block in _blocks(heard)]
    long = [heard for heard, octets in blocks if octets > limit]
    longest = max((octets for _, octets in blocks), default=0)
    bench.sut.bound("VARDISPAR_MAX_PAYLOAD_SIZE")
    bench.none(long, f"payloads of at most {limit} octets", seen=f"a payload of {longest} octets")
    several = any(
        count > 1 for heard in bench.heard for count in Counter(each.ic_type for each in heard.containers).values()
    )
    if bench.profile.spec_version >= _SINCE_1_1:
        bench.info(
            "Does a payload have several containers of the same type?", "yes" if several else "not observed", "VD-IC-04"
        )


# -- the database ------------------------------------------------------------------------------------------------------


def _entry(bench: Bench, var_id: int) -> dict[str, Any]:
    return bench.present(entry_of(bench, var_id), f"an answer of RTDB-DescribeVariable about variable {var_id}")


def _expect(bench: Bench, entry: dict[str, Any], expected: dict[str, Any], *requirements: str) -> None:
    for name, value in expected.items():
        bench.answered(
            entry.get(name), value, name, *requirements, field="creationTime" if name == "creationTime" else None
        )


@case(
    "TC_VD_DB_BV_01",
    "The database entry of a received variable has the contents of its VarCreate",
    requirements="VD-DB-01 VD-PC-07",
    stimulus="a VarCreate of another node, then RTDB-DescribeVariable; again during the repetitions of its VarCreate",
    expect=(
        "specification, value and sequence number as received; isDeleted false; countCreate at most repCnt, the "
        "other counters 0"
    ),
    needs=_DESCRIBE,
)
def entry_of_received(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    record = bench.learnt(peer, var_id, value=b"\0\xff", seqno=7, rep_cnt=bench.sut.rep_cnt(2))
    entry, spec = _entry(bench, var_id), record.spec
    expected: dict[str, Any] = {
        "varId": var_id,
        "prodId": spec.prod_id.hex(":"),
        "repCnt": spec.rep_cnt,
        "descr": spec.descr.decode(),
        "value": record.upd.value.hex(),
        "seqno": 7,
        "isDeleted": False,
        "countCreate": 0,
        "countUpdate": 0,
        "countDelete": 0,
    }
    if spec.creation_time is not None:
        expected |= {"creationTime": spec.creation_time, "timeout": spec.timeout}
    _expect(bench, entry, expected)
    peer.send(peer.request_create(var_id))
    bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    count = _entry(bench, var_id).get("countCreate")
    right = isinstance(count, int) and 0 <= count <= spec.rep_cnt
    bench.proved(right, f"countCreate at most {spec.rep_cnt} (repCnt)", count, "VD-DB-01")


@case(
    "TC_VD_DB_BV_02",
    "The database has only one entry for a variable",
    requirements="VD-DB-01",
    stimulus="a variable is received, updated and requested",
    expect="one entry with its identifier in RTDB-DescribeDatabase",
    needs=Needs(ut=("RTDB-DescribeDatabase",)),
)
def one_entry(bench: Bench) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer)
    for record in (peer.update(var_id, 1), peer.request_create(var_id), peer.create(var_id)):
        peer.send(record)
    bench.require_alive("several records about the variable")
    found = bench.must("RTDB-DescribeDatabase").result.get("variables")
    same = [each for each in found if each.get("varId") == var_id] if isinstance(found, list) else []
    bench.answered(len(same), 1, "entries with the identifier")


@case(
    "TC_VD_DB_BV_03",
    "A deleted variable remains in the database and is marked as deleted ({variant})",
    requirements="VD-DB-02",
    stimulus="a variable is deleted ({variant}); its repetitions end",
    expect="RTDB-DescribeDatabase lists it; RTDB-DescribeVariable returns isDeleted true",
    window=8,
    needs=Needs(
        since=SpecVersion.V2_0, ut=("RTDB-DescribeDatabase", "RTDB-DescribeVariable", "RTDB-Create", "RTDB-Delete")
    ),
    variants={"own": True, "received": False},
)
def stays(bench: Bench, own: bool) -> None:
    peer = bench.peer()
    if own:
        var_id = bench.identifiers.own_var_id()
        bench.must("RTDB-Create", **create_request(bench, var_id))
        bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
        bench.must("RTDB-Delete", varId=var_id)
    else:
        var_id = teach_variable(bench, peer)
        peer.send(peer.delete(var_id))
    if bench.until_instruction(ICType.DELETE_VARIABLES, var_id) is None:
        bench.inconclusive("a VarDelete of the variable, which this case needs", "none in time")
    bench.wait(2)
    # Each row is a VarSpecT; isDeleted is an optional addition (VD-DDB-03).
    row = listed(bench).get(var_id)
    bench.proved(row is not None, "the variable in the list", "not in the list")
    flag = True if row is None else row.get("isDeleted", True)
    bench.answered(flag, True, "isDeleted, if the list has this field")
    _expect(bench, _entry(bench, var_id), {"isDeleted": True, "countDelete": 0, "countCreate": 0, "countUpdate": 0})


@case(
    "TC_VD_DB_BV_04",
    "tStamp is the local time of the last accepted creation or update",
    requirements="VD-DB-03",
    stimulus="a VarCreate, a newer VarUpdate and records that are not accepted, with pauses between them",
    expect="tStamp is renewed only by the first two, to the time of their reception",
    window=12,
    needs=_DESCRIBE,
)
def time_stamp(bench: Bench) -> None:
    peer, tolerance = bench.peer(), round(bench.sut.pixit.clock_tolerance_ms * MS)

    def stamp(after: int) -> int:
        """Return the time stamp of the variable, after checking that it is between ``after`` and now."""
        found = stamp_in(bench, _entry(bench, var_id))
        bench.within(found, after - tolerance, bench.lower.wall() + tolerance, "tStamp in ns", late="neither")
        return found

    begun = bench.lower.wall()
    var_id = teach_variable(bench, peer, seqno=5)
    created = stamp(begun)
    bench.wait(2)
    for record in (peer.update(var_id, 5, b"equal"), peer.update(var_id, 4, b"older"), peer.summary(var_id, 5)):
        peer.send(record)
    bench.require_alive("records that are not accepted")
    bench.answered(stamp(begun), created, "tStamp unchanged by records that are not accepted")
    updated = created
    for seqno in (6, 7, 8):
        before, earlier = bench.lower.wall(), updated
        peer.send(peer.update(var_id, seqno))
        came = bench.until_instruction(ICType.UPDATES, var_id)
        updated = stamp(before)
        # An earlier time can come from a clock that was set back, but not after each of three updates.
        if updated >= earlier:
            break
    bench.none(updated <= earlier, "a later tStamp after a newer VarUpdate", seen=f"{updated - earlier} ns", given=came)


@case(
    "TC_VD_TYP_BV_04",
    (
        "The records about the first variable that a node learns can be decoded and have the contents that the "
        "node received"
    ),
    requirements="VD-TYP-05 VD-TYP-07 VD-IC-01 VD-IC-02 VD-IC-03",
    stimulus="a peer creates a variable, and nothing else",
    expect="beacons with its VarCreate and summaries that can be decoded completely with the profile",
    window=8,
)
def first_words(bench: Bench) -> None:
    peer, since = bench.peer(), bench.mark()
    # Exchanged members of a record can be detected only if their values differ.
    count = bench.sut.rep_cnt(3)
    var_id = next(each for each in bench.identifiers.var_ids(2) if each != count)
    record = peer.create(var_id, rep_cnt=count, value=b"value")
    peer.send(record)
    bench.wait(bench.sut.reaction + 2)
    spoke = bench.needed([heard for heard in bench.heard[since:] if _blocks(heard)], "beacons with a VarDis block")
    bench.none([each for each in spoke if _has_empty_container(each)], "a record in every container", "VD-IC-03")
    bench.every(spoke, lambda each: not _faults(each), "payloads that can be decoded", "VD-IC-01 VD-IC-02")
    said_of_it = {each.kind for heard in spoke for each in heard.instructions(var_id=var_id)}
    kinds = said_of_it - {ICType.CREATE_VARIABLES, ICType.SUMMARIES}
    names = ", ".join(sorted(kind.label for kind in kinds))
    bench.none(
        kinds, "no records of the variable other than VarCreates and summaries", "VD-IC-02 VD-TYP-07", seen=names
    )
    creates = bench.instructions(ICType.CREATE_VARIABLES, since=since)
    wrong = [each for each in creates if each.record.spec.prod_id == peer.node_id and each.record != record]
    observed = f"{wrong[0].record}" if wrong else ""
    bench.none(wrong, f"the VarCreate as received: {record}", "VD-TYP-05 VD-TYP-07", seen=observed)
