"""dcp-vardis.md: Real-Time Database, the time stamp of a variable.

Events that renew tStamp, and events that must not: the timeout of a variable starts from it.
"""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import created_again, described, produced, settled, teach_variable
from dcp_conformance.test_steps.time_stamps import check_later, stamp_in
from dcp_conformance.test_steps.variable_queries import stepped
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_DESCRIBE = Needs(ut=("RTDB-DescribeVariable",))
_V2 = Needs(since=SpecVersion.V2_0, ut=("RTDB-DescribeVariable",))
_OWN = Needs(ut=("RTDB-Create", "RTDB-DescribeVariable"))


def _stamp(bench: Bench, var_id: int) -> int:
    """Return the time stamp of a variable; fails and stops the case if it is not a number."""
    return stamp_in(bench, described(bench.must("RTDB-DescribeVariable", varId=var_id)), "VD-DB-03")


def _earlier(record: VarCreate, peer: Peer, distance: int) -> VarCreate:  # noqa: ARG001 - as the others
    created = record.spec.creation_time
    assert created is not None
    spec = record.spec
    return peer.create(spec.var_id, value=b"older", seqno=9, creation_time=created - 1, producer=spec.prod_id)


_Made = Callable[[VarCreate, Peer, int], VardisRecord]
_IGNORED: dict[str, _Made | Variant] = {
    "the-same-VarCreate": lambda record, _peer, _older: record,
    "an-earlier-VarCreate": Variant(_earlier, needs=_V2),
    "the-same-VarUpdate": lambda record, _peer, _older: record.upd,
    "an-older-VarUpdate": lambda record, peer, older: peer.update(record.spec.var_id, older, b"older"),
    "the-same-VarSumm": lambda record, peer, _older: peer.summary(record.spec.var_id, record.upd.seqno),
    "an-older-VarSumm": lambda record, peer, older: peer.summary(record.spec.var_id, older),
    "a-VarReqUpdate": lambda record, peer, older: peer.request_update(record.spec.var_id, older),
    "a-VarReqCreate": lambda record, peer, _older: peer.request_create(record.spec.var_id),
}


@case(
    "TC_VD_DB_BV_05",
    "A received record that stores nothing does not renew tStamp ({variant})",
    requirements="VD-DB-03",
    stimulus=(
        "a VarCreate; two beacon periods later a record that stores nothing ({variant}); RTDB-DescribeVariable "
        "before and after it"
    ),
    expect="the same tStamp",
    window=12,
    needs=_DESCRIBE,
    variants=_IGNORED,
)
def not_renewed(bench: Bench, make: _Made) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    record = bench.learnt(peer, var_id, seqno=5)
    before = _stamp(bench, var_id)
    bench.wait(2)
    peer.send(make(record, peer, stepped(bench, 5, -1)))
    bench.require_alive("a record that stores nothing")
    bench.answered(_stamp(bench, var_id), before, "tStamp unchanged")


def _requests_of(bench: Bench, peer: Peer, held: VarCreate) -> None:
    var_id = held.spec.var_id
    peer.send(peer.request_create(var_id), peer.request_update(var_id, stepped(bench, held.upd.seqno, -1)))


def _read(bench: Bench, _peer: Peer, held: VarCreate) -> None:
    bench.must("RTDB-Read", varId=held.spec.var_id)
    bench.must("RTDB-DescribeVariable", varId=held.spec.var_id)


def _refused(bench: Bench, _peer: Peer, held: VarCreate) -> None:
    answer = bench.call("RTDB-Update", varId=held.spec.var_id, value="")
    bench.services.require_asked(answer, "an answer to RTDB-Update")


def _activated(bench: Bench, _peer: Peer, _held: VarCreate) -> None:
    with bench.services.deactivated("VD"):
        bench.wait(2)


def _with(*methods: str, since: SpecVersion = SpecVersion.V1_0) -> Needs:
    return Needs(since=since, ut=(*_OWN.ut, *methods))


@case(
    "TC_VD_DB_BV_06",
    "tStamp of a node's own variable is not renewed by an event that stores nothing ({variant})",
    requirements="VD-DB-03",
    stimulus=(
        "RTDB-Create; after its repetitions an event that stores nothing ({variant}); RTDB-DescribeVariable before "
        "and after it"
    ),
    expect="the same tStamp",
    window=16,
    needs=_OWN,
    variants={
        "its-summary-from-a-neighbour": lambda _, peer, held: peer.send(peer.summary(held.spec.var_id, held.upd.seqno)),
        "its-VarUpdate-from-a-neighbour": lambda _, peer, held: peer.send(held.upd),
        "its-VarCreate-from-a-neighbour": lambda _, peer, held: peer.send(held),
        "requests": _requests_of,
        "RTDB-Read": Variant(_read, needs=_with("RTDB-Read")),
        "RTDB-Update-that-is-refused": Variant(_refused, needs=_with("RTDB-Update")),
        "VD-MGMT-Activate": Variant(
            _activated, needs=_with("VD-MGMT-Activate", "VD-MGMT-Deactivate", since=SpecVersion.V1_2)
        ),
    },
)
def own_not_renewed(bench: Bench, act: Callable[[Bench, Peer, VarCreate], object]) -> None:
    mark = bench.mark()
    var_id = produced(bench)
    held = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    if held is None:
        bench.inconclusive("a VarCreate of the node's own variable, which this case needs", "none in time")
    settled(bench, var_id, mark)
    before = _stamp(bench, var_id)
    bench.wait(2)
    act(bench, bench.peer(), held)
    bench.require_alive("an event that stores nothing")
    bench.answered(_stamp(bench, var_id), before, "tStamp unchanged")


@case(
    "TC_VD_DB_BV_07",
    "A creation that replaces a variable renews tStamp ({variant})",
    requirements="VD-DB-03",
    stimulus="a variable is created ({variant}), and again two beacon periods later with a later creationTime",
    expect="a later tStamp",
    window=12,
    needs=_V2,
    variants={
        "received": Variant(False, requirements="VD-DB-03 VD-PC-07"),
        "own": Variant(True, requirements="VD-DB-03 VD-CRE-10", needs=Needs(since=SpecVersion.V2_0, ut=_OWN.ut)),
    },
)
def renewed(bench: Bench, own: bool) -> None:
    peer = bench.peer()
    var_id = produced(bench) if own else teach_variable(bench, peer)

    def measure() -> int:
        before = _stamp(bench, var_id)
        bench.wait(2)
        created_again(bench, var_id) if own else bench.learn(peer, peer.create(var_id, seqno=3))
        return _stamp(bench, var_id) - before

    check_later(bench, "a later tStamp", 1, measure)
