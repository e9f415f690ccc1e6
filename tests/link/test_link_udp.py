"""The UDP link on the loopback interface, without privileges; outages in a network namespace."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from dcp_stack.links.base import LinkError
from dcp_stack.links.udp import UDPLink, open_udp

from ..ports import own_port
from ..waiting import PATIENCE
from .node_processes import eventually

GROUP = "239.73.126.77"
#: Test processes that run side by side must not hear each other.
PORT, OTHER_PORT = own_port(), own_port()


@pytest.fixture
def udp() -> Iterator[Callable[..., UDPLink]]:
    """Opens links, and closes them afterwards."""
    opened: list[UDPLink] = []

    def open_one(group: str = GROUP, port: int = PORT, *arguments, **options) -> UDPLink:
        opened.append(open_udp(group, port, *arguments, **options))
        return opened[-1]

    yield open_one
    for each in opened:
        each.close()


def hear(link: UDPLink, count: int = 1, patience: float = PATIENCE) -> list:
    heard = []
    deadline = time.monotonic() + patience
    while len(heard) < count and time.monotonic() < deadline:
        if select.select([link.fileno()], [], [], 0.05)[0]:
            heard += link.receive()
    return heard


def test_all_hear_each_other_and_not_themselves(udp):
    links = [udp() for _ in range(3)]
    before = time.time_ns()
    for link in links:
        assert link.send(link.source)
    for link in links:
        heard = hear(link, 2)
        assert {each.octets for each in heard} == {other.source for other in links if other is not link}
        # The source is address and port of who sent it.
        assert all(each.octets == each.source for each in heard)
        assert all(before - 1_000_000 <= each.wall <= time.time_ns() + 1_000_000 for each in heard)
        assert hear(link, 1, 0.1) == []
        assert (link.counters.sent, link.counters.received, link.counters.ignored) == (1, 2, 0)


def test_groups_and_ports_are_separate(udp):
    here, elsewhere, group = udp(), udp(port=OTHER_PORT), udp("239.73.126.78")
    here.send(b"x")
    assert hear(elsewhere, 1, 0.1) == []
    assert hear(group, 1, 0.1) == []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        # To the port, but not to the group.
        other.sendto(b"unicast", ("127.0.0.1", PORT))
    assert hear(here, 1, 0.1) == []


def test_broadcast_serves_as_well(udp):
    one, two = udp("127.255.255.255"), udp("127.255.255.255")
    assert one.send(b"to all")
    assert [each.octets for each in hear(two)] == [b"to all"]
    assert hear(one, 1, 0.1) == []


def test_a_burst_is_received_or_counted_as_lost(udp):
    one, two = udp(), udp()
    heard = []
    # As many as the loopback interface queues for the socket: its own drops are not counted anywhere.
    for burst in range(1, 21):
        for _ in range(500):
            assert one.send(bytes(300))
        heard += hear(two, 500 * burst - len(heard) - two.counters.kernel_drops)
        assert len(heard) == two.counters.received
        assert two.counters.received + two.counters.kernel_drops == 500 * burst


def test_losses_in_the_kernel_are_counted(udp):
    one, two = udp(), udp()
    two._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 20_000)
    for _ in range(500):
        one.send(bytes(300))
    eventually(lambda: two.counters.kernel_drops > 250, "most find no room")
    heard = []
    while len(heard) + two.counters.kernel_drops < 500:
        heard += eventually(lambda: hear(two, 1, 0.1), "the rest arrives")
    drops = two.counters.kernel_drops
    assert len(heard) + drops == 500
    assert heard
    assert two.counters.kernel_drops == drops


def test_sizes(udp):
    one, two = udp(), udp(max_packet_size=256)
    assert one.max_packet_size == 65_507
    assert one.send(bytes(65_507))
    assert not one.send(bytes(65_508))
    assert [len(each.octets) for each in hear(two)] == [65_507]
    assert two.send(b"")
    assert not two.send(bytes(257))
    assert [each.octets for each in hear(one)] == [b""]
    assert (one.counters.send_errors, two.counters.send_errors) == (1, 1)


def test_after_close_nothing_happens(udp):
    link = udp()
    link.close()
    link.close()
    assert (link.receive(), link.send(b"x"), link.fileno()) == ([], False, -1)


def test_a_port_with_exclusive_use(udp):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((GROUP, OTHER_PORT))
        with pytest.raises(LinkError, match="another program has this port"):
            udp(port=OTHER_PORT)


@pytest.fixture
def addressed(inside):
    """This thread is inside of the namespace, where ``near`` has an address."""
    inside.ip("address", "add", "192.0.2.1/24", "dev", "near")
    return inside


@pytest.mark.tool("ip")
def test_addresses_are_not_for_any_interface(addressed, udp):
    near = udp(GROUP, PORT, "192.0.2.1")
    assert near.max_packet_size == 1472
    with pytest.raises(LinkError, match=r"no interface has the address 192\.0\.2\.9"):
        udp(GROUP, PORT, "192.0.2.9")


@pytest.mark.tool("ip")
@pytest.mark.parametrize("what", ["interface", "address", "switch"])
def test_an_interface_that_went_away_is_heard_again(addressed, udp, what):
    one, two = udp(GROUP, PORT, "192.0.2.1"), udp(GROUP, PORT, "192.0.2.1")
    descriptors = one.fileno(), two.fileno()
    one.send(b"before")
    assert [each.octets for each in hear(two)] == [b"before"]
    gone = {
        "interface": ("link", "delete", "near"),
        "address": ("address", "delete", "192.0.2.1/24", "dev", "near"),
        "switch": ("link", "set", "near", "down"),
    }[what]
    addressed.ip(*gone)
    assert hear(one, 1, 0.1) == hear(two, 1, 0.1) == []
    assert not one.send(b"to no receiver")
    assert not two.send(b"to no receiver")
    if what == "interface":
        addressed.cable()
    if what == "switch":
        addressed.ip("link", "set", "near", "up")
        addressed.wait_for_carrier()
    else:
        addressed.ip("address", "add", "192.0.2.1/24", "dev", "near")
    # Woken by their descriptors alone.
    for link in (one, two):
        eventually(lambda link=link: not hear(link, 1, 0.05) and not link._down, "the interface is found again")
    assert two.send(b"again")
    assert [each.octets for each in hear(one)] == [b"again"]
    assert one.send(b"back")
    assert [each.octets for each in hear(two)] == [b"back"]
    assert (one.counters.outages, two.counters.outages) == (1, 1)
    assert (one.fileno(), two.fileno()) == descriptors
