"""Sockets: errors and time stamps of the system, on a virtual cable and on the loopback interface."""

from __future__ import annotations

import errno
import ipaddress
import os
import select
import socket
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from dcp_codec.network import interfaces, sockets
from dcp_codec.network.sockets import ANCILLARY, LONGEST, OpeningError

from ..waiting import PATIENCE

ETHER_TYPE = 0x4953
BROADCAST = b"\xff" * 6
LOOPBACK = ipaddress.IPv4Address("127.0.0.1")


@pytest.fixture
def raw(inside) -> Iterator[socket.socket]:
    """Sends any frame out of ``far``."""
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as out:
        out.bind(("far", 0))
        yield out


def frame(octets: bytes, tag: bytes = b"") -> bytes:
    return BROADCAST + b"\x02\0\0\0\0\x01" + tag + ETHER_TYPE.to_bytes(2, "big") + octets


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


# -- what is read from ancillary data -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "data", "stamp"),
    [
        (35, struct.pack("@ll", 1_700_000_000, 123_456_789), 1_700_000_000_123_456_789),
        (64, struct.pack("qq", 1 << 33, 7), (1 << 33) * 1_000_000_000 + 7),
        # Another kind, a piece of one, and one of another level.
        (29, struct.pack("@ll", 1, 2), 0),
        (64, struct.pack("q", 1), 0),
        (35, b"", 0),
    ],
)
def test_stamps(kind, data, stamp):
    assert sockets.stamp_of([(socket.SOL_SOCKET, kind, data)]) == stamp
    assert sockets.stamp_of([(263, 8, bytes(20)), (socket.SOL_SOCKET, kind, data)]) == stamp
    assert sockets.stamp_of([(263, kind, data)]) == 0


def test_tags():
    def auxiliary(status: int, tag: int, tag_type: int) -> list[tuple[int, int, bytes]]:
        return [
            (socket.SOL_SOCKET, 35, bytes(16)),
            (263, 8, struct.pack("IIIHHHH", status, 99, 60, 0, 14, tag, tag_type)),
        ]

    assert sockets.tag_of(auxiliary(1, 0, 0)) == (b"", 99)
    assert sockets.tag_of(auxiliary(1 << 4 | 1 << 6, 5, 0x88A8)) == (b"\x88\xa8\x00\x05", 99)
    # Older kernels say neither of which type it is nor that there is one, but for the number.
    assert sockets.tag_of(auxiliary(1 << 4, 0, 0)) == (b"\x81\x00\x00\x00", 99)
    assert sockets.tag_of(auxiliary(0, 7, 0)) == (b"\x81\x00\x00\x07", 99)
    assert sockets.tag_of([(263, 8, b"short")]) == sockets.tag_of([]) == (b"", 0)


# -- Ethernet -----------------------------------------------------------------------------------------------------


@pytest.mark.tool("ip")
class TestEthernet:
    """On a virtual cable."""

    pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")

    def test_frames_during_opening_do_not_count_as_lost(self, raw, monkeypatch):
        enlarge = sockets.enlarge_receive_buffer

        def after_a_flood(receiver: socket.socket) -> None:
            for _ in range(1000):
                raw.send(frame(bytes(1000)))
            enlarge(receiver)

        monkeypatch.setattr(sockets, "enlarge_receive_buffer", after_a_flood)
        opened = sockets.open_ethernet("near", ETHER_TYPE)
        assert opened.lost() == 0
        assert select.select([opened.raw], [], [], 60)[0]
        opened.close()

    def test_frames_come_with_their_stamps(self, raw):
        opened = sockets.open_ethernet("near", ETHER_TYPE)
        assert (opened.interface, opened.loops) == ("near", False)
        assert opened.address == interfaces.hardware_address("near")[1]
        raw.send(frame(b"octets"))
        assert select.select([opened.raw], [], [], PATIENCE)[0]
        octets, ancillary, flags, _ = opened.raw.recvmsg(LONGEST, ANCILLARY)
        assert (octets, flags) == (frame(b"octets"), 0)
        assert sockets.stamp_of(ancillary) > 1_000_000_000_000_000_000
        with pytest.raises(BlockingIOError):
            opened.raw.recvmsg(LONGEST, ANCILLARY)
        opened.close()
        opened.close()

    @pytest.mark.parametrize("promiscuous", [False, True])
    def test_promiscuous_mode_applies_to_a_recreated_interface(self, inside, promiscuous):
        # Scapy remembers the numbers of interfaces.
        sockets.open_ethernet("near", ETHER_TYPE, promiscuous=promiscuous).close()
        inside.ip("link", "delete", "near")
        inside.cable()
        opened = sockets.open_ethernet("near", ETHER_TYPE, promiscuous=promiscuous)
        shown = subprocess.run(
            ["ip", "-details", "link", "show", "near"], capture_output=True, text=True, check=True
        ).stdout
        assert f"promiscuity {int(promiscuous)}" in shown
        opened.close()

    def test_a_failed_opening_leaves_no_open_socket(self, inside):
        sockets.open_ethernet("near", ETHER_TYPE).close()
        before = descriptors()
        inside.ip("link", "set", "far", "down")
        for interface, message in (
            ("nope0", "there is no such interface; there are .*near"),
            ("far", "link set far up"),
        ):
            with pytest.raises(OpeningError, match=message):
                sockets.open_ethernet(interface, ETHER_TYPE)
        # Here the system has its say when the socket is there already.
        with pytest.raises(OverflowError):
            sockets.open_ethernet("near", 0x10000)
        assert descriptors() == before

    def test_an_interface_that_was_removed(self, inside):
        opened = sockets.open_ethernet("near", ETHER_TYPE)
        inside.ip("link", "delete", "near")
        inside.cable()
        assert opened.interface == ""
        with pytest.raises(OSError, match="No such device"):
            opened.send(frame(b"x"))
        opened.close()


class Driver:
    """Imitates scapy's socket on a driver that sends no short frames."""

    def __init__(self, refusal: int) -> None:
        self.ins = self.outs = self
        self.refusal = refusal
        self.taken: list[bytes] = []

    def send(self, octets: bytes) -> None:
        if len(octets) < 60:
            raise OSError(self.refusal, os.strerror(self.refusal))
        self.taken.append(octets)


class Scapy:
    """Scapy's socket above it, which pads."""

    def __init__(self, driver: Driver) -> None:
        self.ins = self.outs = driver

    def send(self, octets: bytes) -> None:
        self.outs.send(octets.ljust(60, b"\0"))


def test_short_frames_are_padded_only_where_the_driver_wants_it():
    driver = Driver(errno.EINVAL)
    opened = sockets.EthernetSocket(Scapy(driver), bytes(6), loops=False)
    opened.send(frame(b"short"))
    opened.send(frame(bytes(60)))
    assert driver.taken == [frame(b"short").ljust(60, b"\0"), frame(bytes(60))]
    driver.refusal = errno.ENOBUFS
    with pytest.raises(OSError, match="No buffer space available"):
        opened.send(frame(b"short"))


def test_other_systems_get_an_error_with_an_alternative(monkeypatch):
    monkeypatch.delattr(socket, "AF_PACKET")
    with pytest.raises(
        OpeningError, match=r"needs the packet sockets of Linux, which .* does not have; use udp instead"
    ):
        sockets.open_ethernet("lo", ETHER_TYPE, instead="udp")
    with pytest.raises(OpeningError, match=r"does not have$"):
        sockets.open_ethernet("lo", ETHER_TYPE)


# -- UDP ----------------------------------------------------------------------------------------------------------


def test_a_port_chosen_by_the_system_is_not_shared(inside):
    inside.ip("link", "set", "lo", "up")
    Path("/proc/sys/net/ipv4/ip_local_port_range").write_text("50000 50001")
    for _ in range(20):
        first, second = (sockets.open_udp_sender(LOOPBACK, ttl=1) for _ in range(2))
        found = {each.getsockname()[1] for each in (first, second)}
        first.close()
        second.close()
        assert found == {50000, 50001}


def test_the_loss_counter_continues_when_the_kernel_counter_restarts():
    with sockets.open_udp_receiver(LOOPBACK, 0) as receiver:
        losses = sockets.UDPLosses(receiver)
        assert losses.new() == 0
        # As if it had counted 2**32 - 3 before.
        losses._seen = 0xFFFF_FFFD
        assert losses.new() == 3
        assert losses.new() == 0


@pytest.mark.parametrize(
    ("number", "to", "station", "message"),
    [
        (errno.EADDRNOTAVAIL, "239.1.2.3", False, "no interface has the address 127.0.0.1; see: ip -brief address"),
        (
            errno.EINVAL,
            "10.0.0.1",
            False,
            "or 10.0.0.1 is neither a multicast group nor a broadcast address there; see",
        ),
        (errno.EADDRNOTAVAIL, "10.0.0.1", True, "no interface has the address 127.0.0.1; see: ip -brief address"),
        (errno.EINVAL, "10.0.0.1", True, "the interface with the address 127.0.0.1 does not reach 10.0.0.1 (Inv"),
        (
            errno.ENETUNREACH,
            "239.1.2.3",
            False,
            "the interface with the address 127.0.0.1 does not reach 239.1.2.3 (Net",
        ),
        (errno.EADDRINUSE, "239.1.2.3", False, "another program has this port for itself; choose another one"),
        (errno.EACCES, "239.1.2.3", False, "the system does not permit it (Permission denied); ports below 1024"),
        (errno.ENOMEM, "239.1.2.3", False, "Cannot allocate memory"),
    ],
)
def test_errors_of_udp_are_reported(number, to, station, message):
    error = OSError(number, os.strerror(number))
    said = sockets.udp_problem(error, ipaddress.IPv4Address(to), LOOPBACK, station=station)
    assert message in said
    assert ("neither" in message) == ("neither" in said)
