"""A recording as a test: one of its nodes is the implementation, all others are played to it.

What the recorded nodes said is the stimulus, as it was; what the applications of the replaced node did is done again at
the upper interface, as far as there is one. The answers are not compared octet by octet, since the specification leaves
much of them open: they are held against an independent model (:mod:`dcp_conformance.oracle`), and the outcome against
that of the recorded node.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec
from dcp_spec.constants import ICType

from dcp_codec.capture import CaptureError, Frame, open_capture
from dcp_codec.codec import Codec
from dcp_codec.framing.locate import OtherTraffic, locate
from dcp_codec.values import VarCreate, VarUpdate
from dcp_codec.views.dissect import dissect
from dcp_conformance.errors import UsageError
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.model.case import Case, Kind
from dcp_conformance.model.circular import Circle
from dcp_conformance.model.results import CaseResult, Mark
from dcp_conformance.oracle import Limits, Oracle, Waiting
from dcp_conformance.test_system.bench import Bench

MS = 1_000_000
#: How old a payload may be when it is seen on the air, in beacon periods.
_LATENCY = 1.6
#: Findings of one kind that are told.
_MOST = 20


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How to play. ``speed`` 1 is the original timing, 2 twice as fast, 0 as fast as the implementation keeps up."""

    node: bytes | None = None
    """The recorded node whose part the implementation plays."""
    speed: float = 1.0
    services: bool = True
    """Do again what the applications of the replaced node did."""


@dataclass(slots=True)
class Cast:
    """Who is in a recording, and from when to when: times of capture in ns, of the first and the latest beacon."""

    beacons: Counter[bytes] = field(default_factory=Counter)
    produced: Counter[bytes] = field(default_factory=Counter)
    frames: int = 0
    other: int = 0
    first: int | None = None
    last: int = 0

    @property
    def seconds(self) -> float:
        """How long playing takes in the original timing."""
        return 0.0 if self.first is None else (self.last - self.first) / 1e9


def cast_of(path: Path, codec: Codec) -> Cast:
    """Read a recording through. Raises :class:`UsageError`: unreadable, or nothing of the profile in it."""
    cast = Cast()
    for frame, heard, _ in beacons_of(path, codec, cast):
        cast.first = frame.time_ns if cast.first is None else cast.first
        cast.last = max(cast.last, frame.time_ns)
        if heard.sender is None:
            continue
        cast.beacons[heard.sender] += 1
        cast.produced[heard.sender] += sum(
            each.record.spec.prod_id == heard.sender for each in heard.instructions(ICType.CREATE_VARIABLES)
        )
    if not cast.beacons:
        raise UsageError(f"{path}: none of its {cast.frames} frames is DCP in the profile {codec.profile.name}")
    return cast


def beacons_of(path: Path, codec: Codec, cast: Cast | None = None) -> Iterator[tuple[Frame, ReceivedBeacon, bytes]]:
    """The DCP frames of a recording, decoded, with the source address. Raises :class:`UsageError`."""
    try:
        with open_capture(path) as reader:
            for frame in reader:
                if cast is not None:
                    cast.frames += 1
                framing = locate(frame.data, codec.profile.link)
                if isinstance(framing, OtherTraffic):
                    continue
                octets = frame.data[framing.start : framing.end]
                source = framing.src or b"\x02\0\0\0\0\0"
                yield frame, ReceivedBeacon(codec, frame.number, frame.time_ns, frame.time_ns, octets, source), source
    except CaptureError as error:
        raise UsageError(str(error)) from None


def choose_node(cast: Cast, sut_id: bytes | None) -> bytes:
    """Whose part the implementation plays: its own if it is in the recording, else the one that produces least."""
    if sut_id is not None and sut_id in cast.beacons:
        return sut_id
    return min(cast.beacons, key=lambda node: (cast.produced[node], -cast.beacons[node], node))


class Replay:
    """Plays one recording; :meth:`cases` are then run like others, and the first of them does the playing."""

    def __init__(self, path: Path, options: ReplayOptions) -> None:
        self._path = path
        self._options = options
        self._complaints: OrderedDict[tuple[str, str], list[tuple[str, str, int]]] = OrderedDict()
        self._counts: Counter[tuple[str, str]] = Counter()
        self.node = b""
        self.cast = Cast()

    def cases(self) -> list[Case]:
        """The one case that plays the recording."""
        return [
            Case(
                id="TC_NET_REPLAY_BV_01",
                purpose=f"The implementation takes the part of a node in {self._path.name}",
                requirements=_REQUIREMENTS,
                kind=Kind.VALID,
                stimulus="the frames of all other nodes of the recording, in their order and timing",
                expect="the reactions that the variable states ask for, nothing else, and the same outcome",
                window=4,
                section="Recordings",
                module=__name__,
                run=self.play,
            )
        ]

    def take_part(self, codec: Codec, sut_id: bytes | None) -> None:
        """Settle whose part the implementation plays; ``sut_id`` is how it is called, None if that is not known yet.

        Raises :class:`UsageError`: unreadable, nothing of the profile, no such node, or the identifier of another one.
        """
        self.cast = cast = cast_of(self._path, codec)
        self.node = self._options.node or choose_node(cast, sut_id)
        if self.node not in cast.beacons:
            there = ", ".join(node.hex(":") for node in cast.beacons)
            raise UsageError(f"{self._path}: no node {self.node.hex(':')} in it; there are {there}")
        if sut_id is not None and sut_id != self.node and sut_id in cast.beacons:
            raise UsageError(
                f"{self._path}: the implementation is called {sut_id.hex(':')} like one of the recorded nodes, whose "
                f"frames it would ignore; let it take that part (--node {sut_id.hex(':')}), or call it otherwise"
            )

    # -- playing -----------------------------------------------------------------------------------------------

    def play(self, bench: Bench) -> None:
        """Play everything, then look at the outcome."""
        if bench.session.sut_id is None and not bench.beacons(1, 5):
            # Without knowing what is its own nothing can be said of it.
            bench.probes.probe(10)
        self.take_part(bench.codec, bench.session.sut_id)
        oracle = self._oracle(bench, bench.session.sut_id or self.node)
        waiting = Waiting(bench.period, bench.sut.parameter("BPPAR_MAXIMUM_PACKET_SIZE"))
        recorded: dict[int, int | None] = {}
        actions = _Applications(bench, oracle, self.node) if self._options.services and bench.session.upper else None
        # What it has said before is no part of the play.
        begun, first, judged = bench.now(), 0, len(bench.heard)
        for frame, heard, source in beacons_of(self._path, bench.codec):
            first = first or frame.time_ns
            if self._options.speed > 0:
                due = begun + round((frame.time_ns - first) / self._options.speed)
                bench.waiting.wait_ns(max(0, due - bench.now()))
            elif heard.sender == self.node:
                # In step: a beacon of the implementation for each of the node whose part it plays.
                bench.beacons(1, 3)
            judged = self._judge(bench, oracle, waiting, judged)
            if heard.sender == self.node:
                _remember(recorded, heard)
                if actions is not None:
                    actions.act(heard)
                continue
            number = self._send(bench, heard, source)
            if heard.problem is None:
                oracle.hear([each.record for each in heard.instructions()], bench.now(), number)
            else:
                _doubt(bench.codec, oracle, heard)
        self._finish(bench, oracle, waiting, judged)
        self._tell(bench, oracle)
        self._compare(bench, oracle, recorded)

    def _oracle(self, bench: Bench, own_id: bytes) -> Oracle:
        limits = Limits(
            bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH"),
            bench.sut.parameter("VARDISPAR_MAX_DESCRIPTION_LENGTH"),
            bench.sut.parameter("VARDISPAR_MAX_REPETITIONS"),
        )
        return Oracle(
            own_id,
            bench.features,
            bench.profile.types.var_seqno.width,
            limits,
            latency=round(_LATENCY * bench.period),
            window=round(bench.sut.reaction * bench.period),
        )

    def _send(self, bench: Bench, heard: ReceivedBeacon, source: bytes) -> int:
        """As recorded, in the network of the implementation."""
        octets = heard.octets
        if bench.profile.has_header_field("networkId") and heard.beacon is not None and heard.beacon.bp is not None:
            network = bench.sut.parameter("BPPAR_NETWORK_ID")
            if heard.beacon.bp.network_id != network:
                octets = bench.builder.patched(bench.codec.envelope_plan, octets, {"bp.networkId": network})
        return bench.transmission.send(octets, source)

    def _judge(self, bench: Bench, oracle: Oracle, waiting: Waiting, judged: int) -> int:
        """Hold what was heard since against the model; what has been judged now."""
        for heard in bench.heard[judged:]:
            said = [(each.kind, each.record) for each in heard.instructions()]
            waited = waiting.of(len(heard.octets), vardis=bool(said))
            for each in oracle.said(said, heard.time, heard.number, waited=waited):
                self._complain(each.requirement, each.expected, f"variable {each.var_id}: {each.observed}", each.frame)
        for owed in oracle.overdue(bench.now() - bench.period):
            text = f"{owed.kind.label} of variable {owed.var_id}"
            self._complain(owed.requirement, f"{text} in time", f"variable {owed.var_id}: it did not come", owed.cause)
        return len(bench.heard)

    def _complain(self, requirement: str, expected: str, observed: str, frame: int) -> None:
        key = (requirement, expected)
        self._counts[key] += 1
        kept = self._complaints.setdefault(key, []) if len(self._complaints) < _MOST else self._complaints.get(key)
        if kept is not None and len(kept) < 3:
            kept.append((expected, observed, frame))

    def _finish(self, bench: Bench, oracle: Oracle, waiting: Waiting, judged: int) -> None:
        """Wait until everything that is owed had its time, and every variable its summary."""
        alive = sum(version.state == "alive" for _, version in oracle.holdings())
        rounds = math.ceil(alive / max(1, bench.sut.parameter("VARDISPAR_MAX_SUMMARIES")))
        bench.wait(bench.sut.reaction + 2 + rounds)
        self._judge(bench, oracle, waiting, judged)

    # -- judging -----------------------------------------------------------------------------------------------

    def _tell(self, bench: Bench, oracle: Oracle) -> None:
        """The findings as checks; what the recording gave an occasion for, and nothing was found about, is passed."""
        for (requirement, expected), kept in self._complaints.items():
            count = self._counts[requirement, expected]
            times = "" if count == 1 else f" ({count} times)"
            marks = [Mark(frame) for _, _, frame in kept if frame]
            bench.check(False, expected, f"{kept[0][1]}{times}", requirement, frames=marks)
        wrong = {requirement for requirement, _ in self._complaints}
        right = [each for each in _REQUIREMENTS if oracle.occasions.get(each) and each not in wrong]
        if right:
            occasions = sum(oracle.occasions[each] for each in right)
            what = f"what it says is covered by what it heard, and nothing is missing ({occasions} occasions)"
            bench.check(True, what, "", *right)

    def _compare(self, bench: Bench, oracle: Oracle, recorded: dict[int, int | None]) -> None:
        """The outcome: what the implementation holds, what the model says, what the recorded node held."""
        rounds = max(8, math.ceil(len(oracle.variables) / max(1, bench.sut.parameter("VARDISPAR_MAX_SUMMARIES"))) + 2)
        last: dict[int, int | None] = {}
        for heard in bench.heard[-rounds:]:
            _remember(last, heard, only=ICType.SUMMARIES)
        summaries = bench.sut.parameter("VARDISPAR_MAX_SUMMARIES") > 0
        checked = 0
        for var_id, version in sorted(oracle.holdings()):
            expected = version.seqno if version.state == "alive" else None
            has = last.get(var_id)
            if summaries:
                checked += 1
                what = f"variable {var_id} in the end: " + ("deleted" if expected is None else f"number {expected}")
                requirement = "VD-PD-04" if expected is None else "VD-PU-07"
                shown = "it is not summarised" if has is None else f"its summaries say {has}"
                if has != expected:
                    bench.check(False, what, shown, requirement)
            if var_id in recorded and recorded[var_id] != has:
                was = "deleted" if recorded[var_id] is None else f"number {recorded[var_id]}"
                now = "deleted or unknown" if has is None else f"number {has}"
                agrees = "as the specification asks" if has == expected else "against the specification"
                bench.info(
                    f"variable {var_id}: the recorded node and the implementation end alike",
                    f"{was} in the recording, {now} now, {agrees}",
                    "VD-PU-07",
                )
        if checked:
            what = f"the implementation holds in the end what the model holds ({checked} variables)"
            bench.check(True, what, "", "VD-PU-07")
        elif not bench.heard:
            bench.inconclusive("beacons of the implementation", "it said nothing during the whole recording")


_REQUIREMENTS = (
    "VD-PC-09", "VD-PC-10", "VD-PD-04", "VD-PU-01", "VD-PU-06", "VD-PU-07", "VD-PS-01", "VD-PS-02", "VD-PS-03",
    "VD-PS-04", "VD-RU-01", "VD-RU-04", "VD-RC-01", "VD-RC-03", "VD-SCP-01", "VD-SCP-02", "VD-CMP-04", "VD-CMP-05",
    "VD-UPD-08", "VD-UPD-10", "VD-CRE-12", "VD-DEL-05",
)  # fmt: skip


def decided(result: CaseResult) -> CaseResult:
    """The result with the requirements that its checks are about: a recording does not give an occasion for all."""
    found = dict.fromkeys(each for check in result.checks for each in check.requirements)
    return msgspec.structs.replace(result, requirements=tuple(found) or result.requirements)


class _Applications:
    """Does at the upper interface what the recorded node's applications did."""

    def __init__(self, bench: Bench, oracle: Oracle, node: bytes) -> None:
        self._bench = bench
        self._oracle = oracle
        self._node = node
        self._circle = Circle(bench.profile.types.var_seqno.width)
        self._own: dict[int, tuple[Any, int]] = {}
        """Variable -> creation time and number that were last sent."""
        self._report: Any = None

    def act(self, heard: ReceivedBeacon) -> None:
        """A beacon of the recorded node tells what its applications did."""
        for each in heard.instructions(ICType.CREATE_VARIABLES):
            self._create(each.record)
        for each in heard.instructions(ICType.DELETE_VARIABLES):
            if each.var_id in self._own and "RTDB-Delete" in self._bench.services.upper.methods:
                del self._own[each.var_id]
                if self._bench.call("RTDB-Delete", varId=each.var_id).ok:
                    self._oracle.deleted(each.var_id, self._bench.now())
        for each in heard.instructions(ICType.UPDATES):
            self._update(each.record)
        report = heard.report
        if (
            report is not None
            and report.seqno != self._report
            and "SRP-UpdateSafetyData" in self._bench.services.upper.methods
        ):
            self._report = report.seqno
            data = {name: value for name, value in report.s_data.as_dict().items() if not isinstance(value, bytes)}
            self._bench.call("SRP-UpdateSafetyData", sData=data)

    def _create(self, record: VarCreate) -> None:
        spec = record.spec
        if spec.prod_id != self._node or "RTDB-Create" not in self._bench.services.upper.methods:
            return
        known = self._own.get(spec.var_id)
        if known is not None and known[0] == spec.creation_time:
            self._update(record.upd)
            return
        params: dict[str, Any] = {
            "varId": spec.var_id,
            "repCnt": spec.rep_cnt,
            "descr": spec.descr.decode("utf-8", "replace"),
            "value": record.upd.value.hex(),
        }
        if spec.timeout:
            params["timeout"] = spec.timeout
        if self._bench.call("RTDB-Create", **params).ok:
            # What was updated before it was first seen on the air is created with its newest value.
            self._own[spec.var_id] = (spec.creation_time, record.upd.seqno)
            own = self._bench.session.sut_id or self._node
            self._oracle.created(msgspec.structs.replace(spec, prod_id=own), record.upd.value, self._bench.now())

    def _update(self, record: VarUpdate) -> None:
        known = self._own.get(record.var_id)
        if known is None or "RTDB-Update" not in self._bench.services.upper.methods:
            return
        missing = (record.seqno - known[1]) % self._circle.modulus
        if not 0 < missing < self._circle.modulus // 2:
            return
        self._own[record.var_id] = (known[0], record.seqno)
        for _ in range(missing):
            if self._bench.call("RTDB-Update", varId=record.var_id, value=record.value.hex()).ok:
                self._oracle.updated(record.var_id, record.value, self._bench.now())


def _remember(table: dict[int, int | None], heard: ReceivedBeacon, only: ICType | None = None) -> None:
    """Note the last number of each variable that a node sent; None for one that it deleted."""
    for each in heard.instructions():
        if each.kind is ICType.DELETE_VARIABLES:
            table[each.var_id] = None
        elif each.kind is ICType.SUMMARIES or (only is None and each.kind is ICType.UPDATES):
            table[each.var_id] = each.record.seqno
        elif only is None and each.kind is ICType.CREATE_VARIABLES:
            table[each.var_id] = each.record.upd.seqno


def _doubt(codec: Codec, oracle: Oracle, heard: ReceivedBeacon) -> None:
    """A frame that is no beacon: what the implementation takes of it is open (X34)."""
    for each in dissect(codec.beacon_plan, heard.octets).root.walk():
        if each.name == "varId" and isinstance(each.value, int):
            oracle.doubt(each.value)
