"""Machine code finds the bearer payload where ``dcp_codec.framing.locate`` finds it, in every frame there is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dcp_spec.profile.definition import Link
from dcp_tables.table.kernel import native
from dcp_tables.table.kernel.jit import machine
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec.framing.locate import OtherTraffic, locate

from ..chance import examples

pytestmark = pytest.mark.part("tables")

ETHERNET = Link(transport="ethernet", ether_type=0x4953)
UDP = Link(transport="udp", udp_port=5950)
_TYPES = [0x4953, 0x4952, 0x0800, 0x86DD, 0x8100, 0x88A8, 0x0806]


def both(frame: bytes, link: Link) -> tuple[Any, Any]:
    """Result of machine code for a frame in the middle of a buffer, and the expected result."""
    octets = np.frombuffer(b"\xff" * 7 + frame + b"\x49\x53" * 40, np.uint8)
    kind = link.udp_port if link.transport == "udp" else link.ether_type
    start, stop, ether = machine(native.locate)(octets, 7, 7 + len(frame), link.transport == "udp", kind)
    found = locate(frame, link)
    if isinstance(found, OtherTraffic):
        return (start, ether), (-1, -1 if found.ether_type is None else found.ether_type)
    return (start - 7, stop - 7, ether), (found.start, found.end, found.ether_type)


@st.composite
def frames(draw: st.DrawFn) -> bytes:
    octets = bytearray(draw(st.binary(min_size=12, max_size=12)))
    for _ in range(draw(st.integers(0, 3))):
        octets += draw(st.sampled_from([b"\x81\x00", b"\x88\xa8"])) + draw(st.binary(min_size=2, max_size=2))
    octets += draw(st.sampled_from(_TYPES)).to_bytes(2, "big")
    udp = draw(st.sampled_from([b"", b"\x17\x3e\x17\x3e", b"\0\0\x17\x3f"]))
    udp += draw(st.integers(0, 60)).to_bytes(2, "big") + b"\0\0" + draw(st.binary(max_size=40))
    words = draw(st.sampled_from([0x45, 0x46, 0x4F, 0x44, 0x65]))
    four = bytes([words]) + bytes(5) + draw(st.sampled_from([b"\0\0", b"\x40\0", b"\x20\0", b"\0\1"])) + b"\x40"
    four += draw(st.sampled_from([b"\x11", b"\x06"])) + bytes(10) + bytes(4 * max((words & 15) - 5, 0))
    six = draw(st.sampled_from([b"\x60", b"\x6f", b"\x45"])) + bytes(5) + draw(st.sampled_from([b"\x11", b"\x06"]))
    octets += draw(st.sampled_from([four + udp, six + bytes(33) + udp, udp, b""]))
    return bytes(octets[: draw(st.integers(0, len(octets)))] if draw(st.booleans()) else octets)


@pytest.mark.parametrize("link", [ETHERNET, UDP], ids=["ethernet", "udp"])
@settings(max_examples=examples(600))
@given(frame=frames() | st.binary(max_size=80))
def test_machine_code_finds_the_same_payload(link, frame):
    found, expected = both(frame, link)
    assert found == expected


def test_every_length_of_a_tagged_datagram():
    frame = bytes(12) + b"\x81\x00\0\1\x88\xa8\0\2\x08\0" + b"\x45" + bytes(8) + b"\x11" + bytes(10)
    frame += b"\x17\x3e\x17\x3e\0\x10\0\0" + bytes(range(20))
    for size in range(len(frame) + 1):
        for link in (ETHERNET, UDP):
            found, expected = both(frame[:size], link)
            assert found == expected
    assert both(frame, UDP)[0] == (50, 58, 0x0800)


def test_identifiers_are_numbered_in_order_of_appearance():
    octets = np.frombuffer(b"abcabdabc" + b"ab", np.uint8)
    slots, ends, arena = np.full(16, -1, np.int32), np.zeros(4, np.int64), np.empty(8, np.uint8)
    intern = machine(native.intern)
    assert [intern(octets, at, size, slots, ends, arena, many) for at, size, many in (
        (0, 3, 0), (3, 3, 1), (6, 3, 2), (9, 2, 2), (0, 2, 3), (0, 0, 3)
    )] == [0, 1, 0, 2, 2, -1]  # fmt: skip
    assert arena.tobytes() == b"abcabdab"


def test_a_full_pool_is_reported():
    octets = np.frombuffer(b"abcdefgh", np.uint8)
    slots, ends, arena = np.full(16, -1, np.int32), np.zeros(4, np.int64), np.empty(4, np.uint8)
    intern = machine(native.intern)
    assert intern(octets, 0, 5, slots, ends, arena, 0) == -1
    assert machine(native.intern)(octets, 0, 4, slots, ends, arena, 0) == 0
    assert machine(native.intern)(octets, 4, 1, slots, ends, arena, 1) == -1
