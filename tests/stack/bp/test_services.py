"""The services of BP: every status and the order of the checks, in every version that has the service."""

from __future__ import annotations

import msgspec
import pytest
from dcp_spec.status import BPStatus

from dcp_codec.codec import Codec, get_codec
from dcp_stack.bp.services import Registration, UnknownServiceError

from ..bp_rig import (
    DROPHEAD,
    DROPTAIL,
    ME,
    MS,
    OK,
    ONCE,
    PROFILES,
    QUEUE,
    REPEAT,
    SINCE_1_1,
    SINCE_1_2,
    VERSIONS,
    WALL,
    Rig,
)

MODES = [
    (version, mode)
    for version in VERSIONS
    for mode in ((QUEUE, ONCE, REPEAT) if version == "1.0" else (DROPTAIL, DROPHEAD, ONCE, REPEAT))
]
SINCE_1_1_MODES = [(version, mode) for version, mode in MODES if version != "1.0"]


def largest(rig: Rig) -> int:
    """The bound on maxPayloadSize of the version."""
    return 1500 - (4 + (4 if rig.config.profile.spec_version == "1.0" else rig.header))


# -- BP-RegisterProtocol ------------------------------------------------------------------------------------------


@pytest.mark.req("BP-REG-01")
@pytest.mark.req("BP-REG-06")
@pytest.mark.req("BP-REG-08")
@pytest.mark.parametrize(("version", "mode"), MODES)
def test_registration_stores_a_fresh_entry(version, mode):
    rig = Rig(version)
    assert rig.register(7, mode).status is OK
    assert [entry.protocol_id for entry in rig.bp.list_registered().protocols] == [7]
    assert rig.number() == 0
    assert rig.effects == []


@pytest.mark.req("BP-REG-02")
@pytest.mark.parametrize("version", VERSIONS)
def test_a_second_registration_is_refused_and_changes_nothing(version):
    rig = Rig(version)
    rig.register(7, ONCE, size=10, name="first")
    rig.submit(b"kept")
    before = rig.bp.list_registered()
    assert rig.register(7, REPEAT, size=20, name="second").status is BPStatus.PROTOCOL_ALREADY_REGISTERED
    assert rig.bp.list_registered() == before
    assert rig.number() == 1


@pytest.mark.req("BP-REG-03")
@pytest.mark.parametrize("size", [0, -1])
@pytest.mark.parametrize("version", SINCE_1_1)
def test_sizes_that_are_not_positive_are_refused(version, size):
    rig = Rig(version)
    assert rig.register(size=size).status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
    assert rig.bp.list_registered().protocols == ()


def test_1_0_lets_a_client_register_that_never_sends():
    rig = Rig("1.0")
    assert rig.register(size=0).status is OK
    assert rig.register(8, size=-1).status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE


@pytest.mark.req("BP-REG-04")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_largest_payload_of_a_registration(version):
    rig = Rig(version)
    assert rig.register(7, size=largest(rig)).status is OK
    assert rig.register(8, size=largest(rig) + 1).status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE


@pytest.mark.req("BP-REG-04")
def test_the_bound_follows_the_parameter():
    rig = Rig()
    rig.bp.set_parameter("BPPAR_MAXIMUM_PACKET_SIZE", 122)
    assert rig.register(7, size=101).status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
    assert rig.register(7, size=100).status is OK


def test_a_registration_is_bounded_by_the_size_of_a_block():
    rig = Rig(profile="student-2024")
    assert rig.register(7, size=1000).status is OK
    assert rig.register(8, size=1001).status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE


def test_a_registration_is_bounded_by_the_length_field():
    codec = wide()
    rig = Rig(codec=codec)
    assert rig.register(7, size=0xFFFF).status is OK
    assert rig.register(8, size=0x10000).status is BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE


def wide() -> Codec:
    """A profile whose bearer takes more than a length field can say."""
    profile = get_codec("dcp-2.0").profile
    limits = msgspec.structs.replace(profile.limits, uwb_max_packet=100_000, max_beacon_size=100_000)
    return Codec(msgspec.structs.replace(profile, name="wide", limits=limits))


@pytest.mark.req("BP-REG-05")
@pytest.mark.parametrize("entries", [0, -1])
@pytest.mark.parametrize("mode", [DROPTAIL, DROPHEAD])
@pytest.mark.parametrize("version", SINCE_1_1)
def test_a_queue_needs_a_positive_length(version, mode, entries):
    rig = Rig(version)
    assert rig.register(7, mode, entries=entries).status is BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE
    assert rig.bp.list_registered().protocols == ()
    assert rig.register(7, mode, entries=1).status is OK


@pytest.mark.req("BP-QM-09")
@pytest.mark.parametrize("entries", [0, -5])
@pytest.mark.parametrize("mode", [ONCE, REPEAT])
@pytest.mark.parametrize("version", VERSIONS)
def test_buffers_ignore_max_entries(version, mode, entries):
    rig = Rig(version)
    assert rig.register(7, mode, entries=entries).status is OK
    assert rig.submit(b"A") is OK
    assert rig.contents(1) == [b"A"]


@pytest.mark.req("BP-REG-07")
@pytest.mark.parametrize("version", SINCE_1_1)
def test_the_confirm_contains_the_own_identifier(version):
    rig = Rig(version)
    assert rig.register().own_node_identifier == ME
    assert rig.register().own_node_identifier == ME, "the parameter is there whatever the status"
    rig.submit(b"A")
    assert rig.beacon().bp.sender_id == ME


def test_the_confirm_of_1_0_lacks_the_own_identifier():
    assert Rig("1.0").register().own_node_identifier is None


@pytest.mark.req("BP-REG-09")
@pytest.mark.req("DATA-11")
@pytest.mark.parametrize("version", SINCE_1_1)
def test_order_of_the_checks(version):
    rig = Rig(version)
    rig.register(7)
    too_large = largest(rig) + 1
    already, size = BPStatus.PROTOCOL_ALREADY_REGISTERED, BPStatus.ILLEGAL_MAX_PAYLOAD_SIZE
    assert rig.register(7, size=0).status is already
    assert rig.register(7, size=too_large).status is already
    assert rig.register(7, DROPTAIL, entries=0).status is already
    assert rig.register(7, "BP_QMODE_FIFTH").status is already
    assert rig.register(8, DROPTAIL, size=0, entries=0).status is size
    assert rig.register(8, DROPTAIL, size=too_large, entries=0).status is size
    assert rig.register(8, "BP_QMODE_FIFTH", size=0).status is size


@pytest.mark.req("BP-QM-06")
@pytest.mark.parametrize("mode", ["BP_QMODE_FIFTH", "", 4])
@pytest.mark.parametrize("version", VERSIONS)
def test_other_modes_are_refused(version, mode):
    rig = Rig(version)
    assert rig.register(7, mode).status is BPStatus.UNKNOWN_QUEUEING_MODE
    assert rig.bp.list_registered().protocols == ()


@pytest.mark.req("BP-QM-06")
@pytest.mark.parametrize(
    ("version", "mode"),
    [("1.0", DROPTAIL), ("1.0", DROPHEAD), *((version, QUEUE) for version in SINCE_1_1)],
)
def test_modes_of_other_versions_are_refused(version, mode):
    assert Rig(version).register(7, mode, entries=0).status is BPStatus.UNKNOWN_QUEUEING_MODE


def test_modes_can_be_given_by_name():
    rig = Rig()
    assert rig.register(7, "BP_QMODE_REPEAT").status is OK
    assert rig.bp.list_registered().protocols[0].queue_mode is REPEAT


@pytest.mark.req("BP-CLR-04")
@pytest.mark.parametrize("mode", ["BP_QMODE_FIFTH", 4, QUEUE])
@pytest.mark.parametrize("version", SINCE_1_1)
def test_reading_x06_registers_other_modes_and_reports_an_error_when_clearing(version, mode):
    rig = Rig(version, readings={"X06": "refuse-at-clear"})
    assert rig.register(7, mode).status is OK
    assert rig.bp.list_registered().protocols[0].queue_mode == mode
    assert rig.submit(b"A") is BPStatus.UNKNOWN_QUEUEING_MODE
    assert rig.submit(b"") is BPStatus.EMPTY_PAYLOAD
    assert rig.number() == 0
    assert rig.bp.clear_buffer(7).status is BPStatus.UNKNOWN_QUEUEING_MODE
    assert rig.tick() is None
    assert rig.bp.deregister(7).status is OK


@pytest.mark.req("BP-REG-10")
@pytest.mark.parametrize("version", VERSIONS)
def test_only_registered_clients_transmit_and_receive(version):
    rig = Rig(version)
    assert rig.submit(b"A") is BPStatus.UNKNOWN_PROTOCOL
    assert rig.reasons(rig.builder((7, b"A"))) == ["unregistered-protocol"]
    rig.register()
    assert rig.number() == 0
    assert rig.tick() is None
    assert rig.receive(rig.builder((7, b"A"))) == ([(7, b"A")], [])


# -- BP-DeregisterProtocol and BP-ListRegisteredProtocols ---------------------------------------------------------


@pytest.mark.req("BP-DRG-01")
@pytest.mark.req("BP-DRG-02")
@pytest.mark.parametrize("version", VERSIONS)
def test_deregistering_twice(version):
    rig = Rig(version)
    assert rig.bp.deregister(7).status is BPStatus.UNKNOWN_PROTOCOL
    rig.register(7)
    rig.register(8)
    assert rig.bp.deregister(7).status is OK
    assert [entry.protocol_id for entry in rig.bp.list_registered().protocols] == [8]
    assert rig.bp.deregister(7).status is BPStatus.UNKNOWN_PROTOCOL


@pytest.mark.req("BP-DRG-03")
@pytest.mark.req("BP-DRG-04")
@pytest.mark.parametrize(("version", "mode"), MODES)
def test_nothing_is_sent_or_delivered_after_deregistering(version, mode):
    rig = Rig(version)
    rig.register(7, mode)
    rig.submit(b"A")
    rig.bp.deregister(7)
    assert [rig.tick() for _ in range(3)] == [None] * 3
    assert rig.reasons(rig.builder((7, b"A"))) == ["unregistered-protocol"]


@pytest.mark.req("BP-DRG-05")
@pytest.mark.req("BP-REC-01")
@pytest.mark.parametrize(("version", "mode"), MODES)
def test_registering_again_starts_empty(version, mode):
    rig = Rig(version)
    rig.register(7, mode)
    rig.submit(b"old")
    rig.bp.deregister(7)
    assert rig.register(7, mode).status is OK
    assert rig.number() == 0
    assert rig.tick() is None
    rig.submit(b"new")
    assert rig.tick() == [(7, b"new")]


@pytest.mark.req("BP-INI-01")
@pytest.mark.req("DATA-10")
@pytest.mark.parametrize("profile", PROFILES)
def test_no_client_is_registered_at_the_start(profile):
    rig = Rig(profile=profile, node_id=b"02:00:00:00:00:01" if profile == "student-2024" else ME)
    confirm = rig.bp.list_registered()
    assert (confirm.status, confirm.protocols) == (OK, ())


@pytest.mark.req("BP-LST-01")
@pytest.mark.req("BP-LST-02")
@pytest.mark.parametrize("version", VERSIONS)
def test_the_list_contains_registered_clients(version):
    rig = Rig(version)
    mode = QUEUE if version == "1.0" else DROPHEAD
    rig.register(9, mode, size=50, entries=3, several=True, name="Grüße", wall=WALL + 5)
    rig.register(3, REPEAT, size=60, entries=0, name="", wall=WALL + 6)
    rig.submit(b"contents", 9)
    listed = rig.bp.list_registered()
    assert listed.status is OK
    assert listed.protocols == (
        Registration(9, "Grüße", 50, mode, WALL + 5, 3, True),
        Registration(3, "", 60, REPEAT, WALL + 6, 0, False),
    )
    assert msgspec.to_builtins(listed.protocols[0]) == {
        "protocolId": 9,
        "protocolName": "Grüße",
        "maxPayloadSize": 50,
        "queueMode": mode.value,
        "timeStampRegistration": WALL + 5,
        "maxEntries": 3,
        "allowMultiplePayloads": True,
    }


# -- BP-TransmitPayload -------------------------------------------------------------------------------------------


@pytest.mark.req("BP-TXP-01")
@pytest.mark.req("BP-TXP-08")
@pytest.mark.parametrize("version", VERSIONS)
def test_transmitting_unregistered(version):
    assert Rig(version).submit(b"A") is BPStatus.UNKNOWN_PROTOCOL


@pytest.mark.req("BP-TXP-02")
@pytest.mark.parametrize(("version", "mode"), MODES)
def test_a_payload_is_at_most_as_long_as_registered(version, mode):
    rig = Rig(version)
    rig.register(7, mode, size=10)
    assert rig.submit(bytes(11)) is BPStatus.PAYLOAD_TOO_LARGE
    assert rig.number() == 0
    assert rig.submit(bytes(10)) is OK
    assert rig.tick() == [(7, bytes(10))]


@pytest.mark.req("BP-TXP-03")
@pytest.mark.parametrize(("version", "mode"), SINCE_1_1_MODES)
def test_an_empty_payload_is_refused_and_changes_nothing(version, mode):
    rig = Rig(version)
    rig.register(7, mode)
    assert rig.submit(b"") is BPStatus.EMPTY_PAYLOAD
    rig.submit(b"A")
    assert rig.submit(b"") is BPStatus.EMPTY_PAYLOAD
    assert rig.number() == 1
    assert rig.tick() == [(7, b"A")]


@pytest.mark.parametrize("mode", [ONCE, REPEAT])
@pytest.mark.parametrize("profile", ["dcp-1.0", "sim-1.0"])
def test_an_empty_payload_clears_the_buffers_of_1_0(profile, mode):
    rig = Rig(profile=profile)
    rig.register(7, mode)
    assert rig.submit(b"") is OK
    rig.submit(b"A")
    assert rig.submit(b"") is OK
    assert rig.number() == 0
    assert rig.tick() is None


def test_an_empty_payload_is_refused_by_the_queue_of_1_0():
    rig = Rig("1.0")
    rig.register(7, QUEUE)
    rig.submit(b"A")
    assert rig.submit(b"") is BPStatus.EMPTY_PAYLOAD
    assert rig.number() == 1


@pytest.mark.req("BP-TXP-04")
@pytest.mark.req("BP-TXP-05")
@pytest.mark.req("BP-TXP-09")
@pytest.mark.parametrize("mode", [DROPTAIL, DROPHEAD])
@pytest.mark.parametrize("version", SINCE_1_1)
def test_a_full_queue_is_not_an_error(version, mode):
    rig = Rig(version)
    rig.register(7, mode, entries=2)
    assert [rig.submit(payload) for payload in (b"A", b"B", b"C", b"D")] == [OK] * 4
    assert rig.number() == 2
    assert rig.contents(3) == ([b"A", b"B", None] if mode is DROPTAIL else [b"C", b"D", None])


@pytest.mark.req("BP-TXP-06")
@pytest.mark.parametrize("mode", [ONCE, REPEAT])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_buffer_is_overwritten(version, mode):
    rig = Rig(version)
    rig.register(7, mode)
    assert (rig.submit(b"A"), rig.submit(b"B")) == (OK, OK)
    assert rig.number() == 1
    assert rig.tick() == [(7, b"B")]


@pytest.mark.req("BP-TXP-10")
@pytest.mark.parametrize("version", VERSIONS)
def test_order_of_the_checks_of_a_payload(version):
    rig = Rig(version)
    assert rig.submit(bytes(3000)) is BPStatus.UNKNOWN_PROTOCOL
    assert rig.submit(b"") is BPStatus.UNKNOWN_PROTOCOL
    if version == "1.0":
        rig.register(7, QUEUE, size=0)
        assert rig.submit(b"A") is BPStatus.PAYLOAD_TOO_LARGE
        assert rig.submit(b"") is BPStatus.EMPTY_PAYLOAD


def test_payloads_are_copied():
    rig = Rig()
    rig.register(7, REPEAT)
    payload = bytearray(b"A")
    rig.submit(payload)
    payload[:] = b"B"
    assert rig.tick() == [(7, b"A")]
    rig.submit(memoryview(b"C"))
    assert rig.tick() == [(7, b"C")]


# -- BP-ClearBuffer and BP-QueryNumberBufferedPayloads ------------------------------------------------------------


@pytest.mark.req("BP-CLR-01")
@pytest.mark.parametrize("version", SINCE_1_1)
def test_clearing_unregistered(version):
    assert Rig(version).bp.clear_buffer(7).status is BPStatus.UNKNOWN_PROTOCOL


@pytest.mark.req("BP-CLR-02")
@pytest.mark.req("BP-CLR-03")
@pytest.mark.parametrize(("version", "mode"), SINCE_1_1_MODES)
def test_clearing(version, mode):
    rig = Rig(version)
    rig.register(7, mode)
    assert rig.bp.clear_buffer(7).status is OK, "clearing nothing is not an error"
    rig.submit(b"A")
    rig.submit(b"B")
    assert rig.bp.clear_buffer(7).status is OK
    assert rig.number() == 0
    assert rig.contents(3) == [None] * 3
    rig.submit(b"C")
    assert rig.tick() == [(7, b"C")]


def test_1_0_cannot_clear():
    rig = Rig("1.0")
    rig.register()
    with pytest.raises(UnknownServiceError, match=r"BP-ClearBuffer exists since 1\.1"):
        rig.bp.clear_buffer(7)


@pytest.mark.req("BP-QRY-01")
@pytest.mark.parametrize("version", VERSIONS)
def test_querying_unregistered(version):
    confirm = Rig(version).bp.query_number_buffered(7)
    assert (confirm.status, confirm.number) == (BPStatus.UNKNOWN_PROTOCOL, None)


@pytest.mark.req("BP-QRY-02")
@pytest.mark.parametrize(("version", "mode"), [(v, m) for v, m in MODES if m.is_queue])
def test_the_number_in_a_queue(version, mode):
    rig = Rig(version)
    rig.register(7, mode, entries=3)
    numbers = [rig.number()]
    for payload in (b"A", b"B", b"C", b"D"):
        rig.submit(payload)
        numbers.append(rig.number())
    assert numbers == [0, 1, 2, 3, 4 if mode is QUEUE else 3]
    rig.tick()
    assert rig.number() == numbers[-1] - 1


@pytest.mark.req("BP-QRY-03")
@pytest.mark.req("BP-TX-05")
@pytest.mark.parametrize(("mode", "after"), [(ONCE, 0), (REPEAT, 1)])
@pytest.mark.parametrize("version", VERSIONS)
def test_the_number_in_a_buffer(version, mode, after):
    rig = Rig(version)
    rig.register(7, mode)
    assert rig.number() == 0
    rig.submit(b"A")
    assert rig.number() == 1
    rig.tick()
    assert rig.number() == after


# -- management ---------------------------------------------------------------------------------------------------


@pytest.mark.req("BP-MGT-01")
@pytest.mark.req("BP-MGT-02")
@pytest.mark.req("BP-MGT-05")
@pytest.mark.req("BP-TX-07")
@pytest.mark.parametrize("version", SINCE_1_2)
def test_an_inactive_node_is_silent(version):
    rig = Rig(version)
    rig.register(7, REPEAT)
    rig.submit(b"A")
    assert rig.tick() == [(7, b"A")]
    assert rig.bp.deactivate().status is OK
    assert rig.bp.deactivate().status is OK
    assert rig.bp.poll_timeout() is None
    for _ in range(10):
        rig.now += 100 * MS
        rig.bp.handle_timeout(rig.now, WALL)
    assert len(rig.sent()) == 1
    assert rig.bp.activate(rig.now).status is OK
    assert rig.bp.poll_timeout() > rig.now
    assert rig.beacon().bp.seqno == 1
    assert rig.receive(rig.builder((7, b"B"))) == ([(7, b"B")], [])


@pytest.mark.req("BP-MGT-03")
@pytest.mark.req("BP-RX-13")
@pytest.mark.parametrize("version", SINCE_1_2)
def test_payloads_received_while_inactive_are_lost(version):
    rig = Rig(version)
    rig.register(7)
    rig.bp.deactivate()
    assert rig.reasons(rig.builder((7, b"A"))) == ["inactive"]
    assert rig.reasons(b"garbage") == ["inactive"]
    before = len(rig.effects)
    rig.bp.activate(rig.now)
    rig.tick()
    assert len(rig.effects) == before


@pytest.mark.req("BP-MGT-04")
@pytest.mark.parametrize("version", SINCE_1_2)
def test_services_while_inactive(version):
    rig = Rig(version, triggered=True)
    rig.bp.deactivate()
    assert rig.register(7, DROPHEAD).status is OK
    assert rig.register(7).status is BPStatus.PROTOCOL_ALREADY_REGISTERED
    assert rig.submit(b"A") is OK
    assert rig.number() == 1
    assert rig.bp.clear_buffer(7).status is OK
    assert rig.number() == 0
    assert rig.submit(b"B") is OK
    assert rig.bp.set_parameter("BPPAR_BEACON_PERIOD", 50) is None
    assert rig.bp.list_registered().protocols[0].protocol_id == 7
    assert rig.bp.poll_timeout() is None
    rig.bp.activate(rig.now)
    assert rig.tick() == [(7, b"B")]
    rig.bp.deactivate()
    assert rig.bp.deregister(7).status is OK


@pytest.mark.req("BP-MGT-05")
def test_activating_an_active_entity_does_not_delay_beacons():
    rig = Rig()
    due = rig.bp.poll_timeout()
    assert rig.bp.activate(due - 1).status is OK
    assert rig.bp.poll_timeout() == due


@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_activation_exists_since_1_2(version):
    rig = Rig(version)
    with pytest.raises(UnknownServiceError, match=r"since 1\.2"):
        rig.bp.deactivate()
    with pytest.raises(UnknownServiceError, match=r"since 1\.2"):
        rig.bp.activate(rig.now)
    assert rig.bp.active


@pytest.mark.req("BP-INI-03")
@pytest.mark.parametrize("version", VERSIONS)
def test_bp_starts_active(version):
    rig = Rig(version)
    rig.register(7)
    rig.submit(b"A")
    assert rig.tick() == [(7, b"A")]
    assert rig.receive(rig.builder((7, b"B")))[0] == [(7, b"B")]


# -- misuse by our own caller -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        {"prot_id": "7"},
        {"prot_id": 7.0},
        {"prot_id": True},
        {"name": b"client"},
        {"size": "100"},
        {"size": None},
        {"entries": 1.5},
        {"several": 1},
        {"mode": None},
        {"mode": True},
    ],
)
def test_wrong_types_raise(change):
    rig = Rig()
    with pytest.raises(TypeError):
        rig.register(**change)
    assert rig.bp.list_registered().protocols == ()


@pytest.mark.parametrize("prot_id", [-1, 0x10000])
def test_a_protocol_identifier_has_16_bits(prot_id):
    rig = Rig()
    calls = (
        lambda: rig.register(prot_id),
        lambda: rig.bp.deregister(prot_id),
        lambda: rig.submit(b"A", prot_id),
        lambda: rig.bp.clear_buffer(prot_id),
        lambda: rig.bp.query_number_buffered(prot_id),
    )
    for call in calls:
        with pytest.raises(ValueError, match=r"0\.\.65535"):
            call()


def test_a_payload_is_octets():
    rig = Rig()
    rig.register()
    for payload in ("text", 5, None, [1]):
        with pytest.raises(TypeError):
            rig.submit(payload)


def test_the_ends_of_the_identifier_range_are_usable():
    rig = Rig()
    for prot_id in (0, 0xFFFF):
        assert rig.register(prot_id).status is OK
        assert rig.submit(b"A", prot_id) is OK
    assert sorted(rig.tick()) == [(0, b"A"), (0xFFFF, b"A")]
