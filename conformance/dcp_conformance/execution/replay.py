"""Replay of a recording as a test: the implementation takes the part of one node, the tester that of all others.

The stimuli are the recorded frames of the other nodes. The service calls of the replaced node's applications are
repeated at the upper tester, if there is one. The reactions are not compared octet by octet, because the specification
leaves much of them open. They are compared with an independent model (:mod:`dcp_conformance.oracle`), and the final
state with that of the recorded node.
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
from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.definitions.circular import Circle
from dcp_conformance.definitions.results import CaseResult, Mark
from dcp_conformance.errors import UsageError
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.oracle import Limits, Oracle, Waiting
from dcp_conformance.test_system.bench import Bench

MS = 1_000_000
#: Maximum time between composing and receiving a payload, in beacon periods.
_LATENCY = 1.6
#: Maximum number of different findings that are reported.
_MOST = 20


@dataclass(slots=True)
class RecordedNodes:
    """The nodes of a recording, and its duration."""

    beacons: Counter[bytes] = field(default_factory=Counter)
    """Number of beacons by node."""
    produced: Counter[bytes] = field(default_factory=Counter)
    """Number of VarCreates of own variables by node."""
    frames: int = 0
    """Number of all frames."""
    other: int = 0
    first: int | None = None
    """Capture time of the first beacon in ns."""
    last: int = 0
    """Capture time of the latest beacon in ns."""

    @property
    def seconds(self) -> float:
        """Duration of the replay in the original timing, in seconds."""
        return 0.0 if self.first is None else (self.last - self.first) / 1e9


def recorded_nodes(path: Path, codec: Codec) -> RecordedNodes:
    """Read a recording and return its nodes. Raise :class:`UsageError` if it is unreadable or has no DCP frame."""
    cast = RecordedNodes()
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


def beacons_of(
    path: Path, codec: Codec, cast: RecordedNodes | None = None
) -> Iterator[tuple[Frame, ReceivedBeacon, bytes]]:
    """Yield the DCP frames of a recording, with decoded beacon and source address; count all frames in ``cast``.

    Raise :class:`UsageError` if the recording is unreadable.
    """
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


def choose_node(cast: RecordedNodes, sut_id: bytes | None) -> bytes:
    """Return the node whose part the implementation takes: itself if recorded, else the one that produces least."""
    if sut_id is not None and sut_id in cast.beacons:
        return sut_id
    return min(cast.beacons, key=lambda node: (cast.produced[node], -cast.beacons[node], node))


class Replay:
    """Replays one recording as a test case; see :meth:`cases`."""

    def __init__(self, path: Path, node: bytes | None = None, *, speed: float = 1.0, services: bool = True) -> None:
        """``node``: the recorded node whose part the implementation takes; None: chosen automatically.

        ``speed``: 1 is the original timing, 2 is twice as fast, 0 is as fast as the implementation sends beacons.
        ``services``: whether to repeat the service calls of the replaced node's applications.
        """
        self._path, self._wanted, self._speed, self._services = path, node, speed, services
        self._complaints: OrderedDict[tuple[str, str], list[tuple[str, str, int]]] = OrderedDict()
        self._counts: Counter[tuple[str, str]] = Counter()
        self.node = b""
        self.cast = RecordedNodes()

    def cases(self) -> list[Case]:
        """Return the one case that replays the recording; a runner executes it like others."""
        return [
            Case(
                id="TC_NET_REPLAY_BV_01",
                purpose=f"The implementation takes the part of a node in {self._path.name}",
                requirements=_REQUIREMENTS,
                kind=Kind.VALID,
                stimulus="the frames of all other nodes of the recording, in their order and timing",
                expect="the reactions that the variable states require, no others, and the same final state",
                window=4,
                section="Recordings",
                module=__name__,
                run=self.play,
            )
        ]

    def take_part(self, codec: Codec, sut_id: bytes | None) -> None:
        """Determine the node whose part the implementation takes. ``sut_id`` is its identifier, None if unknown.

        Raise :class:`UsageError` if the recording is unreadable, has no DCP frame or not the chosen node, or if the
        implementation has the identifier of another recorded node.
        """
        self.cast = cast = recorded_nodes(self._path, codec)
        self.node = self._wanted or choose_node(cast, sut_id)
        if self.node not in cast.beacons:
            there = ", ".join(node.hex(":") for node in cast.beacons)
            raise UsageError(f"{self._path}: no node {self.node.hex(':')} in it; there are {there}")
        if sut_id is not None and sut_id != self.node and sut_id in cast.beacons:
            raise UsageError(
                f"{self._path}: the implementation has the identifier {sut_id.hex(':')} of another recorded node, "
                f"whose frames it would ignore; select that node (--node {sut_id.hex(':')}), or change the identifier"
            )

    # -- replaying ---------------------------------------------------------------------------------------------

    def play(self, bench: Bench) -> None:
        """Replay the whole recording, then check the final state."""
        if bench.session.sut_id is None and not bench.beacons(1, 5):
            # Only with its node identifier the implementation can be judged.
            bench.probes.probe(10)
        self.take_part(bench.codec, bench.session.sut_id)
        oracle = self._oracle(bench, bench.session.sut_id or self.node)
        waiting = Waiting(bench.period, bench.sut.parameter("BPPAR_MAXIMUM_PACKET_SIZE"))
        recorded: dict[int, int | None] = {}
        actions = _Applications(bench, oracle, self.node) if self._services and bench.session.upper else None
        # Beacons before the replay are not judged.
        begun, first, judged = bench.now(), 0, len(bench.heard)
        for frame, heard, source in beacons_of(self._path, bench.codec):
            first = first or frame.time_ns
            if self._speed > 0:
                due = begun + round((frame.time_ns - first) / self._speed)
                bench.waiting.wait_ns(max(0, due - bench.now()))
            elif heard.sender == self.node:
                # Wait for a beacon of the implementation for each beacon of the replaced node.
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
        self._report(bench, oracle)
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
        """Send a recorded beacon with the network identifier of the implementation; return the frame number."""
        octets = heard.octets
        if bench.profile.has_header_field("networkId") and heard.beacon is not None and heard.beacon.bp is not None:
            network = bench.sut.parameter("BPPAR_NETWORK_ID")
            if heard.beacon.bp.network_id != network:
                octets = bench.builder.patched(bench.codec.envelope_plan, octets, {"bp.networkId": network})
        return bench.transmission.send(octets, source)

    def _judge(self, bench: Bench, oracle: Oracle, waiting: Waiting, judged: int) -> int:
        """Compare the beacons from number ``judged`` on with the model; return the number of judged beacons."""
        for heard in bench.heard[judged:]:
            records = [(each.kind, each.record) for each in heard.instructions()]
            waited = waiting.of(len(heard.octets), vardis=bool(records))
            for each in oracle.transmitted(records, heard.time, heard.number, waited=waited):
                self._complain(each.requirement, each.expected, f"variable {each.var_id}: {each.observed}", each.frame)
        for owed in oracle.overdue(bench.now() - bench.period):
            text = f"{owed.kind.label} of variable {owed.var_id}"
            self._complain(owed.requirement, f"{text} in time", f"variable {owed.var_id}: not sent in time", owed.cause)
        return len(bench.heard)

    def _complain(self, requirement: str, expected: str, observed: str, frame: int) -> None:
        key = (requirement, expected)
        self._counts[key] += 1
        kept = self._complaints.setdefault(key, []) if len(self._complaints) < _MOST else self._complaints.get(key)
        if kept is not None and len(kept) < 3:
            kept.append((expected, observed, frame))

    def _finish(self, bench: Bench, oracle: Oracle, waiting: Waiting, judged: int) -> None:
        """Wait until all due reactions can have been sent, and every variable summarised; judge these beacons."""
        alive = sum(version.state == "alive" for _, version in oracle.holdings())
        rounds = math.ceil(alive / max(1, bench.sut.parameter("VARDISPAR_MAX_SUMMARIES")))
        bench.wait(bench.sut.reaction + 2 + rounds)
        self._judge(bench, oracle, waiting, judged)

    # -- judging -----------------------------------------------------------------------------------------------

    def _report(self, bench: Bench, oracle: Oracle) -> None:
        """Record findings as failed checks, and requirements with occasions but without findings as passed."""
        for (requirement, expected), kept in self._complaints.items():
            count = self._counts[requirement, expected]
            times = "" if count == 1 else f" ({count} times)"
            marks = [Mark(frame) for _, _, frame in kept if frame]
            bench.some(False, expected, requirement, seen=f"{kept[0][1]}{times}", frames=marks)
        wrong = {requirement for requirement, _ in self._complaints}
        right = [each for each in _REQUIREMENTS if oracle.occasions.get(each) and each not in wrong]
        if right:
            occasions = sum(oracle.occasions[each] for each in right)
            what = f"the records that it sends follow from those it received; none is missing ({occasions} occasions)"
            bench.passed(what, *right)

    def _compare(self, bench: Bench, oracle: Oracle, recorded: dict[int, int | None]) -> None:
        """Compare the final state of the implementation with the model, and report differences from the recording."""
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
                state = "deleted" if expected is None else f"sequence number {expected}"
                what = f"variable {var_id} in the end: {state}"
                requirement = "VD-PD-04" if expected is None else "VD-PU-07"
                shown = "it is not summarised" if has is None else f"its summaries have sequence number {has}"
                if has != expected:
                    bench.some(False, what, requirement, seen=shown)
            if var_id in recorded and recorded[var_id] != has:
                was = "deleted" if recorded[var_id] is None else f"sequence number {recorded[var_id]}"
                now = "deleted or unknown" if has is None else f"sequence number {has}"
                agrees = "as the specification requires" if has == expected else "against the specification"
                bench.info(
                    f"variable {var_id}: the recorded node and the implementation end in the same state",
                    f"{was} in the recording, {now} now, {agrees}",
                    "VD-PU-07",
                )
        if checked:
            what = f"the final state of the implementation is that of the model ({checked} variables)"
            bench.passed(what, "VD-PU-07")
        elif not bench.heard:
            bench.inconclusive("beacons of the implementation", "none during the whole recording")


_REQUIREMENTS = (
    "VD-PC-09", "VD-PC-10", "VD-PD-04", "VD-PU-01", "VD-PU-06", "VD-PU-07", "VD-PS-01", "VD-PS-02", "VD-PS-03",
    "VD-PS-04", "VD-RU-01", "VD-RU-04", "VD-RC-01", "VD-RC-03", "VD-SCP-01", "VD-SCP-02", "VD-CMP-04", "VD-CMP-05",
    "VD-UPD-08", "VD-UPD-10", "VD-CRE-12", "VD-DEL-05",
)  # fmt: skip


def decided(result: CaseResult) -> CaseResult:
    """Return the result with only the requirements of its checks: a recording has occasions for some of them."""
    found = dict.fromkeys(each for check in result.checks for each in check.requirements)
    return msgspec.structs.replace(result, requirements=tuple(found) or result.requirements)


class _Applications:
    """Repeats the service calls of the recorded node's applications at the upper tester."""

    def __init__(self, bench: Bench, oracle: Oracle, node: bytes) -> None:
        self._bench = bench
        self._oracle = oracle
        self._node = node
        self._circle = Circle(bench.profile.types.var_seqno.width)
        self._own: dict[int, tuple[Any, int]] = {}
        """By variable: creation time and sequence number of its last record."""
        self._report: Any = None

    def act(self, heard: ReceivedBeacon) -> None:
        """Call the services whose effects are in a beacon of the recorded node."""
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
            # A variable that was updated before its first beacon is created with its newest value.
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
    """Store the last sequence number of each variable in a beacon; None for deleted variables."""
    for each in heard.instructions():
        if each.kind is ICType.DELETE_VARIABLES:
            table[each.var_id] = None
        elif each.kind is ICType.SUMMARIES or (only is None and each.kind is ICType.UPDATES):
            table[each.var_id] = each.record.seqno
        elif only is None and each.kind is ICType.CREATE_VARIABLES:
            table[each.var_id] = each.record.upd.seqno


def _doubt(codec: Codec, oracle: Oracle, heard: ReceivedBeacon) -> None:
    """Mark the variables of an invalid frame as unknown in the model: the processing of its records is open (X34)."""
    for each in dissect(codec.beacon_plan, heard.octets).root.walk():
        if each.name == "varId" and isinstance(each.value, int):
            oracle.doubt(each.value)
