"""Replays of the bundled recordings over virtual Ethernet and UDP, at our node as a process."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from dcp_conformance.cli import main
from dcp_conformance.lower_tester.udp import DEFAULT_GROUP
from dcp_conformance.reference.process import free_port

from ..conformance.command import Command, Result
from .test_conformance_live import ethernet_or_skip

CAPTURES = Path(__file__).resolve().parents[2] / "captures"
#: As many times as fast as recorded: the next one if a busy machine leaves the verdict open.
SPEEDS = (10, 5, 2, *[1] * 12)
FIRST, LAST = "02:00:00:00:00:01", "02:00:00:00:00:03"


@pytest.fixture
def command(capsys) -> Command:
    return Command(capsys, main)


def udp_with(
    node_id: str, program: str = "dcp_stack.cli run", *, profile: str = "cpp-2.0", control: Path | None = None
) -> tuple[object, ...]:
    """Return options that start a node on a UDP link of its own; ``control``: the socket of its upper tester."""
    link = f"udp:{DEFAULT_GROUP}:{free_port()}"
    node = f"{sys.executable} -m {program} --link {link} --node-id {node_id} --profile {profile}"
    options = ("--link", link, "--profile", profile, "--start")
    return (*options, node) if control is None else (*options, f"{node} --control {control}", "--ut", f"unix:{control}")


def replayed(command: Command, *words: object, capture: str = "c_latejoin.mcap") -> Result:
    """Replay a recording until the verdict is not inconclusive (exit status 3)."""
    for speed in SPEEDS:
        done = command("replay", CAPTURES / capture, "--speed", speed, *words)
        if done.status != 3:
            break
    return done


@pytest.mark.parametrize("node", [FIRST, LAST])
def test_our_node_passes_over_ethernet(command, node):
    """The recorded senders include the address that the interface has by default."""
    ethernet_or_skip()
    done = replayed(command, "--node", node)
    assert "over eth:" in done.out
    assert done.status == 0, done.out


def test_our_node_passes_over_udp_without_an_upper_tester(command):
    done = replayed(command, *udp_with(LAST))
    assert done.status == 0, done.out + done.err


RECORDINGS = [
    ("a_bus3.mcap", "cpp-2.0"),
    ("a_bus3_v1.3.6.mcap", "cpp-1.3"),
    ("b_crud.mcap", "cpp-2.0"),
    ("c_latejoin.mcap", "cpp-2.0"),
]


@pytest.mark.parametrize(("capture", "profile"), RECORDINGS)
@pytest.mark.parametrize("link", ["ethernet", "udp"])
def test_our_node_passes_every_recording(command, tmp_path, capture, profile, link):
    if link == "ethernet":
        ethernet_or_skip()
    words = () if link == "ethernet" else ("--node", FIRST, *udp_with(FIRST, profile=profile, control=tmp_path / "n"))
    done = replayed(command, *words, capture=capture)
    assert done.status == 0, done.out + done.err


def test_a_mutant_fails_over_udp(command):
    mutant = "dcp_selftest.mutants M-VD-PU-07-ignored"
    done = replayed(command, "--node", LAST, *udp_with(LAST, mutant))
    assert done.status == 1, done.out + done.err
    assert "VD-CMP-04" in done.out


def test_an_absent_implementation_is_named(command):
    link = f"udp:{DEFAULT_GROUP}:{free_port()}"
    done = command("replay", CAPTURES / "c_latejoin.mcap", "--link", link)
    assert (done.status, done.out) == (2, "")
    assert f"no implementation answers on {link}" in done.err


def test_a_colliding_identifier_is_named(command):
    done = command("replay", CAPTURES / "c_latejoin.mcap", "--node", LAST, *udp_with(FIRST))
    assert (done.status, done.out) == (2, "")
    assert f"the implementation has the identifier {FIRST} of another recorded node" in done.err
