"""SRP requirement by requirement, in virtual time, over all versions of the specification."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import pytest
from dcp_lab.testing import strategies
from dcp_spec.constants import BP_PROTID_SRP, QueueingMode
from dcp_spec.parameters import UnknownParameterError, Violation
from dcp_spec.status import BPStatus, SRPStatus
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec.codec import get_codec
from dcp_codec.errors import EncodeError
from dcp_codec.values import ExtendedSafetyData
from dcp_stack.config import MS, NodeConfig, SRPConfig
from dcp_stack.effects import Dropped, NeighbourExpired, NeighbourSeen
from dcp_stack.positions.fields import FieldError
from dcp_stack.srp.entity import TIMEOUT, NotInitializedError, StateReporting

from ...parts import every

OWN = bytes.fromhex("0200000000aa")
OTHER = bytes.fromhex("0200000000bb")
THIRD = bytes.fromhex("0200000000cc")
TEXT = {OWN: b"02:00:00:00:00:aa", OTHER: b"02:00:00:00:00:bb", THIRD: b"02:00:00:00:00:cc"}
WALL = 1_700_000_000 * 10**9

VERSIONS = ["dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0"]
PROFILES = [*VERSIONS, "cpp-1.3", "cpp-2.0", "sim-2.0", "student-2024"]


@dataclass
class Confirm:
    status: BPStatus
    own_node_identifier: bytes | None = None


@dataclass
class FakeBP:
    """Keeps what was asked; ``answer`` is the status of transmissions, ``refuse`` that of registrations."""

    node_id: bytes | None
    answer: BPStatus = BPStatus.OK
    refuse: BPStatus = BPStatus.OK
    calls: list[str] = field(default_factory=list)
    registration: tuple | None = None
    sent: list[bytes] = field(default_factory=list)

    def register(self, *arguments, now, wall):
        self.calls.append("register")
        if self.refuse is BPStatus.OK:
            self.registration = arguments
        return Confirm(self.refuse, self.node_id)

    def deregister(self, prot_id):
        self.calls.append("deregister")
        assert prot_id == BP_PROTID_SRP
        known, self.registration = self.registration is not None, None
        return Confirm(BPStatus.OK if known else BPStatus.UNKNOWN_PROTOCOL)

    def query_number_buffered(self, prot_id):
        assert prot_id == BP_PROTID_SRP
        return Confirm(BPStatus.UNKNOWN_PROTOCOL if self.registration is None else BPStatus.OK)

    def transmit_payload(self, prot_id, payload, *, now):
        assert prot_id == BP_PROTID_SRP
        if self.registration is None:
            return Confirm(BPStatus.UNKNOWN_PROTOCOL)
        self.sent.append(payload)
        return Confirm(self.answer)


class Bench:
    """One SRP with a fake BP below it."""

    def __init__(self, profile="dcp-2.0", *, started=True, bp_knows_id=True, readings=None, **settings):
        self.codec = get_codec(profile)
        self.text = self.codec.profile.types.node_id.length is not None
        self.own = self.id(OWN)
        self.bp = FakeBP(self.own if bp_knows_id else None)
        self.effects = []
        config = NodeConfig(node_id=self.own, codec=self.codec, srp=SRPConfig(**settings), readings=readings or {})
        self.srp = StateReporting(config, self.bp, emit=self.effects.append, now=0, wall=WALL)
        if started:
            assert self.srp.start(0, WALL) is BPStatus.OK

    def id(self, octets):
        return TEXT[octets] if self.text else octets

    def data(self, first=1):
        names = [f.name for f in self.codec.profile.srp.safety_data]
        return {name: first + number for number, name in enumerate(names)}

    def update(self, first=1, *, now=0, wall=WALL):
        return self.srp.update_safety_data(self.data(first), now=now, wall=wall)

    def sent(self):
        return [self.codec.decode_report(payload) for payload in self.bp.sent]

    def report(self, node=OTHER, *, first=1, stamp=0, seqno=0):
        data = self.codec.safety_data_type(**self.data(first))
        return self.codec.encode_report(ExtendedSafetyData(data, self.id(node), stamp, seqno))

    def receive(self, payload, *, sender=OTHER, now=0, wall=WALL):
        self.srp.handle_payload(payload, self.id(sender), now=now, wall=wall)

    def take(self):
        taken, self.effects[:] = self.effects[:], []
        return taken


@pytest.fixture(params=PROFILES)
def bench(request):
    return Bench(request.param)


# -- initialization, shutdown --------------------------------------------------------------------------------------


@pytest.mark.req("SRP-INI-01")
@pytest.mark.req("SRP-INI-02")
@pytest.mark.req("SRP-INI-03")
@pytest.mark.req("SRP-TYP-07")
def test_registration(bench):
    version = bench.codec.profile.spec_version
    prot_id, name, size, mode, entries, multiple = bench.bp.registration
    assert prot_id == BP_PROTID_SRP == 1
    assert name == f"SRP -- State Reporting Protocol V{version}"
    assert size == len(bench.report(OWN))
    assert mode is (QueueingMode.ONCE if version >= "1.3" else QueueingMode.REPEAT)
    assert (entries, multiple) == (1, False)


@pytest.mark.req("SRP-INI-02")
def test_the_margin_of_a_profile_is_registered():
    codec = get_codec("cpp-2.0")
    limits = msgspec.structs.replace(codec.profile.limits, max_srp_payload=100)
    profile = msgspec.structs.replace(codec.profile, limits=limits)
    bp = FakeBP(OWN)
    config = NodeConfig(node_id=OWN, codec=type(codec)(profile))
    StateReporting(config, bp, emit=print, now=0, wall=0).start(0, 0)
    assert bp.registration[2] == 100


@pytest.mark.req("SRP-INI-04")
def test_a_former_registration_is_deregistered_first():
    bench = Bench(started=False)
    bench.bp.registration = ("left over",)
    assert bench.srp.start(0, WALL) is BPStatus.OK
    assert bench.bp.calls == ["deregister", "register"]


@pytest.mark.req("SRP-INI-05")
def test_a_start_clears_the_state():
    bench = Bench()
    bench.update()
    bench.update()
    bench.receive(bench.report())
    bench.srp.shutdown()
    bench.srp.start(5, WALL)
    assert len(bench.srp.neighbours) == 0
    assert bench.srp.own_motion() is None
    bench.update()
    assert [report.seqno for report in bench.sent()] == [0, 1, 0]


@pytest.mark.req("SRP-INI-06")
@pytest.mark.parametrize("profile", VERSIONS)
def test_the_own_id_is_that_of_the_confirm(profile):
    bench = Bench(profile, started=False)
    bench.bp.node_id = THIRD
    bench.srp.start(0, WALL)
    bench.update()
    assert bench.sent()[0].node_id == THIRD
    bench.receive(bench.report(THIRD))
    assert bench.take() == [Dropped("srp", "own-report", "SRP-RX-02", 24)]


def test_without_an_id_in_the_confirm_the_configured_one_counts():
    bench = Bench("dcp-1.0", bp_knows_id=False)
    bench.update()
    assert bench.sent()[0].node_id == OWN


@pytest.mark.req("SRP-INI-07")
@pytest.mark.req("SRP-SRV-01")
def test_nothing_works_before_the_start(bench):
    fresh = Bench(bench.codec.profile.name, started=False)
    assert fresh.update().status is SRPStatus.INACTIVE
    with pytest.raises(NotInitializedError):
        _ = fresh.srp.neighbours
    fresh.receive(fresh.report())
    assert [effect.reason for effect in fresh.effects] == ["inactive"]
    assert fresh.bp.sent == []
    assert fresh.srp.snapshot()["neighbours"] == []


@pytest.mark.req("SRP-SRV-01")
def test_a_refused_registration_leaves_srp_inactive():
    bench = Bench(started=False)
    bench.bp.refuse = BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
    assert bench.srp.start(0, WALL) is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
    assert not bench.srp.registered
    assert bench.update().status is SRPStatus.INACTIVE


@pytest.mark.req("SRP-SRV-01")
def test_a_restart_of_bp_is_noticed():
    bench = Bench()
    bench.bp.registration = None
    assert bench.update().status is SRPStatus.INACTIVE
    assert bench.bp.sent == []
    assert bench.srp.start(0, WALL) is BPStatus.OK
    assert bench.update().status is SRPStatus.OK


@pytest.mark.req("SRP-INI-07")
def test_under_the_other_reading_there_is_no_response_before_the_start():
    bench = Bench(started=False, readings={"X10": "no-response"})
    assert bench.update() is None
    bench.srp.start(0, WALL)
    assert bench.update().status is SRPStatus.OK


@pytest.mark.req("SRP-SHD-01")
def test_shutdown(bench):
    bench.receive(bench.report())
    bench.srp.shutdown()
    assert bench.bp.registration is None
    assert bench.update().status is SRPStatus.INACTIVE
    assert bench.srp.poll_timeout() is None
    with pytest.raises(NotInitializedError):
        _ = bench.srp.neighbours


def test_a_profile_without_reports_is_refused():
    with pytest.raises(ValueError, match=r"sim-1\.0 has no octets"):
        Bench("sim-1.0")


# -- services ------------------------------------------------------------------------------------------------------


@pytest.mark.req("SRP-SRV-02")
@pytest.mark.req("SRP-SRV-03")
@pytest.mark.req("SRP-TYP-03")
@pytest.mark.req("SRP-TYP-04")
@pytest.mark.req("SRP-FMT-01")
def test_an_update_is_one_report(bench):
    assert bench.update().status is SRPStatus.OK
    (payload,) = bench.bp.sent
    assert len(payload) == bench.bp.registration[2]
    report = bench.codec.decode_report(payload)
    assert report.node_id == bench.own
    assert report.s_data.as_dict() == bench.data()


@pytest.mark.req("SRP-SRV-02")
def test_safety_data_may_be_a_value_of_the_codec(bench):
    bench.srp.update_safety_data(bench.codec.safety_data_type(**bench.data(4)), now=0, wall=WALL)
    assert bench.sent()[0].s_data.as_dict() == bench.data(4)


@pytest.mark.req("SRP-SRV-03")
@pytest.mark.parametrize("answer", [BPStatus.PAYLOAD_TOO_LARGE, BPStatus.EMPTY_PAYLOAD])
def test_the_status_is_ok_whatever_bp_answers(answer):
    bench = Bench()
    bench.bp.answer = answer
    assert bench.update().status is SRPStatus.OK
    assert bench.update().status is SRPStatus.OK


@pytest.mark.req("SRP-SRV-03")
def test_bp_need_not_confirm():
    bench = Bench()
    bench.bp.transmit_payload = lambda *arguments, now: None
    assert bench.update().status is SRPStatus.OK


@pytest.mark.req("SRP-SRV-04")
@pytest.mark.req("SRP-SEQ-01")
@pytest.mark.req("SRP-TYP-06")
def test_every_update_is_counted(bench):
    for number in range(5):
        bench.update(number)
    assert [report.seqno for report in bench.sent()] == [0, 1, 2, 3, 4]


@pytest.mark.req("SRP-SEQ-01")
@pytest.mark.req("SRP-TYP-01")
def test_the_sequence_number_wraps(bench):
    bench.srp._seqno = 2**32 - 1
    bench.update()
    bench.update()
    assert [report.seqno for report in bench.sent()] == [2**32 - 1, 0]


@pytest.mark.req("SRP-TYP-05")
@pytest.mark.parametrize("profile", VERSIONS)
def test_the_stamp_is_the_time_of_the_update(profile):
    bench = Bench(profile)
    bench.update(wall=WALL + 123_456_789)
    assert bench.sent()[0].t_stamp == WALL + 123_456_789


@pytest.mark.req("SRP-TYP-05")
def test_simulation_stamps_count_from_the_creation_of_the_node():
    bench = Bench("sim-2.0")
    bench.update(wall=WALL + 5)
    assert bench.sent()[0].t_stamp == 5_000


@pytest.mark.req("SRP-TYP-02")
@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(data=st.data())
def test_all_reports_have_one_size(profile, data):
    bench = Bench(profile)
    for _ in range(2):
        report = data.draw(strategies.reports(bench.codec))
        bench.srp.update_safety_data(report.s_data, now=0, wall=WALL)
    assert {len(payload) for payload in bench.bp.sent} == {bench.bp.registration[2]}


@pytest.mark.parametrize(
    ("data", "error", "words"),
    [
        ({"x": 1, "y": 2}, FieldError, "needs z"),
        ({"x": 1, "y": 2, "z": 3, "zz": 4}, FieldError, "'zz'"),
        ({"x": 1, "y": 2, "z": "3"}, FieldError, "takes a number"),
        ({"x": 1, "y": 2, "position.z": 3}, FieldError, "called 'z'"),
    ],
)
def test_misuse_raises_and_changes_nothing(data, error, words):
    bench = Bench()
    with pytest.raises(error, match=words):
        bench.srp.update_safety_data(data, now=0, wall=WALL)
    wrong = get_codec("sim-2.0").safety_data_type(*range(6))
    with pytest.raises(EncodeError):
        bench.srp.update_safety_data(wrong, now=0, wall=WALL)
    bench.update()
    assert [report.seqno for report in bench.sent()] == [0]


def test_own_motion_is_estimated_where_it_is_not_reported():
    bench = Bench("cpp-2.0")
    assert bench.srp.own_motion() is None
    bench.update(0)
    assert bench.srp.own_motion().velocity is None
    bench.update(10, now=2 * 10**9)
    motion = bench.srp.own_motion()
    assert (motion.position, motion.velocity) == ((10, 11, 12), (5, 5, 5))
    bench = Bench("sim-2.0")
    bench.update(1)
    assert bench.srp.own_motion().velocity == (4, 5, 6)


# -- parameters and runtime ----------------------------------------------------------------------------------------


@pytest.mark.req("SRP-PAR-01")
def test_the_timeout_parameter():
    srp = Bench().srp
    assert srp.parameters() == {TIMEOUT: 3000}
    assert srp.set_parameter(TIMEOUT, 250.5) is None
    assert srp.parameters() == {TIMEOUT: 250.5}
    for wrong in (0, -1, "3", float("nan"), True):
        assert isinstance(srp.set_parameter(TIMEOUT, wrong), Violation)
    assert srp.parameters() == {TIMEOUT: 250.5}
    with pytest.raises(UnknownParameterError):
        srp.set_parameter("BPPAR_BEACON_PERIOD", 3)
    with pytest.raises(ValueError, match=TIMEOUT):
        Bench(neighbour_table_timeout_ms=0)


def run(bench, until, *, late=0):
    """Call handle_timeout as a driver would, ``late`` ns after it is due; returns when the neighbour was dropped."""
    traversals, dropped = [], {}
    while (due := bench.srp.poll_timeout()) is not None and due + late <= until:
        bench.srp.handle_timeout(due + late, WALL)
        traversals.append(due + late)
        for effect in bench.take():
            if isinstance(effect, NeighbourExpired):
                dropped[effect.node_id] = due + late
    return traversals, dropped


@pytest.mark.req("SRP-RUN-01")
@pytest.mark.req("SRP-RUN-02")
@pytest.mark.req("SRP-PAR-01")
@pytest.mark.req("SRP-PAR-02")
@pytest.mark.parametrize("timeout_ms", [1, 300, 3000])
def test_a_silent_neighbour_is_dropped_in_time(bench, timeout_ms):
    bench = Bench(bench.codec.profile.name, neighbour_table_timeout_ms=timeout_ms)
    bench.receive(bench.report(), now=0)
    traversals, dropped = run(bench, 10 * timeout_ms * MS)
    timeout = timeout_ms * MS
    assert timeout < dropped[bench.id(OTHER)] <= timeout + timeout // 5
    assert len([time for time in traversals if time <= timeout]) >= 5
    assert bench.srp.poll_timeout() is None
    assert bench.srp.neighbours.lookup(bench.id(OTHER)) is None


@pytest.mark.req("SRP-RUN-01")
@given(
    st.lists(st.integers(0, 400 * MS), max_size=20),
    st.integers(0, 90 * MS),
)
def test_five_traversals_in_every_interval_even_when_called_late(gaps, late):
    bench = Bench()
    now, traversals = 0, []
    bench.receive(bench.report(), now=0)
    for gap in gaps:
        done, _ = run(bench, now + gap, late=late)
        traversals += done
        now += gap
        bench.receive(bench.report(), now=now)
    last = now
    traversals += run(bench, now + 4000 * MS, late=late)[0]
    for start in range(0, last, 50 * MS):
        assert len([time for time in traversals if start < time <= start + 3000 * MS]) >= 5


@pytest.mark.req("SRP-RUN-02")
def test_exactly_the_timeout_is_not_too_old():
    bench = Bench()
    bench.receive(bench.report(), now=0)
    bench.srp.handle_timeout(3000 * MS, WALL)
    assert len(bench.srp.neighbours) == 1
    bench.srp._traversed = 0
    bench.srp.handle_timeout(3000 * MS + 1, WALL)
    assert len(bench.srp.neighbours) == 0


@pytest.mark.req("SRP-RUN-02")
@pytest.mark.parametrize("stamp", [0, WALL - 10**15, WALL + 10**15])
def test_the_stamp_of_the_sender_does_not_matter(stamp):
    bench = Bench()
    bench.receive(bench.report(stamp=stamp), now=0)
    _, dropped = run(bench, 9000 * MS)
    assert dropped == {OTHER: 3500 * MS}


@pytest.mark.req("SRP-RUN-02")
def test_a_step_of_the_wall_clock_does_not_matter():
    bench = Bench()
    bench.receive(bench.report(), now=0, wall=WALL)
    bench.srp.handle_timeout(600 * MS, WALL + 10**15)
    assert len(bench.srp.neighbours) == 1


@pytest.mark.req("SRP-RUN-02")
def test_reports_keep_a_neighbour_alive():
    bench = Bench()
    for second in range(10):
        bench.receive(bench.report(seqno=second), now=second * 1000 * MS)
        assert run(bench, second * 1000 * MS)[1] == {}
    assert len(bench.srp.neighbours) == 1


def test_a_call_for_another_reason_traverses_from_half_the_interval_on():
    bench = Bench()
    bench.receive(bench.report(), now=0)
    assert bench.srp.poll_timeout() == 500 * MS
    bench.srp.handle_timeout(250 * MS - 1, WALL)
    assert bench.srp.poll_timeout() == 500 * MS
    bench.srp.handle_timeout(250 * MS, WALL)
    assert bench.srp.poll_timeout() == 750 * MS


def test_srp_needs_no_timer_if_called_for_each_beacon():
    bench = Bench()
    bench.receive(bench.report(), now=0)
    for beacon in range(1, 30):
        assert bench.srp.poll_timeout() > beacon * 100 * MS
        bench.srp.handle_timeout(beacon * 100 * MS, WALL)


def test_a_shorter_timeout_holds_at_once():
    bench = Bench()
    bench.receive(bench.report(), now=0)
    bench.srp.set_parameter(TIMEOUT, 60)
    assert bench.srp.poll_timeout() == 10 * MS


def test_there_is_nothing_to_do_without_neighbours(bench):
    assert bench.srp.poll_timeout() is None
    bench.srp.handle_timeout(10**12, WALL)
    assert bench.effects == []


# -- receive path --------------------------------------------------------------------------------------------------


@pytest.mark.req("SRP-RX-01")
def test_other_lengths_are_ignored(bench):
    good = bench.report()
    for wrong in (b"", b"\0", good[:-1], good + b"\0", good * 2):
        bench.receive(wrong)
        (effect,) = bench.take()
        assert (effect.layer, effect.reason, effect.requirement) == ("srp", "wrong-length", "SRP-RX-01")
    assert len(bench.srp.neighbours) == 0


@pytest.mark.req("SRP-RX-02")
@pytest.mark.req("SRP-NT-03")
def test_own_reports_are_ignored(bench):
    bench.receive(bench.report(OWN), sender=OTHER)
    (effect,) = bench.take()
    assert (effect.reason, effect.requirement) == ("own-report", "SRP-RX-02")
    # The offset is that of the field; a text starts with its length.
    start = effect.offset + 4 * bench.text
    assert bench.report(OWN)[start : start + len(bench.own)] == bench.own
    assert bench.srp.neighbours.list_all_node_ids() == []


@pytest.mark.req("SRP-RX-03")
@pytest.mark.req("SRP-NT-01")
def test_a_report_is_inserted_and_replaced(bench):
    node = bench.id(OTHER)
    bench.receive(bench.report(first=1, seqno=0), now=10, wall=WALL)
    bench.receive(bench.report(first=5, seqno=1), now=20, wall=WALL + 7)
    assert bench.take() == [NeighbourSeen(node, True), NeighbourSeen(node, False)]
    entry = bench.srp.neighbours.lookup(node)
    assert entry.ext_sd.s_data.as_dict() == bench.data(5)
    assert (entry.node_id, entry.reception_time, entry.received_at) == (node, WALL + 7, 20)
    assert bench.srp.neighbours.lookup(bench.id(THIRD)) is None


@pytest.mark.req("SRP-RX-04")
def test_a_lower_sequence_number_replaces(bench):
    bench.receive(bench.report(first=1, seqno=100))
    bench.receive(bench.report(first=5, seqno=5))
    entry = bench.srp.neighbours.lookup(bench.id(OTHER))
    assert (entry.ext_sd.seqno, entry.restarts, entry.lost) == (5, 1, 0)


@pytest.mark.req("SRP-RX-05")
def test_the_key_is_the_node_of_the_report(bench):
    bench.receive(bench.report(THIRD), sender=OTHER)
    assert bench.srp.neighbours.list_all_node_ids() == [bench.id(THIRD)]
    assert bench.srp.neighbours.lookup(bench.id(THIRD)).sender_id == bench.id(OTHER)


@pytest.mark.req("SRP-RX-06")
def test_nothing_received_is_sent(bench):
    for seqno in range(3):
        bench.receive(bench.report(seqno=seqno))
    run(bench, 10**10)
    assert bench.bp.sent == []
    bench.update()
    assert {report.node_id for report in bench.sent()} == {bench.own}


@pytest.mark.req("SRP-RX-03")
def test_a_full_table_drops_an_old_neighbour_with_a_notification():
    bench = Bench(max_neighbours=2)
    nodes = [bytes([2, 0, 0, 0, 1, number]) for number in range(3)]
    for each in nodes:
        bench.receive(bench.report(each))
    assert bench.take()[-3:] == [
        NeighbourExpired(nodes[0]),
        Dropped("srp", "table-full", "SRP-RX-03", 24),
        NeighbourSeen(nodes[2], True),
    ]
    assert sorted(bench.srp.neighbours.list_all_node_ids()) == nodes[1:]


@pytest.mark.parametrize(
    ("profile", "given", "effective"), [("cpp-2.0", None, 1000), ("cpp-2.0", 5000, 5000), ("dcp-2.0", None, 4096)]
)
def test_the_shown_limit_is_the_effective_one(profile, given, effective):
    """The value of the user is used unchanged; the limit of the profile is a default."""
    bench = Bench(profile, max_neighbours=given)
    assert bench.srp.neighbours.capacity == bench.srp.snapshot()["max_neighbours"] == effective


# -- totality ------------------------------------------------------------------------------------------------------


@pytest.mark.req("SRP-RX-01")
@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(data=st.data())
def test_no_octets_raise(profile, data):
    bench = Bench(profile, max_neighbours=3)
    valid = strategies.reports(bench.codec).map(bench.codec.encode_report)
    octets = st.one_of(valid, strategies.mutations(valid), st.binary(max_size=80))
    now = 0
    for payload in data.draw(st.lists(octets, max_size=6)):
        now += data.draw(st.integers(0, 2 * 10**9))
        bench.srp.handle_payload(payload, b"", now=now, wall=WALL + now)
        bench.srp.handle_timeout(now, WALL + now)
        assert len(bench.take()) >= 1
    table = bench.srp.neighbours
    assert len(table) <= 3
    assert bench.own not in table
    msgspec.json.encode(bench.srp.snapshot())
    bench.update()
    bench.srp.own_motion()
    for entry in table:
        table.motion(entry)
        table.delay(entry)


@pytest.mark.parametrize("profile", every(4, PROFILES))
@given(data=st.data())
def test_valid_reports_are_stored_unchanged(profile, data):
    bench = Bench(profile)
    report = data.draw(strategies.reports(bench.codec).filter(lambda each: each.node_id != bench.own))
    bench.srp.handle_payload(bench.codec.encode_report(report), b"", now=0, wall=WALL)
    found = bench.srp.neighbours.lookup(report.node_id).ext_sd
    assert bench.codec.encode_report(found) == bench.codec.encode_report(report)
