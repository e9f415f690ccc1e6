"""Lower testers on a virtual cable and on the loopback interface."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import pytest
from dcp_conformance.errors import LowerTesterError, UsageError
from dcp_conformance.lower_tester import Arrival, LowerTester, open_ethernet, open_udp
from dcp_conformance.lower_tester.sockets import Echoes
from dcp_conformance.lower_tester.udp import DEFAULT_GROUP, parse_udp
from dcp_conformance.reference.namespace import SUT_INTERFACE, TESTER_INTERFACE, Namespace, NamespaceError
from dcp_spec.profile.definition import Link

from .. import waiting
from ..ports import own_port

ETHERNET = Link(ether_type=0x4953)
UDP = Link(transport="udp", udp_port=5950)
PEERS = [bytes.fromhex("02dc90000001"), bytes.fromhex("02dc90000002")]
BROADCAST = b"\xff" * 6
MS = 1_000_000
PATIENCE = int(waiting.PATIENCE * 1000 * MS)
#: Test processes that run side by side must not hear each other.
PORT = own_port()


def hear(lower: LowerTester, count: int = 1, patience: int = PATIENCE) -> list[Arrival]:
    """So many arrivals, or those that came in time."""
    found: list[Arrival] = []
    until = lower.now() + patience
    while len(found) < count and (arrival := lower.receive(until)) is not None:
        found.append(arrival)
    return found


def heard_and_dropped(lower: LowerTester, count: int) -> tuple[int, int]:
    """Number of received frames, and of frames dropped by the kernel, as soon as ``count`` are accounted for."""
    heard = dropped = 0
    until = lower.now() + PATIENCE
    while heard + dropped < count and lower.now() < until:
        heard += len(hear(lower, count, 20 * MS))
        dropped += lower.health().dropped
    assert heard + dropped == count
    return heard, dropped


@pytest.fixture
def cable() -> Iterator[Namespace]:
    """A network of its own."""
    try:
        made = Namespace(b"\x02\0\0\0\0\x01")
    except NamespaceError as error:
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(f"no network namespace: {error}", pytrace=False)
        pytest.skip(f"no network namespace: {error}")
    yield made
    made.close()


@pytest.fixture
def ends(cable) -> Iterator[Callable[..., LowerTester]]:
    """Opens a lower tester at an end of the cable."""
    made: list[LowerTester] = []

    def make(interface: str = TESTER_INTERFACE, link: Link = ETHERNET, **keys) -> LowerTester:
        with cable.entered():
            made.append(open_ethernet(interface, link, **keys))
        return made[-1]

    yield make
    for each in made:
        each.close()
        each.close()


def ip(cable: Namespace, *arguments: str) -> None:
    """Run ``ip`` in the namespace."""
    with cable.entered():
        subprocess.run(["ip", *arguments], check=True)


@pytest.mark.tool("ip")
class TestEthernet:
    """On a virtual cable."""

    def test_frames_arrive_unchanged(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        before = near.now()
        sent = [near.send(f"beacon {n}".encode(), peer) for n, peer in enumerate(PEERS)]
        assert sent[1] == BROADCAST + PEERS[1] + b"\x49\x53" + b"beacon 1"
        heard = hear(far, 2)
        assert [each.frame for each in heard] == sent
        assert [each.source for each in heard] == PEERS
        assert [each.octets for each in heard] == [b"beacon 0", b"beacon 1"]
        assert before <= heard[0].time <= heard[1].time <= far.now()
        assert all(abs(each.wall - far.wall()) < 30_000 * MS for each in heard)
        # Its own frames it does not hear.
        assert near.receive(near.now() + 20 * MS) is None

    def test_only_frames_of_the_type_without_tags(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        for ether_type in ("0800", "4954", "8100000a4953", "4953"):
            near.send_frame(BROADCAST + PEERS[0] + bytes.fromhex(ether_type) + b"?" * 50)
        # Unicast frames to other stations are received, too: the implementation should not send them.
        near.send_frame(PEERS[1] + PEERS[0] + b"\x49\x53" + b"!")
        assert [each.frame[:6] for each in hear(far, 2)] == [BROADCAST, PEERS[1]]
        assert far.receive(far.now() + 20 * MS) is None

    def test_priority_tags_are_accepted_and_vlan_tags_are_not(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        for destination in (BROADCAST, b"\x33\x33\0\0\0\x01", b"\x02\0\0\0\0\x01"):
            near.send_frame(destination + PEERS[0] + bytes.fromhex("810000054953") + b"of a VLAN")
        near.send_frame(BROADCAST + PEERS[0] + bytes.fromhex("8100a0004953") + b"urgent")
        assert [each.octets for each in hear(far)] == [b"urgent"]
        assert far.receive(far.now() + 20 * MS) is None

    def test_frames_longer_than_the_buffer_count_as_lost(self, ends, cable):
        ip(cable, "link", "set", "lo", "up", "mtu", "100000")
        near, far = ends("lo"), ends("lo")
        near.send(bytes(90_000), PEERS[0])
        near.send(b"short", PEERS[0])
        assert [each.octets for each in hear(far)] == [b"short"]
        assert far.health().dropped == 1

    def test_a_full_queue_of_the_interface_is_waited_for(self, ends, cable):
        command = ["tc", "qdisc", "add", "dev", TESTER_INTERFACE, "root", "tbf"]
        with cable.entered():
            queue = [*command, "rate", "400kbit", "burst", "2000", "limit", "4000"]
            made = subprocess.run(queue, capture_output=True, text=True, check=False)
        if made.returncode != 0:
            pytest.skip(f"no queue can be made here: {made.stderr.strip()}")
        near, far = ends(), ends(SUT_INTERFACE)
        for number in range(20):
            near.send(number.to_bytes(2, "big") + bytes(1000), PEERS[0])
        assert [int.from_bytes(each.octets[:2], "big") for each in hear(far, 20)] == list(range(20))

    def test_another_type(self, ends):
        near, far = ends(ether_type=0x88B5), ends(SUT_INTERFACE, ether_type=0x88B5)
        near.send(b"x", PEERS[0])
        assert hear(far)[0].frame[12:14] == b"\x88\xb5"

    def test_the_deadline_ends_waiting(self, ends):
        near = ends()
        begun = near.now()
        assert near.receive(begun + 50 * MS) is None
        assert 50 * MS <= near.now() - begun < PATIENCE
        # The past is over at once.
        begun = near.now()
        assert near.receive(begun - 1) is None
        assert near.now() - begun < PATIENCE

    def test_later_frames_are_kept(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        until = far.now()
        near.send(b"late", PEERS[0])
        time.sleep(0.02)
        assert far.receive(until) is None
        assert hear(far)[0].octets == b"late"

    def test_another_descriptor_ends_waiting(self, ends):
        near = ends()
        reading, writing = os.pipe()
        os.write(writing, b"x")
        begun = near.now()
        assert near.receive(begun + PATIENCE, [reading]) is None
        assert near.now() - begun < PATIENCE
        os.close(reading)
        os.close(writing)

    def test_frames_read_late_have_their_time_of_arrival(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        far.health()
        before = near.now()
        near.send(b"x", PEERS[0])
        sent = near.now()
        time.sleep(0.1)
        arrival = hear(far)[0]
        assert before - 2 * MS <= arrival.time <= sent + 50 * MS
        assert far.health().dropped == 0

    def test_drops_are_counted(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        far._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        for _ in range(400):
            near.send(bytes(1400), PEERS[0])
        assert all(each > 0 for each in heard_and_dropped(far, 400))
        assert far.health().dropped == 0

    def test_many_frames_wait(self, ends):
        near, far = ends(), ends(SUT_INTERFACE)
        for number in range(3000):
            near.send(number.to_bytes(2, "big"), PEERS[0])
        assert [int.from_bytes(each.octets, "big") for each in hear(far, 3000)] == list(range(3000))
        assert far.health().dropped == 0

    def test_a_frame_that_is_too_long(self, ends):
        with pytest.raises(LowerTesterError, match="a frame of 1614 octets is longer than the interface carries"):
            ends().send(bytes(1600), PEERS[0])

    def test_an_interface_that_goes_down_and_comes_back(self, ends, cable):
        near, far = ends(), ends(SUT_INTERFACE)
        ip(cable, "link", "set", TESTER_INTERFACE, "down")
        with cable.entered():
            with pytest.raises(LowerTesterError, match="the interface went down; bring it up again: ip link set"):
                near.receive(near.now() + PATIENCE)
            with pytest.raises(LowerTesterError, match="the interface is down; bring it up first"):
                near.send(b"x", PEERS[0])
        ip(cable, "link", "set", TESTER_INTERFACE, "up")
        with cable.entered():
            near.send(b"again", PEERS[0])
        assert hear(far)[0].octets == b"again"

    def test_an_interface_that_vanishes(self, ends, cable):
        near = ends()
        ip(cable, "link", "delete", TESTER_INTERFACE)
        with cable.entered():
            with pytest.raises(LowerTesterError, match="the interface has vanished; is the adapter plugged in"):
                near.receive(near.now() + PATIENCE)
            for _ in range(2):
                with pytest.raises(LowerTesterError, match="eth:dcp-tester: the interface has vanished"):
                    near.send(b"x", PEERS[0])
        # Health can be asked for all the same.
        assert near.health().dropped == 0

    def test_unsuitable_interfaces(self, ends, cable):
        with pytest.raises(UsageError, match="eth:nope0: there is no such interface; there are lo"):
            ends("nope0")
        with pytest.raises(LowerTesterError, match="eth:lo: the interface is down; bring it up first"):
            ends("lo")
        with pytest.raises(UsageError, match="sends beacons over UDP"):
            ends(link=UDP)
        with pytest.raises(UsageError, match="names no EtherType"):
            ends(link=Link())
        closed = ends()
        closed.close()
        with pytest.raises(LowerTesterError, match="closed"):
            closed.receive(0)

    def test_loopback_copies_are_not_echoes(self, ends, cable):
        ip(cable, "link", "set", "lo", "up")
        one, other = ends("lo"), ends("lo")
        one.send(b"x", PEERS[0])
        assert hear(other)[0].octets == b"x"
        assert one.receive(one.now() + 50 * MS) is None
        # An equal frame from another station is received.
        other.send(b"x", PEERS[0])
        assert hear(one)[0].octets == b"x"

    def test_no_privilege(self, cable):
        if os.geteuid() != 0:
            pytest.skip("only root can give its privileges up")
        code = (
            "from dcp_conformance.lower_tester import open_ethernet\n"
            "from dcp_spec.profile.definition import Link\n"
            f"try: open_ethernet('{TESTER_INTERFACE}', Link(ether_type=0x4953))\n"
            "except Exception as error: print(type(error).__name__, error)"
        )
        with cable.entered():
            # Still root otherwise: another user might not be allowed to read the folder of this project.
            command = ["setpriv", "--bounding-set", "-net_raw", sys.executable, "-c", code]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert "LowerTesterError eth:dcp-tester: this needs the right to open raw sockets: run as root" in done.stdout

    def test_no_scapy(self, cable):
        code = (
            "import sys\nsys.modules['scapy'] = None\nfrom dcp_conformance.lower_tester import open_ethernet\n"
            "from dcp_spec.profile.definition import Link\n"
            f"try: open_ethernet('{TESTER_INTERFACE}', Link(ether_type=0x4953))\n"
            "except Exception as error: print(type(error).__name__, error)"
        )
        with cable.entered():
            done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert done.stdout.startswith("LowerTesterError eth:dcp-tester: scapy is not installed: pip install")


@pytest.fixture
def udp() -> Iterator[Callable[..., LowerTester]]:
    """Opens UDP lower testers."""
    made: list[LowerTester] = []

    def make(group: str = DEFAULT_GROUP, port: int | None = PORT, link: Link = ETHERNET, **keys) -> LowerTester:
        made.append(open_udp(group, port, link=link, **keys))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_multicast(udp):
    near, far = udp(), udp()
    sent = near.send(b"beacon", PEERS[0])
    # In a recording it looks as the profile has it.
    assert sent == BROADCAST + PEERS[0] + b"\x49\x53beacon"
    arrival = hear(far)[0]
    assert (arrival.octets, len(arrival.source)) == (b"beacon", 6)
    assert arrival.source[:4] == bytes((127, 0, 0, 1))
    assert arrival.frame.endswith(b"\x49\x53beacon")
    assert near.receive(near.now() + 20 * MS) is None
    # A frame is its payload, if it is a beacon to this link.
    near.send_frame(sent)
    near.send_frame(BROADCAST + PEERS[0] + b"\x08\x00" + b"no beacon")
    near.send_frame(PEERS[1] + PEERS[0] + b"\x49\x53" + b"for another")
    assert [each.octets for each in hear(far)] == [b"beacon"]
    assert far.receive(far.now() + 50 * MS) is None


def test_datagrams_come_from_the_port_where_the_profile_wants_it(udp):
    port = PORT
    near = udp("127.255.255.255", port, link=UDP)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as implementation:
        implementation.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        implementation.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        implementation.bind(("", port))
        near.send(b"hello", PEERS[0])
        assert select.select([implementation], [], [], waiting.PATIENCE)[0]
        octets, sender = implementation.recvfrom(100)
        assert (octets, sender) == (b"hello", ("127.0.0.1", port))
        # Its own is not heard; another one on this host is, though it has the same address.
        assert near.receive(near.now() + 20 * MS) is None
        implementation.sendto(b"hello", ("127.255.255.255", port))
        arrival = hear(near)[0]
        assert arrival.octets == b"hello"
        assert arrival.source == bytes((127, 0, 0, 1)) + port.to_bytes(2, "big")
    # A recorded frame without a beacon header contains UDP.
    assert arrival.frame[12:14] == b"\x08\x00"


def test_unicast(udp):
    one = udp("127.0.0.2", PORT, interface="127.0.0.1")
    other = udp("127.0.0.1", PORT, interface="127.0.0.2")
    one.send(b"there", PEERS[0])
    assert hear(other)[0].octets == b"there"
    other.send(b"and back", PEERS[0])
    assert hear(one)[0].octets == b"and back"


def test_drops_of_udp(udp):
    near, far = udp(), udp()
    far._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    for _ in range(400):
        near.send(bytes(1400), PEERS[0])
    assert all(each > 0 for each in heard_and_dropped(far, 400))
    assert far.health().dropped == 0
    with pytest.raises(LowerTesterError, match="66000 octets do not fit into a datagram"):
        near.send(bytes(66_000), PEERS[0])


@pytest.mark.tool("ip")
def test_udp_over_an_interface_that_vanishes_and_comes_back(cable):
    def unplug() -> None:
        subprocess.run(["ip", "link", "delete", TESTER_INTERFACE], check=True)

    def plug_in() -> None:
        for command in (
            f"link add {TESTER_INTERFACE} up type veth peer name other-end",
            "link set other-end up",
            f"address add 192.0.2.1/24 dev {TESTER_INTERFACE}",
        ):
            subprocess.run(["ip", *command.split()], check=True)

    with contextlib.ExitStack() as stack:
        stack.enter_context(cable.entered())
        unplug()
        plug_in()
        with pytest.raises(
            UsageError, match="the interface other-end has no IPv4 address; see: ip -brief address show"
        ):
            open_udp(interface="other-end")
        one, other = (stack.enter_context(open_udp(interface=TESTER_INTERFACE)) for _ in range(2))
        one.send(b"before", PEERS[0])
        assert hear(other)[0].octets == b"before"
        assert other.receive(0) is None
        unplug()
        with pytest.raises(LowerTesterError, match=r"192\.0\.2\.1 does not reach 239"):
            one.send(b"to no receiver", PEERS[0])
        plug_in()
        # A tester that only listens also reports that it may have missed frames.
        with pytest.raises(LowerTesterError, match="it was away for a while"):
            other.receive(0)
        assert other.receive(0) is None
        one.send(b"again", PEERS[0])
        assert hear(other)[0].octets == b"again"
        unplug()
        for _ in range(2):
            with pytest.raises(LowerTesterError, match=r"no interface has the address 192\.0\.2\.1"):
                other.receive(0)


def test_invalid_addresses(udp):
    for group, port, interface, message in (
        ("multicast", 1, None, "not an IPv4 address"),
        ("", 0, None, "not within 1..65535"),
        ("", 70_000, None, "not within 1..65535"),
        ("", 5000, "nope0", "interface=nope0: there is no such interface; there are"),
    ):
        with pytest.raises(UsageError, match=message):
            udp(group, port, interface=interface)
    with pytest.raises(LowerTesterError, match=r"no interface has the address 192.0.2.77"):
        udp(interface="192.0.2.77")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as selfish:
        selfish.bind(("127.0.0.1", PORT))
        with pytest.raises(LowerTesterError, match="another program has this port for itself"):
            udp("127.0.0.2", PORT, interface="127.0.0.1")


def test_notations_of_udp_addresses():
    assert parse_udp("udp", UDP) == ("", None, None, UDP)
    assert parse_udp("udp:239.1.2.3", UDP) == ("239.1.2.3", None, None, UDP)
    assert parse_udp("udp:239.1.2.3:77,interface=eth0", UDP) == ("239.1.2.3", 77, "eth0", UDP)
    assert parse_udp("udp::77", UDP) == ("", 77, None, UDP)
    for text in ("tcp:1.2.3.4", "udp:a:b", "udp:1.2.3.4:5:6", "udp,port=5"):
        with pytest.raises(UsageError, match="is not a link"):
            parse_udp(text, UDP)
    # Group and port are those of dcp-node, unless the profile has a port.
    with open_udp(link=ETHERNET) as usual, open_udp(link=UDP) as fixed:
        assert usual.name == "udp:239.73.126.1:18771"
        assert fixed.name == "udp:239.73.126.1:5950"


def test_echoes_are_recognised_once():
    echoes = Echoes()
    echoes.sent(b"a", 0)
    echoes.sent(b"a", 1)
    assert [echoes.is_one(b"a", 2) for _ in range(3)] == [True, True, False]
    assert not echoes.is_one(b"b", 2)
    echoes.sent(b"c", 3)
    assert not echoes.is_one(b"c", 3 + 2001 * MS)
    for number in range(10_000):
        echoes.sent(number.to_bytes(2, "big"), 4)
    assert not echoes.is_one((1).to_bytes(2, "big"), 4)
    assert echoes.is_one((9999).to_bytes(2, "big"), 4)
