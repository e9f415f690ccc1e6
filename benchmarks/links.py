"""Measure what sockets cost below the protocol: CPU time for each frame, beside that of the bare system call.

    python benchmarks/links.py [--frames N] [--json FILE]

Frames of 200 octets go through a virtual cable in a network namespace of its own (root), datagrams over the loopback
interface; one, 16 and 256 per wake-up. Only receiving is measured: the node's links, live capture and the lower tester.
``recvmsg`` is the socket of the Ethernet link, read by a loop that does nothing else; ratios to it can be compared
across machines.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from dcp_conformance.lower_tester import open_ethernet as open_tester
from dcp_conformance.reference.namespace import SUT_INTERFACE, TESTER_INTERFACE, Namespace, NamespaceError
from dcp_spec.profile.definition import Link

from dcp_codec.network import sockets
from dcp_codec.network.live import LiveReader
from dcp_stack.links.ethernet import open_ethernet
from dcp_stack.links.udp import open_udp

ETHERNET = Link(ether_type=0x4953)
OCTETS = bytes(200)
BURSTS = (1, 16, 256)
Receive = Callable[[int], None]


def measured(send: Callable[[], object], receive: Receive, frames: int) -> dict[int, float]:
    """Microseconds of CPU time for each frame, by frames per wake-up; the best of several runs."""
    found = {}
    for burst in BURSTS:
        best = float("inf")
        for _ in range(5):
            taken = 0.0
            for _ in range(max(frames // burst // 5, 1)):
                for _ in range(burst):
                    send()
                begin = time.process_time_ns()
                receive(burst)
                taken += time.process_time_ns() - begin
            best = min(best, taken / (max(frames // burst // 5, 1) * burst))
        found[burst] = best / 1000
    return found


class Results(dict[str, dict[int, float]]):
    """Times by what receives, and by frames per wake-up."""

    def add(self, name: str, frames: int, send: Callable[[], object], receive: Receive) -> None:
        """Measure and print."""
        self[name] = measured(send, receive, frames)
        times = "   ".join(f"{burst:3}: {taken:5.2f}" for burst, taken in self[name].items())
        print(f"  {name:10} {times}  us a frame, by frames per wake-up")


def over_ethernet(results: Results, frames: int) -> None:
    """All that reads frames."""
    with contextlib.ExitStack() as stack:
        out = sockets.open_ethernet(TESTER_INTERFACE, 0x4953)
        stack.callback(out.close)
        frame = b"\xff" * 6 + out.address + b"\x49\x53" + OCTETS
        bare = sockets.open_ethernet(SUT_INTERFACE, 0x4953)
        stack.callback(bare.close)

        def read(count: int) -> None:
            for _ in range(count):
                bare.raw.recvmsg(sockets.LONGEST, sockets.ANCILLARY)

        results.add("recvmsg", frames, lambda: out.send(frame), read)
        bare.close()
        with contextlib.closing(open_ethernet(SUT_INTERFACE, 0x4953)) as link:
            results.add("ethernet", frames, lambda: out.send(frame), lambda count: drained(link.receive, count))
        with LiveReader(SUT_INTERFACE, ETHERNET) as reader:
            results.add("live", frames, lambda: out.send(frame), lambda count: drained(lambda: [next(reader)], count))
        with contextlib.closing(open_tester(SUT_INTERFACE, ETHERNET)) as tester:
            until = tester.now() + 3600 * 10**9
            one = lambda: [tester.receive(until)]  # noqa: E731
            results.add("tester", frames, lambda: out.send(frame), lambda count: drained(one, count))


def over_udp(results: Results, frames: int) -> None:
    """The node's other link."""
    with contextlib.closing(open_udp(port=20_001)) as link, contextlib.closing(open_udp(port=20_001)) as other:
        results.add("udp", frames, lambda: other.send(OCTETS), lambda count: drained(link.receive, count))


def drained(receive: Callable[[], Sequence[object]], count: int) -> None:
    """Receive so many."""
    while count > 0:
        count -= len(receive())


def main() -> None:
    """Measure, print, and write what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100_000, help="for each number (default: 100000)")
    parser.add_argument("--json", type=Path, help="write the numbers here, too")
    options = parser.parse_args()
    results = Results()
    try:
        with contextlib.closing(Namespace(b"\x02\0\0\0\0\x01")) as cable, cable.entered():
            over_ethernet(results, options.frames)
    except NamespaceError as error:
        print(f"  no Ethernet, for want of a network of its own: {error}")
    over_udp(results, options.frames)
    if options.json is not None:
        options.json.write_text(json.dumps(results, indent=2) + "\n")


if __name__ == "__main__":
    main()
