"""dcp-srp.md: Service SRP-UpdateSafetyData and Packet Format.

State reports of the implementation. Without an upper tester only reports that it sends by itself can be checked.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from dcp_spec.constants import SRP_SEQNO_MODULUS, SpecVersion

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.services import (
    Moment,
    nanoseconds,
    report_octets,
    reported_safety_data,
    srp_blocks,
    until_report,
)
from dcp_conformance.test_steps.state_reports import Reporter, Sent
from dcp_conformance.test_steps.time_stamps import Stamps, check_apart, check_now
from dcp_conformance.test_system.bench import Bench

#: Attempts to submit safety data that an application does not replace before the next beacon.
_ATTEMPTS = 12
_UPDATE = Needs(ut=("SRP-UpdateSafetyData",), entities=("srp",))


def _reports(bench: Bench, since: int = 0) -> list[ReceivedBeacon]:
    return [heard for heard in bench.heard[since:] if heard.report is not None]


@case(
    "TC_SRP_REC_BV_01",
    "Every SRP payload is exactly one record, with the identifier of its sender",
    requirements="SRP-FMT-01 SRP-TYP-02 SRP-TYP-04 SRP-INI-06",
    stimulus=(
        "two submissions of safety data; without an upper tester none: the implementation may have a source of its own"
    ),
    expect="SRP blocks of the size of a record, each with the senderId of its beacon as nodeId",
    window=12,
    needs=Needs(entities=("srp",)),
)
def one_record(bench: Bench) -> None:
    if bench.services.offers("SRP-UpdateSafetyData"):
        reporter = Reporter(bench)
        for _ in (1, 2):
            reporter.submit()
            bench.until(lambda heard: srp_blocks(heard))
    elif not bench.until(lambda heard: srp_blocks(heard), 12):
        bench.info(
            "Does the implementation send state reports by itself?",
            "none in 12 beacon periods, and no upper tester to submit safety data",
        )
        return
    size, seen = report_octets(bench), 0
    for heard in bench.heard:
        blocks = srp_blocks(heard)
        seen += len(blocks)
        wrong = [len(block) for block in blocks if len(block) != size]
        if wrong:
            bench.wrong(
                f"a size of {size} octets for every SRP payload",
                f"{wrong[0]} octets",
                "SRP-FMT-01 SRP-TYP-02",
                frames=[heard],
            )
        own = heard.sender or bench.identifiers.sut_id
        for block in blocks:
            node_id = bench.codec.decode_report(block).node_id
            if node_id != own:
                observed = f"nodeId {node_id.hex(':')}, senderId {own.hex(':')}"
                bench.wrong("the senderId of the beacon as nodeId", observed, "SRP-TYP-04 SRP-INI-06", frames=[heard])
    if not seen:
        bench.inconclusive(
            "state reports of the implementation", "none heard (if it has no SRP, set srp = false in [pics])"
        )
    bench.passed(f"{seen} SRP payloads, each a record of its sender")


@case(
    "TC_SRP_REC_BV_02",
    "A submission of safety data is confirmed, and the record has its values in the order of the profile",
    requirements="SRP-SRV-02 SRP-SRV-03 SRP-TYP-03 SRP-TYP-01",
    stimulus="SRP-UpdateSafetyData with a different value in every field",
    expect="SRP-STATUS-OK, and a beacon with an SRP block with these values",
    needs=_UPDATE,
)
def values_arrive(bench: Bench) -> None:
    reporter = Reporter(bench)
    values = reporter.next_values()
    silent = not any(heard.report for heard in bench.wait(2))
    start, before = bench.mark(), bench.lower.wall()
    bench.expect_status("SRP-STATUS-OK", "SRP-UpdateSafetyData", "SRP-SRV-02 SRP-SRV-03", sData=values)
    reporter.noted(values, Moment(before, bench.lower.wall()))
    if (first := reporter.find(values)) is None:
        others = [each for each in _reports(bench, start) if not reporter.foreign(each)]
        if not others:
            reporter.lost("a beacon with the safety data", "SRP-TYP-03 SRP-SRV-03")
        # Without silence it may belong to an earlier submission, and the record of this one was lost.
        other = reported_safety_data(bench, others[-1].report)
        bench.equal(other, values, "sData", "SRP-TYP-03 SRP-SRV-03", frames=others[-1:], given=silent, stop=True)
    first = bench.required(first, "a record with the submitted values", "SRP-TYP-03 SRP-SRV-03")
    step = (reporter.sent("SRP-SRV-03").report.seqno - first.report.seqno) % SRP_SEQNO_MODULUS
    bench.proved(0 < step < 1 << 16, "a seqno of 32 bits that grows slowly", f"an increase of {step}", "SRP-TYP-01")


@case(
    "TC_SRP_REC_BV_03",
    "tStamp is close to the time of the submission",
    requirements="SRP-TYP-05",
    stimulus="SRP-UpdateSafetyData at a known time, twice, two beacon periods apart",
    expect="time stamps close to these times, within the precision of the clocks, and the same difference between them",
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
    """Return the time stamps of two records with the times of their submissions."""
    one, two = (nanoseconds(bench, each.report.t_stamp) for each in (first, second))
    return Stamps(one, two, (first.moment, second.moment))


@case(
    "TC_SRP_REC_TI_01",
    "tStamp is the time of the submission even if the record is sent much later",
    requirements="SRP-TYP-05",
    stimulus="SRP-UpdateSafetyData; then again while BP is inactive for eight beacon periods",
    expect="the difference between the two time stamps is that of the submissions, not of the beacons",
    window=20,
    needs=Needs(
        since=SpecVersion.V1_2, ut=("SRP-UpdateSafetyData", "BP-MGMT-Deactivate", "BP-MGMT-Activate"), entities=("srp",)
    ),
)
def time_stamp_of_late_record(bench: Bench) -> None:
    reporter = Reporter(bench)

    def measure() -> Stamps:
        first = reporter.sent("SRP-TYP-05")
        with bench.services.deactivated("BP"):
            values = reporter.submit()
            bench.wait(8)
        what = "the record is sent after BP was activated"
        return _stamps(bench, first, reporter.awaited(values, "SRP-TYP-05", what=what, insist=False))

    check_apart(bench, "tStamp", measure)


@case(
    "TC_SRP_REC_BV_04",
    "Only the safety data submitted last are sent",
    requirements="SRP-TYP-07",
    stimulus="four submissions of safety data right after a beacon",
    expect="a beacon with the fourth; at most one beacon with another one, prepared before it, and none after it",
    window=8,
    needs=_UPDATE,
)
def newest_only(bench: Bench) -> None:
    reporter = Reporter(bench)
    reporter.sent()
    before = bench.mark()
    handed: list[dict[str, Any]] = []

    def has_one(heard: ReceivedBeacon) -> bool:
        return heard.report is not None and reported_safety_data(bench, heard.report) in handed[-4:]

    def submit() -> None:
        # Different data in each attempt: some versions repeat the last record.
        for _ in range(4):
            handed.append(reporter.next_values())
            reporter.submit()

    def newest() -> list[ReceivedBeacon]:
        return [heard for heard in _reports(bench, before) if reported_safety_data(bench, heard.report) == handed[-1]]

    for attempt in range(_ATTEMPTS):
        between_beacons(bench, "four submissions of safety data", submit, has_one)
        if newest() or until_report(bench, handed[-1]) is not None:
            break
        if not any(not reporter.is_own(heard) for heard in _reports(bench, before)):
            reporter.lost("a beacon with the newest safety data")
        # An application has replaced them: later in the period there is less time for that.
        bench.beacons(1, 2)
        bench.wait(attempt / _ATTEMPTS)
    else:
        reporter.lost("a beacon with the newest safety data")
    older = handed[-4:-1]
    bench.beacons(2, 3)
    shown = newest()
    late = [heard for heard in _reports(bench, before) if reported_safety_data(bench, heard.report) in older]
    bench.proved(
        len(late) <= 1 and all(heard.time < shown[0].time for heard in late),
        "no older safety data after the newest",
        f"{len(late)} beacons with older safety data",
        frames=late,
    )


@case(
    "TC_SRP_REC_BV_05",
    "Records of consecutive submissions have consecutive sequence numbers",
    requirements="SRP-SEQ-01 SRP-TYP-06",
    stimulus="five submissions of safety data, each after the record of the one before was heard",
    expect="five records with consecutive sequence numbers",
    window=20,
    needs=_UPDATE,
)
def sequence_numbers(bench: Bench) -> None:
    reporter = Reporter(bench)
    sent = [reporter.sent() for _ in range(5)]
    numbers, frames = [each.report.seqno for each in sent], [each.heard for each in sent]
    bench.answered(len(set(numbers)), 5, "different sequence numbers", "SRP-TYP-06", frames=frames)
    for first, second in pairwise(sent):
        reporter.check_grown(first, second, "SRP-SEQ-01")


@case(
    "TC_SRP_REC_BV_06",
    "One submission of safety data causes one transmission of its record",
    requirements="SRP-SRV-04 SRP-INI-03",
    stimulus="three submissions of safety data with pauses; in between a variable keeps the implementation sending",
    expect="the record of each submission in exactly one beacon",
    window=30,
    needs=Needs(since=SpecVersion.V1_3, ut=("SRP-UpdateSafetyData",), entities=("srp",)),
)
def once(bench: Bench) -> None:
    reporter = Reporter(bench)
    for number in (1, 2, 3):
        mark = bench.mark()
        values = reporter.sent("SRP-SRV-04").values
        if bench.sut.pics.vardis is not False:
            # Without another payload to send there would be no further beacons to inspect.
            peer = bench.peer()
            peer.send(peer.create(bench.var_id()))
        bench.beacons(3, 4)
        frames = [heard for heard in _reports(bench, mark) if reported_safety_data(bench, heard.report) == values]
        bench.repeated(frames, 1, f"beacons with the record of submission {number}")


@case(
    "TC_SRP_REC_BV_07",
    "Up to 1.2, the newest record is in every beacon",
    requirements="SRP-INI-03",
    stimulus="a submission of safety data, and another one four beacons later",
    expect="the unchanged record of the last submission in every beacon",
    window=20,
    needs=Needs(until=SpecVersion.V1_2, ut=("SRP-UpdateSafetyData",), entities=("srp",)),
)
def repeated(bench: Bench) -> None:
    reporter = Reporter(bench)
    for number in (1, 2):
        first = reporter.sent()
        frames = bench.beacons(4)
        if len(frames) < 4:
            bench.missing("beacons continue while there is a record to repeat", f"{len(frames)} beacons in time")
        other = [heard for heard in frames if heard.report != first.report]
        if other and reporter.application():
            # The reports of the application are then the newest.
            other = [heard for heard in other if heard.report is None or reporter.is_own(heard)]
        bench.none(other, f"the record of submission {number} in four beacons, with unchanged tStamp and seqno")


@case(
    "TC_SRP_REC_BV_08",
    "A repeated record keeps the time of its submission",
    requirements="SRP-TYP-05",
    stimulus="one submission of safety data",
    expect="the same tStamp and seqno in the records of the next beacons",
    window=10,
    needs=Needs(until=SpecVersion.V1_2, ut=("SRP-UpdateSafetyData",), entities=("srp",)),
)
def repeated_time_stamp(bench: Bench) -> None:
    mark = bench.mark()
    values = Reporter(bench).sent().values
    bench.beacons(3, 4)
    frames = [heard for heard in _reports(bench, mark) if reported_safety_data(bench, heard.report) == values]
    stamps = {(heard.report.t_stamp, heard.report.seqno) for heard in frames if heard.report is not None}
    bench.answered(len(stamps), 1, "pairs of tStamp and seqno in all repetitions", frames=frames)


@case(
    "TC_SRP_REC_BV_09",
    "The sequence number does not wrap around at four or eight bits",
    requirements="SRP-SEQ-01 SRP-TYP-01",
    stimulus="a submission of safety data whose record is heard; then 300 submissions",
    expect="a sequence number larger by 300 (mod 2^32) in the record of the last submission",
    window=12,
    needs=_UPDATE,
)
def many_records(bench: Bench) -> None:
    reporter = Reporter(bench)
    before = reporter.sent()
    reporter.fill(299)
    reporter.check_grown(before, reporter.sent())
