"""Records, peers and transmission."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import StopCase
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.known import Reaction

from dcp_codec.values import VarDelete, VarSumm

from .parts import EPOCH, PERIOD, Parts


def test_time_stamps_increase_also_when_time_stands_still():
    parts = Parts()
    first, second = parts.records.creation_time(), parts.records.creation_time()
    assert second == first + 1
    parts.link.time = 10**9
    assert parts.records.creation_time() > second


def test_shortened_values_fit_and_remain_different():
    parts = Parts()
    parts.run.parameters["VARDISPAR_MAX_VALUE_LENGTH"] = 2
    assert parts.records.value(b"ab") == b"ab"
    found = [parts.records.value(each) for each in (b"value", b"vaguest", b"vacant", b"value")]
    assert [len(each) for each in found] == [2, 2, 2, 2]
    assert len({*found}) == 3
    assert found[0] == found[3]


def test_a_timeout_that_the_profile_cannot_express_does_not_apply():
    parts = Parts()
    parts.records.require_timeout(parts.sut.longest_timeout)
    with pytest.raises(StopCase):
        parts.records.require_timeout(parts.sut.longest_timeout + 1)
    assert parts.verdicts.verdict() is Verdict.NOT_APPLICABLE


def test_a_created_variable_is_offered_and_a_measured_one_is_not():
    parts = Parts()
    parts.records.sample(15)
    assert parts.run.identifier_pool.is_unknown(15, 0)
    record = parts.records.create(15, b"\x02\0\0\0\0\x09", value=b"v", seqno=3)
    assert (record.spec.var_id, record.upd.seqno, record.upd.value) == (15, 3, b"v")
    assert not parts.run.identifier_pool.is_unknown(15, 0)
    assert parts.created == {15}


def test_a_peer_counts_its_beacons_and_a_frame_has_its_number():
    parts = Parts()
    peer = parts.peers.new()
    assert [peer.send(peer.summary(1, 1)), peer.send(peer.summary(1, 2))] == [1, 2]
    beacons = [ReceivedBeacon(parts.codec, 0, 0, 0, each, peer.address) for each in parts.link.sent]
    assert [(each.seqno, each.sender) for each in beacons] == [(0, peer.node_id), (1, peer.node_id)]
    assert parts.steps.silent
    assert parts.traffic.events[0].who == peer.address.hex(":")


def test_records_are_split_at_the_maximum_payload():
    parts = Parts()
    size = parts.builder.container_header_size + 2 * parts.builder.record_size(VarSumm(0, 0))
    parts.run.parameters["VARDISPAR_MAX_PAYLOAD_SIZE"] = size
    parts.peers.new().send_all([VarSumm(1, 1), VarSumm(2, 1), VarSumm(3, 1), VarDelete(4)])
    # The third summary fills a payload together with the header of another container.
    counts = [
        sum(len(c.records) for c in parts.codec.salvage(each).beacon.payloads[0].vardis) for each in parts.link.sent
    ]
    assert counts == [2, 1, 1]


def test_the_duration_of_a_transmission_is_lateness():
    parts = Parts()

    def slow() -> None:
        parts.link.time += 2 * PERIOD

    parts.link.on_send = slow
    peer = parts.peers.new()
    peer.send_octets(b"any octets")
    assert parts.link.sent == [b"any octets"]
    assert parts.steps.late_ns == 2 * PERIOD


def test_each_payload_block_keeps_a_slow_implementation_busy():
    parts = Parts()
    parts.run.known.reaction = Reaction(4.0, per_payload=1.0)
    peer = parts.peers.new()
    peer.send(peer.summary(1, 1), parts.records.report(peer.node_id, 1), peer.summary(2, 1))
    assert parts.sut.busy_until == 3 * PERIOD


def test_a_whole_frame_is_recorded_with_the_offset_of_its_payload():
    parts = Parts()
    number = parts.transmission.send_frame(b"header" + b"payload", 6)
    event = parts.traffic.events[0]
    assert (number, event.frame[event.start :]) == (1, b"payload")
    assert event.wall == EPOCH
