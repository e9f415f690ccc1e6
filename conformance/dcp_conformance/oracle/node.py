"""Model of a whole node: BP, SRP and VarDis together, for everything that a tester can send and observe.

The model is independent of the reference node. It answers for each observation whether the specification requires,
allows or forbids it, with the requirement. What the tester cannot know (when a payload was composed, which reading of
the text a node follows, whether a record was lost) stays open until an observation decides it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType, features
from dcp_spec.parameters import Sizes as ParameterSizes
from dcp_spec.parameters import UnknownParameterError, parameter, validate

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.plan.measures import least_size, record
from dcp_codec.plan.tree import Scalar
from dcp_codec.values import RECORD_CLASSES, Container, ExtendedSafetyData, VarCreate, VardisRecord, VarSpec
from dcp_conformance.definitions.broken_rules import broken_by

from .bp import BPModel, Sizes
from .database import Room, VardisModel, var_id_of
from .judgement import MS, Expected, Finding, Timing, either
from .knowledge import NO_CREATION, Limits
from .services import refused_by
from .srp import SRPModel

#: More octets than a report has.
_REPORT = 300


#: By service: the requirement about the order of its checks.
_ORDERS = {
    "BP-RegisterProtocol": "BP-REG-09", "BP-TransmitPayload": "BP-TXP-10", "RTDB-Create": "VD-CRE-13",
    "RTDB-Delete": "VD-DEL-07", "RTDB-Update": "VD-UPD-11", "RTDB-Read": "VD-REA-05",
}  # fmt: skip


class NodeModel:
    """One node as its specification has it. All times are ns of the tester's clock."""

    def __init__(
        self,
        codec: Codec,
        own_id: bytes,
        parameters: Mapping[str, Any],
        timing: Timing,
        *,
        readings: Mapping[str, str] | None = None,
        alone: bool = True,
    ) -> None:
        """``parameters``: values by the names of the specification. ``readings``: those that the node declares.

        ``alone``: whether only the tester uses the services of the node.
        """
        profile = codec.profile
        self.codec = codec
        self.own_id = own_id
        self.timing = timing
        self.values = dict(parameters)
        self._features = features(profile.spec_version)
        self._alone = alone
        self._readings = readings or {}
        header, block = record(codec.envelope_plan, "BPHeader"), record(codec.envelope_plan, "Payload")
        assert block is not None
        self._sizes = Sizes(
            0 if header is None else least_size(header),
            sum(each.size for each in block.members if isinstance(each, Scalar)),
            (1 << 16) - 1,
        )
        self._first_packet_size = int(self.values["BPPAR_MAXIMUM_PACKET_SIZE"])
        self.bp = BPModel(self._features, self._sizes, timing, self._first_packet_size)
        self.srp = SRPModel(
            self._features, timing, own_id, round(self.values.get("SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", 3000) * MS),
            alone=alone, room=profile.limits.max_neighbours,
        )  # fmt: skip
        self.vardis = self._vardis(self._readings)
        self.since = -(1 << 62)
        """Time of the last VarDis payload."""
        self._blocked = -(1 << 62)
        """Last time at which something may have kept a VarDis payload from being sent."""
        self._last = -(1 << 62)
        self._renamed = -(1 << 62)
        self._held = -(1 << 62)
        """Last time at which there may have been no room for a report."""
        self._created: dict[int, tuple[int, int]] = {}
        """creationTime of variables of the node, in ticks, with the times at which they were created."""
        self._number = 0
        self._damaged = False
        """True if the last payload that the node received for VarDis cannot be decoded."""
        self._least = -(1 << 62)

    def _vardis(self, readings: Mapping[str, str]) -> VardisModel:
        profile, values, timing = self.codec.profile, self.values, self.timing
        plan = self.codec.containers_plan
        container = record(plan, "Container")
        assert container is not None
        sizes: dict[ICType, int] = {}
        for kind, made in RECORD_CLASSES.items():
            layout = record(plan, made.__name__)
            sizes[kind] = 0 if layout is None else least_size(layout)
        if profile.types.node_id.length is not None:
            sizes[ICType.CREATE_VARIABLES] += len(self.own_id)
        most = int(values["VARDISPAR_MAX_PAYLOAD_SIZE"])
        room = Room(least_size(container), sizes, most, int(values["VARDISPAR_MAX_SUMMARIES"]))
        descr = int(values["VARDISPAR_MAX_DESCRIPTION_LENGTH"])
        limits = Limits(
            int(values["VARDISPAR_MAX_VALUE_LENGTH"]), descr - self._with_nul, int(values["VARDISPAR_MAX_REPETITIONS"])
        )
        declared = readings.get("X26")
        return VardisModel(
            self.own_id, self._features, profile.types.var_seqno.width, limits, room,
            latency=timing.flight, window=max(timing.patience, 8 * timing.period) + timing.late, late=timing.late,
            spare=-(-timing.late // timing.period),
            lossy=timing.lossy, whole=timing.whole, clock=timing.clock, in_order=timing.flight <= 3 * timing.period,
            scrubbing=_scrubbing(values.get("VARDISPAR_SCRUBBING_PERIOD", 1000), timing),
            scrubs=None if declared is None else declared == "every-node",
        )  # fmt: skip

    @property
    def _with_nul(self) -> int:
        return 1 if self._features.string_format == "nul-terminated" else 0

    @property
    def headers(self) -> int:
        """Octets of the headers of a beacon with one block."""
        return self._sizes.header + self._sizes.block

    @property
    def free(self) -> int:
        """Octets of a payload that is alone in a beacon of the maximum packet size."""
        return int(self.values["BPPAR_MAXIMUM_PACKET_SIZE"]) - self.headers

    @property
    def least_payload(self) -> int:
        """The smallest VARDISPAR_MAX_PAYLOAD_SIZE that leaves room for every VarCreate (X42)."""
        room, values = self.vardis.room, self.values
        lengths = int(values["VARDISPAR_MAX_VALUE_LENGTH"]) + int(values["VARDISPAR_MAX_DESCRIPTION_LENGTH"])
        return room.header + room.sizes[ICType.CREATE_VARIABLES] + lengths

    def bounded(self, name: str, value: int) -> int:
        """Return the value of a parameter of VarDis that is nearest to ``value`` and valid in every reading."""
        room, most = self.vardis.room, int(self.values["VARDISPAR_MAX_PAYLOAD_SIZE"])
        free = most - room.header - room.sizes[ICType.CREATE_VARIABLES]
        value_length, descr = (int(self.values[f"VARDISPAR_MAX_{each}_LENGTH"]) for each in ("VALUE", "DESCRIPTION"))
        match name:
            case "VARDISPAR_MAX_VALUE_LENGTH":
                return max(1, min(value, free - descr, 255))
            case "VARDISPAR_MAX_DESCRIPTION_LENGTH":
                return max(1, min(value, free - value_length, 255))
            case "VARDISPAR_MAX_REPETITIONS":
                return max(1, min(value, 15))
            case "VARDISPAR_MAX_SUMMARIES":
                return max(0, min(value, (most - room.header) // room.sizes[ICType.SUMMARIES]))
        return value

    # -- services --------------------------------------------------------------------------------------------

    def expect(self, method: str, params: Mapping[str, Any], time: int) -> list[Expected]:
        """Return the statuses that a service may answer; empty if the specification leaves it open."""
        if method.startswith(("RTDB-", "VD-MGMT-")):
            return self.vardis.expect(method, params, time)
        if method == "SRP-UpdateSafetyData":
            return [Expected("SRP-STATUS-OK", "SRP-SRV-03")]
        if method.endswith("-SetParameter"):
            return self._settable(method, params)
        return self.bp.expect(method, params)

    def _valid(self, name: str, value: Any) -> bool:
        """Return whether a parameter may have a value; True for a parameter that the specification does not name."""
        try:
            return validate(name, value, self._bounds()) is None
        except UnknownParameterError:
            return True

    def _settable(self, method: str, params: Mapping[str, Any]) -> list[Expected]:
        name, value = params["name"], params["value"]
        try:
            requirement = parameter(name).requirement
        except UnknownParameterError:
            return []
        valid = self._valid(name, value)
        status = method.partition("-")[0].replace("VD", "VARDIS") + "-STATUS-OK"
        # Bounds that are read differently: X05, X23, X39, X42.
        clear = valid and name not in ("VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_PAYLOAD_SIZE")
        if name == "BPPAR_MAXIMUM_PACKET_SIZE":
            # The bearer of this implementation may carry less than that of the profile.
            clear = valid and self._sizes.header + self._sizes.block < value <= self._first_packet_size
        return [Expected(status, requirement)] if clear else []

    def _bounds(self) -> ParameterSizes:
        profile, room, values = self.codec.profile, self.vardis.room, self.values
        return ParameterSizes(
            version=profile.spec_version,
            uwb_max_packet_size=profile.limits.uwb_max_packet,
            node_id=profile.types.node_id.width,
            network_id=profile.types.network_id.width,
            var_len=(profile.types.value.lengths or (profile.types.var_id,))[0].width,
            bp_header=self._sizes.header,
            bp_payload_header=self._sizes.block,
            ic_header=room.header,
            var_spec_fixed=room.sizes[ICType.CREATE_VARIABLES] - room.sizes[ICType.UPDATES],
            var_update_fixed=room.sizes[ICType.UPDATES],
            var_summ=room.sizes[ICType.SUMMARIES],
            max_packet_size=int(values["BPPAR_MAXIMUM_PACKET_SIZE"]),
            max_payload_size=int(values["VARDISPAR_MAX_PAYLOAD_SIZE"]),
            max_value_length=int(values["VARDISPAR_MAX_VALUE_LENGTH"]),
        )

    def judge(
        self, method: str, params: Mapping[str, Any], expected: list[Expected], status: str, code: int | None
    ) -> Iterator[Finding]:
        """Judge the status of an answer. ``code``: that of a JSON-RPC error, None for a result."""
        if not expected:
            return
        if code is not None:
            silent = any(not each.status for each in expected) or "INACTIVE" in either(expected)
            if code == -32603 or (code in (-32001, -32002) and not silent):
                yield Finding((expected[0].requirement,), f"{method} answers {either(expected)}", f"error {code}")
            return
        given = status.replace("_", "-")
        if any(each.status == given for each in expected if each.status):
            return
        first = expected[0].requirement
        reasons: tuple[str, ...] = (first,)
        if not (expected[0].status.endswith("-OK") or given.endswith("-OK")) and (order := _ORDERS.get(method)):
            # Both are refusals.
            reasons = (first, order)
        if method.startswith("RTDB-") and params.get("varId") in self.vardis.mine:
            reasons = (*reasons, *self.vardis.differs(params["varId"], first), *refused_by(method, given))
        elif method.startswith("BP-") and not self.bp.active:
            reasons = (first, "BP-MGT-04")
        shown = "" if len(params) > 12 else f"{method} answers {either([each for each in expected if each.status])}"
        yield Finding(tuple(dict.fromkeys(reasons)), shown, status or "no status")

    def confirmed(
        self,
        method: str,
        params: Mapping[str, Any],
        result: Mapping[str, Any],
        before: tuple[int, int],
        after: tuple[int, int],
    ) -> Iterator[Finding]:
        """Take a result into account. ``before``, ``after``: monotonic and wall time around the call, ns."""
        time = after[0]
        ok = str(result.get("status", "")).replace("_", "-").endswith("-STATUS-OK")
        if method.startswith("BP-MGMT-") and ok:
            self._hold(time)
        if method.endswith("-SetParameter"):
            # The confirm of a rejected value may be positive (BP-PAR-07).
            if ok and self._valid(params["name"], params["value"]):
                self._set(params["name"], params["value"], time)
        elif method == "BP-GetParameters":
            period = (result.get("parameters") or {}).get("BPPAR_BEACON_PERIOD")
            if isinstance(period, int | float):
                self.bp.reported_period(round(period * MS))
        elif method == "SRP-UpdateSafetyData":
            if ok:
                self.srp.submitted(dict(params["sData"]), before[1], after[1], time)
        elif method == "SRP-NeighbourTable":
            rows = [(_octets(row["nodeId"]), row) for row in result.get("neighbours", ()) if "nodeId" in row]
            only = _octets(params["nodeId"]) if "nodeId" in params else None
            yield from self.srp.listed(rows, time, after[1] - after[0], only)
        elif method.startswith(("RTDB-", "VD-MGMT-")):
            yield from self.vardis.confirmed(method, params, result, time, after[1] - after[0])
            if method in ("RTDB-Create", "RTDB-Update") and ok:
                self.vardis.began(params["varId"], after[0] - before[0])
        else:
            yield from self.bp.confirmed(method, params, result, time)

    def created(self, params: Mapping[str, Any], creation: int | None, time: int) -> Iterator[Finding]:
        """Process an RTDB-Create with status OK. ``creation``: creationTime as the node reports it; None if unknown."""
        timed = self._features.creation_time
        var_id = params["varId"]
        spec = VarSpec(
            var_id, self.own_id, params["repCnt"], params["descr"].encode(),
            (creation or 0) if timed else None, params.get("timeout", 0) if timed else None,
        )  # fmt: skip
        before = self._created.get(var_id)
        self.vardis.created_by_application(spec, bytes.fromhex(params["value"]), time)
        if timed and creation is None:
            self.vardis.variables[var_id].latest = 1 << 127
        elif timed and creation is not None:
            self._created[var_id] = creation, time
            # The resolution of a clock may be low, but not half a second.
            if before is not None and creation <= before[0] and time - before[1] > 500 * MS:
                yield Finding(("VD-CRE-09", "VD-CRE-03"), f"a creationTime after {before[0]}", str(creation))

    def _hold(self, time: int) -> None:
        """Record that payloads may have had to wait until now."""
        self._blocked = time
        self.vardis.postpone(time)

    def _set(self, name: str, value: Any, time: int) -> None:
        self.values[name] = value
        vardis = self.vardis
        match name:
            case "BPPAR_MAXIMUM_PACKET_SIZE":
                self._hold(time)
                self.bp.resized(value, time)
            case "BPPAR_BEACON_PERIOD":
                self._hold(time)
                self.bp.set_period(round(value * MS), time)
                vardis.set_window(8 * self.bp.period + self.timing.late)
            case "BPPAR_NETWORK_ID":
                self._renamed = time
            case "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT":
                self.srp.set_timeout(round(value * MS), time)
            case "VARDISPAR_MAX_VALUE_LENGTH":
                vardis.set_limits(time, value=value)
            case "VARDISPAR_MAX_DESCRIPTION_LENGTH":
                vardis.set_limits(time, descr=value - self._with_nul)
            case "VARDISPAR_MAX_REPETITIONS":
                vardis.set_limits(time, repetitions=value)
            case "VARDISPAR_MAX_PAYLOAD_SIZE":
                vardis.set_room(time, most=value)
            case "VARDISPAR_MAX_SUMMARIES":
                vardis.set_room(time, summaries=value)
            case "VARDISPAR_SCRUBBING_PERIOD":
                vardis.set_scrubbing(_scrubbing(value, self.timing))

    # -- frames ----------------------------------------------------------------------------------------------

    def received(
        self,
        blocks: list[tuple[int, bytes]],
        time: int,
        forbidden: tuple[str, ...] = (),
        last: tuple[str, ...] | None = None,
    ) -> None:
        """Process a frame to the node. ``forbidden``: why its receiver must discard it whole; empty if it must not.

        ``last``: why its last block is not one; None if it is.
        """
        self._number += 1
        # X48: a receiver may discard a frame with another number of blocks.
        sure = last is None or self._readings.get("X48") == "deliver-blocks"
        if last is not None and "BP-RX-14" in last and self._readings.get("X02") != "length-field":
            # The end of the frame may decide, and not that of the beacon.
            last = ()
        self.bp.received(blocks, time, forbidden, last, sure=sure)
        closed = forbidden or (() if self.bp.active else ("BP-RX-13", "BP-MGT-03"))
        skipped = False
        for prot_id, octets in blocks:
            if prot_id == BP_PROTID_SRP and self.codec.profile.srp.is_report:
                try:
                    report = self.codec.decode_report(octets)
                except DecodeError:
                    continue
                if isinstance(report, ExtendedSafetyData):
                    self.srp.received(report, self._values(report), time, closed)
            elif prot_id == BP_PROTID_VARDIS:
                self._hear(octets, time, closed, skipped=skipped)
            elif prot_id not in self.bp.clients:
                skipped = True

    def _hear(self, octets: bytes, time: int, closed: tuple[str, ...], *, skipped: bool) -> None:
        """Process a payload of VarDis. ``skipped``: whether a block of an unregistered protocol is before it."""
        try:
            containers = self.codec.decode_containers(octets)
        except DecodeError:
            # The payload is damaged from its first octet, and must have no effect. The node must process the next one.
            self._damaged = True
            return
        records: list[VardisRecord] = [each for container in containers for each in container.records]
        added = ("BP-RX-08",) * skipped + ("VD-ROB-01",) * self._damaged
        self._damaged = False
        if closed:
            for each in records:
                self.vardis.why[var_id_of(each)] = closed
            return
        if len(octets) > self.vardis.room.limit:
            # X49: a payload that is larger than the receiver's own may be discarded.
            for each in records:
                creation = each.spec.creation_time or 0 if isinstance(each, VarCreate) else NO_CREATION
                self.vardis.doubt(var_id_of(each), creation)
            return
        self.vardis.hear(records, time, self._number)
        for var_id in {var_id_of(each) for each in records} if added else ():
            self.vardis.why[var_id] = (*self.vardis.why.get(var_id, ()), *added)

    def beacon(self, octets: bytes, time: int) -> Iterator[Finding]:
        """Judge a beacon of the node that was received at ``time``."""
        try:
            decoded = self.codec.decode(octets)
            envelope, _ = self.codec.decode_envelope(octets)
        except DecodeError as error:
            problem = error.problem
            yield Finding(broken_by(problem) or ("BP-FMT-01",), "a valid beacon", str(problem), "format")
            return
        self._number += 1
        blocks = [(each.protocol_id, each.data or b"") for each in envelope.payloads]
        header = decoded.bp
        yield from self.bp.beacon(blocks, len(octets), None if header is None else header.seqno, time)
        network, shown = self.values.get("BPPAR_NETWORK_ID"), None if header is None else header.network_id
        if None not in (network, shown) and network != shown and time - self._renamed > self.timing.flight:
            yield Finding(("BP-HDR-04", "BP-PAR-02"), f"networkId {network}", str(shown))
        for payload, (_, content) in zip(decoded.payloads, blocks, strict=True):
            if payload.srp is not None:
                yield from self._reported(payload.srp, header.sender_id if header is not None else None, time)
            elif isinstance(payload.content, tuple):
                yield from self._composed(payload.content, len(content), time)
        if len(octets) + self.vardis.room.most + self._sizes.block > int(self.values["BPPAR_MAXIMUM_PACKET_SIZE"]):
            self._hold(time)
        if len(octets) + _REPORT > self.free:
            self._held = time
        self._last = time

    def _reported(self, report: ExtendedSafetyData, sender: bytes | None, time: int) -> Iterator[Finding]:
        stamp = self.codec.profile.types.timestamp
        since_1970 = None if stamp.epoch_ns is None else stamp.epoch_ns + stamp.nanoseconds(report.t_stamp)
        yield from self.srp.sent(report, self._values(report), since_1970, sender, time)

    def _values(self, report: ExtendedSafetyData) -> dict[str, Any]:
        """Return the safety data of a report by the names of the profile; octets as hexadecimal digits."""
        names = [field.name for field in self.codec.profile.srp.safety_data]
        data = report.s_data.as_dict().values()
        return {
            name: value.hex() if isinstance(value, bytes) else value for name, value in zip(names, data, strict=True)
        }

    def _composed(self, containers: tuple[Container, ...], octets: int, time: int) -> Iterator[Finding]:
        # A payload is composed after the one before it was sent; it waits for at most a beacon, unless it is held up.
        since, self.since = self.since - self.timing.flight, time
        if time - self._blocked > 2 * self.bp.period and self._blocked < since + self.bp.period:
            since = max(since, time - self.timing.flight - round(1.6 * self.bp.period))
        since = self._least = max(since, self._least)
        vardis = self.vardis
        if (
            not vardis.active
            and time - vardis.switched > self.timing.flight + round(1.6 * self.bp.period)
            and self._blocked < vardis.switched
        ):
            yield Finding(("VD-MGT-02",), "no payload of VarDis while it is inactive", f"a payload of {octets} octets")
        yield from vardis.payload(containers, octets, since, time, self._number)

    # -- notifications and time ------------------------------------------------------------------------------

    def notified(
        self, method: str, params: Mapping[str, Any], time: int, offset: int | None = None
    ) -> Iterator[Finding]:
        """Judge a notification that the tester got at ``time``.

        ``offset``: wall clock of the tester minus its monotonic one, ns; None if it is unknown.
        """
        prot_id = params.get("protId", -1)
        if method == "BP-ReceivePayload.indication":
            yield from self.bp.indicated(prot_id, bytes.fromhex(str(params.get("payload", ""))))
        elif method == "BP-PayloadTransmitted.indication":
            epoch = params.get("nextBeaconGenerationEpoch")
            foretold = epoch - offset if isinstance(epoch, int) and offset is not None else None
            yield from self.bp.transmitted(prot_id, time, foretold)

    def passed(self, time: int, *, notified: bool) -> Iterator[Finding]:
        """Judge what should have come by ``time``. ``notified``: whether the tester gets notifications."""
        if notified:
            yield from self.bp.undelivered(time)
            if self.codec.profile.behaviour.payload_transmitted_indication:
                yield from self.bp.unconfirmed(time)
        self.srp.expire(time)
        if self.free < _REPORT:
            self._held = time
        if self.bp.active:
            yield from self.srp.unsent(time, max(self._held, self.bp.switched), self.bp.period)
        yield from self.bp.silent(self._last, time)
        if self.vardis.room.most > self.free:
            # A payload of VarDis may be larger than a beacon may be.
            self._hold(time)
        if (
            self.bp.active
            and time - max(self.since, self._blocked) > max(self.timing.patience, 8 * self.bp.period) + self.timing.late
        ):
            yield from self.vardis.silent(time)


def _scrubbing(milliseconds: float, timing: Timing) -> int:
    """Return the longest time between two scrubbings, whose accuracy is left to the implementation; ns."""
    return round(milliseconds * 1.5 * MS) + timing.late + 200 * MS


def _octets(node_id: Any) -> bytes:
    """Return a node identifier in an answer as octets; that of a profile with textual identifiers as its text."""
    text = str(node_id)
    try:
        return bytes.fromhex(text.replace(":", ""))
    except ValueError:
        return text.encode()


__all__ = ["NodeModel", "Timing"]
