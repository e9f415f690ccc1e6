"""Client protocols of BP that the tester runs through the upper tester, and the sizes that limit their payloads.

A client registers under an unused protocol identifier and deregisters when its ``with`` block ends, so that cases do
not see each other's payloads if the implementation is not reset between them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant
from dcp_conformance.errors import CouldNotAskError, UpperTesterError
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.upper_tester import Answer, Notification

from .beacon_gaps import between_beacons
from .kept_payloads import unused_protocol_id as unused_protocol_id

#: Maximum delay of a notification in ns that waits allow for.
_MOST_DELAY = 1_000_000_000

OK = "BP-STATUS-OK"
ALREADY_REGISTERED = "BP-STATUS-PROTOCOL-ALREADY-REGISTERED"
ILLEGAL_SIZE = "BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE"
ILLEGAL_QUEUE = "BP-STATUS-ILLEGAL-DROPPING-QUEUE-SIZE"
UNKNOWN_PROTOCOL = "BP-STATUS-UNKNOWN-PROTOCOL"
TOO_LARGE = "BP-STATUS-PAYLOAD-TOO-LARGE"
EMPTY = "BP-STATUS-EMPTY-PAYLOAD"
UNKNOWN_MODE = "BP-STATUS-UNKNOWN-QUEUEING-MODE"

REGISTER = "BP-RegisterProtocol"
DEREGISTER = "BP-DeregisterProtocol"
LIST = "BP-ListRegisteredProtocols"
TRANSMIT = "BP-TransmitPayload"
CLEAR = "BP-ClearBuffer"
QUERY = "BP-QueryNumberBufferedPayloads"
ACTIVATE = "BP-MGMT-Activate"
DEACTIVATE = "BP-MGMT-Deactivate"
CLIENT = (REGISTER, DEREGISTER, TRANSMIT)
"""Methods of the upper tester that a sending client needs."""

RECEIVED = "BP-ReceivePayload.indication"
TRANSMITTED = "BP-PayloadTransmitted.indication"

LISTED = frozenset(
    {
        "protocolId",
        "protocolName",
        "maxPayloadSize",
        "queueMode",
        "timeStampRegistration",
        "maxEntries",
        "allowMultiplePayloads",
    }
)
"""The fields of an entry of BP-ListRegisteredProtocols that the specification names."""

_LISTED_AS = {"protocolName": "name", "maxPayloadSize": "maxPayloadSize", "queueMode": "queueingMode"}

ONCE, REPEAT = QueueingMode.ONCE, QueueingMode.REPEAT
DROPTAIL, DROPHEAD = QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE_DROPHEAD


def queue_mode(bench: Bench) -> QueueingMode:
    """Return a mode with a queue: 1.0 has only one."""
    return DROPTAIL if DROPTAIL in bench.features.queueing_modes else QueueingMode.QUEUE


def no_confirm(bench: Bench) -> str | None:
    """Return why the status of BP-TransmitPayload cannot be judged (BP-TXP-08), or None; for ``Needs.when``."""
    if bench.sut.pics.transmit_payload_confirm is False and bench.profile.spec_version >= SpecVersion.V1_2:
        return "according to the PICS, BP-TransmitPayload is not confirmed"
    return None


def mode_exists(mode: QueueingMode) -> Callable[[Bench], str | None]:
    """Return a condition for ``Needs.when``: the version must have the queueing mode."""

    def when(bench: Bench) -> str | None:
        if mode in bench.features.queueing_modes:
            return None
        return f"version {bench.profile.spec_version} has no {mode}"

    return when


def each_mode(*methods: str, since: SpecVersion = SpecVersion.V1_0) -> dict[str, Any]:
    """Return a variant for each queueing mode of any version."""
    return {
        mode.name.removeprefix("QUEUE_").lower(): Variant(
            mode, needs=Needs(since=since, entities=(), ut=methods, when=mode_exists(mode))
        )
        for mode in (ONCE, REPEAT, DROPTAIL, DROPHEAD, QueueingMode.QUEUE)
        if not (mode is QueueingMode.QUEUE and since > SpecVersion.V1_0)
    }


# -- sizes -------------------------------------------------------------------------------------------------------------


def header_octets(bench: Bench) -> int:
    """Return ssizeof(BPHeaderT) in the profile."""
    return _place(bench, "payloads[0]")


def block_header_octets(bench: Bench) -> int:
    """Return ssizeof(BPPayloadHeaderT) in the profile."""
    return _place(bench, "payloads[0].data") - header_octets(bench)


def _place(bench: Bench, path: str) -> int:
    bench.excuses.relies_on("size")
    peer_id = bench.peers.made[0].node_id if bench.peers.made else bench.identifiers.node_id()
    octets = bench.builder.beacon(peer_id, 0, [Block(unused_protocol_id(bench), b"x")])
    field = bench.codec.dissect(octets).root.find(path)
    return 0 if field is None else field.offset


def largest_payload(bench: Bench) -> int:
    """Return the largest maxPayloadSize that BP-RegisterProtocol accepts (BP-REG-04), in octets.

    Before 1.1 the limit assumes four octets for the BP header, whatever its size.
    """
    header = header_octets(bench) if bench.features.registration_counts_bp_header else 4
    return bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE") - header - block_header_octets(bench)


def room(bench: Bench) -> int:
    """Return the number of octets for payload blocks, including their headers, in one beacon.

    Raise ``CouldNotAskError`` beside other cases, whose payloads take a part of it.
    """
    bench.control.needs_whole_beacons()
    return bench.sut.bound("BPPAR_MAXIMUM_PACKET_SIZE") - header_octets(bench)


def areas_of_fixed_size(bench: Bench) -> str | None:
    """Return why fitting cannot be tested (blocks of fixed size), or None; for ``Needs.when``."""
    if bench.profile.bp.payload_area:
        return f"all payload blocks of the profile {bench.profile.name} have the same size"
    return None


# -- clients -----------------------------------------------------------------------------------------------------------


class BPClient:
    """A client protocol of the tester. Registers when its ``with`` block begins; inconclusive if that fails."""

    def __init__(
        self,
        bench: Bench,
        mode: QueueingMode | str,
        *,
        size: int = 64,
        entries: int = 4,
        several: bool = False,
        prot_id: int | None = None,
        name: str = "tester",
    ) -> None:
        self.bench = bench
        self.prot_id = unused_protocol_id(bench) if prot_id is None else prot_id
        self.registration: dict[str, Any] = {
            "protId": self.prot_id,
            "name": name,
            "maxPayloadSize": size,
            "queueingMode": str(mode),
            "maxEntries": entries,
            "allowMultiplePayloads": several,
        }
        self._queues = mode in (DROPTAIL, DROPHEAD, QueueingMode.QUEUE)
        self.answer = Answer()
        self._number = 0

    def __enter__(self) -> Self:
        bench = self.bench
        if why := bench.sut.lacks("queue_entries", self.registration["maxEntries"] if self._queues else 0):
            bench.verdicts.not_applicable(f"{why}, and this case needs more")
        self.answer = bench.call(REGISTER, **self.registration)
        if not self.answer.ok and bench.session.beside and bench.sut.capacity("clients"):
            raise CouldNotAskError("other cases are executed at the same time, and have clients")
        if not self.answer.ok and (why := bench.sut.lacks("clients", bench.clients + 1)):
            bench.verdicts.not_applicable(f"{why}, and this case needs more")
        size = self.registration["maxPayloadSize"]
        if self.answer.status == ILLEGAL_SIZE and size > (largest := largest_payload(bench)):
            bench.verdicts.not_applicable(f"payloads have at most {largest} octets, and this case needs {size}")
        bench.services.require_success(REGISTER, self.answer)
        bench.clients += 1
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.bench.clients -= 1
        # If the upper tester has stopped answering, an earlier call has reported it.
        with contextlib.suppress(UpperTesterError):
            self.bench.call(DEREGISTER, protId=self.prot_id)

    def register(self, **changes: Any) -> Answer:
        """Call BP-RegisterProtocol with this client's parameters, some of them changed."""
        return self.bench.call(REGISTER, **{**self.registration, **changes})

    def payload(self, size: int = 12) -> bytes:
        """Return octets that no client has submitted before; unique from four octets on."""
        self._number += 1
        label = self.prot_id.to_bytes(2, "big") + self._number.to_bytes(2, "big")
        return (label + bytes((self._number + index) % 256 for index in range(size)))[:size]

    def transmit(self, payload: bytes, *, must: bool = True) -> Answer:
        """Call BP-TransmitPayload; with ``must`` inconclusive unless confirmed with OK or never confirmed."""
        answer = self.bench.call(TRANSMIT, protId=self.prot_id, payload=payload.hex())
        if must and not answer.ok and no_confirm(self.bench) is None:
            self.bench.inconclusive("a submitted payload, which this case needs", str(answer))
        return answer

    def submit(self, count: int, size: int = 12, *, must: bool = True) -> list[bytes]:
        """Submit ``count`` new payloads between two beacons and return them. ``must``: see :meth:`transmit`."""
        what = f"submission of {count} payloads"
        return between_beacons(self.bench, what, lambda: self.transmit_new(count, size, must=must), self.in_frame)

    def transmit_new(self, count: int, size: int = 12, *, must: bool = True) -> list[bytes]:
        """Submit ``count`` new payloads in succession and return them. ``must``: see :meth:`transmit`."""
        payloads = [self.payload(size) for _ in range(count)]
        for payload in payloads:
            self.transmit(payload, must=must)
        return payloads

    def submit_between(self, what: str, make: Callable[[], list[bytes]]) -> tuple[int, list[bytes]]:
        """Submit payloads between two beacons; return the mark before them and the payloads.

        See :func:`~dcp_conformance.test_steps.beacon_gaps.between_beacons`; ``make`` is called for each attempt.
        """

        def act() -> tuple[int, list[bytes]]:
            start, payloads = self.bench.mark(), make()
            for payload in payloads:
                self.transmit(payload)
            return start, payloads

        return between_beacons(self.bench, what, act, self.in_frame)

    def number(self) -> int | None:
        """Return the number in BP-QueryNumberBufferedPayloads; None if the answer has none."""
        number = self.bench.must(QUERY, protId=self.prot_id).result.get("number")
        return number if isinstance(number, int) else None

    def entry(self) -> Mapping[str, Any] | None:
        """Return this client's entry in BP-ListRegisteredProtocols; None if it is not listed."""
        return registered(self.bench).get(self.prot_id)

    def fields(self) -> dict[str, Any] | None:
        """Return the fields of :meth:`entry` that the specification names: others, such as statistics, may change."""
        entry = self.entry()
        return None if entry is None else {name: value for name, value in entry.items() if name in LISTED}

    def listing(self) -> dict[str, Any]:
        """Return the fields that the list must have for this client, by their names in the list."""
        given = self.registration
        found = {each: given[name] for each, name in _LISTED_AS.items()}
        if self.bench.features.allow_multiple_payloads and QueueingMode(given["queueingMode"]).is_queue:
            # Both fields are irrelevant for the other modes.
            found |= {each: given[each] for each in ("allowMultiplePayloads", "maxEntries")}
        return found

    # -- beacons ----------------------------------------------------------------------------------------------

    def in_frame(self, heard: ReceivedBeacon) -> list[bytes]:
        """Return this client's payloads in a beacon."""
        return heard.data(self.prot_id)

    def sent(self, since: int = 0) -> list[bytes]:
        """Return this client's payloads in beacons since a mark, in order."""
        return [octets for heard in self.bench.heard[since:] for octets in self.in_frame(heard)]

    def frames(self, since: int = 0, *, after: int = 0) -> list[ReceivedBeacon]:
        """Return the beacons with a payload of this client since a mark, and not before a time in ns."""
        return [each for each in self.bench.heard[since:] if each.time >= after and self.in_frame(each)]

    def check_silent(self, after: int) -> None:
        """Check that no beacon since a time (ns) has a payload of this client."""
        self.bench.none(self.frames(after=after), "no beacon with a payload of the client")

    def until_sent(self, payload: bytes | None = None, periods: float | None = None) -> ReceivedBeacon | None:
        """Wait for a beacon with this payload, or with any of this client."""

        def wanted(heard: ReceivedBeacon) -> ReceivedBeacon | None:
            found = self.in_frame(heard)
            return heard if (found if payload is None else payload in found) else None

        return self.bench.until(wanted, periods)

    def put_on_air(self, what: str = "a beacon with the payload", size: int = 12) -> bytes:
        """Submit a new payload and return it; stop as inconclusive unless beacons of the client come."""
        payload = self.payload(size)
        self.transmit(payload)
        needed(self.bench, self.until_sent(), what)
        return payload

    # -- indications -------------------------------------------------------------------------------------------

    def received(self, since: int = 0) -> list[bytes]:
        """Return the payloads indicated to this client, from a number of notifications on."""
        return [octets_of(each) for each in indications(self.bench, RECEIVED, self.prot_id, since)]

    def until_received(self, count: int = 1) -> list[bytes]:
        """Wait until this client has ``count`` indications in total; return the payloads indicated."""
        until(self.bench, lambda: len(self.received()) >= count)
        return self.received()


def registered(bench: Bench) -> dict[int, dict[str, Any]]:
    """Return the entries of BP-ListRegisteredProtocols by protocol identifier."""
    told = bench.must(LIST).result.get("protocols")
    found = bench.present(told if isinstance(told, list) else None, f"a list in the answer to {LIST}", seen=told)
    return {each["protocolId"]: each for each in found if isinstance(each, dict) and "protocolId" in each}


def indications(bench: Bench, method: str, prot_id: int, since: int = 0) -> list[Notification]:
    """Return the notifications of a kind about a protocol, from a number of notifications on."""
    return [
        each
        for each in bench.receiver.notifications[since:]
        if each.method == method and each.params.get("protId") == prot_id
    ]


def octets_of(notification: Notification) -> bytes:
    """Return the payload of an indication; empty if it is not hexadecimal."""
    try:
        return bytes.fromhex(str(notification.params.get("payload", "")))
    except ValueError:
        return b""


def notification_delay(bench: Bench) -> int:
    """Return the time in ns by which the upper tester may delay a notification: that of a slow call, or as measured.

    The specification does not limit how long the implementation's adapter takes.
    """
    return min(max(bench.session.slow_call, bench.session.notifications), _MOST_DELAY)


def wait_for_notifications(bench: Bench) -> None:
    """Wait for the notifications about the last beacon, which may arrive slightly later than the beacon."""
    bench.waiting.wait_ns(round(0.3 * bench.period) + notification_delay(bench))


def until(bench: Bench, holds: Callable[[], bool], periods: float | None = None) -> bool:
    """Wait until a condition holds that depends on notifications; return whether it does.

    A slow upper tester may add its delay to ``periods``.
    """
    wait = round((bench.sut.reaction if periods is None else periods) * bench.period)
    deadline = bench.now() + wait + notification_delay(bench)
    while not holds():
        if bench.now() >= deadline:
            return False
        bench.waiting.wait_ns(max(1, min(deadline - bench.now(), bench.period // 10)))
    return True


def listed(payloads: Iterable[bytes], known: Sequence[bytes]) -> str:
    """Return payloads by their index in a list of known ones, for messages: ``A, B, A``."""
    names = [chr(ord("A") + known.index(each)) if each in known else each[:8].hex() for each in payloads]
    return ", ".join(names) or "none"


# -- something to send -------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def talking(bench: Bench, *, clients: int = 1) -> Iterator[list[BPClient]]:
    """Make the implementation send a beacon in every period: clients with mode REPEAT, and a variable to summarise.

    Yields the clients. Without an upper tester there is only the variable.
    """
    with contextlib.ExitStack() as stack:
        made = []
        if bench.services.offers(*CLIENT):
            for number in range(clients):
                client = stack.enter_context(BPClient(bench, REPEAT))
                client.transmit(client.payload(9 + 7 * number))
                made.append(client)
        if bench.sut.pics.vardis is not False:
            peer = bench.peer()
            peer.send(peer.create(bench.var_id()))
        yield made


def some_beacons(bench: Bench, count: int) -> list[ReceivedBeacon]:
    """Return ``count`` beacons of an implementation that is sending; inconclusive with less than half of them."""
    found = bench.beacons(count)
    if len(found) * 2 < count:
        bench.inconclusive(f"{count} beacons, which this case needs", f"{len(found)}")
    return found


def needed(bench: Bench, found: object, what: str) -> None:
    """Stop as inconclusive without required beacons: BP does not guarantee when a payload is sent (BP-GEN-02)."""
    bench.needed(found, f"{what}, which this case needs", f"none within {bench.sut.reaction:g} periods")
