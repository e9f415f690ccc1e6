"""dcp-srp.md: Service SRP-UpdateSafetyData and Packet Format.

What the implementation says of itself. Without an upper tester only what it sends on its own account can be looked at.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from dcp_spec.constants import SRP_SEQNO_MODULUS, SpecVersion

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.gaps import between_beacons
from dcp_conformance.heard import Heard
from dcp_conformance.reports import Reporter, Sent
from dcp_conformance.services import (
    Moment,
    nanoseconds,
    report_octets,
    srp_blocks,
    told,
    until_report,
)
from dcp_conformance.stamps import Stamps, check_apart, check_now

#: Attempts to hand safety data down that an application does not replace before the next beacon.
_ATTEMPTS = 12
_UPDATE = Needs(ut=("SRP-UpdateSafetyData",), entities=("srp",))


def _reports(bench: Bench, since: int = 0) -> list[Heard]:
    return [heard for heard in bench.heard[since:] if heard.report is not None]


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
        reporter = Reporter(bench)
        for _ in (1, 2):
            reporter.hand_down()
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
    reporter = Reporter(bench)
    values = reporter.next_values()
    silent = not any(heard.report for heard in bench.wait(2))
    start, before = bench.mark(), bench.lower.wall()
    bench.expect_status("SRP-STATUS-OK", "SRP-UpdateSafetyData", "SRP-SRV-02", "SRP-SRV-03", sData=values)
    reporter.noted(values, Moment(before, bench.lower.wall()))
    if (first := reporter.find(values)) is None:
        others = [] if reporter.application() else _reports(bench, start)
        if not others:
            reporter.lost("the safety data appear in a beacon", "SRP-TYP-03", "SRP-SRV-03")
        bench.fail(
            f"a record with sData {values}",
            f"it is {told(bench, others[-1].report)}",
            "SRP-TYP-03",
            "SRP-SRV-03",
            frames=others[-1:],
            # Otherwise it may be that of an earlier hand-down, and this one was not heard.
            shown=silent,
        )
    bench.check(True, "the values are in the record", "", "SRP-TYP-03", "SRP-SRV-03")
    step = (reporter.sent("SRP-SRV-03").report.seqno - first.report.seqno) % SRP_SEQNO_MODULUS
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
    reporter = Reporter(bench)

    def measure() -> Stamps:
        first = reporter.sent()
        bench.wait(2)
        second = reporter.sent()
        return _stamps(bench, first, second)

    found = check_apart(bench, "tStamp", measure)
    if bench.profile.types.timestamp.epoch == "unix":
        check_now(bench, "tStamp", found.first, found.requests[0])


def _stamps(bench: Bench, first: Sent, second: Sent) -> Stamps:
    """The time stamps of two records."""
    one, two = (nanoseconds(bench, each.report.t_stamp) for each in (first, second))
    return Stamps(one, two, (first.moment, second.moment))


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
    reporter = Reporter(bench)

    def measure() -> Stamps:
        first = reporter.sent("SRP-TYP-05")
        with bench.deactivated("BP"):
            values = reporter.hand_down()
            bench.wait(8)
        what = "the record is sent once BP is active again"
        return _stamps(bench, first, reporter.awaited(values, "SRP-TYP-05", what=what, insist=False))

    check_apart(bench, "tStamp", measure)


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
    reporter = Reporter(bench)
    reporter.sent()
    before = bench.mark()
    handed: list[dict[str, Any]] = []

    def has_one(heard: Heard) -> bool:
        return heard.report is not None and told(bench, heard.report) in handed[-4:]

    def hand_down() -> None:
        # Other data in each attempt: some versions repeat the last record.
        for _ in range(4):
            handed.append(reporter.next_values())
            reporter.hand_down()

    def newest() -> list[Heard]:
        return [heard for heard in _reports(bench, before) if told(bench, heard.report) == handed[-1]]

    for attempt in range(_ATTEMPTS):
        between_beacons(bench, "four hand-downs are made", hand_down, has_one)
        if newest() or until_report(bench, handed[-1]) is not None:
            break
        if not any(not reporter.is_own(heard) for heard in _reports(bench, before)):
            reporter.lost("the newest safety data appear in a beacon")
        # An application has replaced them: later in the period there is less time for it.
        bench.beacons(1, 2)
        bench.wait(attempt / _ATTEMPTS)
    else:
        reporter.lost("the newest safety data appear in a beacon")
    older = handed[-4:-1]
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
    reporter = Reporter(bench)
    sent = [reporter.sent() for _ in range(5)]
    numbers, frames = [each.report.seqno for each in sent], [each.heard for each in sent]
    bench.check(len(set(numbers)) == 5, "five different numbers", f"{numbers}", "SRP-TYP-06", frames=frames, shown=True)
    for first, second in pairwise(sent):
        reporter.check_grown(first, second, "SRP-SEQ-01")


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
    reporter = Reporter(bench)
    for number in (1, 2, 3):
        mark = bench.mark()
        values = reporter.sent("SRP-SRV-04").values
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
    reporter = Reporter(bench)
    for number in (1, 2):
        first = reporter.sent()
        frames = bench.beacons(4)
        if len(frames) < 4:
            bench.fail("beacons follow each other while there is a record to repeat", f"{len(frames)} came")
        other = [heard for heard in frames if heard.report != first.report]
        if other and reporter.application():
            # Its reports are the newest then.
            other = [heard for heard in other if heard.report is None or reporter.is_own(heard)]
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
    values = Reporter(bench).sent().values
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
    reporter = Reporter(bench)
    before = reporter.sent()
    reporter.fill(299)
    reporter.check_grown(before, reporter.sent())
