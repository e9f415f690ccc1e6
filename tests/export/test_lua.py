"""The Wireshark dissector, run by the real tshark, shows what our dissector shows: every field, octet for octet."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_lab.testing import strategies

from dcp_codec import Codec, get_codec
from dcp_codec.capture import create_capture, open_capture
from dcp_codec.export.lua import wireshark_dissector

from ..odd_profiles import NAMES
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


def test_sound_and_malformed_beacons_of_every_layout_agree(codec: Codec, tmp_path: Path) -> None:
    """Fields and problems, in one capture; profiles take turns with the malformed beacons: each has a third of them."""
    octets = codec.encode(everything(codec))
    beacons = strategies.beacons(codec).map(codec.encode)
    sound = [octets, octets + bytes(7), *drawn(beacons, 60)]
    changes = list(malformed(codec, octets))[NAMES.index(codec.profile.name) % 3 :: 3]
    wrong = [*changes, *drawn(strategies.mutations(beacons, codec.dissect), 100)]
    capture = write(tmp_path / "c.pcap", codec.profile.link, [*sound, *wrong])
    compared, found = compare(codec, wireshark_dissector(codec), capture)
    assert found == []
    assert compared > 500
