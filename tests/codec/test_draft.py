"""Contents of a recording that a profile does not explain, and drafts of profiles that explain them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from dcp_spec.profile.loading import load_profile

from dcp_codec import Beacon, BPHeader, Codec, Container, Payload, VarSumm, get_codec
from dcp_codec.analysis.guess import guess
from dcp_codec.analysis.profile_draft import draft_profile
from dcp_codec.analysis.shortfall import shortfalls
from dcp_codec.capture import Frame
from dcp_codec.framing.envelope import Envelope
from dcp_codec.framing.ethertype import parse_ether_type
from dcp_codec.framing.frames import FrameDissector

from ..odd_profiles import codec_of

SENDER = bytes.fromhex("020000000001")
CODEC = get_codec("cpp-1.3")


def recording(sizes: list[int], *, containers: bytes = b"") -> list[Frame]:
    """Beacons as of cpp-1.3, with SRP payloads of these sizes and summaries after them."""
    frames = []
    summaries = CODEC.encode_containers((Container(1, (VarSumm(7, 1),)),)) + containers
    for number, size in enumerate(sizes):
        payloads = (Payload(1, bytes(range(size))), Payload(2, summaries))
        octets = CODEC.encode_envelope(Beacon(BPHeader(SENDER, number), payloads))
        data = Envelope(CODEC.profile.link).frame(octets, SENDER)
        frames.append(Frame(number + 1, 1_750_000_000_000_000_000 + number * 100_000_000, data, len(data)))
    return frames


def test_a_report_of_another_size_is_shown_with_profile_lines_for_it() -> None:
    (found,) = shortfalls(CODEC, recording([52] * 10))
    assert found.text == "SRP is 52 octets in 10 of 10 payloads; the profile has 64"
    assert (found.count, found.of, found.frame) == (10, 10, 1)
    assert found.advice == (
        "[srp]",
        'record = [{ name = "unknown", opaque = 52 }]',
        "record_size = 52",
        "safety_data = []",
    )


def test_reports_of_several_sizes_are_octets_of_any_number() -> None:
    (found,) = shortfalls(CODEC, recording([52, 53, 54, 52]))
    assert found.text.startswith("SRP has 3 lengths in 4 payloads (52 octets in 2, 53 octets in 1")
    assert found.advice == ("[srp]", "record = []", "record_size = 0", "safety_data = []")


def test_an_unknown_container_type_is_named() -> None:
    found = shortfalls(CODEC, recording([64] * 3, containers=bytes([9, 1, 5, 6])))
    assert [each.text for each in found] == [
        "VarDis has container types that the profile does not know, in 3 of 3 payloads: 9 (3)"
    ]
    assert "number = 9" in found[0].advice


def test_a_profile_that_explains_everything_has_no_shortfall() -> None:
    assert shortfalls(CODEC, recording([64] * 3)) == []


@pytest.mark.parametrize("sizes", [[52] * 30, [20, 21, 22] * 10])
def test_a_draft_decodes_its_recording(sizes: list[int], tmp_path: Path) -> None:
    frames = recording(sizes)
    draft = draft_profile("mine", frames, "flight.pcap")
    assert (draft.decoded, draft.before, draft.frames) == (30, 0, 30)
    assert draft.left == ()
    path = tmp_path / "mine.toml"
    path.write_text(draft.text, encoding="utf-8")
    assert load_profile(path).srp == draft.profile.srp
    codec = Codec(path)
    assert all(not FrameDissector(codec).dissect(frame).dissection.errors for frame in frames)
    assert "30 of 30 sampled frames decode with it, 0 with" in draft.text


def test_a_draft_lists_unexplained_contents() -> None:
    draft = draft_profile("mine", recording([52] * 4, containers=bytes([9, 1, 5, 6])), 'a "b"\n.pcap')
    assert draft.decoded == 0
    assert "# Not explained yet: VarDis has container types that the profile does not know" in draft.text
    assert "#   number = 9" in draft.text
    assert 'made from a "b"?.pcap' in draft.text


def test_frames_that_are_not_beacons_give_no_draft() -> None:
    with pytest.raises(ValueError, match="no frame looks like a beacon"):
        draft_profile("mine", [Frame(1, 0, bytes(60), 60)], "x")


def test_weak_guesses_are_marked() -> None:
    found = guess(recording([52] * 10))
    assert found.weak
    assert found.warning is not None
    assert "weak guess" in found.warning
    assert found.as_json()["weak"] is True
    good = guess(recording([40] * 10))
    assert not good.weak
    assert good.warning is None
    dissector = FrameDissector(CODEC, None, found.warning)
    dissected = dissector.dissect(recording([52])[0])
    assert dissected.as_json()["profileDoubt"] == found.warning
    assert "profileDoubt" not in FrameDissector(CODEC).dissect(recording([52])[0]).as_json()


def test_an_own_profile_can_be_guessed(tmp_path: Path) -> None:
    own = codec_of("odd-own", tmp_path)
    assert guess(recording([64]), profiles=["cpp-1.3", own]).best.profile.name == "cpp-1.3"


@pytest.mark.parametrize(
    ("text", "number"),
    [("0x4953", 0x4953), ("0X88B5", 0x88B5), ("88b5", 0x88B5), ("18771", 0x4953), ("0600", 0x0600), ("65535", 0xFFFF)],
)
def test_ether_types_that_can_be_read_in_one_way(text: str, number: int) -> None:
    assert parse_ether_type(text) == number


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("4953", "4953 can be hex or decimal: write 0x4953 or 0x1359"),
        ("0x10000", "0x10000 is not an EtherType: it is not within 0x0600 to 0xffff"),
        ("599", "not within"),
        ("ip", "'ip' is not an EtherType; write it in hex, as in 0x4953"),
        ("", "'' is not an EtherType"),
        ("-5", "'-5' is not an EtherType"),
    ],
)
def test_ether_types_that_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        parse_ether_type(text)
