"""Bearer payloads inside link-layer frames: Ethernet II with and without tags, UDP over IPv4 and IPv6."""

from __future__ import annotations

import pytest
from dcp_spec.profile.definition import Link
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec import get_codec
from dcp_codec.capture import Frame
from dcp_codec.framing.frames import DissectedFrame, FrameDissector, with_ether_type
from dcp_codec.framing.locate import Framing, OtherTraffic, bare, locate, mac

from ..chance import examples

DST, SRC = b"\xff" * 6, bytes.fromhex("020000000001")
ETHERNET = Link(transport="ethernet", ether_type=0x4953)
UDP = Link(transport="udp", udp_port=5950)


def ethernet(payload: bytes, ether_type: int = 0x4953, *tags: str) -> bytes:
    return DST + SRC + bytes.fromhex("".join(tags)) + ether_type.to_bytes(2, "big") + payload


def udp(payload: bytes, port: int = 5950, length: int | None = None) -> bytes:
    size = 8 + len(payload) if length is None else length
    return (5950).to_bytes(2, "big") + port.to_bytes(2, "big") + size.to_bytes(2, "big") + bytes(2) + payload


def ipv4(payload: bytes, *, protocol: int = 17, fragment: int = 0, options: int = 0, version: int = 4) -> bytes:
    words = 5 + options
    head = bytes([version << 4 | words, 0]) + (4 * words + len(payload)).to_bytes(2, "big") + bytes(2)
    head += fragment.to_bytes(2, "big") + bytes([64, protocol, 0, 0]) + bytes([10, 0, 0, 1]) + b"\xff" * 4
    return ethernet(head + bytes(4 * options) + payload, 0x0800)


def ipv6(payload: bytes, *, next_header: int = 17, version: int = 6) -> bytes:
    head = bytes([version << 4, 0, 0, 0]) + len(payload).to_bytes(2, "big") + bytes([next_header, 1]) + bytes(32)
    return ethernet(head + payload, 0x86DD)


def payload_of(frame: bytes, link: Link) -> bytes | OtherTraffic:
    found = locate(frame, link)
    return frame[found.start : found.end] if isinstance(found, Framing) else found


# -- Ethernet -----------------------------------------------------------------------------------------------------


@pytest.mark.req("UWB-02")
def test_ethernet() -> None:
    assert locate(ethernet(b"beacon"), ETHERNET) == Framing(14, 20, DST, SRC, 0x4953)


def test_a_frame_with_a_header_only() -> None:
    assert locate(ethernet(b""), ETHERNET) == Framing(14, 14, DST, SRC, 0x4953)


@pytest.mark.req("UWB-02")
@pytest.mark.parametrize("ether_type", [0x0800, 0x4954, 0x5349, 0x606F, 0x0010])
def test_other_ether_type(ether_type: int) -> None:
    assert locate(ethernet(b"beacon", ether_type), ETHERNET) == OtherTraffic("ether-type", ether_type)


def test_another_ether_type_on_request() -> None:
    link = with_ether_type(UDP, 0x606F)
    assert payload_of(ethernet(b"beacon", 0x606F), link) == b"beacon"
    assert locate(ethernet(b"beacon"), link) == OtherTraffic("ether-type", 0x4953)


@pytest.mark.parametrize("tags", [("81000001",), ("88a80001",), ("88a80001", "81000002"), ("81000001", "81000002")])
def test_vlan_tags(tags: tuple[str, ...]) -> None:
    start = 14 + 4 * len(tags)
    assert locate(ethernet(b"beacon", 0x4953, *tags), ETHERNET) == Framing(start, start + 6, DST, SRC, 0x4953)
    assert locate(ethernet(b"beacon", 0x0806, *tags), ETHERNET) == OtherTraffic("ether-type", 0x0806)


def test_three_vlan_tags_are_one_too_many() -> None:
    frame = ethernet(b"beacon", 0x4953, *["81000001"] * 3)
    assert locate(frame, ETHERNET) == OtherTraffic("ether-type", 0x8100)


@pytest.mark.parametrize("size", [14, 15, 17])
def test_cut_off_in_a_tag(size: int) -> None:
    assert locate(ethernet(b"", 0x4953, "81000001")[:size], ETHERNET) == OtherTraffic("ether-type", 0x8100)


@pytest.mark.parametrize("size", range(14))
@pytest.mark.parametrize("link", [ETHERNET, UDP])
def test_short_frames(size: int, link: Link) -> None:
    assert locate(ethernet(b"")[:size], link) == OtherTraffic("short-frame")


# -- UDP ----------------------------------------------------------------------------------------------------------


@pytest.mark.req("UWB-02")
def test_udp_over_ipv4() -> None:
    assert locate(ipv4(udp(b"beacon")), UDP) == Framing(42, 48, DST, SRC, 0x0800)


def test_udp_over_ipv4_with_options() -> None:
    assert payload_of(ipv4(udp(b"beacon"), options=3), UDP) == b"beacon"


def test_udp_over_ipv6() -> None:
    assert locate(ipv6(udp(b"beacon")), UDP) == Framing(62, 68, DST, SRC, 0x86DD)


def test_udp_in_a_tagged_frame() -> None:
    frame = ipv4(udp(b"beacon"))
    assert payload_of(frame[:12] + bytes.fromhex("81000001") + frame[12:], UDP) == b"beacon"


@pytest.mark.req("UWB-02")
def test_other_port() -> None:
    assert locate(ipv4(udp(b"beacon", 5951)), UDP) == OtherTraffic("udp-port", 0x0800)
    assert locate(ipv6(udp(b"beacon", 5951)), UDP) == OtherTraffic("udp-port", 0x86DD)


@pytest.mark.parametrize("fragment", [0x2000, 0x0001, 0x1FFF, 0x3FFF])
def test_fragments_are_other_traffic(fragment: int) -> None:
    assert locate(ipv4(udp(b"beacon"), fragment=fragment), UDP) == OtherTraffic("udp-port", 0x0800)


def test_do_not_fragment_is_not_a_fragment() -> None:
    assert payload_of(ipv4(udp(b"beacon"), fragment=0x4000), UDP) == b"beacon"


def test_other_protocols() -> None:
    for frame in (
        ipv4(udp(b"beacon"), protocol=6),
        ipv4(udp(b"beacon"), version=6),
        ipv6(udp(b"beacon"), next_header=44),
        ipv6(udp(b"beacon"), version=4),
    ):
        assert isinstance(locate(frame, UDP), OtherTraffic)
    assert locate(ethernet(udp(b"beacon"), 0x0806), UDP) == OtherTraffic("udp-port", 0x0806)


def test_padding_after_a_datagram_is_left_out() -> None:
    assert payload_of(ipv4(udp(b"beacon") + b"padding"), UDP) == b"beacon"


@pytest.mark.parametrize("length", [0, 7, 8])
def test_a_datagram_shorter_than_its_header_is_empty(length: int) -> None:
    assert locate(ipv4(udp(b"beacon", length=length)), UDP) == Framing(42, 42, DST, SRC, 0x0800)


def test_a_datagram_longer_than_the_frame_ends_with_it() -> None:
    assert payload_of(ipv4(udp(b"beacon", length=500)), UDP) == b"beacon"


@pytest.mark.parametrize("frame", [ipv4(udp(b"beacon")), ipv6(udp(b"beacon")), ipv4(udp(b"beacon"), options=10)])
def test_cut_off_anywhere(frame: bytes) -> None:
    headers = len(frame) - 6
    for size in range(14, headers):
        assert isinstance(locate(frame[:size], UDP), OtherTraffic)
    for size in range(headers, len(frame)):
        assert payload_of(frame[:size], UDP) == b"beacon"[: size - headers]


@pytest.mark.parametrize("words", range(5))
def test_an_ip_header_of_fewer_than_20_octets_is_invalid(words: int) -> None:
    octets = bytearray(40)
    octets[0], octets[9] = 0x40 | words, 17
    octets[4 * words + 2 : 4 * words + 4] = (5950).to_bytes(2, "big")
    octets[6:8] = bytes(2)
    assert isinstance(locate(ethernet(bytes(octets), 0x0800), UDP), OtherTraffic)


# -- whatever comes -----------------------------------------------------------------------------------------------


_HEADS = st.sampled_from([ethernet(b""), ipv4(b""), ipv6(b""), ipv4(udp(b"")), ethernet(b"", 0x8100), b""])


@pytest.mark.parametrize("link", [ETHERNET, UDP, Link(ether_type=0x0800), Link(ether_type=0x8100)])
def test_any_frame(link: Link) -> None:
    @settings(max_examples=examples(150))
    @given(_HEADS, st.binary(max_size=80), st.data())
    def check(head: bytes, rest: bytes, data: st.DataObject) -> None:
        frame = bytearray(head + rest)
        for _ in range(data.draw(st.integers(0, 3)) if frame else 0):
            frame[data.draw(st.integers(0, len(frame) - 1))] = data.draw(st.integers(0, 255))
        found = locate(bytes(frame), link)
        if isinstance(found, Framing):
            assert 14 <= found.start <= found.end <= len(frame)
            assert (found.dst, found.src) == (frame[:6], frame[6:12])
        else:
            assert found.reason in ("short-frame", "ether-type", "udp-port")
            assert (found.ether_type is None) == (len(frame) < 14)

    check()


# -- frames taken apart -------------------------------------------------------------------------------------------

BEACON = bytes.fromhex("01497e0200000000bb111100080100000029 00020004 01010703")


def frame_of(octets: bytes) -> Frame:
    return Frame(number=1, time_ns=1_700_000_000_000_000_000, data=octets, orig_len=len(octets))


def dissected(octets: bytes, profile: str = "dcp-2.0") -> DissectedFrame:
    found = FrameDissector(get_codec(profile)).dissect(frame_of(octets))
    assert isinstance(found, DissectedFrame)
    return found


@pytest.mark.req("BP-RX-14")
def test_a_frame_as_json() -> None:
    found = dissected(ethernet(BEACON + bytes(20)))
    assert found.sender == "02:00:00:00:00:bb"
    assert [payload.path for payload in found.payloads] == ["payloads[0]"]
    assert found.header is not None
    assert (found.header.offset, found.header.length) == (14, 18)
    assert found.as_json() == {
        "frame": 1,
        "time_ns": 1_700_000_000_000_000_000,
        "src": "02:00:00:00:00:01",
        "dst": "ff:ff:ff:ff:ff:ff",
        "etherType": 0x4953,
        "bp": {
            "version": 1,
            "magicNo": 0x497E,
            "senderId": "02:00:00:00:00:bb",
            "networkId": 0x1111,
            "length": 8,
            "numPayloads": 1,
            "seqno": 41,
        },
        "payloads": [
            {
                "protocolId": 2,
                "length": 4,
                "vardis": [
                    {
                        "icType": 1,
                        "icName": "SUMMARIES",
                        "icNumRecords": 1,
                        "records": [{"varId": 7, "seqno": 3}],
                    }
                ],
            }
        ],
        "padding": 20,
        "errors": [],
        "warnings": [],
    }


def test_offsets_count_from_the_start_of_the_frame() -> None:
    found = dissected(ethernet(BEACON[:-1], 0x4953, "81000001"))
    error = found.as_json()["errors"][0]
    assert (error["path"], error["offset"], error["reason"]) == ("bp.length", 18 + 11, "beacon-overrun")
    assert found.dissection.root.offset == 18


def test_padding_is_not_part_of_a_datagram() -> None:
    block = bytes.fromhex("09 64726f6e6531 00 00000000") + bytes(1000)
    found = dissected(ipv4(udp(block) + b"behind"), "student-2024")
    assert found.dissection.errors == []
    assert found.dissection.padding == b""
    assert found.header is None
    assert found.payloads[0].offset == 42
    # Without a header the frame is from who sent it.
    assert found.sender == "02:00:00:00:00:01"


def test_other_traffic_is_not_dissected() -> None:
    dissector = FrameDissector(get_codec("dcp-2.0"))
    assert dissector.dissect(frame_of(ethernet(BEACON, 0x0806))) == OtherTraffic("ether-type", 0x0806)
    assert dissector.dissect(frame_of(b"short")) == OtherTraffic("short-frame")


def test_bare_octets() -> None:
    assert bare(BEACON) == Framing(0, len(BEACON))
    found = FrameDissector(get_codec("dcp-2.0")).dissect_bare(frame_of(BEACON))
    data = found.as_json()
    assert (data["src"], data["dst"], data["etherType"], data["errors"]) == (None, None, None, [])
    assert found.sender == "02:00:00:00:00:bb"
    cut = FrameDissector(get_codec("student-2024")).dissect_bare(frame_of(b""))
    assert (cut.sender, [block.length for block in cut.payloads]) == (None, [0])


@pytest.mark.parametrize("size", range(10))
def test_a_truncated_header_has_no_sender(size: int) -> None:
    found = dissected(ethernet(BEACON[:size]))
    assert found.sender == ("02:00:00:00:00:bb" if size >= 9 else None)
    assert found.as_json()["errors"] != []


def test_mac() -> None:
    assert mac(SRC) == "02:00:00:00:00:01"
