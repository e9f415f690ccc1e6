"""Measure how late the notifications of an upper tester are: the specification does not limit that."""

from __future__ import annotations

from dcp_spec.constants import QueueingMode

from dcp_conformance.errors import StopCase, UpperTesterError
from dcp_conformance.frames.builder import Block
from dcp_conformance.test_steps.bp_clients import CLIENT, BPClient
from dcp_conformance.test_system.bench import Bench

#: Number of measurements, the factor for the longest time, and the longest wait for an indication in ns.
_ATTEMPTS, _FACTOR, _PATIENCE = 2, 1.5, 1_000_000_000
#: Delays in ns up to which notifications count as immediate, and the interval of looking for them.
_IMMEDIATE, _LOOK = 30_000_000, 5_000_000


def notification_delay(bench: Bench) -> int:
    """Return the time in ns by which notifications may be late; 0 if none is received, or if they are immediate.

    It includes the time in which a received frame is processed. Without BP-ReceivePayload.indication, this takes a
    second. Raises ``LowerTesterError``.
    """
    upper = bench.session.upper
    if upper is None or not set(CLIENT) <= upper.methods:
        return 0
    longest = 0
    try:
        with BPClient(bench, QueueingMode.ONCE) as client:
            for number in range(_ATTEMPTS):
                bench.peer().send(Block(client.prot_id, bytes([number]) * 4))
                begun = bench.now()
                while len(client.received()) <= number:
                    if bench.now() - begun > _PATIENCE:
                        return 0
                    bench.waiting.wait_ns(_LOOK)
                longest = max(longest, bench.now() - begun)
    except (StopCase, UpperTesterError):
        # Cases about these services will report it.
        return 0
    return round(_FACTOR * longest) if longest > _IMMEDIATE else 0
