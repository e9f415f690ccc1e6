"""Model of BP (dcp-bp.md): registrations, queues and buffers, activation, parameters, composition, reception.

What a queue holds is a *set* of possible contents: a beacon that the tester has not received yet may already contain
the head. Each observation removes the contents that contradict it; if none is left, the node has violated a
requirement. ``None`` instead of a set: the contents are unknown until the queue is cleared, or its client registers
again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from operator import sub
from statistics import stdev
from typing import Any, Final

import msgspec
from dcp_spec.constants import Features, QueueingMode, SpecVersion

from .judgement import MS, Expected, Finding, Timing, either

Octets = tuple[bytes, ...]
#: Contents of a queue, oldest first, and payloads in beacons that were not received yet, with the times of generation.
Content = tuple[Octets, Octets]
#: Maximum number of possible contents of a queue; with more, they are unknown.
_MOST: Final = 64
#: Maximum number of payloads of a client in beacons that were not received yet, if a beacon has one of them.
_FLYING: Final = 2
#: Number of intervals of beacons whose mean is judged.
_INTERVALS: Final = 20
#: Longest difference in ns between a period that was set and the one that the implementation can have instead.
_RESOLUTION: Final = 20 * MS
#: Standard errors by which a mean interval must be too short: intervals vary as the implementation chooses.
_DEVIATIONS: Final = 5
#: Number of beacons in succession that are compared with the announced times.
_FORETOLD: Final = 5
_MODES: Final = {each.value for each in QueueingMode}
_Q = QueueingMode


class Client(msgspec.Struct):
    """A registration of the tester."""

    prot_id: int
    name: str
    most: int
    mode: QueueingMode
    entries: int
    several: bool
    listed: dict[str, Any]
    """The fields that the list must show."""
    possible: set[Content] | None
    why: tuple[str, ...] = ()
    """The requirements that decide the contents, after the last change of them."""
    moved: int = 0
    """Time of the last change of the contents, or of the conditions of sending; ns."""
    again: bool = False
    """Whether the identifier was registered before."""
    told: int = 0
    """Transmissions without their notification; negative if notifications came before their beacons."""
    untold: list[int] = msgspec.field(default_factory=list)
    """Times of these transmissions, ns."""
    optional: list[int] = msgspec.field(default_factory=list)
    """Times of further transmissions in the same beacons: one notification of a client and beacon may be enough."""
    spare: list[int] = msgspec.field(default_factory=list)
    """Times of notifications that may be about one of these, or about a beacon that was not received yet."""
    early: list[int] = msgspec.field(default_factory=list)
    """Times of notifications without their beacon, ns."""
    since: int = 0
    """Time of the registration, ns."""
    left: set[bytes] = msgspec.field(default_factory=set)
    """Payloads that must not be sent any more: cleared, displaced, discarded or sent."""
    stamp: int | None = None

    @property
    def empty(self) -> bool:
        """Whether nothing can be waiting."""
        return self.possible is not None and not any(queue or flying for queue, flying in self.possible)

    @property
    def heads(self) -> set[bytes] | None:
        """The payloads that may be next; None if they are unknown."""
        return (
            None
            if self.possible is None
            else {(flying + queue)[0] for queue, flying in self.possible if flying + queue}
        )


class Delivery(msgspec.Struct):
    """A block of a frame that was sent to the node."""

    prot_id: int
    octets: bytes
    time: int
    must: bool
    never: tuple[str, ...] = ()
    """The requirements that forbid the delivery."""
    skipped: bool = False
    """Whether a block of an unregistered protocol is before it in its frame."""


class Sizes(msgspec.Struct, frozen=True):
    """Octets of the headers of a beacon and of a block."""

    header: int
    block: int
    largest: int
    """Largest payload that the length field of a block can express."""


class BPModel:
    """The BP entity of one node. All times are ns of the tester's clock."""

    def __init__(self, features: Features, sizes: Sizes, timing: Timing, packet: int) -> None:
        """``packet``: BPPAR_MAXIMUM_PACKET_SIZE in octets."""
        self._features = features
        self._sizes = sizes
        self.timing = timing
        self.clients: dict[int, Client] = {}
        self.active = True
        self.switched = -(1 << 62)
        """Time of the last activation or deactivation."""
        self.packet = packet
        self._packets: list[tuple[int, int]] = [(-(1 << 62), packet)]
        """Times and values of the maximum packet size."""
        self._gone: dict[int, int] = {}
        """Time of the deregistration of each identifier."""
        self._stamps: dict[int, set[int]] = {}
        """Registration times that the list has shown, by identifier."""
        self._stamped: dict[int, int] = {}
        self.period = timing.period
        """The longest beacon period so far, ns."""
        self._interval = timing.period
        self._exact = False
        """Whether the implementation reports this period as its own, in the resolution that it has."""
        self._paced: list[int] = []
        """Times of beacons with the present period, ns."""
        self._pace_from = -(1 << 62)
        self._lacking = -(1 << 62)
        """Last time at which there may have been no payload for a beacon, ns."""
        self._previous = -(1 << 62)
        """Time of the last beacon, ns."""
        self._foretold: int | None = None
        """Time of the next beacon as the last notification states it, ns of the tester; None if unknown."""
        self._early: list[int] = []
        """How much earlier than foretold the last beacons came, ns."""
        self.deliveries: list[Delivery] = []
        self._seqno: int | None = None
        self.beacons = 0

    # -- services ----------------------------------------------------------------------------------------------

    def expect(self, method: str, params: Mapping[str, Any]) -> list[Expected]:
        """Return the statuses that a service may answer now; empty if the model does not know the service."""
        version = self._features.version
        if method in ("BP-MGMT-Activate", "BP-MGMT-Deactivate"):
            return [Expected("BP-STATUS-OK", "BP-MGT-05" if method.endswith("-Activate") else "BP-MGT-01")]
        if method == "BP-ListRegisteredProtocols":
            return [Expected("BP-STATUS-OK", "BP-LST-01" if version >= SpecVersion.V1_1 else "BP-LST-03")]
        if method == "BP-RegisterProtocol":
            return [self._registering(params)]
        prefix = {
            "BP-DeregisterProtocol": "DRG", "BP-TransmitPayload": "TXP", "BP-ClearBuffer": "CLR",
            "BP-QueryNumberBufferedPayloads": "QRY",
        }.get(method)  # fmt: skip
        if prefix is None:
            return []
        client = self.clients.get(params["protId"])
        if client is None:
            return [Expected("BP-STATUS-UNKNOWN-PROTOCOL", f"BP-{prefix}-01")]
        if method == "BP-TransmitPayload":
            return [self._submitting(client, len(params["payload"]) // 2)]
        queues = client.mode.is_queue
        good = {"DRG": "02", "CLR": "02" if queues else "03", "QRY": "02" if queues else "03"}[prefix]
        return [Expected("BP-STATUS-OK", f"BP-{prefix}-{good}")]

    def _registering(self, params: Mapping[str, Any]) -> Expected:
        version = self._features.version
        if params["protId"] in self.clients:
            return Expected("BP-STATUS-PROTOCOL-ALREADY-REGISTERED", "BP-REG-02")
        least = 1 if version >= SpecVersion.V1_1 else 0
        size = params["maxPayloadSize"]
        if size < least:
            return Expected("BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE", "BP-REG-03")
        if size > self.largest:
            which = "BP-REG-04" if version >= SpecVersion.V1_1 else "BP-REG-11"
            return Expected("BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE", which)
        if params["queueingMode"] in (_Q.QUEUE_DROPTAIL, _Q.QUEUE_DROPHEAD) and params.get("maxEntries", 0) <= 0:
            return Expected("BP-STATUS-ILLEGAL-DROPPING-QUEUE-SIZE", "BP-REG-05")
        return Expected("BP-STATUS-OK", "BP-REG-06")

    @property
    def largest(self) -> int:
        """The largest maxPayloadSize that can be registered now."""
        overhead = self._sizes.header if self._features.registration_counts_bp_header else 4
        return min(self.packet - self._sizes.block - overhead, self._sizes.largest)

    def _submitting(self, client: Client, length: int) -> Expected:
        if length > client.most:
            return Expected("BP-STATUS-PAYLOAD-TOO-LARGE", "BP-TXP-02")
        if not length:
            if self._features.version >= SpecVersion.V1_1:
                return Expected("BP-STATUS-EMPTY-PAYLOAD", "BP-TXP-03")
            if client.mode.is_queue:
                return Expected("BP-STATUS-EMPTY-PAYLOAD", "BP-TXP-12")
            return Expected("BP-STATUS-OK", "BP-TXP-13")
        which = {_Q.QUEUE_DROPTAIL: "BP-TXP-04", _Q.QUEUE_DROPHEAD: "BP-TXP-05"}.get(client.mode, "BP-TXP-06")
        return Expected("BP-STATUS-OK", which)

    def confirmed(
        self, method: str, params: Mapping[str, Any], result: Mapping[str, Any], time: int
    ) -> Iterator[Finding]:
        """Take the confirm of a service with an expected status, and its members, into account."""
        ok = str(result.get("status", "")).replace("_", "-").endswith("-STATUS-OK")
        client = self.clients.get(params.get("protId", -1))
        self._settle(time)
        if method not in ("BP-ListRegisteredProtocols", "BP-QueryNumberBufferedPayloads", "BP-TransmitPayload"):
            self._lacking = time
        match method:
            case "BP-MGMT-Activate" | "BP-MGMT-Deactivate":
                active = method == "BP-MGMT-Activate"
                if active != self.active:
                    self.active, self.switched = active, time
                    for each in self.clients.values():
                        each.moved = time
            case "BP-RegisterProtocol" if ok:
                self._register(params, time)
            case "BP-ListRegisteredProtocols":
                yield from self._listed(result.get("protocols", ()), time)
            case _ if client is None or not ok:
                pass
            case "BP-DeregisterProtocol":
                del self.clients[client.prot_id]
                self._gone[client.prot_id] = time
            case "BP-TransmitPayload":
                self._submit(client, bytes.fromhex(params["payload"]), time)
            case "BP-ClearBuffer":
                self._clear(client, time)
            case "BP-QueryNumberBufferedPayloads":
                yield from self._counted(client, result.get("number"))

    def unknown_outcome(self, method: str, params: Mapping[str, Any]) -> None:
        """Record that a service has no usable answer: whether it took effect is unknown."""
        client = self.clients.get(params.get("protId", -1))
        if client is not None and method in ("BP-TransmitPayload", "BP-ClearBuffer"):
            client.possible = None
        elif method in ("BP-DeregisterProtocol", "BP-RegisterProtocol"):
            self.clients.pop(params.get("protId", -1), None)

    def _register(self, params: Mapping[str, Any], time: int) -> None:
        mode, prot_id = QueueingMode(params["queueingMode"]), params["protId"]
        listed = {"protocolName": params["name"], "maxPayloadSize": params["maxPayloadSize"], "queueMode": mode.value}
        several = bool(params.get("allowMultiplePayloads", False))
        if self._features.version >= SpecVersion.V1_1:
            listed |= {"maxEntries": params.get("maxEntries", 0), "allowMultiplePayloads": several}
        again = prot_id in self._gone
        self.clients[prot_id] = Client(
            prot_id, params["name"], params["maxPayloadSize"], mode, params.get("maxEntries", 0), several, listed,
            {((), ())}, ("BP-DRG-05",) if again else ("BP-REG-06",), time, again, since=time,
        )  # fmt: skip

    def _places(self, client: Client) -> int | None:
        if not client.mode.is_queue:
            return 1
        return None if client.mode is _Q.QUEUE else client.entries

    def _submit(self, client: Client, payload: bytes, time: int) -> None:
        if not payload:
            # 1.0: clears a buffer.
            self._clear(client, time)
            return
        client.left.discard(payload)
        client.moved = time
        if client.possible is None:
            if not client.mode.is_queue:
                client.possible = {((payload,), ())}
            return
        places, why, after = self._places(client), ("BP-QRY-02" if client.mode.is_queue else "BP-TXP-06",), set()
        for queue, flying in client.possible:
            full = places is not None and len(queue) >= places
            if not full:
                after.add(((*queue, payload), flying))
            elif client.mode is _Q.QUEUE_DROPTAIL:
                why = ("BP-QM-01",)
                client.left.add(payload)
                after.add((queue, flying))
            else:
                why = ("BP-QM-02",) if client.mode is _Q.QUEUE_DROPHEAD else ("BP-QM-04",)
                if client.mode is _Q.REPEAT:
                    why = ("BP-QM-05",)
                client.left.add(queue[0])
                after.add(((*queue[1:], payload), flying))
        client.possible = after
        client.left -= {each for queue, flying in after for each in queue + flying}
        client.why = why

    def _clear(self, client: Client, time: int) -> None:
        if client.possible is not None:
            client.left |= {each for queue, _ in client.possible for each in queue}
            client.possible = {((), flying) for _, flying in client.possible}
        else:
            client.possible = {((), ())} if not self.timing.flight else None
        client.why = ("BP-CLR-02" if client.mode.is_queue else "BP-CLR-03",)
        client.moved = time

    def _counted(self, client: Client, number: Any) -> Iterator[Finding]:
        if client.possible is None or type(number) is not int:
            return
        fitting = {each for each in client.possible if len(each[0]) == number}
        if not fitting:
            shown = " or ".join(str(each) for each in sorted({len(queue) for queue, _ in client.possible}))
            yield Finding(self._reasons(client, number), f"{shown} buffered payloads", f"number {number}")
        client.possible = fitting or None

    def _reasons(self, client: Client, number: int | None = None) -> tuple[str, ...]:
        """Return the requirements that decide the contents of a queue."""
        assert client.possible is not None
        fewer = number is not None and number < min(len(queue) for queue, _ in client.possible)
        if not self.active and self.switched <= client.moved:
            return (*client.why, "BP-MGT-04")
        if fewer and len(self._packets) > 1 and self._packets[-1][0] >= client.moved:
            return ("BP-TX-04", "BP-TX-06") if client.mode.is_queue else ("BP-TX-04",)
        if client.again and client.why in (("BP-QM-01",), ("BP-QM-02",), ("BP-QRY-02",)):
            return ("BP-REG-06", "BP-QM-01" if client.mode is _Q.QUEUE_DROPTAIL else "BP-QM-02")
        if fewer and client.mode.is_queue and client.why == ("BP-QRY-02",):
            # A queue that is not full has dropped something.
            return ("BP-QM-01",) if client.mode is _Q.QUEUE_DROPTAIL else ("BP-QM-02",)
        return client.why

    def _listed(self, rows: Iterable[Mapping[str, Any]], time: int) -> Iterator[Finding]:
        found = {row.get("protocolId"): row for row in rows}
        old = self._features.version < SpecVersion.V1_1
        which = "BP-LST-03" if old else "BP-LST-01"
        for prot_id, client in self.clients.items():
            row = found.get(prot_id)
            if row is None:
                yield Finding((which, "BP-REG-06"), f"protocol {prot_id} in the list", "not in the list")
                continue
            for name, value in client.listed.items():
                if name in row and row[name] != value:
                    reason = (which, "BP-REG-02") if name != "protocolName" else (which,)
                    yield Finding(reason[:1], f"{name} {_shown(value)}", _shown(row[name]))
                    client.listed = {**client.listed, name: row[name]}
            stamp = row.get("timeStampRegistration")
            if type(stamp) is int:
                yield from self._stamped_at(client, stamp, time, which)
        for prot_id in self._gone.keys() - self.clients.keys():
            if prot_id in found:
                yield Finding(("BP-DRG-02",), f"no protocol {prot_id} in the list", "still in the list")

    def _stamped_at(self, client: Client, stamp: int, time: int, which: str) -> Iterator[Finding]:
        """Judge the time of a registration; that of an earlier one of the identifier cannot be the same."""
        if client.stamp is not None:
            if client.stamp != stamp:
                yield Finding((which, "BP-REG-06"), f"the registration time {client.stamp}", str(stamp))
            client.stamp = stamp
            return
        client.stamp = stamp
        former = self._stamps.setdefault(client.prot_id, set())
        # The resolution of a clock may be low, but not half a second.
        if stamp in former and time - self._stamped[client.prot_id] > 500_000_000:
            yield Finding((which, "BP-REG-06"), "the time of this registration", "that of an earlier registration")
        former.add(stamp)
        self._stamped[client.prot_id] = time

    # -- parameters --------------------------------------------------------------------------------------------

    def set_period(self, period: int, time: int) -> None:
        """Record a new BPPAR_BEACON_PERIOD in ns. The interval that has begun may be of the former length."""
        self._paced.clear()
        self._early.clear()
        self._pace_from = time + 3 * max(self.period, period) + self.timing.flight
        self.period, self._interval, self._exact = max(self.period, period), period, False

    def reported_period(self, period: int) -> None:
        """Take the period into account that the implementation reports: its resolution may be lower."""
        if abs(period - self._interval) <= _RESOLUTION:
            self._interval, self._exact = period, True

    def _pace(self, time: int) -> Iterator[Finding]:
        """Judge the mean interval of beacons; single ones vary, and a beacon may be left out."""
        if time < self._pace_from or not self.active:
            return
        self._paced.append(time)
        if len(self._paced) <= _INTERVALS:
            return
        mean, always = (time - self._paced[0]) / _INTERVALS, self._paced[0] > self._lacking
        least, most = 0.6 * self._interval, 2.5 * self._interval + self._delay
        if self._exact:
            # Of a mean of intervals that vary.
            error = _DEVIATIONS * stdev(map(sub, self._paced[1:], self._paced)) / _INTERVALS**0.5
            least = max(least, 0.95 * self._interval - error)
            if self.timing.whole:
                most = min(most, 1.05 * self._interval + error)
        self._paced.clear()
        if mean + (2 * self.timing.flight + self.timing.late) / _INTERVALS < least:
            expected = f"a beacon every {self._interval / MS:g} ms on average"
            yield Finding(("BP-PAR-02", "BP-TX-01"), expected, f"every {mean / MS:.1f} ms")
        elif always and mean > most and not self.timing.lossy:
            expected = f"a beacon every {self._interval / MS:g} ms on average, since a payload is repeated"
            yield Finding(("BP-TX-01",), expected, f"every {mean / MS:.1f} ms")

    def resized(self, packet: int, time: int) -> None:
        """Record a new BPPAR_MAXIMUM_PACKET_SIZE."""
        self._settle(time)
        self._lacking = time
        self.packet = packet
        self._packets.append((time, packet))
        for client in self.clients.values():
            if client.possible is not None and not client.empty:
                client.moved = min(client.moved, time)
                client.moved = time

    # -- beacons -----------------------------------------------------------------------------------------------

    def _settle(self, time: int) -> None:
        """Allow for a beacon that was generated before ``time`` and not received yet."""
        if not self.timing.flight or (not self.active and time - self.switched > self.timing.flight):
            return
        # During a call that lasts several periods, the node sends several beacons, which are judged after the answer.
        shortest = 9 * min(self._interval, self.timing.period) // 10
        flying = max(_FLYING, self.timing.flight // shortest + 1)
        for client in self.clients.values():
            if client.possible is None:
                continue
            more = set(client.possible)
            edge = list(client.possible)
            # Where a beacon may have several payloads of a client, it may have them all.
            most = _MOST if client.several and client.mode.is_queue else flying
            while edge and len(more) <= _MOST:
                edge = [
                    (queue if client.mode is _Q.REPEAT else queue[1:], (*sent, queue[0]))
                    for queue, sent in edge
                    if queue and len(sent) < most
                ]
                more.update(edge)
            client.possible = more if len(more) <= _MOST else None

    def beacon(self, blocks: list[tuple[int, bytes]], size: int, seqno: int | None, time: int) -> Iterator[Finding]:
        """Judge a beacon of the node, given its blocks and its size in octets."""
        flight = self.timing.flight
        self.beacons += 1
        yield from self._numbered(seqno)
        yield from self._before_epoch(time)
        if not self.active and time - self.switched > flight:
            yield Finding(("BP-MGT-02", "BP-TX-07"), "no beacon while BP is inactive", f"a beacon of {size} octets")
        since = [value for begun, value in self._packets if begun <= time]
        late = [value for begun, value in self._packets if time - flight <= begun <= time]
        most = max(since[-1:] + (since[-2:-1] if late else []))
        # X04: the header may not count.
        if size - self._sizes.header > most:
            yield Finding(("BP-FMT-02",), f"a beacon of at most {most} octets", f"{size} octets")
        taken: dict[int, int] = {}
        for prot_id, octets in blocks:
            taken[prot_id] = taken.get(prot_id, 0) + 1
            client = self.clients.get(prot_id)
            if client is None:
                gone = self._gone.get(prot_id)
                if gone is not None and time - gone > flight:
                    yield Finding(
                        ("BP-DRG-03",), f"no payload of protocol {prot_id}", f"a payload of {len(octets)} octets"
                    )
                continue
            if taken[prot_id] > 1 and not (client.several and client.mode.is_queue):
                # A buffer has one payload, whatever allowMultiplePayloads is.
                buffer = "BP-QM-04" if client.mode is _Q.ONCE else "BP-QM-05"
                why = buffer if client.several else "BP-QM-07"
                yield Finding((why,), "one payload of a client in a beacon", f"{taken[prot_id]} of protocol {prot_id}")
            yield from self._sent(client, octets, time, first=taken[prot_id] == 1)
        if not any(each.mode is _Q.REPEAT and each.prot_id in taken for each in self.clients.values()):
            self._lacking = time
        self._previous = time
        yield from self._pace(time)
        yield from self._starving(taken, size, time)

    def _before_epoch(self, time: int) -> Iterator[Finding]:
        """Judge that not all of the last beacons came long before, or after, their announced times."""
        foretold, self._foretold = self._foretold, None
        if foretold is None or self.timing.clock is None or time < self._pace_from or not self.active:
            return
        self._early = [*self._early[1 - _FORETOLD :], foretold - time]
        off = self._interval // 2 + self.timing.clock
        if len(self._early) < _FORETOLD or -off <= min(self._early) <= off:
            return
        # A node sends no beacon if it has no payload. That is possible after a beacon without a repeated payload.
        always = self._previous - self._lacking > _FORETOLD * self._interval
        if min(self._early) > off or (always and max(self._early) < -off):
            expected = f"the time of the next beacon as nextBeaconGenerationEpoch, within {off / MS:g} ms"
            yield Finding(("BP-PTI-02", "BP-PAR-02"), expected, f"times that differ by {self._early[-1] / MS:g} ms")
            self._early.clear()

    def _numbered(self, seqno: int | None) -> Iterator[Finding]:
        before, self._seqno = self._seqno, seqno
        if seqno is None or before is None or self.timing.lossy:
            return
        if seqno != (before + 1) % (1 << 32):
            yield Finding(("BP-HDR-08",), f"sequence number {(before + 1) % (1 << 32)}", f"{seqno}")

    def _sent(self, client: Client, octets: bytes, time: int, *, first: bool) -> Iterator[Finding]:
        client.told += 1
        if client.early:
            del client.early[0]
        elif not first:
            client.optional.append(time)
        elif client.spare and client.spare[-1] > time - self.timing.flight:
            client.spare.pop()
            client.optional.append(time)
        elif client.told > 0:
            client.untold.append(time)
        if client.possible is None:
            return
        after: set[Content] = set()
        for queue, flying in client.possible:
            if flying:
                if flying[0] == octets:
                    after.add((queue, flying[1:]))
            elif queue and queue[0] == octets:
                after.add((queue if client.mode is _Q.REPEAT else queue[1:], ()))
            if self.timing.lossy:
                kept = (*flying, *queue)
                for place, each in enumerate(kept):
                    if each == octets and place >= len(flying):
                        rest = kept[place:] if client.mode is _Q.REPEAT else kept[place + 1 :]
                        after.add((rest, ()))
        if after:
            client.possible, client.moved = after, time
            if client.mode is not _Q.REPEAT:
                client.left.add(octets)
                client.left -= {each for queue, flying in after for each in queue + flying}
            client.why = ("BP-TX-05",) if not client.mode.is_queue else ("BP-QM-03",)
            return
        heads = {(flying + queue)[0] for queue, flying in client.possible if flying + queue}
        expected = " or ".join(map(_brief, sorted(heads))) or "nothing"
        yield Finding(self._why_not(client, octets), f"{expected} of protocol {client.prot_id}", _brief(octets))
        client.possible = None

    def _why_not(self, client: Client, octets: bytes) -> tuple[str, ...]:
        """Return the requirements that forbid a payload of a client in this beacon."""
        assert client.possible is not None
        waiting = {each for queue, flying in client.possible for each in queue + flying}
        if client.why and client.why[0] in ("BP-CLR-02", "BP-CLR-03") and octets in client.left:
            return client.why if self.switched < client.moved - self.period else (*client.why, "BP-MGT-04")
        if octets in waiting:
            return ("BP-QM-03", "BP-TX-06")
        if octets in client.left:
            if client.mode.is_queue and client.why == ("BP-QM-03",):
                return ("BP-QM-03",)
            return (
                client.why
                if client.why[0].startswith("BP-QM")
                else ("BP-QM-03" if client.mode.is_queue else "BP-QM-04",)
            )
        if client.again and client.empty:
            return ("BP-DRG-05",)
        return ("BP-QM-03",) if client.mode.is_queue else ("BP-QM-04",)

    def _starving(self, taken: Mapping[int, int], size: int, time: int) -> Iterator[Finding]:
        """Yield a finding for a client whose payload surely fitted into this beacon, but is not sent for too long."""
        if not self.timing.patience or self.timing.lossy:
            return
        for prot_id, client in self.clients.items():
            if prot_id in taken or client.possible is None or not self.active:
                continue
            if time - max(client.moved, self.switched) < self.timing.patience:
                continue
            if not all(queue and not flying for queue, flying in client.possible):
                continue
            longest = max(len(queue[0]) for queue, _ in client.possible)
            others = sum(
                max((len(queue[0]) for queue, _ in each.possible if queue), default=0) + self._sizes.block
                for each in self.clients.values()
                if each is not client and each.possible
            )
            if size + longest + others + 2 * self._sizes.block > self.packet:
                client.moved = time
                continue
            which = "BP-QM-03" if client.mode.is_queue else "BP-QM-05" if client.mode is _Q.REPEAT else "BP-QM-04"
            reasons = (
                (which, "BP-MGT-05") if self.switched > 0 and client.moved == self.switched else (which, "BP-TX-04")
            )
            yield Finding(reasons, f"the payload of protocol {prot_id} in a beacon", "none, although there is room")
            client.possible = None

    def silent(self, since: int, time: int) -> Iterator[Finding]:
        """Judge that no beacon came between two times."""
        if not self.timing.patience or self.timing.lossy or not self.active:
            return
        for client in self.clients.values():
            moved = max(since, client.moved, self.switched)
            if client.possible is None or time - moved < max(self.timing.patience, 10 * self.period):
                continue
            if not all(queue and not flying for queue, flying in client.possible):
                continue
            if (
                max(len(queue[0]) for queue, _ in client.possible) + self._sizes.header + self._sizes.block
                > self.packet
            ):
                continue
            changed = self.switched > 0 and client.moved <= self.switched
            which = "BP-MGT-05" if changed else "BP-QM-03" if client.mode.is_queue else "BP-QM-04"
            yield Finding((which,), f"the payload of protocol {client.prot_id} in a beacon", "no beacon")
            client.possible = None

    # -- reception ---------------------------------------------------------------------------------------------

    def received(
        self, blocks: list[tuple[int, bytes]], time: int, forbidden: tuple[str, ...], last: tuple[str, ...] | None,
        *, sure: bool,
    ) -> None:  # fmt: skip
        """Record the blocks of a frame to the node; ``forbidden``: why its receiver must discard it, empty if not.

        ``last``: why it must not deliver the last block, empty if it may; None if that is one like the others.
        ``sure``: whether it must deliver the others.
        """
        skipped = False
        for place, (prot_id, octets) in enumerate(blocks):
            client = self.clients.get(prot_id)
            never, open_ = forbidden, not sure
            if last is not None and place == len(blocks) - 1:
                never, open_ = never or last, True
            if not never and not self.active:
                never = ("BP-RX-13", "BP-MGT-03")
            if not never and client is None:
                never = ("BP-DRG-04", "BP-RX-08") if prot_id in self._gone else ("BP-RX-08",)
            # X46, X49: empty blocks, and blocks larger than registered, may be ignored.
            must = not (never or open_ or self.timing.lossy) and client is not None and 0 < len(octets) <= client.most
            self.deliveries.append(Delivery(prot_id, octets, time, must, never, skipped))
            skipped = skipped or client is None

    def indicated(self, prot_id: int, octets: bytes) -> Iterator[Finding]:
        """Judge a BP-ReceivePayload.indication about a client of the tester."""
        alike = [each for each in self.deliveries if each.prot_id == prot_id and each.octets == octets]
        if alike:
            # One that is due, otherwise one that is allowed.
            chosen = min(alike, key=lambda each: (bool(each.never), not each.must))
            self.deliveries = [each for each in self.deliveries if each is not chosen]
            if chosen.never:
                yield Finding(chosen.never, f"no payload delivered to protocol {prot_id}", _brief(octets))
        elif prot_id in self.clients or prot_id in self._gone:
            yield Finding(("BP-RXP-02", "BP-RXP-01"), "one indication of each payload, with its octets", _brief(octets))

    def undelivered(self, time: int) -> Iterator[Finding]:
        """Yield a finding for each payload that should have been delivered by ``time``."""
        if not self.deliveries:
            return
        limit = time - self.timing.late - self.timing.notice
        for each in self.deliveries:
            if each.must and each.time < limit:
                which = ("BP-RX-07", "BP-RX-08") if each.skipped else ("BP-RX-07",)
                yield Finding(which, f"an indication of {_brief(each.octets)} to {each.prot_id}", "no indication")
        self.deliveries = [each for each in self.deliveries if each.time >= limit - self.period]
        for each in self.deliveries:
            each.must = each.must and each.time >= limit

    def unconfirmed(self, time: int) -> Iterator[Finding]:
        """Yield a finding for a payload in a beacon without its BP-PayloadTransmitted.indication by ``time``."""
        limit = time - self.timing.late - self.timing.notice
        for client in self.clients.values():
            if client.untold and client.untold[0] < limit and not self.timing.lossy:
                which = ("BP-PTI-03", "BP-PTI-01") if client.mode is _Q.REPEAT else ("BP-PTI-01",)
                yield Finding(which, f"an indication of each transmission to {client.prot_id}", "none of one of them")
            client.untold = [each for each in client.untold if each >= limit]
            # An indication of the registration before may come after the next one.
            surplus = [each for each in client.early if each > client.since + self._slack]
            if surplus and surplus[0] < limit - self.timing.flight and not self.timing.lossy:
                yield Finding(("BP-PTI-01",), "an indication for each payload in a beacon", "one without a payload")
            for each in (client.early, client.optional, client.spare):
                each[:] = [moment for moment in each if moment >= limit - self.timing.flight]

    def transmitted(self, prot_id: int, time: int, epoch: int | None = None) -> Iterator[Finding]:
        """Judge a BP-PayloadTransmitted.indication about a client of the tester, which came at ``time``.

        ``epoch``: nextBeaconGenerationEpoch on the tester's monotonic clock, ns; None if it is unknown.
        """
        self._foretold = epoch
        if epoch is not None and self.timing.clock is not None and epoch + self.timing.clock + self._delay < time:
            past = f"a time {(time - epoch) / MS:g} ms ago"
            yield Finding(("BP-PTI-02",), "the time of the next beacon as nextBeaconGenerationEpoch", past)
        client = self.clients.get(prot_id)
        if client is None or self.timing.lossy:
            return
        client.told -= 1
        if client.untold:
            del client.untold[0]
        elif client.optional:
            del client.optional[0]
            client.spare.append(time)
        else:
            client.early.append(time)
        if client.told < 0 and client.possible is not None and not self.timing.flight:
            yield Finding(("BP-PTI-01",), "an indication for each payload in a beacon", "one without a payload")
            client.told = 0

    @property
    def _delay(self) -> int:
        """The longest time from an event to its notification, ns."""
        return self.timing.late + self.timing.notice + self.timing.flight

    @property
    def _slack(self) -> int:
        """The longest time from a beacon to the notifications about it, ns."""
        return self._delay + self.period

    @property
    def state(self) -> str:
        """A name of the state, for statistics."""
        return "active" if self.active else "inactive"

    def client_state(self, prot_id: int) -> str:
        """A name of the state of a client, for statistics."""
        client = self.clients.get(prot_id)
        if client is None:
            return "former" if prot_id in self._gone else "none"
        how = "unknown" if client.possible is None else "empty" if client.empty else "waiting"
        if client.possible and client.mode.is_queue and client.entries:
            sizes = {len(queue) for queue, _ in client.possible}
            how = "full" if sizes == {client.entries} else how
        name = client.mode.value.removeprefix("BP_QMODE_").removeprefix("QUEUE_").lower()
        return f"{name} {how}{' again' if client.again else ''}{'' if self.active else ', inactive'}"


def _brief(octets: bytes) -> str:
    return f"{octets.hex()}" if len(octets) <= 8 else f"{octets[:6].hex()}... ({len(octets)} octets)"


def _shown(value: Any) -> str:
    return repr(value) if isinstance(value, str) else str(value)


__all__ = ["BPModel", "Client", "Delivery", "Sizes", "either"]
