"""Networks: several hops, with the implementation in the middle.

One peer sends records; another one receives only what the implementation forwards, or echoes it.
"""

from __future__ import annotations

from dcp_spec.constants import ICType

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import case
from dcp_conformance.frames.received import Instruction
from dcp_conformance.test_steps.repetitions import check_order
from dcp_conformance.test_system.bench import Bench

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES


def _check_unchanged(bench: Bench, found: list[Instruction], wanted: VardisRecord, *requirements: str) -> None:
    """Check that records were forwarded unchanged, octet by octet."""
    octets = bench.builder.container(wanted)
    bench.every(
        found, lambda each: bench.builder.container(each.record) == octets, f"the octets of {wanted}", *requirements
    )


@case(
    "TC_NET_HOP_BV_01",
    "A VarCreate, a VarUpdate and a VarDelete are forwarded unchanged, in repCnt beacons ({variant})",
    requirements="VD-SCP-02 VD-TYP-06 VD-PC-10 VD-PU-07 VD-PD-04",
    stimulus="a peer creates a variable with repCnt {variant}, updates and deletes it",
    expect="each of the three in exactly repCnt distinct beacons, with identical octets",
    window=60,
    variants={"1": 1, "2": 2, "5": 5, "max": 255},
)
def passes_through(bench: Bench, wanted: int) -> None:
    count = bench.sut.rep_cnt(wanted)
    peer, producer, name = bench.peer(), bench.identifiers.node_id(), bench.var_id()
    create = peer.create(name, rep_cnt=count, producer=producer, descr=b"a far one", value=b"\x00\xff\x80", seqno=200)
    steps = (
        (_CREATE, create, ("VD-TYP-06", "VD-PC-10")),
        (_UPDATE, peer.update(name, 201, b"another length"), ("VD-PU-07",)),
        (_DELETE, peer.delete(name), ("VD-PD-04",)),
    )
    for kind, record, requirements in steps:
        mark = peer.stimulate(record)
        found = bench.check_repeated(kind, name, count, mark, "VD-SCP-02")
        _check_unchanged(bench, found, record, *requirements)


@case(
    "TC_NET_HOP_BV_02",
    "A record received again from the next hop is not forwarded again",
    requirements="VD-SCP-03",
    stimulus="a peer creates, updates and deletes a variable; another peer echoes each record when it is forwarded",
    expect="each of the three in exactly repCnt beacons",
    window=60,
)
def no_echo(bench: Bench) -> None:
    source, echo = bench.peer(), bench.peer()
    name, count = bench.var_id(), bench.sut.rep_cnt(2)
    for kind, record in (
        (_CREATE, source.create(name, rep_cnt=count)),
        (_UPDATE, source.update(name, 1)),
        (_DELETE, source.delete(name)),
    ):
        mark = source.stimulate(record)
        for _ in range(count):
            if bench.until_instruction(kind, name) is None:
                break
            echo.send(record)
        echo.send(record, record)
        echo.send(record)
        bench.check_repeated(kind, name, count, mark)


@case(
    "TC_NET_HOP_BV_03",
    "Repetitions of the producer do not restart those of the implementation",
    requirements="VD-SCP-03 VD-SCP-02",
    stimulus="a peer sends a VarCreate and a VarUpdate in repCnt beacons each, one per beacon period",
    expect="both in exactly repCnt beacons of the implementation",
    window=40,
)
def repetitions_of_the_producer(bench: Bench) -> None:
    source, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(4)
    for kind, record in ((_CREATE, source.create(name, rep_cnt=count)), (_UPDATE, source.update(name, 1))):
        mark = bench.mark()
        for _ in range(count):
            source.send(record)
            bench.wait(1)
        bench.check_repeated(kind, name, count, mark)


@case(
    "TC_NET_HOP_BI_01",
    "Records of single-hop scope are not forwarded ({variant})",
    requirements="VD-SCP-01",
    stimulus="a {variant} about a variable that the implementation knows, with its current sequence number",
    expect="no such record in its beacons, other than its own",
    window=10,
    variants={
        "summary": ICType.SUMMARIES,
        "request-for-update": ICType.REQUEST_VARUPDATES,
        "request-for-create": ICType.REQUEST_VARCREATES,
    },
)
def single_hop(bench: Bench, kind: ICType) -> None:
    peer, name = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(name, seqno=4))
    mark = bench.mark()
    if kind is ICType.SUMMARIES:
        # A summary of the implementation's own has number 4; with an older number it is a copy.
        peer.send(peer.summary(name, 3))
    elif kind is ICType.REQUEST_VARUPDATES:
        peer.send(peer.request_update(name, 4))
    else:
        peer.send(peer.request_create(name))
    bench.require_alive("a record of single-hop scope")
    bench.beacons(3)
    found = bench.instructions(kind, name, mark)
    if kind is ICType.SUMMARIES:
        found = [each for each in found if each.record.seqno != 4]
    bench.none(found, "no copy of the record")


@case(
    "TC_NET_HOP_BV_04",
    "Successive updates are forwarded in order, however they are distributed over beacons ({variant})",
    requirements="VD-PU-07 VD-RX-09",
    stimulus="VarUpdates 1 to 6 of a variable ({variant})",
    expect="sequence numbers that do not decrease, and number 6 in exactly repCnt beacons",
    window=30,
    variants={"one-payload": "one", "six-beacons": "burst", "one-per-period": "paced"},
)
def chain(bench: Bench, how: str) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    bench.learn(peer, peer.create(name, rep_cnt=count))
    mark = bench.mark()
    updates = [peer.update(name, number, bytes((number,))) for number in range(1, 7)]
    if how == "one":
        peer.send(*updates)
    for each in updates if how != "one" else ():
        peer.send(each)
        bench.wait(1 if how == "paced" else 0)
    found = bench.waiting.repeated(_UPDATE, name, mark)
    numbers = check_order(bench, found, "VD-RX-09")
    bench.repeated(numbers.count(6), count, "beacons with sequence number 6", "VD-PU-07", frames=found[-4:])
    bench.every(
        found,
        lambda each: each.record.value == bytes((each.record.seqno,)),
        "each sequence number with its own value",
        "VD-PU-07",
    )


@case(
    "TC_NET_HOP_BV_05",
    "Creation, update, deletion and renewed creation of a variable are all forwarded",
    requirements="VD-PC-09 VD-PU-07 VD-PD-04 VD-PC-10",
    stimulus=(
        "a peer creates a variable, updates it, deletes it and creates it again, each step after the one before is "
        "complete"
    ),
    expect="each record in exactly repCnt beacons, unchanged",
    window=60,
)
def whole_life(bench: Bench) -> None:
    peer, name, count = bench.peer(), bench.var_id(), bench.sut.rep_cnt(2)
    steps = (
        (_CREATE, lambda: peer.create(name, value=b"first", rep_cnt=count), "VD-PC-09"),
        (_UPDATE, lambda: peer.update(name, 1, b"second"), "VD-PU-07"),
        (_DELETE, lambda: peer.delete(name), "VD-PD-04"),
        # Sequence numbers restart at 0 after the renewed creation.
        (_CREATE, lambda: peer.create(name, value=b"third", rep_cnt=count), "VD-PC-10"),
        (_UPDATE, lambda: peer.update(name, 1, b"fourth"), "VD-PU-07"),
    )
    for kind, make, requirement in steps:
        record = make()
        mark = peer.stimulate(record)
        found = bench.check_repeated(kind, name, count, mark, requirement)
        _check_unchanged(bench, found, record, requirement)
