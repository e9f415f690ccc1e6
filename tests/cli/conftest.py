"""Run ``dcp-codec`` in this process and keep what it printed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from dcp_codec import Codec
from dcp_codec.capture import Frame, create_capture
from dcp_codec.cli import main
from dcp_codec.values import Beacon, BPHeader, Container, Payload, VarCreate, VarSpec, VarSumm, VarUpdate

NODE = bytes.fromhex("020000000001")
ETHERNET = b"\xff" * 6 + NODE + bytes.fromhex("4953")
START_NS = 1_795_225_151_000_000_123


class Result(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    def call(*args: object) -> Result:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(arg) for arg in args])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return Result(int(stop.value.code or 0), captured.out, captured.err)

    return call


def beacon(seqno: int, *, sender: bytes = NODE) -> Beacon:
    """A beacon that creates variable 7 and summarises 7 and 9."""
    create = VarCreate(VarSpec(7, sender, 2, b"pos", creation_time=START_NS, timeout=5000), VarUpdate(7, 3, b"ABCD"))
    containers = (Container(5, (create,)), Container(1, (VarSumm(7, 3), VarSumm(9, 0))))
    return Beacon(BPHeader(sender, seqno, network_id=0x1111), (Payload(2, containers),))


def frames_of(*octets: bytes) -> list[Frame]:
    """Frames 100 ms apart."""
    return [
        Frame(number=index + 1, time_ns=START_NS + index * 100_000_000, data=data, orig_len=len(data))
        for index, data in enumerate(octets)
    ]


def write(path: Path, *octets: bytes) -> Path:
    """A capture of these Ethernet frames."""
    with create_capture(path) as writer:
        for frame in frames_of(*octets):
            writer.write(frame)
    return path


@pytest.fixture
def codec() -> Codec:
    return Codec("cpp-2.0")


@pytest.fixture
def good(codec: Codec) -> list[bytes]:
    """Five good frames of two senders; the last has bearer padding."""
    other = bytes.fromhex("020000000002")
    frames = [ETHERNET + codec.encode(beacon(seqno)) for seqno in range(3)]
    frames.append(ETHERNET + codec.encode(beacon(40, sender=other)))
    frames.append(ETHERNET + codec.encode(beacon(41, sender=other)) + b"\0" * 9)
    return frames
