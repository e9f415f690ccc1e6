"""Readable parts of damaged beacons: the result of strict decoding if there is no error, else all sound parts.

Every property runs over every built-in profile and the odd ones of tests/odd_profiles.py.
"""

from __future__ import annotations

import msgspec
import pytest
from dcp_lab.testing import strategies
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st

from dcp_codec import Beacon, Codec, Container, DecodeError, EncodeError, Payload, Salvaged, VarSumm, get_codec
from dcp_codec.views.fields import Field

#: Dissecting takes its time, and there are many profiles; a long run still draws more than a short one.
EXAMPLES = settings(max_examples=max(20, settings().max_examples // 4))


def header_fields(codec: Codec, octets: bytes) -> dict[str, Field]:
    header = codec.dissect(octets).root.child("bp")
    return {} if header is None else {each.name: each for each in header.children}


def lied(octets: bytes, field: Field | None, value: int) -> bytes:
    """The octets with another number in a field."""
    assert field is not None
    layout = field.layout
    number = value.to_bytes(field.length, getattr(layout, "order", "big"))
    return octets[: field.offset] + number + octets[field.offset + field.length :]


def contents(codec: Codec, octets: bytes) -> list[Field]:
    """The place of the client payload of every block."""
    payloads = codec._salvager._dissect(octets, 0, 0).root.child("payloads")
    assert payloads is not None
    return [codec._salvager._place_of_content(each) for each in payloads.children]


@EXAMPLES
@given(data=st.data())
def test_sound_beacons_equal_strict_decoding(codec: Codec, data: st.DataObject) -> None:
    octets = codec.encode(data.draw(strategies.beacons(codec)))
    beacon, end = codec.decode_from(octets)
    assert repr(codec.salvage(octets)) == repr(Salvaged(beacon, end=end))
    # The other path gives the same result, though it is not used for sound beacons.
    assert repr(codec._salvager.salvage(octets)) == repr(Salvaged(beacon, end=end))


@EXAMPLES
@given(data=st.data())
def test_octets_never_raise(codec: Codec, data: st.DataObject) -> None:
    valid = strategies.beacons(codec).map(codec.encode)
    octets = data.draw(st.one_of(st.binary(max_size=80), strategies.mutations(valid, codec.dissect)))
    found = codec.salvage(octets)
    try:
        beacon, first = codec.decode(octets), None
    except DecodeError as error:
        beacon, first = None, error.problem
    if first is None:
        assert repr(found.beacon) == repr(beacon)
    assert bool(found.problems) == (first is not None)
    assert found.reading != "length" or found.problems[:1] == ((first,) if first else ())
    assert not found.damaged or found.beacon is not None
    for each in found.damaged:
        assert found.beacon is not None
        assert 0 <= each.payload < len(found.beacon.payloads)


@EXAMPLES
@given(data=st.data())
def test_damage_to_one_payload_does_not_affect_the_others(codec: Codec, data: st.DataObject) -> None:
    octets = codec.encode(data.draw(strategies.beacons(codec)))
    places = contents(codec, octets)
    index = data.draw(st.integers(0, len(places) - 1))
    place = places[index]
    assume(place.length)
    junk = data.draw(st.binary(min_size=place.length, max_size=place.length))
    damaged = octets[: place.offset] + junk + octets[place.offset + place.length :]
    before, after = codec.salvage(octets).beacon, codec.salvage(damaged).beacon
    assert before is not None
    assert after is not None
    assert repr(after.bp) == repr(before.bp)
    assert len(after.payloads) == len(before.payloads)
    for number, (was, now) in enumerate(zip(before.payloads, after.payloads, strict=True)):
        if number != index:
            assert repr(was) == repr(now)
        else:
            assert now.protocol_id == was.protocol_id
    assert {each.payload for each in codec.salvage(damaged).damaged} <= {index}


@EXAMPLES
@given(data=st.data())
def test_containers_before_a_bad_one_are_kept(codec: Codec, data: st.DataObject) -> None:
    containers = data.draw(strategies.containers(codec))
    assume(containers)
    sound = codec.encode_containers(containers)
    known = set(codec.profile.vardis.container_types.by_name().values())
    unknown = min(set(range(256)) - known)
    bad = data.draw(st.sampled_from([bytes([unknown, 1, 0]), bytes([min(known)]), bytes([min(known), 0])]))
    bp = data.draw(strategies.envelopes(codec)).bp
    try:
        octets = codec.encode_envelope(Beacon(bp, (Payload(2, sound + bad), Payload(7, b"behind"))))
    except EncodeError:
        # More than a length or an area of the profile can hold.
        reject()
    found = codec.salvage(octets)
    assert found.beacon is not None
    assert repr(found.beacon.payloads[0].vardis) == repr(containers)
    assert found.beacon.payloads[1].data == b"behind"
    assert [each.payload for each in found.damaged] == [0]
    assert found.octets_of(0) == sound + bad
    assert found.octets_of(1) is None
    assert found.damaged[0].problem in found.problems


BLOCKS = (
    Payload(1, bytes(40)),
    Payload(2, (Container(1, (VarSumm(4, 7),)), Container(1, (VarSumm(5, 1),)))),
)
CODEC = get_codec("dcp-2.0")


def beacon(*payloads: Payload, padding: int = 0) -> bytes:
    contents = [
        msgspec.structs.replace(each, content=CODEC.encode_containers(each.content))
        if isinstance(each.content, tuple)
        else each
        for each in payloads
    ]
    header = CODEC.decode(CODEC.encode(Beacon(_HEADER, (Payload(9, b"x"),)))).bp
    return CODEC.encode_envelope(Beacon(header, tuple(contents))) + bytes(padding)


_HEADER = CODEC.decode(bytes.fromhex("01497e0200000000bb1111000601000000290009000278 79".replace(" ", ""))).bp


def test_blocks_after_an_unreadable_report_are_read() -> None:
    found = CODEC.salvage(beacon(*BLOCKS))
    assert found.beacon is not None
    assert found.beacon.bp == _HEADER
    assert found.beacon.payloads == BLOCKS
    assert [(each.reason, each.requirement) for each in found.problems] == [("wrong-length", "SRP-RX-01")]
    (damaged,) = found.damaged
    assert (damaged.payload, damaged.octets, damaged.problem) == (0, bytes(40), found.problems[0])


@pytest.mark.parametrize("padding", [0, 3, 4, 16, 30])
@pytest.mark.parametrize(
    ("field", "change", "reading"),
    [
        ("magicNo", lambda value: 0x7E49, "length"),
        ("version", lambda value: 2, "length"),
        ("numPayloads", lambda value: value + 1, "length"),
        ("numPayloads", lambda value: value - 1, "length"),
        ("length", lambda value: value + 18, "count"),
        ("length", lambda value: value - 4 * len(BLOCKS), "count"),
        ("length", lambda value: (value & 0xFF) << 8 | value >> 8, "count"),
        ("length", lambda value: 0, "count"),
    ],
)
@pytest.mark.parametrize("blocks", [BLOCKS[1:], BLOCKS[1:] * 2])
def test_a_header_with_one_wrong_field(
    field: str, change: object, reading: str, padding: int, blocks: tuple[Payload, ...]
) -> None:
    assert callable(change)
    sound = beacon(*blocks, padding=padding)
    place = header_fields(CODEC, sound)[field]
    octets = lied(sound, place, change(place.value))
    found = CODEC.salvage(octets)
    assert found.problems
    assert found.beacon == CODEC.decode(sound)
    assert not found.damaged
    # Where the padding happens to agree with a reading that is preferred, the values are the same all the same.
    assert found.reading in (reading, "length")


@pytest.mark.parametrize("padding", [0, 3, 4, 16])
@pytest.mark.parametrize("blocks", [BLOCKS[1:], BLOCKS[1:] * 3, (*BLOCKS[1:], Payload(9, b"data"))])
def test_blocks_whose_lengths_count_their_headers(blocks: tuple[Payload, ...], padding: int) -> None:
    sound = beacon(*blocks, padding=padding)
    payloads = CODEC.dissect(sound).root.child("payloads")
    assert payloads is not None
    octets = sound
    for each in payloads.children:
        length = each.child("length")
        assert length is not None
        octets = lied(octets, length, length.value + 4)
    found = CODEC.salvage(octets)
    assert found.reading == "whole"
    assert found.beacon == CODEC.decode(sound)
    assert [each.reason for each in found.problems][:1] == [found.problems[0].reason]


def test_a_block_that_is_cut_off_is_the_last_that_is_read() -> None:
    sound = beacon(Payload(9, b"first"), *BLOCKS[1:])
    found = CODEC.salvage(sound[:-2])
    assert found.beacon is not None
    assert found.beacon.payloads[0] == Payload(9, b"first")
    assert found.beacon.payloads[1].vardis == BLOCKS[1].vardis[:1]  # type: ignore[index]
    assert found.octets_of(1) == CODEC.encode_containers(BLOCKS[1].content)[:-2]  # type: ignore[arg-type]
    assert found.problems[0].reason == "beacon-overrun"


@pytest.mark.parametrize("size", range(18))
def test_a_truncated_header_gives_no_values(size: int) -> None:
    assert CODEC.salvage(beacon(*BLOCKS)[:size]).beacon is None


def test_octets_of_another_protocol_are_not_read() -> None:
    octets = beacon(*BLOCKS)
    assert CODEC.salvage(b"\x02\x00\x00" + octets[3:]).beacon is None
