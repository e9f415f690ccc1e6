"""Is an impaired link what it was asked to be? Realised / asked for every effect, side by side.

    python benchmarks/impairment.py [--no-relay] [--json]

Statistics come from virtual time, with so many frames that 1 % is four standard deviations or more. The relay is then
asked for the same losses over real interfaces: it must take exactly the frames that the same seed takes in virtual
time. Its delay is measured from the transmission to the kernel's stamp at the receiver. Beyond the asked-for time that
has two system calls and the time in which the machine wakes a process up, some 0.1 ms, so that 1 % is kept from a delay
of about 20 ms on, in the median. Needs the right to make network namespaces, or --no-relay.

Exit status: 0 if every ratio is within 1 %, 1 if not.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from statistics import median
from typing import NamedTuple

from dcp_codec.impairment import Channel, parse_impairment

MS = 1_000_000
BOUND = 0.01
ETHER_TYPE = 0x88B5
OPTIONS = "delay=20ms,loss=0.2,burst=3"


class Row(NamedTuple):
    """One effect: what was asked for, what came, from how many samples."""

    where: str
    impairment: str
    what: str
    asked: float
    realised: float
    samples: int

    @property
    def ratio(self) -> float:
        return self.realised / self.asked


def played(text: str, frames: int, octets: bytes = b"") -> Channel:
    """A channel through which so many frames have gone, one each 100 ms."""
    channel = Channel(parse_impairment(text), seed=7)
    offer = channel.offer
    for now in range(0, frames * 100 * MS, 100 * MS):
        offer(octets, now)
    return channel


def virtual() -> Iterator[Row]:
    where = "virtual time"
    for text, frames in [("loss=0.1", 1_500_000), ("loss=0.5", 200_000)]:
        count = played(text, frames).counters
        yield Row(where, text, "share lost", parse_impairment(text).mean_loss, count.loss, frames)
    for text, frames in [("loss=0.2,burst=3", 2_500_000), ("p=0.1,r=0.25,bad=0.8", 1_500_000)]:
        impairment, count = parse_impairment(text), played(text, frames).counters
        yield Row(where, text, "share lost", impairment.mean_loss, count.loss, frames)
        if impairment.bad == 1:
            yield Row(where, text, "mean burst, frames", 1 / impairment.bursts[1], count.mean_burst, count.bursts)
    for text, frames, mean in [
        ("delay=5ms", 1_000, 5.0),
        ("delay=5ms,jitter=2ms", 100_000, 6.0),
        ("delay=5ms,jitter=2ms,distribution=normal", 100_000, 5.0),
        ("delay=5ms,jitter=2ms,distribution=exponential", 100_000, 7.0),
    ]:
        count = played(text, frames).counters
        yield Row(where, text, "mean delay, ms", mean, count.mean_delay / MS, frames)
    count = played("duplicate=0.2", 700_000).counters
    yield Row(where, "duplicate=0.2", "share duplicated", 0.2, count.duplicated / count.offered, count.offered)
    count = played("reorder=0.2,delay=1ms", 700_000).counters
    yield Row(where, "reorder=0.2", "share held back", 0.2, count.reordered / count.offered, count.offered)
    count = played("corrupt=0.02", 100_000, bytes(100)).counters
    yield Row(where, "corrupt=0.02", "share of octets", 0.02, count.flipped / count.octets, count.octets)
    count = played("corrupt_frames=0.2,flips=3", 700_000, bytes(40)).counters
    yield Row(where, "corrupt_frames=0.2", "share corrupted", 0.2, count.corrupted / count.offered, count.offered)


def socket_in(namespace: str) -> socket.socket:
    """A packet socket on the station's interface, with the kernel's stamps."""
    from dcp_lab.sim.testbed.place import INTERFACE

    libc = ctypes.CDLL(None, use_errno=True)
    back, inside = (os.open(name, os.O_RDONLY) for name in ("/proc/self/ns/net", f"/run/netns/{namespace}"))
    try:
        if libc.setns(inside, 0x40000000):
            raise OSError(ctypes.get_errno(), "setns")
        opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHER_TYPE))
        opened.bind((INTERFACE, ETHER_TYPE))
        opened.setsockopt(socket.SOL_SOCKET, 35, 1)
    finally:
        libc.setns(back, 0x40000000)
        os.close(back)
        os.close(inside)
    opened.settimeout(0.25)
    return opened


def relayed(frames: int = 400) -> tuple[list[Row], dict[str, int]]:
    """The relay between two namespaces; ratios, and how late the relay itself was (ns)."""
    from dcp_lab.relay import RelayFabric
    from dcp_lab.sim.testbed import namespaces

    from dcp_codec.network.sockets import stamp_of

    impairment = parse_impairment(OPTIONS)
    expected = Channel(impairment, seed=7, name="0>1")
    passing = [number for number in range(frames) if expected.offer(b"", number * MS).copies]
    addresses = [bytes([2, 0, 0, 0, 0, number]) for number in range(2)]
    sent: list[int] = []
    delays: dict[int, float] = {}
    with RelayFabric(namespaces.own_prefix(), addresses, impairment=impairment, seed=7) as fabric:
        a, b = map(socket_in, fabric.namespaces)

        def take() -> bool:
            try:
                octets, ancillary, *_ = b.recvmsg(2000, 128)
            except TimeoutError:
                return False
            number = int.from_bytes(octets[14:18], "big")
            delays[number] = (stamp_of(ancillary) - sent[number]) / MS
            return True

        for number in range(frames):
            b.settimeout(0.004)
            take()
            sent.append(time.time_ns())
            a.send(b"\xff" * 6 + addresses[0] + ETHER_TYPE.to_bytes(2, "big") + number.to_bytes(4, "big") + bytes(42))
        b.settimeout(0.25)
        while take():
            pass
        lateness = fabric.counters()["lateness_ns"]
        a.close()
        b.close()
    same = sorted(delays) == passing
    rows = [
        Row("relay, veth", OPTIONS, "frames passed, same seed", len(passing), len(delays) if same else 0, frames),
        Row("relay, veth", OPTIONS, "median delay, ms", impairment.delay / MS, median(delays.values()), len(delays)),
    ]
    return rows, lateness


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-relay", action="store_true", help="only virtual time")
    parser.add_argument("--json", action="store_true", help="for programs")
    options = parser.parse_args()
    rows, lateness = list(virtual()), {}
    if not options.no_relay:
        real, lateness = relayed()
        rows += real
    wrong = [row for row in rows if abs(row.ratio - 1) > BOUND]
    if options.json:
        print(json.dumps({"rows": [{**row._asdict(), "ratio": row.ratio} for row in rows], "lateness_ns": lateness}))
        return 1 if wrong else 0
    print(f"{'where':<13} {'impairment':<45} {'what':<24} {'asked':>8} {'realised':>9} {'ratio':>7} {'samples':>9}")
    for row in rows:
        print(
            f"{row.where:<13} {row.impairment:<45} {row.what:<24} {row.asked:8.4g} {row.realised:9.5g} "
            f"{row.ratio:7.4f} {row.samples:9d}"
        )
    if lateness:
        said = ", ".join(f"{name} {value / MS:.3f} ms" for name, value in lateness.items())
        print(f"the relay sent frames after their deadlines by: {said}")
    print(f"{len(rows) - len(wrong)} of {len(rows)} within {BOUND:.0%}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
