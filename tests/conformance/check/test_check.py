"""Invariants over recordings: silent about networks that follow the specification, and about nothing else."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle, islice, pairwise
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.check import RULES, Judge
from dcp_conformance.check.recording import judge_versions
from dcp_conformance.definitions.case import DECLARED
from dcp_conformance.definitions.declared import declared_by
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_lab.testing.strategies import beacons, mutations
from dcp_spec.catalogue.requirements import requirements
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.values import VarDelete, VardisRecord, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_stack.config import BPConfig
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.topology import Full, Grid, Line, Topology

from ...chance import examples
from ...parts import also, every
from ..air import MS, SECOND, Script, case_of, findings, judged, simulated, thinned
from ..rig import codec_of

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
PROFILES = ("dcp-2.0", "dcp-1.3", "dcp-1.2", "dcp-1.1", "dcp-1.0")
TOPOLOGIES: dict[str, Topology] = {"full": Full(), "line": Line(), "grid": Grid(3)}
A, B, C = 1, 2, 3


# -- every invariant: a recording that keeps it, and the same with one thing wrong ----------------------------------


@dataclass
class Outcome:
    """The findings that a script expects of its wrong version."""

    requirements: tuple[str, ...]
    frames: tuple[int, ...] = ()
    """Some frames that the finding has to name; empty if it is about no frame."""
    also: tuple[str, ...] = ()
    """Other invariants that the same octets break."""
    verdict: Verdict = Verdict.FAIL
    pics: Pics | None = None


Scripted = Callable[[Script, bool], Outcome]
SCRIPTS: dict[str, tuple[str, Scripted]] = {}


def script(rule: str, profile: str = "dcp-2.0", variant: str = "") -> Callable[[Scripted], Scripted]:
    """Register a recording for an invariant."""

    def register(function: Scripted) -> Scripted:
        SCRIPTS[f"{rule}{f'-{variant}' if variant else ''}"] = (profile, function)
        return function

    return register


def swapped(number: int) -> int:
    """A 64-bit number with its octets the other way round."""
    return int.from_bytes(number.to_bytes(8, "big"), "little")


@script("CK_DATA_ORDER")
def byte_order(air: Script, wrong: bool) -> Outcome:
    create = air.create(1, A)
    if wrong:
        time = swapped(create.spec.creation_time or 0)
        create = msgspec.structs.replace(create, spec=msgspec.structs.replace(create.spec, creation_time=time))
    number = air.say(A, create, VarSumm(1, 0))
    return Outcome(("DATA-01",), (number,))


@script("CK_DATA_PACKED", "cpp-2.0")
def packing(air: Script, wrong: bool) -> Outcome:
    if not wrong:
        # Profiles whose records have no such regions have nothing to judge but the reports themselves.
        air.profile, air.codec = "dcp-2.0", codec_of("dcp-2.0")
        air.say(A, report=air.report(A))
        return Outcome(())
    number = air.say(A, report=air.report(A, t_stamp=0))
    return Outcome(("DATA-02",), (number,))


@script("CK_BP_FORMAT")
def beacon_format(air: Script, wrong: bool) -> Outcome:
    air.say(A, VarSumm(1, 0))
    number = air.say(A, VarSumm(1, 0), patch=lambda octets: b"\2" + octets[1:] if wrong else octets)
    return Outcome(("BP-HDR-01",), (number,))


def _patched(variant: str, requirement: str, patch: Callable[[bytes], bytes]) -> None:
    """Register a beacon of dcp-2.0 with one fault in its headers."""

    def beacon(air: Script, wrong: bool) -> Outcome:
        air.say(A, VarSumm(1, 0))
        number = air.say(A, VarSumm(1, 0), patch=lambda octets: patch(octets) if wrong else octets)
        return Outcome((requirement,), (number,))

    script("CK_BP_FORMAT", variant=variant)(beacon)


_patched("magic", "BP-HDR-02", lambda octets: octets[:1] + octets[2:0:-1] + octets[3:])
_patched("length", "BP-HDR-06", lambda octets: octets[:12] + bytes([octets[12] + 18]) + octets[13:])
_patched("one-more", "BP-HDR-07", lambda octets: octets[:13] + bytes([octets[13] + 1]) + octets[14:])
_patched("block-length", "BP-FMT-01", lambda octets: octets[:21] + bytes([octets[21] + 4]) + octets[22:])


@script("CK_UWB_BROADCAST")
def broadcast(air: Script, wrong: bool) -> Outcome:
    number = air.say(A, VarSumm(1, 0), destination=air.node(B) if wrong else b"\xff" * 6)
    return Outcome(("UWB-01",), (number,))


@script("CK_BP_SIZE")
def packet_size(air: Script, wrong: bool) -> Outcome:
    air.say(A, VarSumm(1, 0))
    number = air.say(A, *(VarSumm(each, 0) for each in range(60 if wrong else 10)))
    return Outcome(("BP-FMT-02",), (number,), pics=Pics(pixit=Testing(max_packet_size=100)))


@script("CK_BP_NETWORK")
def network_identifier(air: Script, wrong: bool) -> Outcome:
    numbers = [air.say(A, VarSumm(1, 0), network_id=0x1111 + (wrong and each % 2)) for each in range(8)]
    return Outcome(("BP-HDR-04",), (numbers[3],))


@script("CK_BP_SENDER")
def sender_identifier(air: Script, wrong: bool) -> Outcome:
    air.say(A, VarSumm(1, 0))
    number = air.say(B if wrong else A, VarSumm(1, 0), source=A)
    # A gateway may carry beacons of others.
    return Outcome(("BP-HDR-03", "BP-PAR-09", "DATA-04"), (1, number), verdict=Verdict.INFO)


@script("CK_BP_SEQNO")
def beacon_numbers(air: Script, wrong: bool) -> Outcome:
    for each in range(100, 120):
        air.say(A, VarSumm(1, 0), seqno=each)
    number = air.say(A, VarSumm(1, 0), seqno=90 if wrong else 120)
    return Outcome(("BP-HDR-08",), (number - 1, number))


@script("CK_BP_SEQNO", variant="stuck")
def stuck_numbers(air: Script, wrong: bool) -> Outcome:
    numbers = [air.say(A, VarSumm(1, each), seqno=0 if wrong else each) for each in range(5)]
    return Outcome(("BP-HDR-08",), (numbers[0], numbers[1]))


@script("CK_BP_SEQNO", variant="small")
def numbers_that_never_grow(air: Script, wrong: bool) -> Outcome:
    numbers = [air.say(A, VarSumm(1, 0), seqno=each % (4 if wrong else 100)) for each in range(25)]
    return Outcome(("BP-HDR-08",), (numbers[20],))


@script("CK_BP_PERIOD")
def beacon_period(air: Script, wrong: bool) -> Outcome:
    for _ in range(40):
        air.say(A, VarSumm(1, 0))
    # Intervals are 33.3 ms.
    return Outcome(("BP-TX-01",), pics=Pics(pixit=Testing(beacon_period_ms=50.0 if wrong else 33.3)))


@script("CK_VD_RECORDS")
def record_rules(air: Script, wrong: bool) -> Outcome:
    number = air.say(A, VarSumm(1, 0), VarSumm(1 if wrong else 2, 0))
    return Outcome(("VD-PAY-03",), (number,))


@script("CK_SRP_OWN")
def own_reports(air: Script, wrong: bool) -> Outcome:
    number = air.say(A, report=air.report(A, about=B if wrong else A))
    return Outcome(("SRP-TYP-04", "SRP-RX-06"), (number,))


@script("CK_SRP_LENGTH")
def report_length(air: Script, wrong: bool) -> Outcome:
    def longer(octets: bytes) -> bytes:
        payload = bytearray(octets + b"\0")
        payload[10:12] = (int.from_bytes(payload[10:12], "big") + 1).to_bytes(2, "big")
        payload[20:22] = (int.from_bytes(payload[20:22], "big") + 1).to_bytes(2, "big")
        return bytes(payload)

    air.say(A, report=air.report(A))
    number = air.say(A, report=air.report(A), patch=longer if wrong else bytes)
    return Outcome(("SRP-FMT-01", "SRP-TYP-02", "SRP-TYP-03"), (number,), also=("CK_BP_FORMAT",))


@script("CK_SRP_SEQNO")
def report_numbers(air: Script, wrong: bool) -> Outcome:
    air.say(A, report=air.report(A, seqno=1000))
    number = air.say(A, report=air.report(A, seqno=900 if wrong else 1001))
    return Outcome(("SRP-SEQ-01",), (number - 1, number))


@script("CK_SRP_SEQNO", variant="same")
def report_numbers_twice(air: Script, wrong: bool) -> Outcome:
    air.say(A, report=air.report(A, seqno=1000))
    number = air.say(A, report=air.report(A, seqno=1000 if wrong else 1001))
    return Outcome(("SRP-TYP-06",), (number - 1, number))


@script("CK_SRP_SEQNO", variant="slow")
def report_numbers_of_slow_beacons(air: Script, wrong: bool) -> Outcome:
    """A node that restarts between two of its beacons may come to the number of its last report again."""
    air.say(A, report=air.report(A, seqno=48), seqno=1)
    air.time += 9 * SECOND
    number = air.say(A, report=air.report(A, seqno=48), seqno=2 if wrong else 1)
    air.say(A, report=air.report(A, seqno=98), seqno=3 if wrong else 2)
    return Outcome(("SRP-TYP-06",), (number - 1, number))


@script("CK_SRP_SEQNO", variant="time")
def report_times(air: Script, wrong: bool) -> Outcome:
    for each in range(12):
        number = air.say(A, report=air.report(A, late=200 * MS if wrong and each % 3 == 2 else 0))
    return Outcome(("SRP-TYP-05",), (number - 3,))


@script("CK_SRP_TIME")
def report_ages(air: Script, wrong: bool) -> Outcome:
    number = air.say(A, report=air.report(A, late=-3600 * SECOND if wrong else 0))
    return Outcome(("SRP-TYP-05", "DATA-05"), (number,), verdict=Verdict.INFO)


@script("CK_SRP_VALUES")
def report_values(air: Script, wrong: bool) -> Outcome:
    report = air.report(A)
    data = msgspec.structs.replace(report.s_data, x=float("nan") if wrong else 1.0)
    air.say(A, report=report)
    number = air.say(A, report=msgspec.structs.replace(air.report(A), s_data=data))
    expected = ("SRP-TYP-02", "SRP-TYP-05")
    return Outcome(expected, (number,), verdict=Verdict.INFO)


@script("CK_VD_ORDER")
def container_order(air: Script, wrong: bool) -> Outcome:
    create, summary = air.create(1, A), VarSumm(1, 0)
    number = air.say(A, *((summary, create) if wrong else (create, summary)))
    return Outcome(("VD-PAY-01",), (number,))


@script("CK_VD_ORDER", "dcp-1.0", "twice")
def containers_of_one_type(air: Script, wrong: bool) -> Outcome:
    create, summary, update = air.create(1, A), VarSumm(1, 0), VarUpdate(2, 3, b"x")
    records = (update, summary) if not wrong else (create, update, summary, VarReqCreate(9), VarReqUpdate(9, 1))
    if wrong:
        # Two containers UPDATES, with a permitted one between them.
        number = air.say(A, update, summary, patch=_with_container_twice)
        return Outcome(("VD-IC-04",), (number,), also=("CK_VD_PAYLOAD", "CK_VD_RECORDS"))
    number = air.say(A, *records)
    return Outcome(("VD-IC-04",), (number,))


def _with_container_twice(octets: bytes) -> bytes:
    """Repeat the first container (UPDATES of one variable with one octet) after itself, in the layout of 1.0."""
    header, payload = octets[:14], octets[14:]
    first = payload[4 : 4 + 2 + 4]
    containers = first + payload[4:]
    return header + payload[:2] + len(containers).to_bytes(2, "big") + containers


@script("CK_VD_PAYLOAD")
def payload_consistency(air: Script, wrong: bool) -> Outcome:
    number = air.say(A, VarSumm(1, 3), VarUpdate(1, 4 if wrong else 3, b"x"))
    return Outcome(("VD-CMP-04", "VD-UPD-10"), (number,))


@script("CK_VD_PAYLOAD", variant="deleted")
def summary_of_a_deleted_variable(air: Script, wrong: bool) -> Outcome:
    air.say(A, VarSumm(1, 3), VarSumm(2, 0))
    number = air.say(A, VarDelete(1), VarSumm(1 if wrong else 2, 3 if wrong else 0))
    return Outcome(("VD-CMP-05",), (number,), also=("CK_VD_DELETED",) if wrong else ())


@script("CK_VD_SEQNO")
def variables_forwards(air: Script, wrong: bool) -> Outcome:
    first = air.say(B, VarSumm(1, 250))
    second = air.say(B, VarSumm(1, 249 if wrong else 3))
    air.idle(12)
    return Outcome(("VD-TYP-03", "VD-PU-06"), (first, second))


@script("CK_VD_SEQNO", variant="silent")
def forwarded_variables_after_another_node_falls_silent(air: Script, wrong: bool) -> Outcome:
    # The number of this node cannot be judged any more, but those of other nodes are.
    air.say(A, VarSumm(2, 250))
    air.say(A, VarSumm(2, 249))
    first = air.say(B, VarSumm(1, 250))
    second = air.say(B, VarSumm(1, 249 if wrong else 3))
    air.idle(12, nodes=(B, C))
    return Outcome(("VD-TYP-03", "VD-PU-06"), (first, second))


@script("CK_VD_VALUE")
def one_value(air: Script, wrong: bool) -> Outcome:
    first = air.say(A, air.create(1, A), VarSumm(1, 0))
    second = air.say(B, air.create(1, A, value=b"abce" if wrong else b"abcd"), VarSumm(1, 0))
    air.idle(30)
    return Outcome(("VD-PU-05", "VD-PU-07"), (first, second))


@script("CK_VD_VALUE", "dcp-1.3", "update")
def one_value_of_an_update(air: Script, wrong: bool) -> Outcome:
    air.say(A, air.create(1, A), VarSumm(1, 0))
    first = air.say(A, VarSumm(1, 1), VarUpdate(1, 1, b"new"))
    second = air.say(B, VarSumm(1, 1), VarUpdate(1, 1, b"ne" if wrong else b"new"))
    air.idle(30)
    return Outcome(("VD-PU-05", "VD-PU-07"), (first, second))


@script("CK_VD_SPEC")
def one_spec(air: Script, wrong: bool) -> Outcome:
    first = air.say(A, air.create(1, A), VarSumm(1, 0))
    second = air.say(B, air.create(1, A, descr=b"w" if wrong else b"v"), VarSumm(1, 0))
    return Outcome(("VD-TYP-06", "VD-PC-10"), (first, second))


@script("CK_VD_SPEC", "dcp-1.3", "before-2.0")
def one_spec_before_creation_times(air: Script, wrong: bool) -> Outcome:
    first = air.say(A, air.create(1, A), VarSumm(1, 0))
    second = air.say(B, air.create(1, A, rep_cnt=2 if wrong else 1), VarSumm(1, 0))
    air.idle(30)
    return Outcome(("VD-TYP-06", "VD-PC-10"), (first, second))


@script("CK_VD_SPEC", variant="creation-time")
def forwarded_creation_time(air: Script, wrong: bool) -> Outcome:
    first = air.say(A, air.create(1, A, age=5), VarSumm(1, 0))
    second = air.say(B, air.create(1, A, age=2 if wrong else 5), VarSumm(1, 0))
    air.idle(30)
    return Outcome(("VD-TYP-06", "VD-PC-10"), (first, second))


@script("CK_VD_DELETED")
def deleted(air: Script, wrong: bool) -> Outcome:
    air.say(A, VarSumm(1, 0))
    first = air.say(A, VarDelete(1))
    second = air.say(A, VarSumm(1 if wrong else 2, 0))
    air.idle(12)
    return Outcome(("VD-DEL-05", "VD-PD-04", "VD-CMP-05"), (first, second))


@script("CK_VD_CREATION")
def recreation(air: Script, wrong: bool) -> Outcome:
    first = air.say(A, air.create(1, A, age=10), VarSumm(1, 0))
    second = air.say(A, air.create(1, A, age=20 if wrong else 5), VarSumm(1, 0))
    return Outcome(("VD-CRE-09",), (first, second), verdict=Verdict.INFO)


@script("CK_VD_REPEAT")
def repetitions(air: Script, wrong: bool) -> Outcome:
    for var_id in range(1, 6):
        create = air.create(var_id, A, rep_cnt=2)
        for _ in range(3 if wrong else 2):
            number = air.say(A, create, VarSumm(var_id, 0))
    air.idle(30)
    return Outcome(("VD-SCP-02", "VD-SCP-03"), (3,) if wrong else (number,))


@script("CK_VD_REPEAT", variant="equal-request")
def answers_to_equal_requests(air: Script, wrong: bool) -> Outcome:
    for var_id in range(1, 7):
        air.say(A, air.create(var_id, A), VarSumm(var_id, 0))
        air.idle(3)
        air.say(A, VarSumm(var_id, 1), VarUpdate(var_id, 1, b"new"))
        air.idle(3)
        air.say(B, VarReqUpdate(var_id, 1))
        air.say(A, VarSumm(var_id, 1), *([VarUpdate(var_id, 1, b"new")] if wrong else []))
    air.idle(30)
    return Outcome(("VD-RU-03",), (22, 44))


@script("CK_VD_REQUEST")
def requests(air: Script, wrong: bool) -> Outcome:
    first = air.say(B, VarSumm(1, 0))
    second = air.say(B, VarReqCreate(1 if wrong else 2))
    return Outcome(("VD-SCP-01",), (first, second))


Records = tuple[VardisRecord, ...]


def _dialogue(
    air: Script, wrong: bool, occasion: Callable[[int], Records], right: Callable[[int], Records],
    wrong_one: Callable[[int], Records] = lambda _: (), *, a: Callable[[int], Records] = lambda _: (),
) -> tuple[int, ...]:  # fmt: skip
    """B shows again and again that it hears A: it passes on the updates of variable 100. In between an occasion.

    ``occasion``: what A says; ``right``: what B says then; ``wrong_one``: what it says if it is wrong; ``a``: what A
    says after that. Gives the frames of the occasions.
    """
    create = air.create(100, A)
    air.say(A, create, VarSumm(100, 0))
    air.say(B, create, VarSumm(100, 0))
    frames = []
    for number in range(1, 13):
        for who in (A, B):
            air.say(who, VarSumm(100, number), VarUpdate(100, number, b"x"))
        frames.append(air.say(A, *occasion(number)))
        statement = wrong_one(number) if wrong else right(number)
        air.say(B, *(statement or (VarSumm(100, number),)))
        rest = tuple(each for each in statement if isinstance(each, VarSumm)) or (VarSumm(100, number),)
        air.idle(6, a(number) or (VarSumm(100, number),), rest, nodes=(A, B))
    return tuple(frames[:2])


@script("CK_NET_HEARS")
def hears_whom(air: Script, wrong: bool) -> Outcome:
    if not wrong:
        _dialogue(air, False, lambda n: (VarSumm(100, n),), lambda n: (VarSumm(100, n),))
        return Outcome(())
    # No node reacts: the rule observes that it cannot decide.
    air.idle(20)
    return Outcome(("UWB-01",), verdict=Verdict.INFO)


@script("CK_VD_TAKES_CREATE")
def takes_creations(air: Script, wrong: bool) -> Outcome:
    def create(number: int) -> Records:
        return (air.create(number, A, age=-number), VarSumm(number, 0))

    frames = _dialogue(air, wrong, create, create)
    return Outcome(("VD-PC-07", "VD-PC-09", "VD-RX-04"), frames, also=("CK_VD_ASK_CREATE",))


@script("CK_VD_TAKES_UPDATE")
def takes_updates(air: Script, wrong: bool) -> Outcome:
    create = air.create(7, A)
    for who in (A, B):
        air.say(who, create, VarSumm(7, 0))

    def update(number: int) -> Records:
        return (VarSumm(7, number), VarUpdate(7, number, b"x"))

    frames = _dialogue(air, wrong, update, update, lambda _: (VarSumm(7, 0),))
    return Outcome(("VD-PU-07", "VD-RX-04"), frames, also=("CK_VD_ASK_UPDATE",))


@script("CK_VD_TAKES_DELETE")
def takes_deletions(air: Script, wrong: bool) -> Outcome:
    for var_id in range(1, 13):
        create = air.create(var_id, A)
        for who in (A, B):
            air.say(who, create, VarSumm(var_id, 0))

    def left(first: int) -> Records:
        return tuple(VarSumm(var_id, 0) for var_id in range(first, 13))

    frames = _dialogue(
        air, wrong, lambda number: (VarDelete(number),), lambda number: (VarDelete(number), *left(number + 1)),
        lambda _: left(1),
    )  # fmt: skip
    return Outcome(("VD-PD-04",), frames)


@script("CK_VD_ASK_UPDATE")
def asks_for_updates(air: Script, wrong: bool) -> Outcome:
    create = air.create(7, A)
    for who in (A, B):
        air.say(who, create, VarSumm(7, 0))

    def summary(number: int) -> Records:
        return (VarSumm(7, number),)

    def asks(number: int) -> Records:
        return (VarSumm(7, number - 1), VarReqUpdate(7, number - 1))

    def silent(number: int) -> Records:
        return (VarSumm(7, 0),)

    def tells(number: int) -> Records:
        return (VarSumm(7, number), VarUpdate(7, number, b"x"))

    if wrong:
        return Outcome(("VD-PS-04",), _dialogue(air, wrong, summary, asks, silent))
    air.say(A, *tells(1))
    for number in range(2, 14):
        air.say(A, *summary(number))
        air.say(B, *asks(number))
        for who in (A, B):
            air.say(who, *tells(number))
        air.idle(5, (VarSumm(7, number),), (VarSumm(7, number),), nodes=(A, B))
    return Outcome(())


@script("CK_VD_ASK_CREATE")
def asks_for_creations(air: Script, wrong: bool) -> Outcome:
    air.seqno.update({A: 0, B: 0})
    for var_id in range(1, 13):
        air.say(A, air.create(var_id, A), VarSumm(var_id, 0))

    def summary(number: int) -> Records:
        return (VarSumm(number, 0),)

    # Before B is there at all.
    return Outcome(
        ("VD-PS-01",), _dialogue(air, wrong, summary, lambda number: (VarReqCreate(number), VarSumm(100, number)))
    )


@script("CK_VD_ANSWER_UPDATE")
def answers_update_requests(air: Script, wrong: bool) -> Outcome:
    create = air.create(7, C, seqno=3)
    for who in (C, A, B):
        air.say(who, create, VarSumm(7, 3))
    frames = _dialogue(
        air, wrong, lambda _: (VarReqUpdate(7, 0),), lambda _: (VarSumm(7, 3), VarUpdate(7, 3, b"abcd")),
        lambda _: (VarSumm(7, 3),),
    )  # fmt: skip
    return Outcome(("VD-RU-04",), frames)


@script("CK_VD_ANSWER_CREATE")
def answers_create_requests(air: Script, wrong: bool) -> Outcome:
    create = air.create(7, B)
    air.say(B, create, VarSumm(7, 0))
    frames = _dialogue(
        air, wrong, lambda _: (VarReqCreate(7),), lambda _: (create, VarSumm(7, 0)), lambda _: (VarSumm(7, 0),)
    )
    return Outcome(("VD-RC-03",), frames)


@script("CK_VD_TEACH")
def teaches(air: Script, wrong: bool) -> Outcome:
    create = air.create(7, C, seqno=3)
    for who in (C, A, B):
        air.say(who, create, VarSumm(7, 3))
    air.say(A, VarSumm(7, 3))
    air.seqno[A] += 1000
    frames = _dialogue(
        air, wrong, lambda _: (VarSumm(7, 1),), lambda _: (VarSumm(7, 3), VarUpdate(7, 3, b"abcd")),
        lambda _: (VarSumm(7, 3),), a=lambda number: (VarSumm(100, number),),
    )  # fmt: skip
    return Outcome(("VD-PS-03",), frames)


@script("CK_VD_BACKED")
def summaries_without_a_value(air: Script, wrong: bool) -> Outcome:
    air.say(A, air.create(7, A), VarSumm(7, 0))
    before = air.say(A, VarSumm(7, 0))
    first = air.say(A, VarSumm(7, 3), *([] if wrong else [VarUpdate(7, 3, b"x")]))
    air.idle(12, (VarSumm(7, 3),), nodes=(A,))
    return Outcome(("VD-SCP-02", "VD-CMP-04"), (before, first))


@script("CK_VD_BACKED", variant="nobody")
def a_variable_that_was_never_created(air: Script, wrong: bool) -> Outcome:
    air.idle(15, (VarSumm(7, 0),), nodes=(A,))
    new = [] if wrong else [air.create(8, A)]
    first = air.say(A, *new, VarSumm(7, 0), VarSumm(8, 0))
    air.idle(12, (VarSumm(7, 0), VarSumm(8, 0)), nodes=(A,))
    return Outcome(("VD-SCP-02", "VD-CMP-04"), (first,))


@script("CK_NET_AGREES")
def agrees(air: Script, wrong: bool) -> Outcome:
    create = air.create(7, A)
    for who in (A, B):
        air.say(who, create, VarSumm(7, 0))
    first = air.say(A, VarSumm(7, 1), VarUpdate(7, 1, b"x"))
    air.say(B, VarSumm(7, 0 if wrong else 1), *([] if wrong else [VarUpdate(7, 1, b"x")]))
    air.idle(100, (VarSumm(7, 1),), (VarSumm(7, 0 if wrong else 1),), nodes=(A, B))
    return Outcome(("VD-PU-07", "VD-PU-06"), (first,), verdict=Verdict.INFO)


@script("CK_VD_ENDLESS")
def endless_requests(air: Script, wrong: bool) -> Outcome:
    first = air.say(B, VarReqCreate(7))
    for _ in range(12):
        air.say(A, air.create(7, A, rep_cnt=3), VarSumm(7, 0))
        last = air.say(B, *([VarReqCreate(7)] if wrong else [air.create(7, A, rep_cnt=3), VarSumm(7, 0)]))
    return Outcome(("VD-PC-07", "VD-PU-07", "VD-RC-03", "VD-RU-04"), (first, last - 1), verdict=Verdict.INFO)


@script("CK_NET_SILENT")
def falls_silent(air: Script, wrong: bool) -> Outcome:
    for number in range(80):
        air.say(A, *([] if wrong and number >= 40 else [VarSumm(7, 0)]), report=air.report(A))
    return Outcome(("VD-RUN-02",), verdict=Verdict.INFO)


class TestEveryInvariant:
    def test_each_invariant_has_recordings(self):
        assert {each.partition("-")[0] for each in SCRIPTS} == {rule.id for rule in RULES}
        assert len({rule.id for rule in RULES}) == len(RULES)

    @pytest.mark.parametrize("name", SCRIPTS)
    def test_a_recording_that_keeps_the_invariant_passes(self, name: str):
        profile, write = SCRIPTS[name]
        air = Script(profile)
        outcome = write(air, False)
        run = judged(air.frames, air.profile, outcome.pics)
        assert findings(run) == []
        case = case_of(run, name.partition("-")[0])
        assert case.verdict is Verdict.PASS, case.reason
        assert not [check for check in case.checks if check.verdict is Verdict.INFO and check.frames]

    @pytest.mark.parametrize("name", SCRIPTS)
    def test_a_recording_that_violates_the_invariant_fails_with_requirement_and_frames(self, name: str):
        profile, write = SCRIPTS[name]
        air = Script(profile)
        outcome = write(air, True)
        run = judged(air.frames, air.profile, outcome.pics)
        rule = name.partition("-")[0]
        found = [check for check in case_of(run, rule).checks if check.verdict is outcome.verdict]
        assert found, case_of(run, rule).checks
        assert {each for check in found for each in check.requirements} == set(outcome.requirements)
        named = {mark.frame for check in found for mark in check.frames}
        assert named >= set(outcome.frames)
        others = {case.id for case in run.cases if case.verdict in (Verdict.FAIL, Verdict.ERROR)} - {rule}
        # Requirements that the profile of a script declares as violated fail as in a run.
        assert others - {DECLARED} <= set(outcome.also), findings(run)
        if outcome.verdict is Verdict.FAIL:
            assert all(run.requirements[each] is Verdict.FAIL for each in outcome.requirements)
            kept = {event.frame for event in case_of(run, rule).evidence}
            assert named <= kept

    @pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.id)
    def test_requirements_of_each_invariant_are_in_the_catalogue(self, rule):
        assert rule.requirements
        assert not set(rule.requirements) - set(requirements())


# -- networks of our own nodes ---------------------------------------------------------------------------------------


class TestNetworksThatFollowTheSpecification:
    """Nothing may be found in them, whatever happens to nodes, frames and recorder."""

    @pytest.mark.part("suite")
    @pytest.mark.parametrize(("place", "profile"), [*enumerate(PROFILES)])
    def test_nothing_is_found(self, place: int, profile: str):
        shapes = islice(cycle(TOPOLOGIES.values()), place, None)
        for seed, count, busy in ((1, 3, 6), (2, 5, 3), (3, 10, 0.5)):
            frames = simulated(profile, count, seed=seed, topology=next(shapes), busy=busy, seconds=10)
            assert findings(judged(frames, profile)) == []

    @pytest.mark.parametrize(
        ("profile", "shape"),
        [
            *every(3, (("dcp-2.0", each) for each in TOPOLOGIES)),
            *also("suite", ("dcp-1.3", "line"), ("dcp-1.0", "grid")),
        ],
    )
    def test_nothing_is_found_where_nodes_are_restarted_and_frames_are_lost(self, profile: str, shape: str):
        for seed in (1, 2):
            frames = simulated(
                profile, 5, seed=seed, topology=TOPOLOGIES[shape], restarts=True, quality=Quality(loss=0.2), busy=2
            )
            assert findings(judged(frames, profile)) == []

    @pytest.mark.parametrize(
        ("profile", "share"), [("dcp-2.0", 0.2), *also("suite", ("dcp-1.3", 0.1), ("dcp-2.0", 0.6))]
    )
    def test_nothing_is_found_where_the_recorder_misses_frames(self, profile: str, share: float):
        for seed in (1, 2):
            frames = simulated(profile, 4, seed=seed, restarts=seed == 2, busy=3)
            assert findings(judged(thinned(frames, share, seed), profile)) == []

    @pytest.mark.parametrize(("profile", "seed", "count"), [("dcp-2.0", 101, 3), ("dcp-1.3", 103, 5)])
    def test_seeds_that_once_caused_false_findings(self, profile: str, seed: int, count: int):
        assert findings(judged(simulated(profile, count, seed=seed, restarts=True), profile)) == []

    @pytest.mark.parametrize("period", [20, 100, 1000])
    def test_nothing_is_found_at_any_beacon_period(self, tmp_path: Path, period: int):
        frames = simulated("dcp-2.0", 4, seconds=60 if period == 1000 else 15, bp=BPConfig(beacon_period_ms=period))
        path = tmp_path / "slow.mcap"
        with create_capture(path) as writer:
            for frame in frames:
                writer.write(frame)
        run, _ = judge_versions(path, "dcp-2.0", Pics())[0]
        assert findings(run) == []

    @pytest.mark.part("suite")
    def test_each_rule_about_networks_was_exercised(self):
        """A rule that passes without having checked anything would prove nothing."""
        exercised: set[str] = set()
        for profile, loss in (("dcp-2.0", 0.0), ("dcp-2.0", 0.3), ("dcp-1.3", 0.3)):
            for busy in (0.5, 3):
                frames = simulated(profile, 5, seconds=30, quality=Quality(loss=loss), busy=busy, restarts=loss > 0)
                run = judged(frames, profile, Pics())
                assert findings(run) == []
                exercised |= {case.id for case in run.cases if case.verdict is Verdict.PASS}
        assert {rule.id for rule in RULES} - exercised == set()

    def test_sequence_numbers_that_wrap_are_not_a_fault(self):
        air = Script()
        air.seqno = {A: 2**32 - 5, B: 2**32 - 9}
        for number in range(600):
            value = number.to_bytes(2, "big")
            create = [air.create(1, A, value=value)] if number == 0 else []
            update = VarUpdate(1, number % 256, value)
            air.say(A, *create, VarSumm(1, number % 256), *([update] if number else []), report=air.report(A))
            air.say(B, *create, VarSumm(1, number % 256), *([update] if number else []))
        run = judged(air.frames, "dcp-2.0")
        assert findings(run) == []
        assert case_of(run, "CK_VD_VALUE").verdict is Verdict.PASS

    def test_a_recorder_that_swaps_frames_is_not_the_senders_fault(self):
        frames = simulated("dcp-2.0", 3)
        for place in range(50, len(frames) - 10, 40):
            frames[place : place + 6] = reversed(frames[place : place + 6])
        run = judged(frames, "dcp-2.0")
        assert "CK_BP_SEQNO" not in {case.id for case in run.cases if case.verdict is Verdict.FAIL}

    def test_frames_that_the_recorder_cut_are_not_judged(self):
        frames = [
            Frame(each.number, each.time_ns, each.data[:40], len(each.data)) for each in simulated("dcp-2.0", 3)[:50]
        ]
        run = judged(frames, "dcp-2.0")
        assert findings(run) == []
        assert "50 frames are truncated in the recording and were not judged" in run.notes

    def test_a_period_that_is_not_stated_is_reported_and_not_judged(self):
        frames = simulated("dcp-2.0", 3)
        run = judged(frames, "dcp-2.0")
        assert case_of(run, "CK_BP_PERIOD").verdict is Verdict.INFO
        stated = judged(frames, "dcp-2.0", Pics(pixit=Testing(beacon_period_ms=200)))
        assert case_of(stated, "CK_BP_PERIOD").verdict is Verdict.FAIL

    @pytest.mark.parametrize("seconds", [-3600, 3600])
    def test_a_clock_that_is_set_while_recording_is_not_a_fault(self, seconds: int):
        frames = simulated("dcp-2.0", 3)
        half = len(frames) // 2
        frames[half:] = [
            msgspec.structs.replace(each, time_ns=each.time_ns + seconds * SECOND) for each in frames[half:]
        ]
        run = judged(frames, "dcp-2.0", Pics(pixit=Testing(beacon_period_ms=100)))
        assert findings(run) == []
        told = [each.observed.rpartition(" ms +/-")[0] for each in case_of(run, "CK_BP_PERIOD").checks]
        means = [float(each.rpartition(" ")[2]) for each in told if each]
        assert len(means) == 3
        assert all(90 < mean < 110 for mean in means)

    def test_many_observations_do_not_hide_a_fault(self):
        air = Script()
        for each in range(60):
            number = each // 2
            air.say(A, VarSumm(1, 0), seqno=number, source=A)
        for each in range(100, 120):
            air.say(A, VarSumm(1, 0), seqno=each)
        air.say(A, VarSumm(1, 0), seqno=60)
        run = judged(air.frames, "dcp-2.0")
        assert case_of(run, "CK_BP_SEQNO").verdict is Verdict.FAIL


# -- recordings of an implementation that is not perfect -----------------------------------------------------------


GOLDENS = {
    "a_bus3": {"CK_DATA_ORDER": {"DATA-01"}, "CK_DATA_PACKED": {"DATA-02"}},
    "a_bus3_v1.3.6": {"CK_DATA_ORDER": {"DATA-01"}, "CK_DATA_PACKED": {"DATA-02"}},
    "b_crud": {"CK_DATA_ORDER": {"DATA-01"}, "CK_VD_ANSWER_UPDATE": {"VD-RU-04"}},
    "c_latejoin": {
        "CK_DATA_ORDER": {"DATA-01"},
        "CK_DATA_PACKED": {"DATA-02"},
        "CK_VD_TAKES_UPDATE": {"VD-PU-07", "VD-RX-04"},
    },
}
BLAMED = {
    "b_crud": ("CK_VD_ANSWER_UPDATE", "02:00:00:00:00:01"),
    "c_latejoin": ("CK_VD_TAKES_UPDATE", "02:00:00:00:00:02"),
}


class TestCaptures:
    @pytest.mark.parametrize("name", GOLDENS)
    def test_findings_in_the_captures_are_true(self, name: str):
        run, codec = judge_versions(CAPTURES / f"{name}.mcap", None, Pics())[0]
        failed = {case.id: case for case in run.cases if case.verdict is Verdict.FAIL}
        assert {
            rule: {each for check in case.checks if check.verdict is Verdict.FAIL for each in check.requirements}
            for rule, case in failed.items()
        } == GOLDENS[name] | {DECLARED: set(declared_by(codec.profile))}
        assert not [case for case in run.cases if case.verdict is Verdict.ERROR]
        assert codec.profile.name == ("cpp-1.3" if "1.3" in name else "cpp-2.0")
        if name in BLAMED:
            rule, node = BLAMED[name]
            assert all(
                check.observed.startswith(node) for check in failed[rule].checks if check.verdict is Verdict.FAIL
            )

    def test_padding_of_zeros_is_distinguished_from_addresses(self):
        air = Script("cpp-2.0")
        packing(air, wrong=True)
        run = judged(air.frames, air.profile, Pics())
        found = " ".join(check.observed for check in case_of(run, "CK_DATA_PACKED").checks)
        assert "virtual table pointer (zero)" in found
        run, _ = judge_versions(CAPTURES / "a_bus3.mcap", None, Pics())[0]
        found = " ".join(check.observed for check in case_of(run, "CK_DATA_PACKED").checks)
        assert "virtual table pointer (0x" in found
        assert "virtual table pointer (zero)" not in found

    def test_hazards_of_the_design_are_observed_and_not_faults(self):
        run, _ = judge_versions(CAPTURES / "a_bus3_v1.3.6.mcap", None, Pics())[0]
        seen = [check for check in case_of(run, "CK_VD_REQUEST").checks if check.verdict is Verdict.INFO]
        assert {each for check in seen for each in ("H1", "H2") if each in check.expected} == {"H1", "H2"}
        assert case_of(run, "CK_VD_REQUEST").verdict is Verdict.PASS

    def test_frames_of_findings_are_kept_with_their_octets_marked(self):
        run, _ = judge_versions(CAPTURES / "c_latejoin.mcap", None, Pics())[0]
        case = case_of(run, "CK_VD_TAKES_UPDATE")
        check = next(check for check in case.checks if check.verdict is Verdict.FAIL)
        kept = {event.frame: event for event in case.evidence}
        assert set(kept) >= {mark.frame for mark in check.frames}
        mark = check.frames[0]
        octets = bytes.fromhex(kept[mark.frame].octets)
        # The update of variable 1: identifier, number, length, value.
        assert octets[mark.offset] == 1
        assert mark.length == 3 + octets[mark.offset + 2]

    def test_an_unreadable_file_is_reported(self, tmp_path: Path):
        with pytest.raises(UsageError, match="no-such"):
            judge_versions(tmp_path / "no-such.mcap", None, Pics())
        text = tmp_path / "text.pcap"
        text.write_text("nothing of the kind")
        with pytest.raises(UsageError, match="text\\.pcap"):
            judge_versions(text, "dcp-2.0", Pics())
        with pytest.raises(UsageError, match="no-profile"):
            judge_versions(CAPTURES / "b_crud.mcap", "no-profile", Pics())
        with pytest.raises(UsageError, match="none of its 563 frames"):
            judge_versions(CAPTURES / "b_crud.mcap", "dcp-2.0", Pics(), ether_type="0x8888")
        with pytest.raises(UsageError, match="is not an EtherType"):
            judge_versions(CAPTURES / "b_crud.mcap", None, Pics(), ether_type="x")

    def test_a_file_without_beacons_is_reported(self, tmp_path: Path):
        with pytest.raises(UsageError, match="the recording has no frames"):
            judge_versions(recorded(tmp_path / "none.pcap", []), None, Pics())
        other = [b"\xff" * 12 + b"\x08\x06" + bytes(46)]
        with pytest.raises(UsageError, match="with the EtherTypes and ports of the built-in profiles; dcp-codec stats"):
            judge_versions(recorded(tmp_path / "other.pcap", other), None, Pics())
        with pytest.raises(UsageError, match="with 0x9999; dcp-codec stats"):
            judge_versions(recorded(tmp_path / "other.pcap", other), None, Pics(), ether_type="0x9999")

    def test_an_uncertain_profile_is_reported(self, tmp_path: Path):
        frames: list[bytes] = []
        for name in ("a_bus3", "a_bus3_v1.3.6"):
            with open_capture(CAPTURES / f"{name}.mcap") as reader:
                frames += [frame.data for _, frame in zip(range(100), reader, strict=False)]
        run, codec = judge_versions(recorded(tmp_path / "both.pcap", frames), None, Pics())[0]
        # Half of the frames decode as either: which of the two is named first does not matter.
        found, other = codec.profile.name, {"cpp-2.0": "cpp-1.3", "cpp-1.3": "cpp-2.0"}[codec.profile.name]
        note = f"100 of 200 sampled frames decode; 100 others decode as {other}: decode each version with --profile)"
        assert [each.endswith(note) for each in run.notes if each.startswith(f"the profile was guessed: {found}")] == [
            True
        ]
        certain, _ = judge_versions(CAPTURES / "b_crud.mcap", None, Pics())[0]
        assert not any("guess" in each for each in certain.notes)


# -- whatever comes --------------------------------------------------------------------------------------------------


def recorded(path: Path, octets: list[bytes]) -> Path:
    """A recording of these frames, 33 ms apart."""
    with create_capture(path) as writer:
        for number, each in enumerate(octets, 1):
            writer.write(Frame(number, 1_795_225_151 * SECOND + number * 33 * MS, each, len(each)))
    return path


def framed(octets: list[bytes]) -> list[Frame]:
    """Frames of some stations, 33 ms apart."""
    return [
        Frame(number, 10**18 + number * 33 * MS, each, len(each))
        for number, octets_ in enumerate(octets, 1)
        for each in [b"\xff" * 6 + bytes([2, 0, 0, 0, 0, number % 4]) + b"\x49\x53" + octets_]
    ]


@pytest.mark.parametrize("profile", ["dcp-2.0", *also("suite", "dcp-1.0", "cpp-2.0")])
def test_no_recording_raises_an_exception(profile: str):
    codec = codec_of(profile)
    valid = beacons(codec).map(codec.encode)

    @settings(max_examples=examples(60))
    @given(st.lists(st.one_of(valid, mutations(valid, codec.dissect), st.binary(max_size=80)), max_size=12))
    def judge_all(octets: list[bytes]) -> None:
        # Twice, so that everything is also a repetition of something.
        run = judged(framed(octets * 2), profile)
        assert not [case for case in run.cases if case.verdict is Verdict.ERROR]

    judge_all()


@pytest.mark.part("suite")
def test_forged_senders_and_variables_do_not_use_up_memory():
    """A flood with ever new senders, variables and numbers is followed up to the limits and no further."""
    judge = Judge(codec_of("dcp-2.0"), Pics())
    air = Script()
    everything = [VarSumm(var_id, 3) for var_id in range(0, 250, 2)]

    def flood(begin: int, end: int) -> None:
        for number in range(begin, end):
            air.frames.clear()
            air.seqno.clear()
            sender = number.to_bytes(4, "big")
            air.say(A, *everything, patch=lambda octets, sender=sender: octets[:5] + sender + octets[9:])
            judge.feed(air.frames[0])

    # 125 variables of each of 550 senders: more pairs than are followed.
    flood(0, 550)
    tracemalloc.start()
    flood(550, 600)
    left, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # A frame, and what is known of its sender: not of its variables.
    assert left < 50 * 8000
    assert judge.result().cases


def test_marks_are_within_their_frames():
    air = Script()
    deleted(air, True)
    run = judged(air.frames, "dcp-2.0")
    marks = [mark for case in run.cases for check in case.checks for mark in check.frames if mark.length]
    assert marks
    assert all(mark.offset + mark.length <= len(air.frames[mark.frame - 1].data) for mark in marks)
    assert all(first.number < second.number for first, second in pairwise(air.frames))
