"""dcp-srp.md: Service SRP-UpdateSafetyData and Packet Format.

What the implementation says of itself. Without an upper tester only what it sends on its own account can be looked at.
"""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import SRP_SEQNO_MODULUS, SpecVersion

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.gaps import between_beacons
from dcp_conformance.heard import Heard
from dcp_conformance.services import (
    check_apart,
    check_now,
    nanoseconds,
    report_octets,
    safety_data,
    srp_blocks,
    timed,
    told,
    until_report,
)

_UPDATE = Needs(ut=("SRP-UpdateSafetyData",), entities=("srp",))


def _reports(bench: Bench, since: int = 0) -> list[Heard]:
    return [heard for heard in bench.heard[since:] if heard.report is not None]


def _handed_down(bench: Bench, number: int) -> dict[str, Any]:
    values = safety_data(bench, number)
    bench.must("SRP-UpdateSafetyData", sData=values)
    return values


def _sent(bench: Bench, number: int) -> Heard:
    """Hand safety data down and wait for the beacon that carries them first; stops as failed if none comes."""
    heard = until_report(bench, _handed_down(bench, number))
    if heard is None:
        bench.fail("the safety data appear in a beacon", "they do not", "SRP-SRV-03")
    return heard


@case(
    "TC_SRP_REC_BV_01",
    "Every SRP payload is exactly one record, with the identifier of the node that sends it",
    requirements="SRP-FMT-01 SRP-TYP-02 SRP-TYP-04 SRP-INI-06",
    stimulus="two hand-downs of safety data; without an upper tester none, the implementation may have a source",
    expect="SRP blocks of the record's size, whose nodeId is the senderId of their beacons",
    window=12,
    needs=Needs(entities=("srp",)),
)
def one_record(bench: Bench) -> None:
    if bench.session.upper is not None and "SRP-UpdateSafetyData" in bench.session.upper.methods:
        for number in (1, 2):
            _handed_down(bench, number)
            bench.until(lambda heard: srp_blocks(heard))
    elif not bench.until(lambda heard: srp_blocks(heard), 12):
        bench.info("state reports on its own account", "none for 12 beacon periods, and no upper tester to ask for one")
        return
    size, seen = report_octets(bench), 0
    for heard in bench.heard:
        blocks = srp_blocks(heard)
        seen += len(blocks)
        wrong = [len(block) for block in blocks if len(block) != size]
        if wrong:
            bench.fail(
                f"every SRP payload has {size} octets",
                f"one has {wrong[0]}",
                "SRP-FMT-01",
                "SRP-TYP-02",
                frames=[heard],
                shown=True,
            )
        own = heard.sender or bench.sut_id
        for block in blocks:
            node_id = bench.codec.decode_report(block).node_id
            if node_id != own:
                observed = f"nodeId is {node_id.hex(':')}, the sender {own.hex(':')}"
                bench.fail(
                    "nodeId is the sender's identifier",
                    observed,
                    "SRP-TYP-04",
                    "SRP-INI-06",
                    frames=[heard],
                    shown=True,
                )
    if not seen:
        bench.inconclusive(
            "the implementation sends state reports", "none was heard ([pics] srp = false if it has no SRP)"
        )
    bench.check(True, f"{seen} SRP payloads are records of their sender")


@case(
    "TC_SRP_REC_BV_02",
    "A hand-down is confirmed, and its values stand in the record in the order of the profile",
    requirements="SRP-SRV-02 SRP-SRV-03 SRP-TYP-03 SRP-TYP-01",
    stimulus="SRP-UpdateSafetyData with another value in every field",
    expect="SRP-STATUS-OK, and a beacon with an SRP block of these values",
    needs=_UPDATE,
    smoke=True,
)
def values_arrive(bench: Bench) -> None:
    values = safety_data(bench, 1)
    silent = not any(heard.report for heard in bench.wait(2))
    start = bench.mark()
    bench.expect_status("SRP-STATUS-OK", "SRP-UpdateSafetyData", "SRP-SRV-02", "SRP-SRV-03", sData=values)
    heard = until_report(bench, values)
    if heard is None or heard.report is None:
        others = _reports(bench, start)
        expected, observed = f"a record with sData {values}", told(bench, others[-1].report) if others else "not there"
        bench.fail(
            expected,
            f"it is {observed}",
            "SRP-TYP-03",
            "SRP-SRV-03",
            frames=others[-1:],
            # Otherwise it may be that of an earlier hand-down, and this one was not heard.
            shown=silent and others,
        )
    bench.check(True, "the values are in the record", "", "SRP-TYP-03", "SRP-SRV-03")
    second = _sent(bench, 2).report
    step = -1 if second is None else (second.seqno - heard.report.seqno) % SRP_SEQNO_MODULUS
    bench.check(
        0 < step < 1 << 16,
        "seqno is a number of 32 bits that grows slowly",
        f"it grows by {step}",
        "SRP-TYP-01",
        shown=True,
    )


@case(
    "TC_SRP_REC_BV_03",
    "tStamp is near the time of the hand-down",
    requirements="SRP-TYP-05",
    stimulus="SRP-UpdateSafetyData at a known time, twice, with two beacon periods in between",
    expect="time stamps near these times, as far as the clocks agree; their difference is that of the hand-downs",
    window=12,
    needs=_UPDATE,
)
def time_stamp(bench: Bench) -> None:
    stamps, requests = [], []
    for number in (1, 2):
        values = safety_data(bench, number)
        requests.append(timed(bench, "SRP-UpdateSafetyData", sData=values))
        heard = until_report(bench, values)
        if heard is None or heard.report is None:
            bench.fail("the safety data appear in a beacon", "they do not")
        stamps.append(nanoseconds(bench, heard.report.t_stamp))
        if number == 1:
            bench.wait(2)
    check_apart(bench, "tStamp", stamps[1] - stamps[0], *requests)
    if bench.profile.types.timestamp.epoch == "unix":
        check_now(bench, "tStamp", stamps[0], requests[0])


@case(
    "TC_SRP_REC_TI_01",
    "tStamp is the time of the hand-down also when the record leaves much later",
    requirements="SRP-TYP-05",
    stimulus="SRP-UpdateSafetyData; then again while BP is inactive for eight beacon periods",
    expect="the two time stamps are apart as the hand-downs are, not as the beacons",
    window=20,
    needs=Needs(
        since=SpecVersion.V1_2,
        ut=("SRP-UpdateSafetyData", "BP-MGMT-Deactivate", "BP-MGMT-Activate"),
        entities=("srp",),
    ),
)
def time_stamp_of_late_record(bench: Bench) -> None:
    values = safety_data(bench, 1)
    begun = timed(bench, "SRP-UpdateSafetyData", sData=values)
    sent = until_report(bench, values)
    first = None if sent is None else sent.report
    with bench.deactivated("BP"):
        values = safety_data(bench, 2)
        handed = timed(bench, "SRP-UpdateSafetyData", sData=values)
        bench.wait(8)
    heard = until_report(bench, values)
    if heard is None or heard.report is None or first is None:
        bench.fail("the record is sent once BP is active again", "it is not", "SRP-TYP-05")
    check_apart(bench, "tStamp", nanoseconds(bench, heard.report.t_stamp - first.t_stamp), begun, handed)


@case(
    "TC_SRP_REC_BV_04",
    "Only the safety data handed down last are transmitted",
    requirements="SRP-TYP-07",
    stimulus="four hand-downs at once, right after a beacon",
    expect="the fourth in a beacon; of the others at most one, in a beacon that was prepared before, and none later",
    window=8,
    needs=_UPDATE,
)
def newest_only(bench: Bench) -> None:
    _sent(bench, 0)
    before = bench.mark()
    handed: list[dict[str, Any]] = []

    def has_one(heard: Heard) -> bool:
        return heard.report is not None and told(bench, heard.report) in handed[-4:]

    def hand_down() -> None:
        # Other data in each attempt: some versions repeat the last record.
        first = len(handed) + 1
        handed.extend(safety_data(bench, number) for number in range(first, first + 4))
        for number in range(first, first + 4):
            _handed_down(bench, number)

    between_beacons(bench, "four hand-downs are made", hand_down, has_one)
    *older, last = handed[-4:]

    def newest() -> list[Heard]:
        return [heard for heard in _reports(bench, before) if told(bench, heard.report) == last]

    if not newest() and until_report(bench, last) is None:
        bench.fail("the newest safety data appear in a beacon", "they do not", frames=_reports(bench, before))
    bench.beacons(2, 3)
    shown = newest()
    late = [heard for heard in _reports(bench, before) if told(bench, heard.report) in older]
    bench.check(
        len(late) <= 1 and all(heard.time < shown[0].time for heard in late),
        "no older safety data are sent any more",
        f"{len(late)} beacons have older ones",
        frames=late,
        shown=True,
    )


@case(
    "TC_SRP_REC_BV_05",
    "Records of consecutive hand-downs have consecutive sequence numbers",
    requirements="SRP-SEQ-01 SRP-TYP-06",
    stimulus="five hand-downs, each after the record of the one before was heard",
    expect="five records, each with the number behind that of the one before",
    window=20,
    needs=_UPDATE,
)
def sequence_numbers(bench: Bench) -> None:
    frames = [_sent(bench, number) for number in range(5)]
    numbers = [heard.report.seqno for heard in frames if heard.report is not None]
    bench.check(len(set(numbers)) == 5, "five different numbers", f"{numbers}", "SRP-TYP-06", frames=frames, shown=True)
    wanted = [(numbers[0] + step) % SRP_SEQNO_MODULUS for step in range(5)]
    bench.check(numbers == wanted, f"the numbers {wanted}", f"{numbers}", "SRP-SEQ-01", frames=frames, shown=True)


@case(
    "TC_SRP_REC_BV_06",
    "One hand-down leads to one transmitted record, and to none without it",
    requirements="SRP-SRV-04 SRP-INI-03",
    stimulus="three hand-downs with pauses; in between a variable keeps the beacons coming",
    expect="the record of each hand-down in exactly one beacon",
    window=30,
    needs=Needs(since=SpecVersion.V1_3, ut=("SRP-UpdateSafetyData",), entities=("srp",)),
)
def once(bench: Bench) -> None:
    for number in (1, 2, 3):
        mark = bench.mark()
        values = _handed_down(bench, number)
        if until_report(bench, values) is None:
            bench.fail("the safety data appear in a beacon", "they do not", "SRP-SRV-04")
        if bench.pics.vardis is not False:
            # Something for the implementation to say, or there would be no beacons to look at.
            peer = bench.peer()
            peer.send(peer.create(bench.var_id()))
        bench.beacons(3, 4)
        frames = [heard for heard in _reports(bench, mark) if told(bench, heard.report) == values]
        bench.check(
            len(frames) == 1,
            f"the record of hand-down {number} is in one beacon",
            f"it is in {len(frames)}",
            frames=frames,
            shown=len(frames) > 1,
        )


@case(
    "TC_SRP_REC_BV_07",
    "Up to 1.2 the newest record is in every beacon",
    requirements="SRP-INI-03",
    stimulus="one hand-down, and another four beacons later",
    expect="every beacon has the record of the last hand-down, unchanged",
    window=20,
    needs=Needs(until=SpecVersion.V1_2, ut=("SRP-UpdateSafetyData",), entities=("srp",)),
)
def repeated(bench: Bench) -> None:
    for number in (1, 2):
        first = _sent(bench, number)
        frames = bench.beacons(4)
        if len(frames) < 4:
            bench.fail("beacons follow each other while there is a record to repeat", f"{len(frames)} came")
        other = [heard for heard in frames if heard.report != first.report]
        bench.check(
            not other,
            f"four beacons repeat the record of hand-down {number}, its tStamp and seqno too",
            f"{len(other)} of them do not",
            frames=other,
            shown=True,
        )


@case(
    "TC_SRP_REC_BV_08",
    "A repeated record keeps the time of its hand-down",
    requirements="SRP-TYP-05",
    stimulus="one hand-down",
    expect="the records of the next beacons have one tStamp and one seqno",
    window=10,
    needs=Needs(until=SpecVersion.V1_2, ut=("SRP-UpdateSafetyData",), entities=("srp",)),
)
def repeated_time_stamp(bench: Bench) -> None:
    mark = bench.mark()
    values = told(bench, _sent(bench, 1).report)
    bench.beacons(3, 4)
    frames = [heard for heard in _reports(bench, mark) if told(bench, heard.report) == values]
    stamps = {(heard.report.t_stamp, heard.report.seqno) for heard in frames if heard.report is not None}
    bench.check(
        len(stamps) == 1,
        "one pair of tStamp and seqno in all repetitions",
        f"{len(stamps)} of them",
        frames=frames,
        shown=True,
    )


@case(
    "TC_SRP_REC_BV_09",
    "The sequence number counts beyond what four and eight bits hold",
    requirements="SRP-SEQ-01 SRP-TYP-01",
    stimulus="a hand-down, whose record is heard; then 300 hand-downs, one after the other",
    expect="the record of the last has a number that is greater by 300 (mod 2^32)",
    window=12,
    needs=_UPDATE,
)
def many_records(bench: Bench) -> None:
    before = _sent(bench, 1)
    for _ in range(299):
        _handed_down(bench, 2)
    after = _sent(bench, 3)
    assert before.report is not None
    assert after.report is not None
    grown = (after.report.seqno - before.report.seqno) % SRP_SEQNO_MODULUS
    said = f"it went from {before.report.seqno} to {after.report.seqno}"
    bench.check(grown == 300, "the number grows by 300", said, frames=[before, after], shown=True)
