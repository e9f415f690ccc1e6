"""Columns say what the scalar codec says: on every recording, in every profile, on good and on bad octets."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from dcp_lab.testing import strategies
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.rules import contradictions
from dcp_tables.table.decoding import ColumnDecoder
from dcp_tables.table.input.sources import Recording, packed
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec import Codec
from dcp_codec.capture import Frame

from ..chance import examples
from ..codec.test_any_profile import profiles
from .conftest import CAPTURES

#: Profiles that are compiled; all others are run as plain Python, from the same source.
COMPILED = ("cpp-2.0", "student-2024")
#: Of the frames of each recording, one of so many is damaged.
DAMAGED_ONE_OF = dict(zip(CAPTURES, (2, 3, 7, 2), strict=True))


def framed(codec: Codec, octets: bytes, number: int = 1) -> Frame:
    """A bearer payload as the profile's link carries it."""
    link, addresses = codec.profile.link, bytes(range(1, 7)) + bytes([2, 0, 0, 0, 0, number % 256])
    if link.transport == "ethernet":
        assert link.ether_type is not None
        data = addresses + link.ether_type.to_bytes(2, "big") + octets
    else:
        assert link.udp_port is not None
        size = 8 + len(octets)
        udp = bytes(2) + link.udp_port.to_bytes(2, "big") + (size & 0xFFFF).to_bytes(2, "big") + bytes(2)
        data = addresses + b"\x86\xdd\x60\0\0\0" + bytes(2) + b"\x11" + bytes(33) + udp + octets
    return Frame(number, number * 1_000_003, data, len(data) + number, number % 3)


def decoded(decoder: ColumnDecoder, blocks: Any, rows: Any) -> dict[str, list[dict[str, Any]]]:
    tables: dict[str, list[dict[str, Any]]] = defaultdict(list)
    frames = 0
    for block in blocks:
        done = 0
        for batch in decoder.batches(block):
            done += batch.frames
            errors = batch.tables["errors"]
            assert len(set(errors.column("frame").to_pylist())) == batch.malformed
            assert batch.frames - batch.malformed <= batch.tables["beacons"].num_rows + batch.other <= batch.frames
            for name, table in batch.tables.items():
                table.validate(full=True)
                tables[name] += rows(table)
        assert done == block.frames
        frames += done
    return tables


@pytest.fixture(scope="session")
def decoder_of(odd_codec):
    made: dict[str, ColumnDecoder] = {}

    def make(name: str) -> ColumnDecoder:
        if name not in made:
            made[name] = ColumnDecoder(odd_codec(name), interpret=name not in COMPILED)
        return made[name]

    return make


@pytest.mark.part("tables")
def test_every_recording(recording, reference, rows, differ, frames_of):
    path, codec = recording
    with Recording(path) as source:
        found = decoded(ColumnDecoder(codec), source.blocks(), rows)
        assert source.problems == []
    frames = frames_of(path)
    assert source.frames == len(frames)
    assert differ(found, reference(codec, frames)) == []


@pytest.mark.part("tables")
def test_damaged_recordings(recording, reference, rows, differ, frames_of):
    """Every second, third or seventh frame of each recording with an octet changed, cut off, or both."""
    path, codec = recording
    every = DAMAGED_ONE_OF[path.name]
    rng = np.random.default_rng(every)
    frames = []
    for frame in frames_of(path):
        data = bytearray(frame.data)
        if frame.number % every == 0:
            for _ in range(int(rng.integers(1, 4))):
                data[int(rng.integers(0, len(data)))] = int(rng.integers(0, 256))
            data = data[: int(rng.integers(0, 2 * len(data)))]
        frames.append(Frame(frame.number, frame.time_ns, bytes(data), frame.orig_len))
    found = decoded(ColumnDecoder(codec), [packed(frames, 0)], rows)
    assert found["errors"]
    assert differ(found, reference(codec, frames)) == []


def test_any_message(any_profile, decoder_of, reference, rows, differ):
    decoder = decoder_of(any_profile)
    codec = decoder.codec
    beacons = strategies.beacons(codec).map(codec.encode)
    octets = st.one_of(beacons, strategies.mutations(beacons, codec.dissect), st.binary(max_size=64))

    @settings(max_examples=examples(15 if any_profile not in COMPILED else 150))
    @given(st.lists(octets, min_size=1, max_size=3), st.binary(max_size=3))
    def check(messages: list[bytes], padding: bytes) -> None:
        frames = [framed(codec, message + padding, number) for number, message in enumerate(messages, start=1)]
        with np.errstate(over="ignore"):
            found = decoded(decoder, [packed(frames, 0)], rows)
        assert differ(found, reference(codec, frames)) == []

    check()


@pytest.mark.part("tables")
@settings(max_examples=examples(60))
@given(profiles().filter(lambda profile: not list(contradictions(profile))), st.data())
def test_any_profile(reference, rows, differ, profile: Profile, data: st.DataObject) -> None:
    codec = Codec(profile)
    octets = codec.encode(data.draw(strategies.beacons(codec)))
    damaged = data.draw(strategies.mutations(st.just(octets), codec.dissect))
    frames = [framed(codec, each, n) for n, each in enumerate((octets, damaged, octets[: len(octets) // 2]), start=1)]
    with np.errstate(over="ignore"):
        found = decoded(ColumnDecoder(codec, interpret=True), [packed(frames, 0)], rows)
    assert differ(found, reference(codec, frames)) == []
