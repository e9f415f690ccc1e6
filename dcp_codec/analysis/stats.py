"""Statistics of a recording: beacons, loss and intervals per sender, containers and records by type, variables.

The ledger tells which nodes hold the numbers of variables, and which of them are stale.

A malformed beacon whose blocks can be separated counts as a beacon, with its readable parts. Memory is bounded: there
are counters per sender and per variable, with an upper limit on both.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from dcp_spec.constants import BP_PROTID_SRP, BP_SEQNO_MODULUS
from dcp_spec.profile.definition import Link

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.framing.locate import Framing, OtherTraffic, mac
from dcp_codec.jsonform import node_id_text
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, Payload

from .ledger import Ledger

#: Senders and variables beyond this number share one counter.
MAX_KEYS = 65_536
#: Malformed frames that are kept as examples.
EXAMPLES = 10


class IntervalStats:
    """Running statistics of the time between beacons of one sender, in ns (Welford's method, constant memory)."""

    __slots__ = ("_m2", "count", "longest", "mean", "shortest")

    def __init__(self) -> None:
        self.count = 0
        self.mean = 0.0
        self._m2 = 0.0
        self.shortest = math.inf
        self.longest = -math.inf

    def add(self, interval_ns: int) -> None:
        """Count one interval."""
        self.count += 1
        delta = interval_ns - self.mean
        self.mean += delta / self.count
        self._m2 += delta * (interval_ns - self.mean)
        self.shortest = min(self.shortest, interval_ns)
        self.longest = max(self.longest, interval_ns)

    def as_json(self) -> dict[str, Any]:
        """``count`` and mean, stddev, min, max in ms (null without an interval)."""
        if not self.count:
            return {"count": 0, "mean_ms": None, "stddev_ms": None, "min_ms": None, "max_ms": None}
        deviation = math.sqrt(self._m2 / (self.count - 1)) if self.count > 1 else 0.0
        return {
            "count": self.count,
            "mean_ms": round(self.mean / 1e6, 6),
            "stddev_ms": round(deviation / 1e6, 6),
            "min_ms": round(self.shortest / 1e6, 6),
            "max_ms": round(self.longest / 1e6, 6),
        }


class SenderStats:
    """One sender: beacons, sequence numbers, missing numbers between them, intervals.

    ``lost`` counts the skipped numbers. A number that goes back, or forward by 2^31 or more, is a ``restart`` and not a
    loss; a repeated number is a ``duplicate`` (C.1 of the protocol reference: only an estimate). ``backwards`` counts
    the beacons before which the clock of the recorder was set back: they have no interval.
    """

    __slots__ = (
        "backwards", "beacons", "duplicates", "first_seqno", "intervals", "last_seqno", "last_time_ns", "lost",
        "restarts",
    )  # fmt: skip

    def __init__(self) -> None:
        self.beacons = 0
        self.backwards = 0
        self.first_seqno: int | None = None
        self.last_seqno: int | None = None
        self.lost = 0
        self.restarts = 0
        self.duplicates = 0
        self.last_time_ns: int | None = None
        self.intervals = IntervalStats()

    def add(self, seqno: int | None, time_ns: int) -> None:
        """Count one beacon."""
        self.beacons += 1
        if self.last_time_ns is not None:
            if time_ns >= self.last_time_ns:
                self.intervals.add(time_ns - self.last_time_ns)
            else:
                self.backwards += 1
        self.last_time_ns = time_ns
        if seqno is None:
            return
        if self.last_seqno is None:
            self.first_seqno = seqno
        else:
            step = (seqno - self.last_seqno) % BP_SEQNO_MODULUS
            if step == 0:
                self.duplicates += 1
            elif step < BP_SEQNO_MODULUS // 2:
                self.lost += step - 1
            else:
                self.restarts += 1
        self.last_seqno = seqno

    def as_json(self) -> dict[str, Any]:
        """Return the counters under the names of ``dcp-codec stats --format json``."""
        return {
            "beacons": self.beacons,
            "first_seqno": self.first_seqno,
            "last_seqno": self.last_seqno,
            "lost": self.lost,
            "restarts": self.restarts,
            "duplicates": self.duplicates,
            "backwards": self.backwards,
            "interval": self.intervals.as_json(),
        }


class Stats:
    """Counts the frames of a recording; :meth:`as_json` lists the results. ``link`` is that of :meth:`add`."""

    def __init__(self, codec: Codec, link: Link | None = None) -> None:
        self.codec = codec
        #: The reason why a guessed profile may be wrong; for the JSON form.
        self.doubt: str | None = None
        self._link = link or codec.profile.link
        numbers = codec.profile.vardis.container_types.by_name()
        self._names = codec.profile.vardis.container_names()
        self._updates = numbers["UPDATES"]
        self._creates = numbers["CREATE-VARIABLES"]
        self.frames = 0
        self.beacons = 0
        self.malformed = 0
        self.padded = 0
        self.srp = 0
        self.vardis = 0
        self.other_payloads = 0
        self.octets = 0
        self.senders: dict[str, SenderStats] = {}
        self.containers: Counter[str] = Counter()
        self.records: Counter[str] = Counter()
        self.damaged: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.other_traffic: Counter[str] = Counter()
        self.last_values: dict[int, tuple[int, str]] = {}
        self.ledger = Ledger()
        self.first_time_ns: int | None = None
        self.last_time_ns: int | None = None
        #: (frame number, problem) of the first malformed frames.
        self.examples: list[tuple[int, str]] = []

    def add(self, frame: Frame, framing: Framing | OtherTraffic) -> None:
        """Count one frame after ``dcp_codec.framing.locate.locate``."""
        self.frames += 1
        if isinstance(framing, OtherTraffic):
            kind = f"0x{framing.ether_type:04x}" if framing.ether_type is not None else framing.reason
            self.other_traffic[kind] += 1
            return
        octets = frame.data if framing.end == len(frame.data) else frame.data[: framing.end]
        try:
            beacon, end = self.codec.decode_from(octets, framing.start)
        except DecodeError as error:
            self.malformed += 1
            self.reasons[error.problem.reason] += 1
            if len(self.examples) < EXAMPLES:
                self.examples.append((frame.number, str(error.problem)))
            found = self.codec.salvage(octets[framing.start :])
            if found.beacon is None or not found.clear:
                return
            beacon, end = found.beacon, framing.start + found.end
            self.damaged.update(self._kind(beacon.payloads[each.payload]) for each in found.damaged)
        self._count(beacon, frame, framing)
        self.octets += end - framing.start
        self.padded += end < len(octets)

    def _count(self, beacon: Beacon, frame: Frame, framing: Framing) -> None:
        self.beacons += 1
        # Minimum and maximum: files may hold frames out of order, and clocks may be set.
        self.first_time_ns = min(frame.time_ns, self.first_time_ns if self.first_time_ns is not None else frame.time_ns)
        self.last_time_ns = max(frame.time_ns, self.last_time_ns if self.last_time_ns is not None else frame.time_ns)
        seqno: int | None = None
        if beacon.bp is not None:
            sender = node_id_text(beacon.bp.sender_id, self.codec.profile.types.node_id.representation)
            seqno = beacon.bp.seqno
        else:
            sender = mac(framing.src) if framing.src is not None else "unknown"
        stats = self.senders.get(sender)
        if stats is None:
            key = sender if len(self.senders) < MAX_KEYS else "others"
            stats = self.senders.setdefault(key, SenderStats())
        stats.add(seqno, frame.time_ns)
        who = beacon.bp.sender_id if beacon.bp is not None else framing.src or b""
        self.ledger.feed(frame.number, frame.time_ns, who, beacon)
        for payload in beacon.payloads:
            match self._kind(payload):
                case "srp":
                    self.srp += 1
                case "vardis":
                    self.vardis += 1
                    for container in payload.vardis or ():
                        self._count_container(container)
                case _:
                    self.other_payloads += 1

    def _kind(self, payload: Payload) -> str:
        """Return the protocol of a payload, also of an unreadable one."""
        if isinstance(payload.content, tuple):
            return "vardis"
        report = payload.protocol_id == BP_PROTID_SRP and self.codec.srp_plan is not None
        return "srp" if report or isinstance(payload.content, ExtendedSafetyData) else "other"

    def _count_container(self, container: Container) -> None:
        name = self._names[container.ic_type]
        self.containers[name] += 1
        self.records[name] += len(container.records)
        if container.ic_type == self._updates:
            updates: Any = container.records
        elif container.ic_type == self._creates:
            updates = [record.upd for record in container.records]
        else:
            return
        for update in updates:
            if update.var_id in self.last_values or len(self.last_values) < MAX_KEYS:
                self.last_values[update.var_id] = (update.seqno, update.value.hex())

    def _variables(self) -> dict[str, dict[str, Any]]:
        """Return for each variable with one producer: how many nodes hold its number, and which had a stale one."""
        ledger, representation = self.ledger, self.codec.profile.types.node_id.representation
        period = max((each.intervals.mean for each in self.senders.values()), default=0.0)
        stale = ledger.stale(period)
        found = {}
        for var_id in sorted(ledger.compared):
            producer = ledger.producers[var_id]
            number = ledger.number(producer, var_id)
            late = [each for each in stale if each.var_id == var_id]
            found[str(var_id)] = {
                "producer": node_id_text(producer, representation),
                "nodes": sum(ledger.number(node, var_id) is not None for node in ledger.nodes),
                "current": sum(ledger.number(node, var_id) == number for node in ledger.nodes),
                "stale": len({each.node for each in late}),
                "longest_lag_s": round(max((each.age for each in late), default=0) / 1e9, 6),
            }
        return found

    def as_json(self) -> dict[str, Any]:
        """Return the object that ``dcp-codec stats --format json`` prints; counters have the specification's names."""
        span = None
        if self.first_time_ns is not None and self.last_time_ns is not None:
            span = (self.last_time_ns - self.first_time_ns) / 1e9
        return {
            "profile": self.codec.profile.name,
            **({} if self.doubt is None else {"profileDoubt": self.doubt}),
            "frames": self.frames,
            "beacons": self.beacons,
            "first_time_ns": self.first_time_ns,
            "last_time_ns": self.last_time_ns,
            "duration_s": span,
            "octets": self.octets,
            "senders": {sender: stats.as_json() for sender, stats in sorted(self.senders.items())},
            "srp": self.srp,
            "vardis": self.vardis,
            "other_payloads": self.other_payloads,
            "damaged_payloads": dict(sorted(self.damaged.items())),
            "containers": dict(sorted(self.containers.items())),
            "records": dict(sorted(self.records.items())),
            "padded": self.padded,
            "errors": self.malformed,
            "error_reasons": dict(self.reasons.most_common()),
            "other_traffic": dict(self.other_traffic.most_common()),
            "variables": self._variables(),
            "last_sent_value": {
                str(var_id): {"seqno": seqno, "value": value}
                for var_id, (seqno, value) in sorted(self.last_values.items())
            },
        }
