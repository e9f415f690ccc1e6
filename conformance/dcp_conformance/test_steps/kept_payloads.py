"""Payloads that an implementation keeps while BP is deactivated, on which cases rely that deactivate BP as a means."""

from __future__ import annotations

from contextlib import suppress

from dcp_spec.constants import QueueingMode

from dcp_conformance.errors import UpperTesterError
from dcp_conformance.test_system.bench import Bench

_ATTEMPTS = 2


def unused_protocol_id(bench: Bench) -> int:
    """Return an unregistered protocol identifier, the one that the tester used least recently.

    Raises ``NamesUsedUp`` if all of them may still be registered.
    """
    width = bench.profile.types.protocol_id.width
    first, size = (0x7000, 0x0F00) if width > 1 else (0x70, 0x60)
    session = bench.session
    numbers = (first + (session.next_protocol + 1 + step) % size for step in range(size))
    number = next((each for each in numbers if each not in session.held_protocols), None)
    if number is None:
        bench.identifiers.used_up("an unregistered protocol identifier", 0, size)
    session.next_protocol = number - first
    return number


def keeps_payloads(bench: Bench) -> bool:
    """Return whether the implementation sends two payloads that were submitted while BP was deactivated.

    It is tried once in a run, and again after a failure, which a lost beacon may explain. Other cases judge it
    (BP-MGT-04). An implementation that does not survive it, or refuses a payload, is not asked again.
    """
    session = bench.session
    if session.keeps_payloads is None:
        # Until it is known: the attempt may end the implementation, or this case.
        session.keeps_payloads = False
        session.keeps_payloads = any(_kept(bench) for _ in range(_ATTEMPTS))
    return session.keeps_payloads


def _kept(bench: Bench) -> bool:
    prot_id = unused_protocol_id(bench)
    mode = max(QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE, key=lambda each: each in bench.features.queueing_modes)
    bench.must(
        "BP-RegisterProtocol", protId=prot_id, name="tester", maxPayloadSize=8, queueingMode=str(mode), maxEntries=2,
        allowMultiplePayloads=False,
    )  # fmt: skip
    try:
        start, payloads = bench.mark(), (b"first", b"second")
        with bench.services.deactivated("BP"):
            for each in payloads:
                if not bench.call("BP-TransmitPayload", protId=prot_id, payload=each.hex()).ok:
                    return False
            # An implementation may lose them with time.
            bench.wait(2)

        def all_sent(_: object) -> bool:
            return {octets for heard in bench.heard[start:] for octets in heard.data(prot_id)} >= set(payloads)

        return bool(bench.until(all_sent, 2 * bench.sut.reaction))
    finally:
        with suppress(UpperTesterError):
            bench.call("BP-DeregisterProtocol", protId=prot_id)
