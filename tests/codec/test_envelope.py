"""Frames around bearer payloads, for recordings."""

from __future__ import annotations

import pytest
from dcp_spec.profile.definition import Link
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec.framing.envelope import Envelope, unicast
from dcp_codec.framing.locate import Framing, locate

MAC = bytes.fromhex("020000000001")
LINKS = [Link(ether_type=0x4953), Link(transport="udp", udp_port=5950)]


@pytest.mark.parametrize("link", LINKS)
@given(octets=st.binary(max_size=300), source=st.binary(max_size=8))
def test_an_envelope_is_opened_by_the_codec(link, octets, source):
    frame = Envelope(link).frame(octets, source)
    found = locate(frame, link)
    assert isinstance(found, Framing)
    assert frame[found.start : found.end] == octets
    assert found.dst == b"\xff" * 6
    assert found.src is not None
    assert not found.src[0] & 1


def test_envelopes_octet_by_octet():
    source = bytes.fromhex("7f000001c59d")
    assert unicast(source) == bytes.fromhex("7e000001c59d")
    assert unicast(MAC) == MAC
    frame = Envelope(LINKS[1]).frame(b"hi", source)
    headers = "ffffffffffff 7e000001c59d 0800  4500001e00000000 0111 3acf 7f000001 ffffffff  c59d 173e 000a 0000"
    assert frame == bytes.fromhex(headers) + b"hi"
    words = [int.from_bytes(frame[at : at + 2], "big") for at in range(14, 34, 2)]
    assert sum(words) % 0xFFFF == 0
    # Profiles without an EtherType are recorded under one that is for experiments.
    assert Envelope(Link()).frame(b"", MAC)[12:] == b"\x88\xb5"


def test_a_datagram_above_the_maximum_length_is_recorded():
    assert len(Envelope(LINKS[1]).frame(bytes(65_600), MAC)) == 14 + 28 + 65_600
