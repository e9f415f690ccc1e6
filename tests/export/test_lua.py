"""The Wireshark dissector, run by the real tshark, shows what our dissector shows: every field, octet for octet."""

from __future__ import annotations

from pathlib import Path

import pytest

from dcp_codec import Codec, get_codec
from dcp_codec.capture import create_capture, open_capture
from dcp_codec.export.lua import wireshark_dissector
from dcp_codec.testing import strategies

from .beacons import RECORDINGS, drawn, everything, malformed
from .wireshark import compare, write

pytestmark = [pytest.mark.tool("tshark"), pytest.mark.part("tools")]


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda path: path.stem)
def test_every_field_of_the_recordings_agrees(recording: Path, tmp_path: Path) -> None:
    codec = get_codec("cpp-1.3" if "v1.3" in recording.stem else "cpp-2.0")
    capture = tmp_path / "capture.pcap"
    with open_capture(recording) as frames, create_capture(capture) as copy:
        for frame in frames:
            copy.write(frame)
    compared, found = compare(codec, wireshark_dissector(codec), capture)
    assert found == []
    assert compared > 10_000


def test_every_field_of_every_layout_agrees(codec: Codec, tmp_path: Path) -> None:
    octets = codec.encode(everything(codec))
    payloads = [octets, octets + bytes(7), *drawn(strategies.beacons(codec).map(codec.encode), 60)]
    compared, found = compare(
        codec, wireshark_dissector(codec), write(tmp_path / "c.pcap", codec.profile.link, payloads)
    )
    assert found == []
    assert compared > 500


def test_malformed_beacons_have_the_same_fields_and_problems(codec: Codec, tmp_path: Path) -> None:
    beacons = strategies.beacons(codec).map(codec.encode)
    mutations = strategies.mutations(beacons, codec.dissect)
    payloads = [*malformed(codec, codec.encode(everything(codec))), *drawn(mutations, 100)]
    _, found = compare(codec, wireshark_dissector(codec), write(tmp_path / "c.pcap", codec.profile.link, payloads))
    assert found == []
