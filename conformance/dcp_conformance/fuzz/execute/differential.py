"""Compare the observable state of an implementation with the model: summaries, values, services, neighbour table.

Only behaviour that the specification defines is compared: not the state of variables that a damaged or disputed message
has named, and not the order of records.
"""

from __future__ import annotations

from typing import Any

from dcp_spec.constants import ICType

from dcp_codec.errors import DecodeError
from dcp_conformance.fuzz.steps import Call, Effect
from dcp_conformance.oracle import Version
from dcp_conformance.test_steps.services import described, rows
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.traffic import Event
from dcp_conformance.upper_tester import Answer

from .model_monitor import Observer

#: Part of the neighbour timeout during which a neighbour must be in the table; after it, the entry may have expired.
_FRESH = 0.5


class Comparison:
    """Compares one implementation with its model, on the bench of one case."""

    def __init__(self, bench: Bench, observer: Observer) -> None:
        self._bench = bench
        self._observer = observer
        self._reports: dict[bytes, int] = {}
        """Time of the last safety data report to the implementation, by node identifier."""
        self._judged = len(bench.heard)
        self._followed = bench.traffic.frames
        """Number of the last frame that was passed to the model."""
        upper = bench.session.upper
        self._methods = upper.methods if upper is not None else frozenset[str]()

    # -- while steps are executed ------------------------------------------------------------------------------

    def follow(self) -> None:
        """Pass to the model all frames that were sent since the last call, including markers."""
        bench = self._bench
        new: list[Event] = []
        for event in reversed(bench.traffic.events):
            if event.number and event.number <= self._followed:
                break
            if event.direction == "sent":
                new.append(event)
        self._followed = bench.traffic.frames
        since = bench.lower.wall() - bench.now()
        for event in reversed(new):
            self._sent(event.frame[event.start :], event.wall - since, event.number)

    def _sent(self, octets: bytes, time: int, number: int) -> None:
        if self._is_large(octets):
            self._observer.doubts(octets)
        else:
            self._observer.hears(octets, time, number)
        try:
            beacon = self._bench.codec.decode(octets)
        except DecodeError:
            # The specification leaves open whether a report before the damage is processed: expect no neighbour.
            return
        if not self._observer.is_for_node(beacon):
            return
        for payload in beacon.payloads:
            report = payload.srp
            if report is not None and report.node_id != self._observer.own_id:
                self._reports[report.node_id] = time

    def _is_large(self, octets: bytes) -> bool:
        """Return whether a payload is longer than VARDISPAR_MAX_PAYLOAD_SIZE.

        The parameter limits the payloads that a node sends. The specification does not define the maximum length of
        payloads that a node must accept.
        """
        most = self._bench.sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE")
        if not most or len(octets) <= most:
            return False
        payloads = self._bench.codec.dissect(octets).root.child("payloads")
        lengths = [payload.child("length") for payload in payloads.children] if payloads is not None else []
        return any(length is not None and (length.value or 0) > most for length in lengths)

    def called(self, step: Call, answer: Answer, at: int) -> Effect | None:
        """Compare the answer to a service call with the model, and update the model after a success."""
        self.follow()
        var_id = step.params.get("varId")
        if type(var_id) is not int:
            return None
        expected = self._observer.expects(step.method, var_id)
        if expected is not None and expected != answer.ok and answer.code is None:
            what = "succeeds" if answer.ok else "is refused"
            detail = f"{step.method} of variable {var_id} {what} with {answer.status}"
            return Effect("state", detail, at, f"{step.method} {answer.status}")
        if not answer.ok:
            return None
        oracle, now = self._observer.oracle, self._bench.now()
        match step.method:
            case "RTDB-Create":
                self._created(var_id, step.params)
            case "RTDB-Update":
                oracle.updated(var_id, bytes.fromhex(step.params["value"]), now)
            case "RTDB-Delete":
                oracle.deleted(var_id, now)
        return None

    def _created(self, var_id: int, params: dict[str, Any]) -> None:
        bench = self._bench
        creation: int | None = None
        if "RTDB-DescribeVariable" in self._methods:
            found = described(bench.call("RTDB-DescribeVariable", varId=var_id)).get("creationTime")
            creation = found if isinstance(found, int) else None
        spec = bench.records.spec(
            var_id,
            self._observer.own_id,
            rep_cnt=params["repCnt"],
            descr=params["descr"].encode(),
            creation_time=0 if creation is None else creation,
        )
        self._observer.created(spec, bytes.fromhex(params["value"]), bench.now())
        if creation is None and self._observer.compares_creations:
            # Without the creation time the model cannot order this creation and those of other nodes.
            self._observer.oracle.doubt(var_id)

    def effect_at(self, at: int) -> Effect | None:
        """Judge the beacons received since the last call."""
        bench = self._bench
        self.follow()
        heard, self._judged = bench.heard[self._judged :], len(bench.heard)
        most = bench.sut.parameter("BPPAR_MAXIMUM_PACKET_SIZE")
        for each in heard:
            effect = self._observer.says(each.octets, most, each.time, each.number, at)
            if effect is not None:
                return effect
        return None

    # -- at the end of a round ---------------------------------------------------------------------------------

    def round(self, at: int) -> Effect | None:
        """Wait for the time of all reactions, then compare everything that is observable from outside."""
        bench = self._bench
        bench.wait(bench.sut.reaction + 2)
        effect = self.effect_at(at) or self._observer.missing(bench.now(), at, busy=self._busy())
        return effect or self._variables(at) or self._summaries(at) or self._neighbours(at)

    def _busy(self) -> bool:
        most = self._bench.sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE")
        return any(len(heard.octets) > most // 2 for heard in self._bench.heard)

    def _variables(self, at: int) -> Effect | None:
        bench = self._bench
        certain = self._observer.certain(list(self._observer.oracle.variables))
        if "RTDB-DescribeDatabase" in self._methods:
            listed = {row.get("varId"): row for row in rows(bench.call("RTDB-DescribeDatabase"), "variables")}
            for var_id, version in certain:
                row = listed.get(var_id)
                alive = row is not None and not row.get("isDeleted", False)
                if alive != (version.state == "alive"):
                    shown = "alive" if alive else "not alive"
                    return self._differs(at, "RTDB-DescribeDatabase", var_id, shown, version)
        for var_id, version in certain:
            if version.state != "alive":
                continue
            if "RTDB-Read" in self._methods:
                value = bench.call("RTDB-Read", varId=var_id).result.get("value")
                if value != version.value.hex():
                    return self._differs(at, "RTDB-Read", var_id, f"value {value}", version)
            if "RTDB-DescribeVariable" in self._methods:
                seqno = described(bench.call("RTDB-DescribeVariable", varId=var_id)).get("seqno")
                if seqno is not None and seqno != version.seqno:
                    return self._differs(at, "RTDB-DescribeVariable", var_id, f"number {seqno}", version)
        return None

    def _differs(self, at: int, method: str, var_id: int, shown: str, version: Version) -> Effect:
        expected = f"{version.state}, number {version.seqno}, value {version.value.hex()}"
        return Effect("state", f"variable {var_id}: {method} says {shown}; the model has it {expected}", at, method)

    def _summaries(self, at: int) -> Effect | None:
        """Compare the last summary of each variable with the model; a deleted variable must not have one."""
        bench = self._bench
        if bench.sut.parameter("VARDISPAR_MAX_SUMMARIES") <= 0:
            return None
        last: dict[int, tuple[int, int]] = {}
        for heard in bench.heard[-2:]:
            for each in heard.instructions(ICType.SUMMARIES):
                last[each.var_id] = (each.record.seqno, heard.time)
        for var_id, version in self._observer.certain(list(last)):
            expected = version.seqno if version.state == "alive" else None
            number, time = last[var_id]
            # The number at the time when the payload was composed is correct, too.
            if number != expected and time - version.since > 3 * bench.period:
                detail = f"variable {var_id} is summarised with {number}, where the model has {expected}"
                return Effect("state", detail, at, "summary")
        return None

    def _neighbours(self, at: int) -> Effect | None:
        bench = self._bench
        if "SRP-NeighbourTable" not in self._methods or not self._reports:
            return None
        table = {
            str(row.get("nodeId")).replace(":", "").lower()
            for row in rows(bench.call("SRP-NeighbourTable"), "neighbours")
        }
        fresh = bench.now() - round(bench.sut.parameter("SRPPAR_NEIGHBOUR_TABLE_TIMEOUT") * 1_000_000 * _FRESH)
        most = bench.sut.capacity("neighbours")
        for node_id, time in self._reports.items():
            # An identifier that is text may be in the answer as text, or as octets.
            name = node_id.hex(":")
            there = node_id.hex() in table or node_id.decode(errors="replace").replace(":", "").lower() in table
            if time >= fresh and not there and (most is None or len(self._reports) < most):
                return Effect("state", f"the neighbour {name} is not in the table", at, "neighbour missing")
        return None
