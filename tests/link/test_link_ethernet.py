"""The Ethernet link on a virtual cable, in a network namespace of its own."""

from __future__ import annotations

import select
import selectors
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dcp_stack.links.base import LinkError, Reception
from dcp_stack.links.ethernet import EthernetLink, open_ethernet

from ..waiting import PATIENCE
from .node_processes import eventually

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")
pytestmark = pytest.mark.tool("ip")

ETHER_TYPE = 0x4953
_SOL_PACKET, _PACKET_STATISTICS = 263, 6


class Ear:
    """Waits on the descriptor of a link, which is registered once, as a node does."""

    def __init__(self, link: EthernetLink) -> None:
        self.link = link
        self._selector = selectors.DefaultSelector()
        self._selector.register(link.fileno(), selectors.EVENT_READ)

    def wait_until(self, done: Callable[[list[Reception]], bool], patience: float = PATIENCE) -> list[Reception]:
        """Frames received until ``done`` or the time limit."""
        heard: list[Reception] = []
        deadline = time.monotonic() + patience
        while not done(heard) and time.monotonic() < deadline:
            if self._selector.select(0.05):
                heard += self.link.receive()
        return heard

    def hear(self, count: int = 1) -> list[bytes]:
        heard = self.wait_until(lambda heard: len(heard) >= count)
        return [each.octets for each in heard]

    def hears_nothing(self) -> bool:
        return not self.wait_until(lambda heard: len(heard) > 0, 0.2)

    def close(self) -> None:
        self._selector.close()
        self.link.close()


@pytest.fixture
def ear(inside) -> Iterator[Callable[..., Ear]]:
    """Opens links, and closes them afterwards."""
    opened: list[Ear] = []

    def open_one(interface: str, ether_type: int = ETHER_TYPE, **options) -> Ear:
        opened.append(Ear(open_ethernet(interface, ether_type, **options)))
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()


@pytest.fixture
def raw(inside) -> Iterator[Callable[[bytes], None]]:
    """Sends any frame out of ``far``."""
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as out:
        out.bind(("far", 0))
        yield lambda frame: out.send(frame) and None


def frame(octets: bytes, *, to: bytes = b"\xff" * 6, ether_type: int = ETHER_TYPE) -> bytes:
    return to + b"\x02\0\0\0\0\x99" + ether_type.to_bytes(2, "big") + octets


def test_both_hear_each_other_and_not_themselves(ear):
    near, far = ear("near"), ear("far", source=b"\x02\0\0\0\0\x05")
    before = time.time_ns()
    assert near.link.send(b"from near")
    (heard,) = far.wait_until(lambda heard: len(heard) > 0)
    assert (heard.octets, heard.source) == (b"from near", near.link.source)
    assert before - 1_000_000 <= heard.wall <= time.time_ns() + 1_000_000
    # Stamps are of the kernel, in nanoseconds.
    assert far.link.send(b"from far")
    (heard,) = near.wait_until(lambda heard: len(heard) > 0)
    assert (heard.octets, heard.source) == (b"from far", b"\x02\0\0\0\0\x05")
    assert near.hears_nothing()
    assert far.hears_nothing()
    for each in (near, far):
        counters = each.link.counters
        assert (counters.sent, counters.received, counters.ignored, counters.outages) == (1, 1, 0, 0)


def test_frames_are_broadcast_with_source_and_type(ear, inside):
    near = ear("near", source=b"\x02\0\0\0\0\x07")
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3)) as tap:
        tap.bind(("far", 3))
        tap.settimeout(PATIENCE)
        near.link.send(b"octets")
        assert tap.recv(100) == b"\xff" * 6 + b"\x02\0\0\0\0\x07" + b"\x49\x53" + b"octets"


def test_padding_is_passed_to_bp(ear, raw):
    near = ear("near")
    raw(frame(b"x".ljust(46, b"\0")))
    raw(frame(b""))
    raw(frame(b"y"))
    assert near.hear(3) == [b"x".ljust(46, b"\0"), b"", b"y"]


def test_other_ether_types_do_not_pass_the_kernel(ear, raw):
    near = ear("near")
    for _ in range(1000):
        raw(frame(b"other", ether_type=0x88B5))
    assert near.hears_nothing()
    # Not even seen by the socket, let alone queued or ignored here.
    seen = struct.unpack("II", near.link._socket.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))
    assert (seen, near.link.counters.ignored) == ((0, 0), 0)
    raw(frame(b"ours"))
    assert near.hear() == [b"ours"]


def test_frames_for_others_and_tagged_frames_are_ignored_and_own_addresses_counted(ear, raw, inside):
    near = ear("near", source=b"\x02\0\0\0\0\x01")
    # So that the kernel shows frames for other stations at all.
    inside.ip("link", "set", "near", "promisc", "on")
    raw(frame(b"for another", to=b"\x02\0\0\0\0\x77"))
    raw(frame(struct.pack(">HH", 5, ETHER_TYPE) + b"tagged", ether_type=0x8100))
    raw(frame(struct.pack(">HH", 5, ETHER_TYPE) + b"tagged", ether_type=0x8100, to=b"\x33\x33\0\0\0\x01"))
    raw(b"\xff" * 6 + near.link.source + b"\x49\x53" + b"from our address")
    raw(frame(b"for us", to=near.link.source))
    raw(frame(b"multicast", to=b"\x33\x33\0\0\0\x01"))
    raw(frame(b"for all"))
    # Only BP can tell a reflection from the frame of another node with the same address, by the senderId.
    assert near.hear(4) == [b"from our address", b"for us", b"multicast", b"for all"]
    assert near.link.counters.ignored == 3
    assert near.link.counters.own_address == 1


def test_priority_tags_are_accepted_and_vlan_tags_are_not(ear, raw, inside):
    near = ear("near")
    for destination in (b"\xff" * 6, b"\x33\x33\0\0\0\x01", near.link.source):
        raw(frame(struct.pack(">HH", 5, ETHER_TYPE) + b"of a VLAN", ether_type=0x8100, to=destination))
    raw(frame(struct.pack(">HH", 0xA000, ETHER_TYPE) + b"urgent", ether_type=0x8100))
    assert near.hear() == [b"urgent"]
    assert near.link.counters.ignored == 3


def test_a_burst_is_received_or_counted_as_lost(ear, inside):
    near, far = ear("near"), ear("far")
    for number in range(10_000):
        assert near.link.send(number.to_bytes(4, "big") + bytes(300))

    def accounted(heard: list[Reception]) -> bool:
        return len(heard) + far.link.counters.kernel_drops + inside.lost_on_the_cable() >= 10_000

    heard = [each.octets for each in far.wait_until(accounted)]
    counters = far.link.counters
    assert len(heard) == counters.received
    assert counters.received + counters.kernel_drops + inside.lost_on_the_cable() == 10_000
    assert [int.from_bytes(octets[:4], "big") for octets in heard] == sorted(
        int.from_bytes(octets[:4], "big") for octets in heard
    )


def test_losses_in_the_kernel_are_counted(ear):
    near, far = ear("near"), ear("far")
    far.link._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
    for _ in range(1000):
        near.link.send(bytes(300))
    eventually(lambda: far.link.counters.kernel_drops > 500, "most find no room")
    heard = far.wait_until(lambda heard: len(heard) + far.link.counters.kernel_drops >= 1000)
    drops = far.link.counters.kernel_drops
    assert len(heard) + drops == 1000
    assert heard
    # Looking does not forget.
    assert far.link.counters.kernel_drops == drops


def test_a_failure_to_send_is_reported_once(ear, inside, caplog):
    near = ear("near")
    inside.ip("link", "set", "near", "mtu", "100")
    for _ in range(3):
        assert not near.link.send(bytes(200))
        assert near.link.send(bytes(50))
    assert [each.getMessage() for each in caplog.records if each.levelname == "WARNING"] == [
        "eth:near: 200 octets cannot be sent: Message too long"
    ]
    assert near.link.counters.outages == 0


def test_frames_that_are_too_long_are_counted_and_not_sent(ear, inside):
    near = ear("near")
    assert near.link.max_packet_size == 1500
    assert near.link.send(bytes(1500))
    assert not near.link.send(bytes(1501))
    # Here the system refuses.
    large = ear("near", max_packet_size=4000)
    assert not large.link.send(bytes(3000))
    assert large.link.send(b"x")
    assert (near.link.counters.send_errors, large.link.counters.send_errors) == (1, 1)
    assert large.link.counters.outages == 0


def test_received_frames_longer_than_the_buffer_are_ignored(ear, inside):
    inside.ip("link", "set", "lo", "up", "mtu", "100000")
    one, two = ear("lo"), ear("lo")
    assert one.link.send(bytes(90_000))
    assert one.link.send(bytes(65_535))
    assert [len(octets) for octets in two.hear()] == [65_535]
    assert (two.link.counters.received, two.link.counters.ignored) == (1, 1)


def test_a_full_queue_of_the_interface_loses_frames_but_not_the_link(ear, inside):
    narrow(inside, "near")
    near, far = ear("near"), ear("far")
    sent = sum(near.link.send(bytes(1000)) for _ in range(100))
    counters = near.link.counters
    assert 0 < sent < 100
    assert (counters.sent, counters.send_errors, counters.outages) == (sent, 100 - sent, 0)
    assert len(far.hear(sent)) == sent


def test_a_link_without_a_carrier_is_not_up(ear, inside):
    near = ear("near")
    assert near.link.up
    # The other end: this interface stays switched on.
    inside.ip("link", "set", "far", "down")
    eventually(lambda: not near.link.up, "the carrier is lost")
    assert near.link.counters.outages == 0
    inside.ip("link", "set", "far", "up")
    eventually(lambda: near.link.up, "the carrier is back")


def narrow(inside, interface: str) -> None:
    """Let few frames wait before the interface, and pass slowly."""
    queue = ["tbf", "rate", "400kbit", "burst", "2000", "limit", "4000"]
    command = ["tc", "-n", inside.name, "qdisc", "add", "dev", interface, "root", *queue]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        pytest.skip(f"no queue can be made here: {done.stderr.strip()}")


def test_jumbo_frames(ear, inside):
    for interface in ("near", "far"):
        inside.ip("link", "set", interface, "mtu", "9000")
    near, far = ear("near"), ear("far")
    assert near.link.max_packet_size == 9000
    assert near.link.send(bytes(9000))
    assert not near.link.send(bytes(9001))
    assert [len(octets) for octets in far.hear()] == [9000]


def settled(far: Ear, outages: int) -> bool:
    """Whether the link is back; it is woken by its descriptor alone."""
    far.wait_until(lambda _: far.link.counters.outages == outages and not far.link._down)
    return not far.link._down


def test_an_interface_that_goes_down_and_up_again_is_heard_again(ear, inside):
    near, far = ear("near"), ear("far")
    descriptor = far.link.fileno()
    for times in (1, 2):
        inside.ip("link", "set", "far", "down")
        far.wait_until(lambda _, times=times: far.link.counters.outages == times)
        assert not far.link.send(b"to no receiver")
        assert far.hears_nothing()
        inside.ip("link", "set", "far", "up")
        assert settled(far, times)
        inside.wait_for_carrier()
        assert near.link.send(b"again")
        assert far.hear() == [b"again"]
        assert far.link.send(b"back")
        assert near.hear() == [b"back"]
    counters = far.link.counters
    assert (counters.outages, counters.send_errors, far.link.fileno()) == (2, 2, descriptor)


def test_an_interface_may_come_up_again_with_another_address(ear, inside):
    near, far = ear("near"), ear("far")
    inside.ip("link", "set", "far", "down")
    far.wait_until(lambda _: far.link.counters.outages == 1)
    inside.ip("link", "set", "far", "address", "02:00:00:00:00:aa")
    inside.ip("link", "set", "far", "up")
    assert settled(far, 1)
    inside.wait_for_carrier()
    assert far.link.send(b"back")
    (heard,) = near.wait_until(lambda heard: len(heard) > 0)
    assert heard.source == far.link.source == bytes.fromhex("0200000000aa")


def test_frames_queued_when_the_interface_went_down_are_discarded(ear, inside):
    near, far = ear("near"), ear("far")
    for times, notice in enumerate((far.link.receive, lambda: far.link.send(b"to no receiver") or []), start=1):
        assert near.link.send(b"before")
        assert select.select([far.link._socket], [], [], PATIENCE)[0]
        inside.ip("link", "set", "far", "down")
        before = [each.octets for each in notice()]
        assert far.link.counters.outages == times
        assert before in ([], [b"before"])
        inside.ip("link", "set", "far", "up")
        heard = far.wait_until(lambda _: not far.link._down)
        inside.wait_for_carrier()
        assert near.link.send(b"after")
        heard += far.wait_until(lambda heard: any(each.octets == b"after" for each in heard))
        assert [each.octets for each in heard] == [b"after"]
    assert (far.link.counters.received, far.link.counters.ignored) == (2, 2)


def test_a_missing_privilege_to_reopen_is_reported_once(inside):
    code = """
import logging, os, sys
from dcp_stack.links.ethernet import open_ethernet
logging.basicConfig(stream=sys.stdout, format="%(message)s")
link = open_ethernet("far", 0x4953)
os.setresgid(65534, 65534, 65534)
os.setresuid(65534, 65534, 65534)
print("ready")
for line in sys.stdin:
    link.receive()
    print("looked")
"""
    process = inside.python(code)
    assert process.line() == "ready"

    def look() -> list[str]:
        process.say("look")
        return list(iter(process.line, "looked"))

    inside.ip("link", "delete", "far")
    said = look()
    inside.cable()
    deadline = time.monotonic() + PATIENCE
    while not any("sudo setcap cap_net_raw+ep" in line for line in said) and time.monotonic() < deadline:
        said += look()
    for _ in range(20):
        time.sleep(0.05)
        said += look()
    assert said[0].startswith("eth:far: went down")
    assert sum("this needs the right to open raw sockets" in line for line in said) == 1
    assert len(said) == 3


def test_an_interface_that_is_removed_and_made_again_is_heard_again(ear, inside):
    near, far = ear("near"), ear("far")
    first_source, descriptor = far.link.source, far.link.fileno()
    for times in (1, 2):
        inside.ip("link", "delete", "far")
        for each in (near, far):
            each.wait_until(lambda _, each=each, times=times: each.link.counters.outages == times)
            assert not each.link.send(b"to no receiver")
            assert each.hears_nothing()
        inside.cable()
        assert settled(near, times)
        assert settled(far, times)
        assert near.link.send(b"again")
        assert far.hear() == [b"again"]
        assert far.link.send(b"back")
        assert [each.source for each in near.wait_until(lambda heard: len(heard) > 0)] == [far.link.source]
    # The address is that of the new interface.
    assert far.link.source != first_source
    assert far.link.fileno() == descriptor


def test_an_interface_may_be_replaced_between_two_calls(ear, inside):
    near, far = ear("near"), ear("far")
    inside.ip("link", "delete", "far")
    inside.cable()
    assert far.link.receive() == []
    assert near.link.send(b"first try")
    assert far.hear() == [b"first try"]
    assert far.link.counters.outages == near.link.counters.outages == 1


def test_without_a_watch_calls_find_the_interface_again(ear, inside):
    near, far = ear("near"), ear("far")
    for each in (near, far):
        each.link._selector.unregister(each.link._watch)
        each.link._watch.close()
        each.link._watch = None
    inside.ip("link", "delete", "far")
    near.wait_until(lambda _: near.link.counters.outages == 1)
    far.wait_until(lambda _: far.link.counters.outages == 1)
    inside.cable()
    deadline = time.monotonic() + PATIENCE
    while not (near.link.send(b"beacon") and far.link.receive()) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert near.link.send(b"found")
    assert far.wait_until(lambda heard: any(each.octets == b"found" for each in heard))[-1].octets == b"found"


def test_the_loopback_interface_serves_nodes_on_one_host(ear, inside):
    inside.ip("link", "set", "lo", "up")
    one, two = ear("lo"), ear("lo")
    assert one.link.source != two.link.source
    assert one.link.source[0] == 2
    assert one.link.send(b"to two")
    assert two.hear() == [b"to two"]
    assert one.hears_nothing()


def test_all_on_a_bridge_hear_each_other(ear, inside):
    inside.ip("link", "add", "hub", "type", "bridge")
    inside.ip("link", "set", "hub", "up")
    names = ("one", "two", "three")
    for name in names:
        inside.ip("link", "add", name, "type", "veth", "peer", "name", f"{name}-port")
        inside.ip("link", "set", f"{name}-port", "master", "hub")
        for end in (name, f"{name}-port"):
            inside.ip("link", "set", end, "up")
    ears = [ear(name) for name in names]

    def all_beacon(heard: list[Reception]) -> bool:
        # A bridge forwards only when its ports are ready, so each node sends until all are heard.
        for name, each in zip(names, ears, strict=True):
            each.link.send(name.encode())
        return len({each.octets for each in heard}) == 2

    for name, each in zip(names, ears, strict=True):
        assert {found.octets.decode() for found in each.wait_until(all_beacon)} == set(names) - {name}


def test_without_scapy_the_error_names_the_package_to_install(inside, monkeypatch):
    monkeypatch.setitem(sys.modules, "scapy.layers.l2", None)
    with pytest.raises(LinkError, match=r"pip install 'dcp-conformance-kit\[scapy\]'"):
        open_ethernet("near", ETHER_TYPE)


def test_after_close_nothing_happens(ear):
    near = ear("near")
    near.link.close()
    near.link.close()
    assert (near.link.receive(), near.link.send(b"x"), near.link.fileno()) == ([], False, -1)
    assert near.link.counters.send_errors == 1


def test_errors_are_reported(inside):
    with pytest.raises(LinkError, match=r"eth:wlan7: there is no such interface; there are .*near"):
        open_ethernet("wlan7", ETHER_TYPE)
    inside.ip("link", "set", "near", "down")
    with pytest.raises(LinkError, match="ip link set near up"):
        open_ethernet("near", ETHER_TYPE)
    with pytest.raises(ValueError, match="6"):
        open_ethernet("far", ETHER_TYPE, source=b"short")
    with pytest.raises(ValueError, match="0x0045"):
        open_ethernet("far", 0x45)


def test_other_kinds_of_interfaces_are_refused(inside):
    made = subprocess.run(["ip", "tuntap", "add", "tube", "mode", "tun"], capture_output=True, text=True, check=False)
    if made.returncode != 0:
        pytest.skip(f"no tun interface can be made here: {made.stderr.strip()}")
    inside.ip("link", "set", "tube", "up")
    with pytest.raises(LinkError, match="not Ethernet"):
        open_ethernet("tube", ETHER_TYPE)


def test_without_the_privilege_the_error_says_how_to_get_it(inside):
    code = """
from dcp_stack.links.base import LinkError
from dcp_stack.links.ethernet import open_ethernet
try:
    open_ethernet("near", 0x4953)
except LinkError as error:
    print(error)
"""
    # Still root otherwise: another user might not be allowed to read the folder of this project.
    command = ["setpriv", "--bounding-set", "-net_raw", sys.executable, "-c", code]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "sudo setcap cap_net_raw+ep" in said
    # All users share the interpreter of the system.
    assert str(Path(sys.executable).resolve()) not in said


def test_two_links_on_one_interface_do_not_hear_each_other_but_a_third_hears_both(ear):
    """Linux shows what goes out to sockets for all EtherTypes only; for nodes on one host there is macvlan."""
    first, second = ear("near"), ear("near", source=bytes.fromhex("0200000000ff"))
    other = ear("far")
    assert first.link.send(b"of the first")
    assert second.link.send(b"of the second")
    assert sorted(other.hear(2)) == [b"of the first", b"of the second"]
    assert first.hears_nothing()
    assert second.hears_nothing()
    assert (first.link.counters.ignored, second.link.counters.ignored) == (0, 0)


def test_nodes_on_one_host_hear_each_other_over_macvlan_interfaces(ear, inside):
    for name in ("one", "two"):
        inside.ip("link", "add", name, "link", "near", "type", "macvlan", "mode", "bridge")
        inside.ip("link", "set", name, "up")
    inside.wait_for_carrier("one", "two")
    first, second, other = ear("one"), ear("two"), ear("far")
    assert first.link.send(b"hello")
    assert second.hear() == [b"hello"]
    assert other.hear() == [b"hello"]
    assert first.hears_nothing()
