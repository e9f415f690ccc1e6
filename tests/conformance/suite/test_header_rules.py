"""The faults that new implementers make first, in one frame each: what is named is the requirement that they break."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

import pytest
from dcp_conformance.frames.header_rules import Violation, judge
from dcp_lab.testing import strategies
from dcp_spec.catalogue.requirements import requirements
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec import Beacon, BPHeader, DecodeError, Payload, get_codec

from ..rig import codec_of

CODEC = get_codec("dcp-2.0")
SENDER = bytes.fromhex("0200000000bb")
REQUEST = b"\x04\x01\xeb"
ONE, TWO = ((2, REQUEST),), ((2, REQUEST), (7, b"hello"))


class Frame(NamedTuple):
    """A beacon of dcp-2.0 written octet by octet, so that everything can be wrong."""

    magic: bytes = b"\x49\x7e"
    version: bytes = b"\1"
    sender: bytes = SENDER
    network: bytes = b"\x11\x11"
    length: Callable[[int], int] = lambda size: size
    count: int = 0
    seqno: bytes = b"\0\0\0\x29"
    more: int = 0
    """Excess of each block length, in octets."""
    blocks: tuple[tuple[int, bytes], ...] = TWO

    def octets(self, *, padded: bool = False) -> bytes:
        body = b"".join(struct.pack(">HH", number, len(data) + self.more) + data for number, data in self.blocks)
        number = len(self.blocks) + self.count
        header = self.version + self.magic + self.sender + self.network
        octets = header + struct.pack(">HB", self.length(len(body)), number) + self.seqno + body
        return octets.ljust(46, b"\0") if padded else octets


FAULTS: dict[str, tuple[Frame, str, str]] = {
    "magic-swapped": (Frame(magic=b"\x7e\x49"), "BP-HDR-02", "octets are swapped"),
    "magic-other": (Frame(magic=b"\x12\x34"), "BP-HDR-02", "0x1234"),
    "version-2": (Frame(version=b"\2"), "BP-HDR-01", "0x2"),
    "length-with-header": (Frame(length=lambda size: size + 18), "BP-HDR-06", "counts the header of the beacon"),
    "length-swapped": (Frame(length=lambda size: size << 8), "BP-HDR-06", "octets are swapped"),
    "length-without-block-headers": (Frame(length=lambda size: size - 8), "BP-HDR-06", "does not count the headers"),
    "length-0": (Frame(length=lambda size: 0), "BP-HDR-06", "0"),
    "one-more": (Frame(count=1), "BP-HDR-07", "3: there are 2"),
    "one-less": (Frame(count=-1), "BP-HDR-07", "1: there are 2"),
    "none": (Frame(count=-2), "BP-HDR-07", "0: there are 2"),
    "block-length-with-header": (Frame(more=4), "BP-FMT-01", "counts the header of the block"),
    "one-block-length-with-header": (Frame(more=4, blocks=ONE), "BP-FMT-01", "counts the header of the block"),
    "one-block-length-with-header-with-header": (
        Frame(length=lambda size: size + 18, blocks=ONE),
        "BP-HDR-06",
        "counts the header of the beacon",
    ),
    "sender-of-8": (Frame(sender=bytes(range(8))), "DATA-04", "one of 8"),
    "sender-of-4": (Frame(sender=b"abcd"), "DATA-04", "one of 4"),
    "no-network": (Frame(network=b""), "BP-HDR-04", "the field is missing"),
    "network-of-1": (Frame(network=b"\x11"), "BP-HDR-05", "one of 1"),
    "network-of-4": (Frame(network=b"\0\0\x11\x11"), "DATA-03", "one of 4"),
    "seqno-of-1": (Frame(seqno=b"\7"), "BP-HDR-08", "one of 1"),
}


def named(found: list[Violation]) -> list[str]:
    return [each.requirement for each in found]


@pytest.mark.parametrize("padded", [False, True])
@pytest.mark.parametrize("name", FAULTS)
def test_a_typical_mistake_is_named(name: str, padded: bool) -> None:
    frame, requirement, said = FAULTS[name]
    octets = frame.octets(padded=padded)
    with pytest.raises(DecodeError):
        CODEC.decode(octets)
    found = judge(octets, CODEC, source=frame.sender)
    assert named(found) == [requirement]
    assert said in found[0].observed
    assert 0 <= found[0].offset < len(octets)


def test_the_octets_that_are_wrong_are_marked() -> None:
    (found,) = judge(Frame(length=lambda size: size + 18).octets(), CODEC)
    assert (found.path, found.offset, found.length) == ("bp.length", 11, 2)
    assert (found.expected, str(found)) == (
        "length is 16",
        "bp.length at octet 11: 34: it counts the header of the beacon as well; expected: length is 16",
    )


@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.3", "dcp-1.2", "dcp-1.1", "dcp-1.0"])
@pytest.mark.parametrize("padded", [False, True])
def test_little_endian_integers(profile: str, padded: bool) -> None:
    codec = codec_of(profile)
    names = {"version": "B", "magicNo": "H", "senderId": "6s", "networkId": "H", "length": "H", "numPayloads": "B"}
    values = {"version": 1, "magicNo": 0x497E, "senderId": SENDER, "networkId": 0x1112, "length": 7, "numPayloads": 1}
    names, values = names | {"seqno": "I"}, values | {"seqno": 41}
    header = codec.profile.bp.header
    octets = struct.pack("<" + "".join(names[each] for each in header), *(values[each] for each in header))
    octets += struct.pack("<HH", 2, 3) + REQUEST
    assert named(judge(octets.ljust(46 * padded, b"\0"), codec)) == ["DATA-01"]


@pytest.mark.parametrize(("order", "requirement"), [(">", ["DATA-02"]), ("<", ["DATA-02", "DATA-01"])])
def test_a_structure_sent_in_its_memory_layout(order: str, requirement: list[str]) -> None:
    octets = struct.pack(f"{order}BxH6sHHBxI", 1, 0x497E, SENDER, 0x1111, 7, 1, 41) + struct.pack(f"{order}HH", 2, 3)
    assert named(judge(octets + REQUEST, CODEC)) == requirement


@pytest.mark.parametrize("version", ["dcp-1.0", "dcp-1.1", "dcp-1.3"])
def test_the_header_of_another_version(version: str) -> None:
    codec = codec_of(version)
    header = BPHeader(SENDER, 41)
    octets = codec.encode_envelope(Beacon(header, tuple(Payload(number, data) for number, data in TWO)))
    found = named(judge(octets, CODEC))
    assert found == [{"dcp-1.0": "BP-HDR-10", "dcp-1.1": "BP-HDR-10", "dcp-1.3": "BP-HDR-04"}[version]]


def test_an_unreadable_report_fails_only_its_own_requirement() -> None:
    octets = Frame(blocks=((1, bytes(40)), *TWO)).octets()
    assert named(judge(octets, CODEC)) == ["SRP-FMT-01"]


def test_a_bad_container_is_reported_in_addition_to_the_header() -> None:
    octets = Frame(magic=b"\x7e\x49", blocks=((2, REQUEST + b"\x09\x01\x01"),)).octets()
    assert named(judge(octets, CODEC)) == ["BP-HDR-02", "VD-IC-02"]


@given(data=st.data())
def test_decodable_frames_violate_nothing_and_no_frame_raises(data: st.DataObject) -> None:
    valid = strategies.beacons(CODEC).map(CODEC.encode)
    assert judge(data.draw(valid), CODEC) == []
    octets = data.draw(st.one_of(st.binary(max_size=60), strategies.mutations(valid, CODEC.dissect)))
    found = judge(octets, CODEC)
    try:
        CODEC.decode(octets)
        assert not found
    except DecodeError:
        assert found
    for each in found:
        assert not each.requirement or each.requirement in requirements()
        assert 0 <= each.offset <= len(octets)
