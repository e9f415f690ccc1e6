"""Initialization, payload generation in time, scrubbing, shutdown (B.6)."""

from __future__ import annotations

import pytest
from dcp_spec.constants import QueueingMode
from dcp_spec.status import BPStatus, VardisStatus

from dcp_stack.config import NodeConfig
from dcp_stack.vardis.entity import Vardis

from ..vardis_rig import ME, MS, OTHER, VERSIONS, WALL, OneSlot, Rig, VarCreate, VarDelete, VarSumm, VarUpdate

# -- initialization, shutdown -----------------------------------------------------------------------------------


@pytest.mark.req("VD-INI-02")
@pytest.mark.req("VD-INI-01")
@pytest.mark.req("VD-INI-05")
@pytest.mark.parametrize(
    ("version", "mode"),
    [
        ("1.0", QueueingMode.ONCE),
        ("1.1", QueueingMode.QUEUE_DROPTAIL),
        ("1.2", QueueingMode.QUEUE_DROPHEAD),
        ("1.3", QueueingMode.QUEUE_DROPHEAD),
        ("2.0", QueueingMode.QUEUE_DROPHEAD),
    ],
)
def test_registration(version: str, mode: QueueingMode) -> None:
    rig = Rig(version, start=False, max_payload_size=500, bp_queue_entries=3)
    assert not rig.vardis.active
    assert rig.create() is VardisStatus.INACTIVE
    assert rig.bp.registrations == []
    rig.bp.own_id = OTHER
    assert rig.vardis.start(0, WALL) is BPStatus.OK
    name = f"VarDis -- Variable Dissemination Protocol V{version}"
    assert rig.bp.registrations == [(2, name, 500, mode, 3, False)]
    assert rig.vardis.active
    assert rig.vardis.own_node_identifier == OTHER
    rig.create()
    assert rig.records(VarCreate)[0].spec.prod_id == OTHER


@pytest.mark.req("VD-INI-05")
def test_without_an_answer_the_configured_identifier_counts() -> None:
    rig = Rig("1.0", start=False)
    rig.bp.tells_own_id = False
    rig.vardis.start(0, WALL)
    assert rig.vardis.own_node_identifier == ME


@pytest.mark.req("VD-INI-03")
def test_a_registration_left_over_is_replaced() -> None:
    rig = Rig()
    rig.create()
    crashed = rig.vardis
    rig.vardis = Vardis(rig.config, rig.bp, emit=rig.effects.append, now=rig.now, wall=rig.wall)
    assert rig.vardis.start(rig.now, rig.wall) is BPStatus.OK
    assert rig.bp.deregistrations == 1
    assert rig.vardis is not crashed
    assert rig.vardis.describe_database().variables == ()


@pytest.mark.req("VD-INI-01")
@pytest.mark.req("VD-INI-04")
def test_active_only_after_a_registration_that_succeeded() -> None:
    rig = Rig(start=False)
    rig.bp.refuse = [BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE]
    assert rig.vardis.start(0, WALL) is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
    assert not rig.vardis.active
    assert rig.vardis.activate().status is VardisStatus.INACTIVE
    assert rig.vardis.poll_timeout() is None
    rig.vardis.handle_timeout(10**12, WALL)
    assert rig.vardis.start(0, WALL) is BPStatus.OK
    assert not any(rig.vardis.snapshot()["queues"].values())
    assert rig.vardis.snapshot()["variables"] == {}


@pytest.mark.req("VD-SHD-01")
@pytest.mark.req("VD-SHD-02")
@pytest.mark.req("VD-SHD-03")
@pytest.mark.req("VD-INI-04")
def test_shutdown_and_a_new_start() -> None:
    rig = Rig()
    rig.create(timeout=10)
    rig.receive(rig.vc(8), VarSumm(9, 1))
    rig.vardis.shutdown()
    assert not rig.vardis.active
    assert rig.bp.registration is None
    assert rig.vardis.poll_timeout() is None
    assert rig.create() is VardisStatus.INACTIVE
    changes = len(rig.effects)
    rig.vardis.handle_timeout(rig.now + 10**12, rig.wall)
    assert len(rig.effects) == changes
    rig.vardis.shutdown()
    assert rig.bp.deregistrations == 1
    snapshot = rig.vardis.snapshot()
    assert snapshot["variables"] == {}
    assert not any(snapshot["queues"].values())
    rig.vardis.start(rig.now, rig.wall)
    assert rig.entry() is None


def test_a_node_without_vardis() -> None:
    config = NodeConfig(node_id=ME, codec=Rig().codec, vardis=None)
    with pytest.raises(ValueError, match="without VarDis"):
        Vardis(config, OneSlot(ME), emit=lambda effect: None, now=0, wall=WALL)


# -- generating payloads ----------------------------------------------------------------------------------------


@pytest.mark.req("VD-RUN-01")
def test_the_next_payload_follows_the_last() -> None:
    rig = Rig()
    rig.create(rep_cnt=3)
    rig.vardis.payload_transmitted(0, WALL)
    assert rig.bp.slot is not None
    for _ in range(2):
        rig.bp.take()
        rig.vardis.payload_transmitted(rig.now, rig.wall)
    assert len(rig.bp.submitted) == 3
    assert rig.entry().count_create == 0


BEACON = 100 * MS


@pytest.mark.req("VD-RUN-01")
def test_a_payload_includes_records_that_arrive_before_its_beacon() -> None:
    rig = Rig(buffer_check_period_ms=20)
    rig.bp.beacon = BEACON
    rig.create(rep_cnt=3)
    rig.vardis.payload_transmitted(rig.now, rig.wall)
    assert rig.bp.slot is None
    assert rig.vardis.poll_timeout() == BEACON
    rig.wait(99)
    assert rig.bp.queries == 1, "an empty buffer is not a reason to compose while the beacon is still to come"
    rig.update(value=b"late")
    rig.wait(1)
    assert rig.bp.slot is not None
    creation, *_ = rig.codec.decode_containers(rig.bp.slot)
    assert [(each.upd.seqno, each.upd.value) for each in creation.records] == [(1, b"late")]


@pytest.mark.req("VD-RUN-02")
@pytest.mark.parametrize(("period", "composed_at"), [(20, 100), (100, 100), (130, 130), (240, 240)])
def test_after_idling_the_buffer_is_checked_at_the_beacon(period: int, composed_at: int) -> None:
    rig = Rig(buffer_check_period_ms=period, scrubbing_period_ms=60_000)
    rig.bp.beacon = BEACON
    rig.create()
    while rig.bp.slot is None:
        due = rig.vardis.poll_timeout()
        assert due is not None
        assert due > rig.now
        rig.wait((due - rig.now) // MS)
        if rig.bp.slot is None:
            rig.bp.beacon += BEACON
    assert rig.now == composed_at * MS


@pytest.mark.req("VD-RUN-01")
@pytest.mark.parametrize("lead", [1, 2.5, 99, 100, 1000])
def test_the_lead_is_the_time_between_composing_and_beacon(lead: float) -> None:
    rig = Rig(compose_lead_ms=lead)
    rig.create(rep_cnt=3)
    rig.bp.beacon = BEACON
    rig.vardis.payload_transmitted(rig.now, rig.wall)
    due = rig.vardis.poll_timeout()
    assert due == BEACON - round(lead * MS)
    rig.vardis.handle_timeout(max(due, 0), rig.wall)
    assert rig.bp.slot is not None


@pytest.mark.req("VD-RUN-01")
def test_a_beacon_that_is_brought_forward_is_not_missed() -> None:
    rig = Rig()
    rig.create(rep_cnt=3)
    rig.bp.beacon = BEACON
    rig.vardis.payload_transmitted(rig.now, rig.wall)
    rig.bp.beacon = 20 * MS
    assert rig.vardis.poll_timeout() == 20 * MS
    rig.wait(20)
    assert rig.bp.slot is not None


@pytest.mark.req("VD-RUN-01")
@pytest.mark.req("VD-RUN-02")
def test_composing_after_the_beacon_can_be_chosen() -> None:
    rig = Rig(readings={"X54": "after-the-beacon"}, buffer_check_period_ms=20)
    rig.bp.beacon = BEACON
    rig.create(rep_cnt=3)
    assert rig.vardis.poll_timeout() == 20 * MS
    rig.wait(20)
    assert rig.bp.slot is not None
    rig.bp.take()
    rig.vardis.payload_transmitted(rig.now, rig.wall)
    assert len(rig.bp.submitted) == 2


@pytest.mark.req("VD-RUN-02")
def test_a_payload_still_buffered_by_bp_is_not_displaced() -> None:
    rig = Rig()
    rig.create(rep_cnt=3)
    rig.bp.beacon = BEACON
    rig.wait(100)
    assert len(rig.bp.submitted) == 1
    rig.bp.beacon += BEACON
    rig.update()
    rig.wait(100)
    assert len(rig.bp.submitted) == 1


@pytest.mark.req("VD-RUN-02")
def test_the_buffer_is_checked_in_every_period() -> None:
    rig = Rig(buffer_check_period_ms=20)
    rig.create()
    # The request itself asks BP, too.
    rig.bp.queries = 0
    assert rig.vardis.poll_timeout() == 20 * MS
    rig.vardis.handle_timeout(20 * MS - 1, WALL)
    assert rig.bp.queries == 0
    rig.wait(20)
    assert len(rig.bp.submitted) == 1
    rig.wait(100)
    assert (rig.bp.queries, len(rig.bp.submitted)) == (6, 1)  # BP still holds it
    rig.bp.take()
    rig.bp.query_status = BPStatus.UNKNOWN_PROTOCOL
    rig.wait(20)
    assert len(rig.bp.submitted) == 1
    rig.bp.query_status = BPStatus.OK
    rig.wait(20)
    assert len(rig.bp.submitted) == 2


@pytest.mark.req("VD-RUN-02")
@pytest.mark.req("VD-PAR-01")
@pytest.mark.req("VD-PAR-08")
def test_a_new_period_counts_from_the_last_check() -> None:
    rig = Rig(buffer_check_period_ms=1000, scrubbing_period_ms=60000)
    rig.wait(1000)
    rig.wait(100)
    rig.vardis.set_parameter("VARDISPAR_BUFFER_CHECK_PERIOD", 150)
    assert rig.vardis.poll_timeout() == 1150 * MS
    rig.wait(1000)
    assert rig.bp.queries == 1 + 7


@pytest.mark.req("VD-RUN-02")
def test_late_timeouts_keep_the_phase() -> None:
    rig = Rig(buffer_check_period_ms=20)
    rig.vardis.handle_timeout(90 * MS, WALL)
    assert (rig.bp.queries, rig.vardis.poll_timeout()) == (1, 100 * MS)


@pytest.mark.req("VD-SCR-01")
def test_late_scrubbing_keeps_its_phase() -> None:
    rig = Rig(buffer_check_period_ms=65000)
    rig.vardis.handle_timeout(4700 * MS, WALL)
    assert rig.vardis.poll_timeout() == 5000 * MS


@pytest.mark.req("VD-PAR-01")
@pytest.mark.req("VD-PAR-05")
def test_a_larger_payload_is_registered_when_the_buffer_is_empty() -> None:
    rig = Rig(max_payload_size=100, max_description_length=8)
    for var_id in range(1, 6):
        rig.create(var_id, bytes(20), rep_cnt=2)
    rig.wait(60)
    held = rig.bp.slot
    rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 300)
    rig.wait(100)
    assert rig.bp.slot == held
    assert rig.bp.registration[2] == 100
    assert len(rig.sent()[0].records) == 5
    assert rig.bp.registration[2] == 300
    rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 60)
    assert len(rig.sent()[0].records) == 1
    assert rig.bp.registration[2] == 300


def test_a_registration_that_bp_refuses_leaves_the_old_one() -> None:
    rig = Rig(max_payload_size=100, max_description_length=8)
    rig.create(1)
    rig.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", 300)
    rig.bp.refuse = [BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE]
    assert rig.count(VarCreate, 1, payloads=1) == 1
    assert rig.bp.registrations[-1][2] == 100
    rig.bp.refuse = [BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE] * 2
    rig.vardis.payload_transmitted(rig.now, rig.wall)
    rig.vardis.check_invariants()
    assert not rig.vardis.active


# -- scrubbing --------------------------------------------------------------------------------------------------


@pytest.mark.req("VD-SCR-01")
@pytest.mark.req("VD-SCR-03")
@pytest.mark.req("VD-SCR-04")
@pytest.mark.req("VD-INI-06")
@pytest.mark.parametrize("x27", ["strictly-greater", "at-least"])
def test_the_timeout_is_strict(x27: str) -> None:
    rig = Rig(scrubbing_period_ms=50, readings={"X27": x27})
    rig.create(timeout=100)
    rig.wait(99)
    assert not rig.entry().is_deleted
    rig.wait(1)
    assert rig.entry().is_deleted == (x27 == "at-least")
    rig.wait(49)
    assert rig.entry().is_deleted == (x27 == "at-least")
    rig.wait(1)
    assert rig.entry().is_deleted
    assert rig.changes()[-1] == ("deleted", 7)


@pytest.mark.req("VD-SCR-03")
@pytest.mark.parametrize(("late_ns", "deleted"), [(-1, False), (0, False), (1, True)])
def test_the_age_is_compared_in_ns(late_ns: int, deleted: bool) -> None:
    rig = Rig()
    rig.now = 7
    rig.create(timeout=1000)
    rig.vardis.handle_timeout(7 + 1000 * MS + late_ns, rig.wall)
    assert rig.entry().is_deleted == deleted


@pytest.mark.req("VD-SCR-02")
@pytest.mark.req("VD-TYP-04")
def test_variables_without_timeout_stay_for_ever() -> None:
    rig = Rig(buffer_check_period_ms=65000)
    rig.create(1, timeout=0)
    rig.create(2, timeout=1)
    rig.delete(2)
    rig.drain()
    rig.wait(3_600_000)
    assert not rig.entry(1).is_deleted
    assert rig.entry(2).count_delete == 0


@pytest.mark.req("VD-SCR-04")
@pytest.mark.req("VD-SCR-05")
def test_every_node_scrubs_and_notifies_clients() -> None:
    rig = Rig(scrubbing_period_ms=50)
    rig.receive(rig.vc(timeout=60))
    rig.receive(VarSumm(7, 3), VarUpdate(7, 1, b"v"))
    rig.wait(100)
    assert rig.entry().is_deleted
    assert not any(rig.queue(name) for name in ("createQ", "updateQ", "summaryQ", "reqUpdQ", "reqCreateQ"))
    rig.bp.take()  # composed before
    assert rig.count(VarDelete) == 2


@pytest.mark.req("VD-SCR-06")
def test_updates_keep_a_variable_alive_and_other_records_do_not() -> None:
    rig = Rig(scrubbing_period_ms=50)
    rig.receive(rig.vc(timeout=200))
    for seqno in range(1, 30):
        rig.wait(100)
        rig.receive(VarUpdate(7, seqno, b"v"))
    assert not rig.entry().is_deleted
    for _ in range(4):
        rig.wait(100)
        rig.receive(VarUpdate(7, 29, b"v"), VarSumm(7, 29), VarUpdate(7, 28, b"v"))
    assert rig.entry().is_deleted


@pytest.mark.req("VD-SCR-03")
def test_a_step_of_the_wall_clock_ages_nothing() -> None:
    rig = Rig(scrubbing_period_ms=50)
    rig.create(timeout=1000)
    rig.wall_offset += 10**15
    rig.wait(500)
    assert not rig.entry().is_deleted
    rig.wall_offset -= 10**16
    rig.wait(600)
    assert rig.entry().is_deleted


@pytest.mark.req("VD-SCR-01")
def test_scrubbing_continues_while_inactive() -> None:
    rig = Rig()
    rig.create(timeout=10)
    rig.vardis.deactivate()
    rig.wait(1000)
    assert rig.vardis.snapshot()["variables"][7]["isDeleted"]


@pytest.mark.parametrize("version", VERSIONS[:-1])
def test_nothing_is_scrubbed_before_2_0(version: str) -> None:
    rig = Rig(version, buffer_check_period_ms=65000)
    rig.create()
    assert rig.vardis.poll_timeout() == 65000 * MS
    rig.wait(10**6)
    assert rig.read() == b"ABCD"
