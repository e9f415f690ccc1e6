"""The layers say what the codec says, on every recording and in every profile, and give the same octets back."""

from __future__ import annotations

import contextlib
import copy
import pickle
import re
from pathlib import Path
from typing import Any

import pytest
from dcp_lab.testing import strategies
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scapy.layers.l2 import Ether
from scapy.packet import Padding, Raw

from dcp_codec import Codec
from dcp_codec.capture import open_capture
from dcp_codec.framing.locate import Framing, locate
from dcp_codec.jsonform import node_id_octets, node_id_text
from dcp_codec.plan.tree import Scalar, Text
from dcp_codec.scapy.layers import DCPBeacon, DCPPayload, Octets, use_profile
from dcp_codec.views.dissect import Dissection
from dcp_codec.views.dissect import Field as Found

from ..chance import examples
from ..parts import every

RECORDINGS = sorted((Path(__file__).parent.parent.parent / "captures").glob("*.mcap"))
PER_PROFILE = settings(max_examples=examples(12), suppress_health_check=[HealthCheck.function_scoped_fixture])


def reach(beacon: Any, path: str) -> Any:
    """Values of the layers at a path of the codec, such as ``payloads[0].vardis[1].records[2].value.length``."""
    found, previous = beacon, ""
    for name, index in re.findall(r"(\w+)(?:\[(\d+)\])?", path.removeprefix("bp.")):
        if isinstance(found, tuple):
            owner = found[0]
            return owner.getfieldval(previous if name == "data" else f"{previous}L{name[1:]}")
        value = found.getfieldval(name)
        is_leaf = not index and not hasattr(value, "fields_desc")
        found = (found, value) if is_leaf else value[int(index)] if index else value
        previous = name
    return found[1] if isinstance(found, tuple) else found


def expected(codec: Codec, found: Found) -> Any:
    if found.value is None:
        return Octets(found.raw)
    layout = found.layout
    if isinstance(layout, Scalar | Text) and layout.role == "node-id":
        representation = codec.profile.types.node_id.representation
        text = node_id_text(found.value, representation)
        # Text that would not give these octets again, such as a real backslash before an x, is not text.
        return text if node_id_octets(text, representation) == found.value else Octets(found.raw)
    return found.value


def assert_same(codec: Codec, beacon: Any, dissection: Dissection) -> None:
    for found in dissection.root.walk():
        if found.children or isinstance(found.value, float):
            continue
        if isinstance(found.layout, Scalar | Text) and found.value is not None:
            held = reach(beacon, found.path)
            if isinstance(held, Octets) and dissection.errors:
                # A value that would not give these octets again, such as a string without its NUL.
                assert bytes(held) == found.raw, found.path
            else:
                assert held == expected(codec, found), found.path


@pytest.mark.part("suite")
@pytest.mark.skipif(not RECORDINGS, reason="captures/*.mcap are not there")
@pytest.mark.parametrize("path", every(4, RECORDINGS), ids=lambda path: path.stem)
def test_recordings(path: Path) -> None:
    with open_capture(path) as reader:
        frames = list(reader)
        name = reader.metadata["dcp.profile"]["name"]
    codec = use_profile(name)
    beacons = 0
    for frame in frames:
        framing = locate(frame.data, codec.profile.link)
        if not isinstance(framing, Framing):
            continue
        packet = Ether(frame.data)
        beacon = packet[DCPBeacon]
        dissection = codec.dissect(frame.data[framing.start :])
        assert_same(codec, beacon, dissection)
        assert bytes(packet) == frame.data
        padding = packet[Padding].load if Padding in packet else b""
        assert padding == dissection.padding
        beacon.clear_derived()
        assert beacon.length is None
        assert bytes(packet) == frame.data
        beacons += 1
    assert beacons > 200


@PER_PROFILE
@given(data=st.data())
def test_every_profile(codec: Codec, data: st.DataObject) -> None:
    octets = codec.encode(data.draw(strategies.beacons(codec)))
    beacon = DCPBeacon(octets)
    dissection = codec.dissect(octets)
    assert_same(codec, beacon, dissection)
    assert bytes(beacon) == octets
    assert not [problem for problem in beacon.problems if problem.severity == "error"]
    beacon.clear_derived()
    assert bytes(beacon) == octets


@PER_PROFILE
@given(data=st.data())
def test_copies(codec: Codec, data: st.DataObject) -> None:
    octets = codec.encode(data.draw(strategies.beacons(codec)))
    beacon = DCPBeacon(octets)
    for other in (beacon.copy(), copy.deepcopy(beacon), pickle.loads(pickle.dumps(beacon)), beacon / Raw(b"")):
        assert bytes(other) == octets
    twin = beacon.copy()
    for block in twin.payloads:
        block.length = 0
    assert bytes(beacon) == octets


@PER_PROFILE
@given(data=st.data())
def test_padding_is_not_part_of_the_beacon(codec: Codec, data: st.DataObject) -> None:
    if codec.profile.bp.header == ():
        pytest.skip("without a header nothing says where a beacon ends")
    octets = codec.encode(data.draw(strategies.beacons(codec)))
    beacon = DCPBeacon(octets + bytes(20))
    assert beacon[Padding].load == bytes(20)
    assert bytes(beacon) == octets + bytes(20)
    assert beacon.do_build() == octets


@PER_PROFILE
@given(data=st.data())
def test_damaged_octets_never_raise_and_none_is_lost(codec: Codec, data: st.DataObject) -> None:
    octets = data.draw(strategies.mutations(strategies.beacons(codec).map(codec.encode), codec.dissect))
    whole = Ether(b"\xff" * 6 + bytes(6) + b"\x49\x53" + octets) if octets else Ether()
    assert isinstance(whole.summary(), str)
    beacon = DCPBeacon(octets)
    if not octets:
        return
    assert_same(codec, beacon, codec.dissect(octets))
    assert bytes(beacon) == octets
    assert bytes(beacon.copy()) == octets
    assert "DCP" in beacon.show(dump=True)
    assert repr(beacon)
    assert beacon.summary().startswith("DCP")
    assert beacon == DCPBeacon(octets) or b"\x7f" in octets or b"\xff" in octets  # NaN is not equal to itself
    beacon.clear_derived()
    # A length may be gone that said less than there is, and what there is may be too long to be announced.
    with contextlib.suppress(ValueError):
        bytes(beacon)


@settings(max_examples=examples(100), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(octets=st.binary(min_size=1, max_size=200))
def test_any_octets(octets: bytes) -> None:
    for layer in (DCPBeacon, DCPPayload):
        assert bytes(layer(octets)) == octets
