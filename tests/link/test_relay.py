"""The relay between virtual Ethernet interfaces, in real time: what it forwards, when, and what it survives."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median

import pytest
from dcp_lab.relay import RelayError, RelayFabric
from dcp_lab.relay.control import RelayProcess
from dcp_lab.relay.messages import Setup
from dcp_lab.sim.testbed import namespaces
from dcp_lab.sim.testbed.place import INTERFACE

from dcp_codec.capture import open_capture
from dcp_codec.impairment import Impairment, parse_impairment
from dcp_codec.network.namespaces import batch

from ..waiting import eventually

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")
pytestmark = pytest.mark.tool("ip")

ETHER_TYPE = 0x88B5
ADDRESSES = [bytes([2, 0, 0, 0, 0, number]) for number in range(3)]
_CLONE_NEWNET = 0x40000000


@pytest.fixture(scope="module", autouse=True)
def rights() -> None:
    if shutil.which("ip") is None:
        return
    if not namespaces.permitted():
        message = "network namespaces cannot be made here: run as root (CAP_NET_ADMIN)"
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)


Make = Callable[..., RelayFabric]


@pytest.fixture
def make() -> Iterator[Make]:
    made: list[RelayFabric] = []

    def build(impairment: str = "", **options: object) -> RelayFabric:
        prefix = f"{namespaces.own_prefix()}-r{len(made)}"
        made.append(RelayFabric(prefix, ADDRESSES, impairment=parse_impairment(impairment), **options))
        return made[-1]

    yield build
    for each in made:
        each.close()


Listen = Callable[[str], socket.socket]


@pytest.fixture
def listen() -> Iterator[Listen]:
    """Packet sockets on the interfaces of stations, by namespace."""
    opened: list[socket.socket] = []

    def open_one(namespace: str) -> socket.socket:
        opened.append(socket_in(namespace))
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()


def socket_in(namespace: str) -> socket.socket:
    libc = ctypes.CDLL(None, use_errno=True)
    back, inside = (os.open(name, os.O_RDONLY) for name in ("/proc/self/ns/net", f"/run/netns/{namespace}"))
    try:
        assert libc.setns(inside, _CLONE_NEWNET) == 0
        opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHER_TYPE))
        opened.bind((INTERFACE, ETHER_TYPE))
    finally:
        assert libc.setns(back, _CLONE_NEWNET) == 0
        os.close(back)
        os.close(inside)
    opened.settimeout(5)
    return opened


def frame(sender: int, text: bytes) -> bytes:
    return b"\xff" * 6 + ADDRESSES[sender] + ETHER_TYPE.to_bytes(2, "big") + text


def waiting_in(opened: socket.socket) -> list[bytes]:
    """Frames that have arrived."""
    found = []
    opened.settimeout(0)
    try:
        while True:
            found.append(opened.recv(2000)[14:])
    except BlockingIOError:
        opened.settimeout(5)
        return found


def test_frames_reach_all_nodes_in_range_and_are_recorded(make: Make, listen: Listen, tmp_path: Path) -> None:
    fabric = make(pairs=[(0, 1), (1, 0), (1, 2)], record=tmp_path, profile="dcp-2.0")
    a, b, c = map(listen, fabric.namespaces)
    b.send(frame(1, b"both hear this"))
    assert a.recv(2000) == c.recv(2000) == frame(1, b"both hear this")
    a.send(frame(0, b"only b hears this"))
    assert b.recv(2000)[14:] == b"only b hears this"
    c.send(frame(2, b"no node hears this"))
    b.send(frame(1, b"the end"))
    assert a.recv(2000)[14:] == c.recv(2000)[14:] == b"the end"
    assert waiting_in(b) == []
    counters = fabric.close()
    assert {name: each["delivered"] for name, each in counters["links"].items()} == {"0>1": 1, "1>0": 2, "1>2": 2}
    assert [each["recorded"] for each in counters["ports"]] == [3, 3, 3]
    with open_capture(tmp_path / "port-2.mcap") as capture:
        assert [each.data[14:] for each in capture] == [b"both hear this", b"no node hears this", b"the end"]
        assert capture.metadata["dcp.profile"]["name"] == "dcp-2.0"
    assert namespaces.existing(f"{namespaces.own_prefix()}-r") == []


def test_links_change_while_frames_pass(make: Make, listen: Listen) -> None:
    fabric = make()
    a, b, c = map(listen, fabric.namespaces)

    def hear(text: bytes) -> tuple[list[bytes], list[bytes]]:
        """Frames received by the two other nodes up to a frame that is never blocked."""
        a.send(frame(0, text))
        fabric.partition([])
        fabric.port(2, up=True)
        fabric.set_quality((0, 1), Impairment())
        a.send(frame(0, b"end"))
        found = []
        for each in (b, c):
            heard = []
            while (got := each.recv(2000)[14:]) != b"end":
                heard.append(got)
            found.append(heard)
        return found[0], found[1]

    assert hear(b"1") == ([b"1"], [b"1"])
    fabric.partition([[0, 1], [2]])
    assert hear(b"2") == ([b"2"], [])
    fabric.port(2, up=False)
    assert hear(b"3") == ([b"3"], [])
    fabric.set_quality((0, 1), parse_impairment("loss=1"))
    assert hear(b"4") == ([], [b"4"])
    with pytest.raises(RelayError, match=r"the relay refuses: station 7: there are 0\.\.2"):
        fabric.port(7, up=False)


def test_a_frame_is_sent_at_its_deadline_and_not_before(make: Make, listen: Listen) -> None:
    fabric = make("delay=20ms")
    a, b, _ = map(listen, fabric.namespaces)
    delays, late = [], []
    for number in range(30):
        slept = time.monotonic_ns()
        time.sleep(0.02)
        begun = time.monotonic_ns()
        late.append(begun - slept - 20_000_000)
        a.send(frame(0, bytes([number])))
        assert b.recv(2000)[14:15] == bytes([number])
        delays.append(time.monotonic_ns() - begun)
    assert min(delays) >= 20_000_000
    # Relay and receiver wake up three times for each frame, on a busy machine as late as this process after a pause.
    assert median(delays) < 40_000_000 + 3 * median(late)
    assert fabric.counters()["links"]["0>1"]["delay"] == 30 * 20_000_000


def test_the_relay_survives_strange_frames_and_changes_of_interfaces(make: Make, listen: Listen) -> None:
    fabric = make("delay=1ms")
    a, b, _ = map(listen, fabric.namespaces)
    batch("ip", fabric.air, ["link set p2 mtu 100"])
    for octets in (b"", b"\x00", bytes(1400), os.urandom(900)):
        a.send(frame(0, octets))
        assert b.recv(2000)[14 : 14 + len(octets)] == octets
    eventually(lambda: fabric.counters()["ports"][2]["refused"] == 2, "frames that are too long for port 2 are counted")
    # Not the EtherType of the listener, a VLAN tag, and a length in place of the type.
    for kind in (b"\x08\x00" + b"\x45" * 3, b"\x81\x00\x00\x05\x88\xb5tagged", b"\x00\x05" + bytes(30)):
        a.send(b"\xff" * 6 + ADDRESSES[0] + kind)
    batch("ip", fabric.air, ["link set p0 down", "link set p0 up"])
    batch("ip", fabric.namespaces[2], [f"link del {INTERFACE}"])
    eventually(lambda: fabric.counters()["ports"][2]["outages"] > 0, "a removed interface is noticed")
    batch("ip", fabric.air, [f"link add p2 type veth peer name {INTERFACE} netns {fabric.namespaces[2]}"])
    batch("ip", fabric.air, ["link set p2 addrgenmode none up"])
    batch("ip", fabric.namespaces[2], [f"link set {INTERFACE} addrgenmode none up"])
    c = listen(fabric.namespaces[2])
    c.settimeout(0.1)

    def heard_again() -> bool:
        a.send(frame(0, b"are you there"))
        try:
            return c.recv(2000)[14:] == b"are you there"
        except TimeoutError:
            return False

    eventually(heard_again, "an interface that comes back is used again")


def test_an_invalid_setup_is_refused() -> None:
    with pytest.raises(RelayError, match=r"port 0, interface nowhere: there is no such interface"):
        RelayProcess(Setup(ports=("nowhere",)))
    with pytest.raises(RelayError, match=r"los: unknown key"):
        RelayProcess(Setup(ports=(), impairment="los=1"))


def test_a_killed_relay_is_reported(make: Make) -> None:
    fabric = make()
    os.kill(fabric._relay.pid, signal.SIGKILL)
    with pytest.raises(RelayError, match="the relay has ended"):
        fabric.counters()
    assert fabric.close() == {}
