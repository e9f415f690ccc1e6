"""dcp-vardis.md: Service RTDB-Update."""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType, seqno_modulus

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.errors import StopCase
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.beacon_gaps import in_a_gap, pace, pausable
from dcp_conformance.test_steps.repetitions import check_one_in_each
from dcp_conformance.test_steps.services import (
    NOT_EXPRESSIBLE,
    NOT_PRODUCER,
    OK,
    UNKNOWN,
    VALUE_TOO_LONG,
    count_of,
    create_request,
    deleted_by_peer,
    empty_status,
    entry_of,
    expect_any,
    holds_two_octets,
    least_left,
    max_repetitions,
    or_removed,
    produced,
    settled,
    several_repetitions,
    statuses_after_deletion,
    teach_variable,
    timed,
)
from dcp_conformance.test_steps.time_stamps import Stamps, check_apart
from dcp_conformance.test_system.bench import Bench

_U = ICType.UPDATES
_C = ICType.CREATE_VARIABLES
_UPDATE = Needs(ut=("RTDB-Create", "RTDB-Update"))
_UPDATE_READ = Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Read"))


@case(
    "TC_VD_UPD_BV_01",
    "An update is sent with its value and the next sequence number",
    requirements="VD-UPD-07 VD-UPD-08",
    stimulus=(
        "RTDB-Create; four times RTDB-Update, also with octets 0 and 0xFF, each after the VarUpdate of the one before"
    ),
    expect="VARDIS-STATUS-OK each time; VarUpdates with these values and sequence numbers 1, 2, 3, 4",
    window=25,
    needs=_UPDATE,
)
def updates(bench: Bench) -> None:
    var_id = produced(bench)
    for number, given in enumerate((b"value 1", b"\0\0", b"\xff\xff", b"v\0"), 1):
        value = bench.records.value(given)
        mark = bench.mark()
        bench.expect_status(OK, "RTDB-Update", "VD-UPD-08", varId=var_id, value=value.hex())
        record = _until_value(bench, var_id, value)
        frames = bench.instructions(_U, var_id, mark)
        seen = frames[-1] if frames else "none"
        record = bench.required(record, f"a VarUpdate with the value {value!r}", "VD-UPD-08", seen=seen, frames=frames)
        bench.answered(record.seqno, number, "seqno in the VarUpdate", "VD-UPD-07", frames=frames)


def _until_value(bench: Bench, var_id: int, value: bytes) -> Any | None:
    """Wait for a VarUpdate with this value and return it; None if there is none in time."""

    def wanted(heard: ReceivedBeacon) -> Any | None:
        record = heard.about(_U, var_id)
        return record if record is not None and record.value == value else None

    return bench.until(wanted)


@case(
    "TC_VD_UPD_BV_02",
    "Sequence numbers wrap around",
    requirements="VD-UPD-07",
    stimulus=(
        "as many RTDB-Updates as leave two to the modulus; then these two and one more, each after the VarUpdate "
        "before it"
    ),
    expect="VarUpdates with sequence numbers modulus - 1, 0, 1",
    window=25,
    needs=Needs(
        ut=("RTDB-Create", "RTDB-Update"),
        when=lambda bench: (
            holds_two_octets(bench)
            if bench.profile.types.var_seqno.width == 1
            else "sequence numbers have more than one octet"
        ),
    ),
)
def wrap(bench: Bench) -> None:
    var_id, modulus = produced(bench), seqno_modulus(bench.profile.types.var_seqno.width)
    for number in range(1, modulus - 1):
        bench.must("RTDB-Update", varId=var_id, value=number.to_bytes(2, "big").hex())
    for number in range(modulus - 1, modulus + 2):
        value, mark = number.to_bytes(2, "big"), bench.mark()
        bench.must("RTDB-Update", varId=var_id, value=value.hex())
        shown = _until_value(bench, var_id, value)
        frames = bench.instructions(_U, var_id, mark)
        what = f"seqno of the VarUpdate of update {number}"
        bench.equal(shown and shown.seqno, number % modulus, what, frames=frames)


@case(
    "TC_VD_UPD_BV_03",
    "A VarUpdate is sent in exactly repCnt beacons ({variant})",
    requirements="VD-UPD-08 VD-UPD-09",
    stimulus="RTDB-Create with repCnt {variant}; after its repetitions RTDB-Update",
    expect="one VarUpdate of the variable in each of exactly repCnt beacons",
    window=50,
    needs=_UPDATE,
    variants={"1": "1", "2": "2", "most": "most"},
)
def repetitions(bench: Bench, name: str) -> None:
    count = count_of(bench, name)
    var_id = produced(bench, rep_cnt=count)
    settled(bench, var_id)
    mark = bench.mark()
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    frames = bench.until_quiet(lambda heard: heard.instructions(_U, var_id), since=mark)
    bench.repeated(frames, count, "beacons with the VarUpdate", "VD-UPD-08")
    check_one_in_each(bench, frames, _U, var_id, "VD-UPD-09")


@case(
    "TC_VD_UPD_BV_04",
    "A further update restarts the repetitions",
    requirements="VD-UPD-08 VD-UPD-09",
    stimulus="RTDB-Update of a variable with the maximum repCnt; after two beacons another RTDB-Update",
    expect="the second VarUpdate in exactly repCnt beacons; the first in none with or after it",
    window=60,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update"), when=several_repetitions),
)
def counted_again(bench: Bench) -> None:
    count = max_repetitions(bench)
    var_id = produced(bench, rep_cnt=count)
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"first").hex())
    for _ in range(2):
        bench.required(bench.until_instruction(_U, var_id), "repetitions of the first VarUpdate", "VD-UPD-08")
    mark = bench.mark()
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"second").hex())
    _check_newest(bench, var_id, mark, count)


def _check_newest(bench: Bench, var_id: int, mark: int, count: int) -> None:
    """Check the beacons after update number 2: ``count`` of them since ``mark`` have it.

    Of the beacons from now on, at most one has an older VarUpdate, and comes before them.
    """
    done, value, seqno = bench.mark(), bench.records.value(b"second"), 2
    frames = bench.until_quiet(lambda heard: heard.instructions(_U, var_id), since=mark)
    newest = [heard for heard in frames if _newest(heard.instructions(_U, var_id)[-1].record, value, seqno)]
    bench.repeated(newest, count, "beacons with the newest VarUpdate", "VD-UPD-08", frames=frames)
    check_one_in_each(bench, frames, _U, var_id, "VD-UPD-09")
    old = [heard for heard in bench.receiver.frames_with(_U, var_id, done) if heard not in newest]
    late = [heard for heard in old if newest and heard.time >= newest[0].time]
    bench.proved(
        len(old) <= 1 and not late,
        "an older VarUpdate only in a beacon prepared before the update",
        f"in {len(old)} beacons, {len(late)} of them after the newest",
        "VD-UPD-09",
        frames=old,
    )


def _newest(record: object, value: bytes, seqno: int) -> bool:
    return getattr(record, "value", None) == value and getattr(record, "seqno", None) == seqno


@case(
    "TC_VD_UPD_BV_05",
    "After two updates in quick succession only the newest value is sent, in one VarUpdate per beacon",
    requirements="VD-UPD-09 VD-UPD-08",
    stimulus="two RTDB-Updates in succession, right after a beacon",
    expect="exactly repCnt beacons with one VarUpdate: the second value with seqno 2",
    window=30,
    needs=_UPDATE,
)
def quick(bench: Bench) -> None:
    count = min(2, max_repetitions(bench))
    for attempt in range(3):
        var_id = produced(bench, rep_cnt=count)
        settled(bench, var_id)

        def update(var_id: int = var_id) -> None:
            for value in (bench.records.value(b"first"), bench.records.value(b"second")):
                bench.must("RTDB-Update", varId=var_id, value=value.hex())

        def updated(heard: ReceivedBeacon, var_id: int = var_id) -> bool:
            return bool(heard.instructions(_U, var_id))

        bench.beacons(1, 1.5)
        mark, slow = bench.mark(), bench.session.typical_call > bench.period / 3
        if in_a_gap(bench, update, updated, paused=(attempt == 2 or slow) and pausable(bench))[1]:
            _check_newest(bench, var_id, mark, count)
            return
    bench.inconclusive("two updates between two beacons", f"a beacon in between in each attempt{pace(bench)}")


@case(
    "TC_VD_UPD_BV_06",
    "A VarCreate with repetitions left has the newest value and its sequence number",
    requirements="VD-UPD-10",
    stimulus="RTDB-Create with the maximum repCnt; after the first VarCreate RTDB-Update",
    expect="after at most one VarCreate with the old value, all others have the new value and seqno 1",
    window=40,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update"), when=several_repetitions),
)
def in_creations(bench: Bench) -> None:
    count, start = max_repetitions(bench), bench.mark()
    var_id = produced(bench, rep_cnt=count, value=b"first")
    bench.needed(bench.until_instruction(_C, var_id), "a VarCreate")
    bench.must("RTDB-Update", varId=var_id, value=bench.records.value(b"newer").hex())
    mark = bench.mark()
    if not least_left(bench, count, start):
        bench.inconclusive("VarCreates with repetitions left", "possibly none left after the update")
    frames = bench.until_quiet(lambda heard: heard.instructions(_C, var_id), since=mark)
    records = [heard.about(_C, var_id) for heard in frames]
    after = (
        records[1:]
        if records and not _newest(getattr(records[0], "upd", None), bench.records.value(b"newer"), 1)
        else records
    )
    wrong = [each for each in after if each is None or not _newest(each.upd, bench.records.value(b"newer"), 1)]
    bench.none(wrong, "the value of the update and seqno 1 in the VarCreates after it", frames=frames)
    bench.some(after, "VarCreates after the update", frames=frames)


# -- refusals ----------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_UPD_BI_01",
    "RTDB-Update rejects a variable that does not exist",
    requirements="VD-UPD-02",
    stimulus="RTDB-Update for an identifier that is not in use",
    expect="VARIABLE-DOES-NOT-EXIST; no VarUpdate",
    needs=Needs(ut=("RTDB-Update",)),
)
def unknown(bench: Bench) -> None:
    var_id = bench.unknown_id()
    bench.expect_status(UNKNOWN, "RTDB-Update", varId=var_id, value=bench.records.value(b"value").hex())
    bench.require_alive("RTDB-Update for an unknown variable")
    bench.none(bench.receiver.frames_with(_U, var_id), "no VarUpdate")


@case(
    "TC_VD_UPD_BO_01",
    "RTDB-Update rejects a variable of another node",
    requirements="VD-UPD-03",
    stimulus="a peer creates a variable; RTDB-Update, with a value and with an empty one",
    expect="NOT-PRODUCER both times; the value of the peer is unchanged",
    needs=Needs(ut=("RTDB-Update", "RTDB-Read")),
)
def foreign(bench: Bench) -> None:
    var_id = teach_variable(bench, bench.peer(), value=b"theirs")
    for value in (bench.records.value(b"ours"), b""):
        bench.expect_status(NOT_PRODUCER, "RTDB-Update", varId=var_id, value=value.hex())
    shown = bench.call("RTDB-Read", varId=var_id).result.get("value")
    bench.answered(shown, bench.records.value(b"theirs").hex(), "the value unchanged")


@case(
    "TC_VD_UPD_BO_02",
    "RTDB-Update rejects a deleted variable of another node, and checks the producer first",
    requirements="VD-UPD-03",
    stimulus="a peer creates and deletes a variable; RTDB-Update",
    expect="NOT-PRODUCER; up to 1.3 VARIABLE-DOES-NOT-EXIST once it has been removed",
    needs=Needs(ut=("RTDB-Update",)),
)
def foreign_deleted(bench: Bench) -> None:
    var_id, value = deleted_by_peer(bench, max_repetitions(bench)), bench.records.value(b"ours").hex()
    expect_any(bench, or_removed(bench, NOT_PRODUCER), "RTDB-Update", varId=var_id, value=value)


@case(
    "TC_VD_UPD_BO_03",
    "RTDB-Update rejects a deleted variable",
    requirements="VD-UPD-04 VD-UPD-12",
    stimulus="RTDB-Create and RTDB-Delete; RTDB-Update, with a valid value and with one that is too long",
    expect="VARIABLE-IS-DELETED both times (up to 1.3 VARIABLE-BEING-DELETED)",
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-Delete")),
)
def deleted(bench: Bench) -> None:
    var_id = produced(bench, rep_cnt=max_repetitions(bench))
    bench.must("RTDB-Delete", varId=var_id)
    mark = bench.mark()
    # The deletion determines the status, whatever the maximum length is.
    for value in (bench.records.value(b"newer"), b"v" * (bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH") + 1)):
        answer = bench.call("RTDB-Update", varId=var_id, value=value.hex())
        if answer.code != NOT_EXPRESSIBLE:
            bench.services.check_status(answer, statuses_after_deletion(bench), "RTDB-Update")
    bench.beacons(2, 2.5)
    bench.none(bench.receiver.frames_with(_U, var_id, mark), "no VarUpdate of the deleted variable")


@case(
    "TC_VD_UPD_BI_02",
    "A value of maximum length is accepted, one that is an octet longer is rejected",
    requirements="VD-UPD-05",
    stimulus="RTDB-Update with a value of the maximum length, then with one octet more",
    expect="VARDIS-STATUS-OK, then VALUE-TOO-LONG; value and sequence number are those of the first update",
    needs=_UPDATE_READ,
)
def value(bench: Bench) -> None:
    longest = bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH")
    var_id = produced(bench)
    bench.expect_status(OK, "RTDB-Update", varId=var_id, value=(b"v" * longest).hex())
    answer = bench.call("RTDB-Update", varId=var_id, value=(b"w" * (longest + 1)).hex())
    if answer.code == NOT_EXPRESSIBLE:
        bench.info("Can the profile express the value?", str(answer))
    else:
        bench.services.check_status(answer, (VALUE_TOO_LONG,), "RTDB-Update")
    _check_unchanged(bench, var_id, b"v" * longest)


@case(
    "TC_VD_UPD_BI_03",
    "An empty value is rejected",
    requirements="VD-UPD-06",
    stimulus="RTDB-Update with a value, then with an empty one",
    expect=(
        "VARDIS-STATUS-OK, then EMPTY-VALUE (1.0: INVALID-VALUE); value and sequence number are those of the first "
        "update"
    ),
    needs=_UPDATE_READ,
)
def empty_value(bench: Bench) -> None:
    var_id = produced(bench)
    bench.expect_status(OK, "RTDB-Update", varId=var_id, value=bench.records.value(b"x").hex())
    bench.expect_status(empty_status(bench), "RTDB-Update", varId=var_id, value="")
    _check_unchanged(bench, var_id, b"x")


def _check_unchanged(bench: Bench, var_id: int, value: bytes) -> None:
    shown = bench.call("RTDB-Read", varId=var_id).result.get("value")
    bench.answered(shown, value.hex(), "the value unchanged by the rejected update")
    record = bench.until_instruction(_U, var_id)
    bench.equal(record and (record.seqno, record.value), (1, value), "seqno and value of the VarUpdate")


@case(
    "TC_VD_UPD_BV_07",
    "An update renews the time stamp of the database entry",
    requirements="VD-UPD-08",
    stimulus="RTDB-Create, three beacon periods later RTDB-Update; RTDB-DescribeVariable before and after it",
    expect="seqno 1, the new value, countUpdate at most two less than repCnt, tStamp three periods later",
    window=6,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update", "RTDB-DescribeVariable")),
)
def entry(bench: Bench) -> None:
    count, newer = max_repetitions(bench), bench.records.value(b"newer").hex()

    def measure() -> Stamps:
        var_id = bench.identifiers.own_var_id()
        created = timed(bench, "RTDB-Create", **create_request(bench, var_id, rep_cnt=count))
        before = entry_of(bench, var_id) or {}
        bench.wait(3)
        start = bench.mark()
        updated = timed(bench, "RTDB-Update", varId=var_id, value=newer)
        after = entry_of(bench, var_id) or {}
        least = least_left(bench, count, start)
        bench.answered(after.get("value"), newer, "the new value")
        bench.answered(after.get("seqno", 1), 1, "seqno")
        left = after.get("countUpdate", count)
        bench.proved(least <= left <= count, f"countUpdate from {least} to {count}", left)
        if "tStamp" not in before or "tStamp" not in after:
            # Both fields are optional, so there is nothing more to check.
            raise StopCase
        return Stamps(before["tStamp"], after["tStamp"], (created, updated))

    check_apart(bench, "tStamp", measure)
