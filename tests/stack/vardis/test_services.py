"""Services for applications: statuses, the order of checks, what the database then holds (B.5)."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest
from dcp_spec.constants import BP_PROTID_VARDIS
from dcp_spec.parameters import UnknownParameterError
from dcp_spec.status import VardisStatus

from dcp_codec import Codec, get_codec
from dcp_stack.effects import VariableChanged
from dcp_stack.vardis.confirms import NoResponseError

from ..vardis_rig import ME, MS, OTHER, VERSIONS, WALL, Rig, VarCreate, VarDelete, VarSumm, VarUpdate

S = VardisStatus


# -- not registered ----------------------------------------------------------------------------------------------


def every_service(rig: Rig) -> list[Callable[[], object]]:
    vardis = rig.vardis
    return [
        rig.create,
        rig.update,
        rig.delete,
        lambda: vardis.read(7).status,
        lambda: vardis.describe_variable(7).status,
        lambda: vardis.describe_database().status,
    ]


@pytest.mark.req("VD-SRV-01")
def test_without_a_registration_services_are_refused() -> None:
    rig = Rig()
    assert rig.create() is S.OK
    # Another client deregistered VarDis: VarDis gets no notification.
    rig.bp.deregister(BP_PROTID_VARDIS)
    rig.effects.clear()
    assert [service() for service in every_service(rig)] == [S.INACTIVE] * 6
    assert rig.effects == []


@pytest.mark.req("VD-SRV-01")
def test_under_the_other_reading_services_do_not_answer_without_a_registration() -> None:
    rig = Rig(readings={"X30": "no-response"})
    assert rig.create() is S.OK
    # Being deactivated is another matter.
    rig.vardis.deactivate()
    assert [service() for service in every_service(rig)] == [S.INACTIVE] * 6
    rig.vardis.activate()
    rig.bp.deregister(BP_PROTID_VARDIS)
    rig.effects.clear()
    for service in every_service(rig):
        with pytest.raises(NoResponseError, match="X30"):
            service()
    assert rig.effects == []
    rig.vardis.start(rig.now, rig.wall)
    assert rig.create() is S.OK


# -- create -----------------------------------------------------------------------------------------------------


@pytest.mark.req("VD-CRE-10")
@pytest.mark.req("VD-CRE-12")
@pytest.mark.req("VD-DB-01")
@pytest.mark.req("VD-DB-03")
def test_create_stores_everything() -> None:
    rig = Rig()
    rig.now = 5
    assert rig.create(7, b"ABCD", rep_cnt=3, descr=b"pos", timeout=5000) is S.OK
    entry = rig.entry()
    assert (entry.value, entry.seqno, entry.t_stamp, entry.is_deleted) == (b"ABCD", 0, WALL + 5, False)
    assert (entry.count_create, entry.count_update, entry.count_delete) == (3, 0, 0)
    assert (entry.spec.rep_cnt, entry.spec.descr, entry.spec.timeout) == (3, b"pos", 5000)
    assert (rig.queue("createQ"), rig.queue("summaryQ")) == ([7], [7])
    assert rig.effects == [VariableChanged("created", 7, 0, b"ABCD", ME)]


@pytest.mark.req("VD-CRE-08")
@pytest.mark.parametrize("given", [None, ME, OTHER])
def test_the_producer_is_always_this_node(given: bytes | None) -> None:
    rig = Rig()
    assert rig.create(prod_id=given) is S.OK
    assert rig.entry().spec.prod_id == ME


@pytest.mark.req("VD-CRE-08")
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_before_1_2_the_producer_is_an_argument(version: str) -> None:
    rig = Rig(version)
    assert rig.create(7, prod_id=OTHER) is S.OK
    assert rig.create(8, prod_id=None) is S.OK
    assert (rig.entry(7).spec.prod_id, rig.entry(8).spec.prod_id) == (OTHER, ME)
    assert rig.update(7) is S.NOT_PRODUCER


@pytest.mark.req("VD-CRE-04")
@pytest.mark.req("VD-CRE-05")
@pytest.mark.req("VD-CRE-06")
@pytest.mark.req("VD-CRE-07")
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({"descr": b"d" * 10}, S.OK),
        ({"descr": b"d" * 11}, S.VARIABLE_DESCRIPTION_TOO_LONG),
        ({"value": b"v" * 12}, S.OK),
        ({"value": b"v" * 13}, S.VALUE_TOO_LONG),
        ({"value": b""}, S.EMPTY_VALUE),
        ({"rep_cnt": 0}, S.ILLEGAL_REPCOUNT),
        ({"rep_cnt": -1}, S.ILLEGAL_REPCOUNT),
        ({"rep_cnt": 1}, S.OK),
        ({"rep_cnt": 4}, S.OK),
        ({"rep_cnt": 5}, S.ILLEGAL_REPCOUNT),
    ],
)
def test_limits_of_create(version: str, change: dict[str, object], status: VardisStatus) -> None:
    longest = 11 if version == "1.0" else 10  # 1.0 counts the terminating NUL
    rig = Rig(version, max_description_length=longest, max_value_length=12, max_repetitions=4)
    assert rig.create(**change) is status.in_version(version)
    assert (rig.entry() is None) == (status is not S.OK)


@pytest.mark.req("DATA-08")
@pytest.mark.req("VD-CRE-04")
def test_descriptions_are_counted_in_bytes() -> None:
    rig = Rig(max_description_length=6)
    assert rig.create(7, descr="äöü".encode()) is S.OK
    assert rig.create(8, descr="äöüx".encode()) is S.VARIABLE_DESCRIPTION_TOO_LONG


@pytest.mark.req("VD-CRE-13")
@pytest.mark.req("DATA-11")
def test_the_first_failed_check_determines_the_status() -> None:
    rig = Rig(max_description_length=4, max_value_length=4)
    rig.receive(rig.vc(9, b"v", descr=b"d"))
    wrong: dict[str, object] = {"descr": b"ddddd", "value": b"vvvvv", "rep_cnt": 0}
    rig.vardis.deactivate()
    assert rig.create(9, **wrong) is S.INACTIVE
    rig.vardis.activate()
    assert rig.create(9, **wrong) is S.VARIABLE_EXISTS
    assert rig.create(7, **wrong) is S.VARIABLE_DESCRIPTION_TOO_LONG
    assert rig.create(7, **wrong | {"descr": b"d"}) is S.VALUE_TOO_LONG
    assert rig.create(7, **wrong | {"descr": b"d", "value": b""}) is S.EMPTY_VALUE
    assert rig.create(7, **wrong | {"descr": b"d", "value": b"v"}) is S.ILLEGAL_REPCOUNT


@pytest.mark.req("VD-CRE-15")
def test_an_empty_description_is_accepted_or_refused_by_reading() -> None:
    assert Rig().create(descr=b"") is S.OK
    assert Rig(readings={"X21": "refuse-locally"}).create(descr=b"") is S.VARIABLE_DESCRIPTION_TOO_LONG


@pytest.mark.req("VD-CRE-03")
@pytest.mark.req("VD-CRE-09")
@pytest.mark.parametrize("step_ns", [0, 1, 999, 10**9, -1, -(10**12)])
def test_a_new_creation_is_strictly_later_even_if_the_clock_was_set_back(step_ns: int) -> None:
    rig = Rig()
    rig.create()
    rig.update()
    first = rig.entry().spec.creation_time
    rig.wall_offset += step_ns
    assert rig.create(value=b"again") is S.OK
    entry = rig.entry()
    assert first == WALL
    assert entry.spec.creation_time == max(WALL + step_ns, WALL + 1)
    assert (entry.seqno, entry.value, entry.count_create, entry.count_update) == (0, b"again", 2, 0)


@pytest.mark.req("VD-CRE-09")
@pytest.mark.parametrize(("unit", "expected"), [("s", WALL // 10**9), ("ms", WALL // MS), ("us", WALL // 1000)])
def test_creation_times_are_in_the_unit_of_the_profile(unit: str, expected: int) -> None:
    profile = get_codec("dcp-2.0").profile
    types = msgspec.structs.replace(
        profile.types, timestamp=msgspec.structs.replace(profile.types.timestamp, unit=unit)
    )
    rig = Rig(codec=Codec(msgspec.structs.replace(profile, types=types)))
    for later in range(3):
        assert rig.create() is S.OK
        assert rig.entry().spec.creation_time == expected + later


def test_no_creation_is_later_than_the_last_time_stamp() -> None:
    profile = get_codec("dcp-2.0").profile
    stamp = msgspec.structs.replace(profile.types.timestamp, width=1, unit="s")
    types = msgspec.structs.replace(profile.types, timestamp=stamp)
    rig = Rig(codec=Codec(msgspec.structs.replace(profile, types=types)))
    rig.wall_offset = WALL - (WALL // 10**9 - 255) % 256 * 10**9
    assert rig.create() is S.OK
    assert rig.entry().spec.creation_time == 255
    assert rig.create() is S.VARIABLE_EXISTS


@pytest.mark.req("VD-CRE-11")
def test_creating_again_withdraws_everything_pending() -> None:
    rig = Rig()
    rig.create()
    rig.update()
    rig.delete()
    rig.create(value=b"new")
    assert {name: rig.queue(name) for name in ("createQ", "summaryQ")} == {"createQ": [7], "summaryQ": [7]}
    assert not any(rig.queue(name) for name in ("deleteQ", "updateQ", "reqUpdQ", "reqCreateQ"))
    rig.receive(VarSumm(8, 0))
    assert rig.queue("reqCreateQ") == [8]
    rig.create(8)
    assert rig.queue("reqCreateQ") == []


@pytest.mark.req("VD-CRE-02")
@pytest.mark.parametrize("version", VERSIONS[:-1])
def test_before_2_0_an_identifier_is_free_again_after_the_last_deletion(version: str) -> None:
    rig = Rig(version)
    rig.create()
    assert rig.create() is S.VARIABLE_EXISTS
    rig.delete()
    assert rig.create() is S.VARIABLE_EXISTS
    rig.drain()
    assert rig.entry() is None
    assert rig.delete() is S.VARIABLE_DOES_NOT_EXIST
    assert rig.create() is S.OK


@pytest.mark.req("VD-CRE-14")
@pytest.mark.req("VD-SRV-02")
@pytest.mark.req("DATA-10")
def test_the_confirm_is_the_answer_to_the_call_and_carries_a_status_only() -> None:
    rig = Rig()
    confirm = rig.vardis.create(7, None, 1, b"d", b"v", now=0, wall=WALL)
    assert confirm.__struct_fields__ == ("status",)
    assert confirm.status.is_ok
    assert rig.bp.submitted == []


@pytest.mark.req("VD-TYP-01")
@pytest.mark.req("VD-TYP-04")
@pytest.mark.parametrize(
    "wrong", [{"var_id": 256}, {"var_id": -1}, {"timeout": 65536}, {"timeout": -1}, {"prod_id": b"short"}]
)
def test_arguments_that_cannot_be_encoded_are_misuse(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="not"):
        Rig().create(**wrong)


def test_misuse_that_only_old_versions_know() -> None:
    with pytest.raises(ValueError, match="timeout"):
        Rig("1.3").create(timeout=1)
    with pytest.raises(ValueError, match="NUL"):
        Rig("1.0").create(descr=b"a\0b")


@pytest.mark.req("VD-TYP-04")
@pytest.mark.req("VD-TYP-05")
@pytest.mark.req("VD-TYP-07")
@pytest.mark.req("VD-CMP-07")
@pytest.mark.parametrize("version", VERSIONS)
def test_created_variables_are_sent(version: str) -> None:
    rig = Rig(version)
    rig.create(255, b"\0", rep_cnt=1, timeout=65535 if version == "2.0" else 0)
    (record,) = rig.records(VarCreate)
    assert record == rig.vc(255, b"\0", prod_id=ME, rep_cnt=1, created=WALL, timeout=65535)


# -- what can never fit -----------------------------------------------------------------------------------------


def test_a_variable_that_fits_into_no_payload_is_refused() -> None:
    # ICHeader 2 + VarSpec 19 + VarUpdate 3 = 24 octets around description and value.
    rig = Rig(max_payload_size=64, max_value_length=20, max_description_length=20)
    assert rig.vardis.set_parameter("VARDISPAR_MAX_VALUE_LENGTH", 60) is None
    assert rig.create(1, bytes(30), descr=bytes(10)) is S.OK
    assert rig.create(2, bytes(31), descr=bytes(10)) is S.VALUE_TOO_LONG
    # Its VarCreate no longer fits into a payload, its VarUpdate does: RTDB-Update checks the value only.
    assert rig.update(1, bytes(31)) is S.OK
    assert rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 40) is None
    assert rig.create(2, b"v", descr=bytes(16)) is S.VARIABLE_DESCRIPTION_TOO_LONG
    assert rig.create(2, b"v", descr=bytes(15)) is S.OK
    # The header and VarUpdate take 2 and 3 octets of the 40.
    assert rig.update(1, bytes(35)) is S.OK
    assert rig.update(1, bytes(36)) is S.VALUE_TOO_LONG


def test_a_description_longer_than_its_length_field_is_refused() -> None:
    rig = Rig(max_description_length=300)
    assert rig.create(descr=bytes(255)) is S.OK
    assert rig.create(descr=bytes(256)) is S.VARIABLE_DESCRIPTION_TOO_LONG


def test_a_repetition_count_wider_than_its_field_is_refused() -> None:
    rig = Rig("1.1", max_repetitions=400)
    assert rig.create(7, rep_cnt=255) is S.OK
    assert rig.create(8, rep_cnt=256) is S.ILLEGAL_REPCOUNT


def test_the_database_is_bounded() -> None:
    rig = Rig(max_variables=2)
    assert rig.create(1) is S.OK
    rig.receive(rig.vc(2), rig.vc(3))
    assert rig.drops() == ["database-full"]
    assert rig.create(3) is S.INACTIVE
    assert rig.create(1) is S.OK
    rig.receive(VarSumm(9, 0))
    assert rig.queue("reqCreateQ") == []
    assert rig.drops() == ["database-full"] * 2


def test_requests_are_bounded() -> None:
    rig = Rig(max_variables=3)
    rig.receive(tuple(VarSumm(var_id, 0) for var_id in range(10)))
    assert rig.queue("reqCreateQ") == [0, 1, 2]
    assert rig.drops() == ["database-full"] * 7


# -- update, delete, read, describe -----------------------------------------------------------------------------


@pytest.mark.req("VD-UPD-05")
@pytest.mark.req("VD-UPD-06")
@pytest.mark.req("VD-TYP-02")
@pytest.mark.parametrize("version", VERSIONS)
def test_limits_of_update(version: str) -> None:
    rig = Rig(version, max_value_length=12)
    rig.create()
    assert rig.update(value=bytes(13)) is S.VALUE_TOO_LONG
    assert rig.update(value=b"") is S.EMPTY_VALUE.in_version(version)
    assert (rig.entry().seqno, rig.read()) == (0, b"ABCD")
    for length in (12, 1, 5):
        assert rig.update(value=bytes(length)) is S.OK
        assert rig.read() == bytes(length)


@pytest.mark.req("VD-UPD-03")
@pytest.mark.req("VD-DEL-03")
def test_the_producer_is_checked_before_deletion_and_value() -> None:
    rig = Rig()
    rig.receive(rig.vc())
    rig.receive(VarDelete(7))
    assert rig.update(value=b"") is S.NOT_PRODUCER
    assert rig.delete() is S.NOT_PRODUCER
    rig.create(8)
    rig.delete(8)
    assert rig.update(8, b"") is S.VARIABLE_IS_DELETED


@pytest.mark.req("VD-UPD-07")
@pytest.mark.req("VD-TYP-03")
def test_sequence_numbers_wrap() -> None:
    rig = Rig()
    rig.create()
    for expected in [*range(1, 256), 0, 1]:
        rig.update(value=bytes([expected]))
        assert rig.entry().seqno == expected


@pytest.mark.req("VD-UPD-08")
@pytest.mark.req("VD-UPD-09")
@pytest.mark.req("VD-DB-03")
def test_update_starts_its_repetitions_again_and_is_queued_once() -> None:
    rig = Rig()
    rig.create(rep_cnt=3)
    rig.drain()
    rig.update(value=b"one")
    rig.sent()
    rig.update(value=b"two")
    entry = rig.entry()
    assert (entry.count_update, rig.queue("updateQ"), entry.t_stamp) == (3, [7], rig.wall)
    assert rig.changes()[-1] == ("updated", 7)
    assert rig.count(VarUpdate) == 3


@pytest.mark.req("VD-DEL-05")
@pytest.mark.req("VD-DEL-06")
@pytest.mark.req("VD-DB-02")
def test_a_deleted_variable_stays_and_only_its_deletion_is_sent() -> None:
    rig = Rig()
    rig.create()
    rig.update()
    assert rig.delete() is S.OK
    assert rig.changes()[-1] == ("deleted", 7)
    assert [rig.records() for _ in range(3)] == [[VarDelete(7)], [VarDelete(7)], []]
    assert rig.entry().is_deleted
    assert rig.vardis.describe_database().variables[0].is_deleted


@pytest.mark.req("VD-DEL-05")
def test_deleting_removes_requests() -> None:
    rig = Rig()
    rig.receive(rig.vc(9))
    rig.receive(VarSumm(9, 3))
    assert rig.queue("reqUpdQ") == [9]
    rig.receive(VarDelete(9))
    assert not any(rig.queue(name) for name in ("reqUpdQ", "createQ", "summaryQ", "updateQ"))


@pytest.mark.req("VD-REA-04")
@pytest.mark.req("VD-DB-03")
def test_read_returns_the_value_and_its_time_of_arrival() -> None:
    rig = Rig()
    rig.receive(rig.vc())
    rig.now += 123
    rig.receive(VarUpdate(7, 1, b"new"))
    rig.now += 1000
    rig.receive(VarUpdate(7, 1, b"newer"), VarSumm(7, 4))
    found = rig.vardis.read(7)
    assert (found.status, found.value, found.t_stamp) == (S.OK, b"new", WALL + 123)


@pytest.mark.req("VD-REA-03")
def test_a_deleted_variable_has_no_value_to_read() -> None:
    rig = Rig()
    rig.create()
    rig.delete()
    found = rig.vardis.read(7)
    assert (found.status, found.value, found.t_stamp) == (S.VARIABLE_IS_DELETED, None, None)


@pytest.mark.req("VD-DDB-02")
@pytest.mark.req("VD-DDB-03")
@pytest.mark.req("VD-DVA-02")
@pytest.mark.req("VD-DVA-03")
def test_describing_shows_deleted_variables_too() -> None:
    rig = Rig()
    assert rig.vardis.describe_database().variables == ()
    rig.create(1)
    rig.create(2)
    rig.delete(1)
    listed = rig.vardis.describe_database()
    assert listed.status is S.OK
    assert [(found.spec.var_id, found.is_deleted, found.t_stamp) for found in listed.variables] == [
        (1, True, WALL),
        (2, False, WALL),
    ]
    assert rig.vardis.describe_variable(1).status is S.OK
    assert rig.entry(1).count_delete == 2
    assert rig.vardis.describe_variable(3).status is S.VARIABLE_DOES_NOT_EXIST
    assert rig.entry(3) is None


@pytest.mark.req("VD-DVA-03")
def test_a_description_does_not_change_afterwards() -> None:
    rig = Rig()
    rig.create()
    before = rig.entry()
    rig.update()
    assert before.seqno == 0


# -- activation -------------------------------------------------------------------------------------------------


def answers(rig: Rig) -> list[VardisStatus]:
    """Of every service."""
    return [
        rig.create(8),
        rig.update(),
        rig.delete(),
        rig.vardis.read(7).status,
        rig.vardis.describe_database().status,
        rig.vardis.describe_variable(7).status,
    ]


@pytest.mark.req("VD-SRV-01")
@pytest.mark.req("VD-MGT-01")
@pytest.mark.req("VD-MGT-04")
@pytest.mark.req("VD-CRE-01")
@pytest.mark.req("VD-UPD-01")
@pytest.mark.req("VD-DEL-01")
@pytest.mark.req("VD-REA-01")
@pytest.mark.req("VD-DDB-01")
@pytest.mark.req("VD-DVA-01")
def test_inactive_services_report_it_and_do_nothing() -> None:
    rig = Rig()
    rig.create()
    before = rig.vardis.snapshot()
    assert rig.vardis.deactivate().status is S.OK
    assert answers(rig) == [S.INACTIVE] * 6
    assert rig.vardis.describe_database().variables == ()
    assert rig.entry() is None
    assert rig.vardis.read(7).value is None
    assert rig.vardis.activate().status is S.OK
    assert rig.vardis.snapshot() == before


@pytest.mark.req("VD-MGT-02")
@pytest.mark.req("VD-MGT-05")
@pytest.mark.req("VD-MGT-06")
@pytest.mark.req("VD-RUN-03")
def test_composing_stops_while_inactive_and_continues_afterwards() -> None:
    rig = Rig()
    rig.create(rep_cnt=3)
    rig.sent()
    rig.vardis.deactivate()
    submitted = len(rig.bp.submitted)
    rig.wait(1000)
    rig.vardis.payload_transmitted(rig.now, rig.wall)
    assert len(rig.bp.submitted) == submitted
    rig.vardis.activate()
    assert rig.count(VarCreate) == 2
    assert rig.read() == b"ABCD"


@pytest.mark.req("VD-MGT-03")
def test_inactive_received_payloads_are_lost() -> None:
    rig = Rig()
    rig.vardis.deactivate()
    rig.receive(rig.vc())
    assert rig.drops() == ["vardis-inactive"]
    rig.vardis.activate()
    assert rig.entry() is None


# -- parameters -------------------------------------------------------------------------------------------------


@pytest.mark.req("VD-PAR-01")
def test_parameters_affect_later_changes_only() -> None:
    rig = Rig()
    rig.create(1, bytes(32), descr=bytes(32), rep_cnt=5)
    for name, value in (("VALUE_LENGTH", 4), ("DESCRIPTION_LENGTH", 4), ("REPETITIONS", 2)):
        assert rig.vardis.set_parameter(f"VARDISPAR_MAX_{name}", value) is None
    assert rig.create(2, bytes(5)) is S.VALUE_TOO_LONG
    assert rig.create(2, bytes(4), descr=bytes(5)) is S.VARIABLE_DESCRIPTION_TOO_LONG
    assert rig.create(2, bytes(4), rep_cnt=3) is S.ILLEGAL_REPCOUNT
    assert rig.create(2, bytes(4), descr=bytes(4), rep_cnt=2) is S.OK
    rig.receive(VarUpdate(1, 1, b"x"), rig.vc(3, bytes(5)))
    assert rig.drops() == ["bad-value", "update-own"]
    assert (rig.read(1), rig.count(VarCreate, 1)) == (bytes(32), 5)


@pytest.mark.parametrize(
    ("name", "valid", "invalid"),
    [
        pytest.param(
            "MAX_VALUE_LENGTH", (1, 32, 255), (0, -1, 256, 1.5, True, "4", None), marks=pytest.mark.req("VD-PAR-02")
        ),
        pytest.param("MAX_DESCRIPTION_LENGTH", (1, 944), (0, 945), marks=pytest.mark.req("VD-PAR-03")),
        pytest.param("MAX_REPETITIONS", (1, 15), (0, 16), marks=pytest.mark.req("VD-PAR-04")),
        pytest.param("MAX_PAYLOAD_SIZE", (1, 1478), (0, 1479), marks=pytest.mark.req("VD-PAR-05")),
        pytest.param("MAX_SUMMARIES", (0, 499), (-1, 500), marks=pytest.mark.req("VD-PAR-06")),
        pytest.param("SCRUBBING_PERIOD", (1, 65000), (0, 65001), marks=pytest.mark.req("VD-PAR-07")),
        pytest.param("BUFFER_CHECK_PERIOD", (1, 65000), (0, 65001), marks=pytest.mark.req("VD-PAR-08")),
    ],
)
def test_bounds(name: str, valid: tuple[int, ...], invalid: tuple[object, ...]) -> None:
    rig = Rig()
    for value in valid:
        assert rig.vardis.set_parameter(f"VARDISPAR_{name}", value) is None
        assert rig.vardis.parameters()[f"VARDISPAR_{name}"] == value
    for value in invalid:
        violation = rig.vardis.set_parameter(f"VARDISPAR_{name}", value)
        assert violation is not None
        assert violation.parameter == f"VARDISPAR_{name}"
        assert rig.vardis.parameters()[f"VARDISPAR_{name}"] == valid[-1]


@pytest.mark.req("VD-PAR-02")
@pytest.mark.req("VD-PAR-03")
def test_bounds_follow_other_parameters() -> None:
    rig = Rig(max_payload_size=100)
    assert rig.vardis.set_parameter("VARDISPAR_MAX_VALUE_LENGTH", 98) is None
    assert rig.vardis.set_parameter("VARDISPAR_MAX_VALUE_LENGTH", 99) is not None
    assert rig.vardis.set_parameter("VARDISPAR_MAX_DESCRIPTION_LENGTH", 1) is not None
    rig.vardis.set_parameter("VARDISPAR_MAX_VALUE_LENGTH", 70)
    assert rig.vardis.set_parameter("VARDISPAR_MAX_DESCRIPTION_LENGTH", 6) is None
    assert rig.vardis.set_parameter("VARDISPAR_MAX_DESCRIPTION_LENGTH", 7) is not None
    assert rig.vardis.set_parameter("VARDISPAR_MAX_SUMMARIES", 49) is None
    assert rig.vardis.set_parameter("VARDISPAR_MAX_SUMMARIES", 50) is not None


def test_the_longest_value_can_be_bound_by_the_whole_record() -> None:
    rig = Rig(max_payload_size=100, readings={"X23": "record-bound"})
    assert rig.vardis.set_parameter("VARDISPAR_MAX_VALUE_LENGTH", 44) is None
    violation = rig.vardis.set_parameter("VARDISPAR_MAX_VALUE_LENGTH", 45)
    assert violation is not None
    assert violation.requirement == "VD-PAR-03"
    assert rig.vardis.parameters()["VARDISPAR_MAX_VALUE_LENGTH"] == 44


def test_parameters_that_the_profile_leaves_open_respect_their_bounds() -> None:
    found = Rig(max_payload_size=60).vardis.parameters()
    assert found["VARDISPAR_MAX_VALUE_LENGTH"] == 32
    assert found["VARDISPAR_MAX_DESCRIPTION_LENGTH"] == 60 - 24 - 32
    assert found["VARDISPAR_MAX_SUMMARIES"] == 20
    with pytest.raises(ValueError, match="VARDISPAR_MAX_REPETITIONS must be at most 15"):
        Rig(max_repetitions=16)
    with pytest.raises(ValueError, match="VARDISPAR_MAX_DESCRIPTION_LENGTH"):
        Rig(max_payload_size=40)


def test_only_parameters_of_vardis_and_of_the_version() -> None:
    rig = Rig("1.3")
    assert "VARDISPAR_SCRUBBING_PERIOD" not in rig.vardis.parameters()
    assert rig.vardis.set_parameter("VARDISPAR_SCRUBBING_PERIOD", 1000) is not None
    for name in ("BPPAR_BEACON_PERIOD", "VARDISPAR_NONE"):
        with pytest.raises(UnknownParameterError):
            rig.vardis.set_parameter(name, 1)
