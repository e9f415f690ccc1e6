"""Execute the steps of a sequence on an implementation and on its model, and judge each observation."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from typing import Any, Final

import msgspec
from dcp_spec.constants import BP_PROTID_VARDIS, ICType, QueueingMode, features

from dcp_codec.values import ExtendedSafetyData, VarCreate, VardisRecord
from dcp_conformance.errors import NeverAnsweredError, NoAnswerError, UpperTesterError
from dcp_conformance.frames.builder import Block, FrameBuilder
from dcp_conformance.frames.sampling import sampler
from dcp_conformance.oracle.judgement import Finding, either
from dcp_conformance.oracle.node import NodeModel
from dcp_conformance.upper_tester import Answer

from .executor import Event, Executor
from .steps import (
    AGAIN,
    DATA,
    ENDS,
    FAULTS,
    FILL,
    GROUP,
    OWN,
    ZERO,
    Beacon,
    Call,
    Client,
    Damaged,
    Data,
    Fill,
    Records,
    Report,
    Step,
    Trait,
    Wait,
    text,
)

#: Services whose octets are given as sizes.
_SIZED: Final = ("payload", "value")
#: Services whose missing answer the model can follow: queries, and changes of a queue.
_FOLLOWED: Final = re.compile(
    r"RTDB-(Read|Describe.*)|BP-(List.*|Query.*|TransmitPayload|ClearBuffer)|SRP-NeighbourTable|.*-GetParameters"
)
#: Container types of the other kinds of records than creations.
_KINDS: Final = {
    "delete": ICType.DELETE_VARIABLES,
    "update": ICType.UPDATES,
    "summary": ICType.SUMMARIES,
    "ask-update": ICType.REQUEST_VARUPDATES,
    "ask-create": ICType.REQUEST_VARCREATES,
}
#: Sequence numbers, and octets after the last payload, of beacons that are unusual.
_NUMBERS: Final = {"seqno 0": 0, "seqno largest": -1}
_PADDING: Final = {"padded": b"\xa5" * 46, "padded far": bytes(200)}
#: A payload for VarDis that begins with a container of an unknown type.
_DAMAGED: Final = b"\x63\x01\x00"
#: Octets of the longest beacon that a bearer may pad.
_PADDED: Final = 64
_QUERY, _LIST = "BP-QueryNumberBufferedPayloads", "BP-ListRegisteredProtocols"
_TABLE, _DESCRIBE, _ALL = "SRP-NeighbourTable", "RTDB-DescribeVariable", "RTDB-DescribeDatabase"


class Row(msgspec.Struct, frozen=True):
    """A step as it went: what was sent, what the model allowed, and what came."""

    sent: str
    allowed: str
    came: str


class Counterexample(AssertionError):  # noqa: N818 - not an error of the tester
    """A sequence whose last step shows that the node violates a requirement."""

    def __init__(self, finding: Finding, steps: list[Step], rows: list[Row]) -> None:
        self.finding = finding
        self.steps = steps
        self.rows = rows
        super().__init__(str(self))

    def __str__(self) -> str:
        return "\n".join((", ".join(self.finding.requirements), *table(self.rows)))


def table(rows: Iterable[Row]) -> Iterator[str]:
    """Yield the lines of a table of steps."""
    for number, row in enumerate(rows, 1):
        yield f"{number:3} {row.sent}"
        if row.allowed:
            yield f"      allowed: {row.allowed}"
        if row.came:
            yield f"      came:    {row.came}"


class Driver:
    """Executes one sequence. Raises :class:`Counterexample` at the first observation that the model forbids."""

    def __init__(self, executor: Executor, reached: Counter[tuple[str, str]] | None = None) -> None:
        """``reached``: the pairs (state of the model, event), which are counted."""
        self.executor = executor
        self.reached = reached if reached is not None else Counter()
        self.decided: dict[str, None] = {}
        """The requirements that decided the statuses of this sequence."""
        self.pairs: set[tuple[str, str]] = set()
        """The pairs of this sequence."""
        self.model = NodeModel(
            executor.codec,
            executor.own_id,
            executor.parameters(),
            executor.timing,
            readings=executor.readings,
            alone=executor.alone,
        )
        self.steps: list[Step] = []
        self.rows: list[Row] = []
        self._builder = FrameBuilder(executor.codec)
        self._made = sampler(executor.codec)
        self._mark = 0
        self._shown: dict[int, dict[str, Any]] = {}
        """The safety data before, by the number of the neighbour."""
        self._seqnos: Counter[int] = Counter()
        self._sent = -(1 << 62)
        """Time of the last frame, ns."""
        self.protocols: dict[int, int] = {}
        """The protocol identifiers of this run, by the numbers of the sequence."""
        self.initial = dict(self.model.values)
        """The values of the parameters at the beginning."""
        self._row: list[str] = ["", ""]
        self._submitted: dict[int, str] = {}
        """The payload submitted last for each protocol, hexadecimal."""

    @property
    def least_packet(self) -> int:
        """The smallest maximum packet size that every reading allows."""
        return self.model.headers + 1

    # -- steps -----------------------------------------------------------------------------------------------

    def run(self, steps: Iterable[Step]) -> None:
        """Execute all steps of a sequence, and what follows the last one."""
        for step in steps:
            self.step(step)
        self.finish()

    def step(self, step: Step) -> None:
        """Execute one step."""
        self.steps.append(step)
        self._row = ["", ""]
        try:
            if isinstance(step, Call):
                for _ in range(step.times):
                    self._call(step)
            elif isinstance(step, Beacon):
                self._send(step)
            else:
                self._wait(round(step.periods * self.executor.timing.period))
                self._look_around()
        finally:
            self.rows.append(Row(text(step), *self._row))

    def finish(self) -> None:
        """Wait until everything has shown, and query the whole state."""
        timing = self.executor.timing
        # Where time costs nothing, also wait for what has no payload to be in.
        periods = timing.patience // timing.period + 4 if timing.whole else 4
        self.steps.append(Wait(periods))
        self._row = ["", ""]
        try:
            self._wait(periods * timing.period)
            self._look_around()
        finally:
            self.rows.append(Row(f"wait {periods} periods", *self._row))
        self.steps.pop()

    def _fail(self, finding: Finding) -> None:
        self._row = [finding.expected, finding.observed]
        row = Row(text(self.steps[-1]), *self._row)
        raise Counterexample(finding, list(self.steps), [*self.rows, row])

    def _judge(self, findings: Iterable[Finding]) -> None:
        for finding in findings:
            self._fail(finding)

    def _count(self, state: str, event: str) -> None:
        pair = (state, event)
        self.pairs.add(pair)
        self.reached[pair] += 1

    # -- time ------------------------------------------------------------------------------------------------

    def _wait(self, duration: int) -> None:
        for event in self.executor.wait(duration):
            self._take(event)
        self._alive()
        self._judge(self.model.passed(self.executor.now(), notified=bool(self.protocols)))

    def _take(self, event: Event) -> None:
        if event.octets:
            self._judge(self.model.beacon(event.octets, event.time))
        else:
            offset = self.executor.wall() - self.executor.now()
            self._judge(self.model.notified(event.method, event.params, event.time, offset))

    def _settle(self) -> None:
        """Wait until the node has processed the frames that were sent, before a service depends on them."""
        timing = self.executor.timing
        left = self._sent + timing.late + timing.flight - self.executor.now()
        if left > 0:
            self._wait(left)

    def _alive(self) -> None:
        if why := self.executor.died():
            self._fail(Finding(("BP-RX-16", "VD-ROB-01"), "a node that runs", why))

    # -- services --------------------------------------------------------------------------------------------

    def _call(self, step: Call) -> None:
        if step.method not in self.executor.methods:
            return
        params = self._resolved(step)
        answer = self._asked(step.method, params)
        if answer is None:
            return
        self._look_after(step.method, params)

    def _asked(self, method: str, params: dict[str, Any]) -> Answer | None:
        """Call a service and judge the answer; None if there is none that can be judged."""
        self._settle()
        executor, model = self.executor, self.model
        for event in executor.wait(0):
            self._take(event)
        expected = model.expect(method, params, executor.now())
        refused = expected and not any(each.status.endswith("-OK") for each in expected)
        self._count(self._state(method, params), f"{method}, refused" if refused else self._event(method, params))
        if expected and not expected[0].requirement.startswith("X"):
            self.decided[expected[0].requirement] = None
        before = executor.now(), executor.wall()
        try:
            answer = executor.call(method, params)
        except UpperTesterError as error:
            self._alive()
            if not executor.lossy_services:
                self._fail(Finding(("DATA-10",), f"an answer to {method}", str(error)))
            unanswered = isinstance(error, NoAnswerError | NeverAnsweredError)
            if unanswered and not _FOLLOWED.fullmatch(method):
                # The model cannot follow the node any further.
                raise
            model.bp.unknown_outcome(method, params)
            return None
        after = executor.now(), executor.wall()
        self._alive()
        if method == "BP-TransmitPayload" and not executor.confirms and expected:
            answer = Answer(expected[0].status)
        self._row = [either([each for each in expected if each.status]), str(answer)]
        if method.endswith("-SetParameter") and answer.code is None and not answer.known:
            self._fail(Finding((f"{method.partition('-')[0]}-PAR-01",), "a status of the specification", str(answer)))
        self._judge(model.judge(method, params, expected, answer.status, answer.code))
        if answer.code is not None:
            model.bp.unknown_outcome(method, params)
            return None
        if method == "RTDB-Create" and answer.ok:
            self._judge(model.created(params, self._creation(params["varId"]), after[0]))
        self._judge(model.confirmed(method, params, answer.result | {"status": answer.status}, before, after))
        return answer

    def _creation(self, var_id: int) -> int | None:
        if _DESCRIBE not in self.executor.methods:
            return None
        try:
            answer = self.executor.call(_DESCRIBE, {"varId": var_id})
        except NeverAnsweredError:
            return None
        found = answer.result.get("variable", {}).get("creationTime") if answer.ok else None
        return found if isinstance(found, int) else None

    def _resolved(self, step: Call) -> dict[str, Any]:
        """Return the parameters of a call, with the identifiers of this run and new octets."""
        params = dict(step.params)
        if "protId" in params:
            number = params["protId"]
            params["protId"] = self.protocols.setdefault(number, self.executor.names.protocol(number))
        if "varId" in params:
            params["varId"] = self._variable(params["varId"])
        if params.get("name") == "VARDISPAR_MAX_PAYLOAD_SIZE":
            params["value"] = max(params["value"], self.model.least_payload)
        elif params.get("name") in ("VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_DESCRIPTION_LENGTH"):
            # If such values do not fit into its payloads, a node may refuse the maximum, or set a smaller one (X39).
            params["value"] = min(params["value"], self.model.bounded(params["name"], params["value"]))
        for name, wide in (("name", False), ("descr", params.get(FILL) == "ones")):
            if isinstance(params.get(name), int):
                params[name] = _letters(params[name], wide=wide)
        for name in _SIZED if not step.method.endswith("-SetParameter") else ():
            if isinstance(params.get(name), int):
                again, fill = bool(params.pop(AGAIN, False)), params.pop(FILL, "")
                params[name] = self._octets(params[name], again=again, fill=fill).hex()
        modes = features(self.executor.codec.profile.spec_version).queueing_modes
        if params.get("queueingMode", "").startswith(QueueingMode.QUEUE) and params["queueingMode"] not in modes:
            # 1.0 has one mode with a queue.
            params["queueingMode"] = str(QueueingMode.QUEUE)
        if step.method == "SRP-UpdateSafetyData":
            kind: Data = "again" if params.pop(AGAIN, False) else params.pop(DATA, "")
            params["sData"] = self._safety_data(OWN, kind)
        return params

    def _variable(self, number: int) -> int:
        var_id = self.executor.names.variable(number)
        self.model.vardis.mine.add(var_id)
        return var_id

    def _octets(self, size: int, *, again: bool = False, fill: Fill = "") -> bytes:
        """Return octets that differ from those before, as far as the size allows; ``again``: the octets before."""
        if fill:
            return (b"\x00" if fill == "zeros" else b"\xff") * size
        self._mark += not again
        mark = self._mark.to_bytes(2, "big") if size > 1 else bytes((self._mark % 256,))
        return (mark * (size // len(mark) + 1))[:size]

    def _safety_data(self, node: int, kind: Data) -> dict[str, Any]:
        """Return safety data that differ from those before of this node as ``kind`` says."""
        before = self._shown.get(node)
        if kind == "again" and before is not None:
            return before
        self._mark += 1
        number, values = self._mark, dict[str, Any]()
        for index, field in enumerate(self.executor.codec.profile.srp.safety_data):
            small = 0 if kind == "zeros" else (7 * number + 3 * index + 1) % 100
            value: Any = small
            if field.type == "opaque":
                value = bytes([small] * field.octets).hex()
            elif field.type.startswith("f") and kind == "near" and before is not None:
                value = before[field.name] + 0.1
            elif field.type.startswith("f") and kind != "zeros":
                # All digits of a double, so that a shorter number shows.
                value = small + 1 / 3 if kind != "far" else (-1) ** index * 5000.0 * (small + 1)
            values[field.name] = value
        self._shown[node] = values
        return values

    # -- looking ---------------------------------------------------------------------------------------------

    def _look(self, method: str, **params: Any) -> None:
        if method in self.executor.methods:
            row, self._row = self._row, ["", ""]
            self._asked(method, params)
            self._row = row

    def _look_after(self, method: str, params: dict[str, Any]) -> None:
        """Query what a service may have changed."""
        if not self.executor.looks:
            return
        prot_id = params.get("protId")
        if method in ("BP-RegisterProtocol", "BP-DeregisterProtocol"):
            self._look(_LIST)
        if prot_id in self.model.bp.clients and method != _QUERY:
            self._look(_QUERY, protId=prot_id)
        if method.endswith(("-Activate", "-Deactivate")) or params.get("name") == "BPPAR_MAXIMUM_PACKET_SIZE":
            for each in list(self.model.bp.clients):
                self._look(_QUERY, protId=each)
        if "varId" in params:
            self._look(_DESCRIBE, varId=params["varId"])
        if params.get("name") == "BPPAR_BEACON_PERIOD":
            self._look("BP-GetParameters")

    def _look_around(self) -> None:
        """Query the whole state."""
        if not self.executor.looks:
            return
        model = self.model
        for prot_id in list(model.bp.clients):
            self._look(_QUERY, protId=prot_id)
        if model.srp.watched:
            self._look(_TABLE)
            for node_id in model.srp.known:
                self._look(_TABLE, nodeId=node_id.hex(":"))
        if self.protocols:
            self._look(_LIST)
        if model.vardis.mine:
            self._look(_ALL)
            for var_id in sorted(model.vardis.mine)[:8]:
                self._look("RTDB-Read", varId=var_id)
                self._look(_DESCRIBE, varId=var_id)

    # -- frames ----------------------------------------------------------------------------------------------

    def _send(self, step: Beacon) -> None:
        executor = self.executor
        node_id, address = executor.names.neighbour(step.sender)
        forbidden = FAULTS.get(step.fault, ())
        for blocks in self._beacons(step):
            for event in executor.wait(0):
                self._take(event)
            octets = self._framed(step, blocks, executor.own_id if step.fault == "own-sender" else node_id)
            if octets is None:
                return
            time = executor.now()
            executor.send(octets, address, len(blocks))
            contents = [(each.protocol_id, each.octets) for each in blocks]
            if step.trait == "last block into the padding":
                contents[-1] = blocks[-1].protocol_id, blocks[-1].octets + _PADDING["padded"]
            self.model.received(contents, time, forbidden, ENDS.get(step.trait))
            self._sent = time
            self._alive()
        if not executor.looks:
            return
        if any(isinstance(each, Report) for each in step.blocks):
            self._look(_TABLE)
        ids = [each.variable for each in step.blocks if isinstance(each, Records) and each.count == 1]
        for number in dict.fromkeys(ids):
            self._look(_DESCRIBE, varId=self._variable(number))

    def _beacons(self, step: Beacon) -> Iterator[list[Block]]:
        """Yield the blocks of the beacons of a step: several if the records do not fit into one payload."""
        blocks: list[Block] = []
        model = self.model
        about = _about(step)
        for kind, group in groupby(step.blocks, key=lambda each: each.kind if isinstance(each, Records) else None):
            if kind is not None:
                # Neighbouring records of one kind are in one container.
                if self.executor.hears_vardis:
                    yield from self._record_blocks(group, step, blocks)
                continue
            for each in group:
                if isinstance(each, Client):
                    prot_id = self.protocols.setdefault(each.protocol, self.executor.names.protocol(each.protocol))
                    self._count(model.bp.client_state(prot_id), f"payload{about}")
                    blocks += [
                        Block(prot_id, self._octets(each.size, again=each.again, fill=each.fill))
                        for _ in range(each.count)
                    ]
                elif isinstance(each, Damaged):
                    self._count("VarDis active" if model.vardis.active else "VarDis inactive", f"damaged{about}")
                    blocks.append(Block(BP_PROTID_VARDIS, _DAMAGED))
                elif isinstance(each, Report) and self.executor.codec.profile.srp.is_report:
                    for number in range(each.neighbour, each.neighbour + each.count):
                        report = self._report(number, each)
                        event = f"report{about}{' of a wrong length' if each.excess else ''}"
                        self._count(model.srp.state_of(report.node_id), event)
                        made = self._builder.srp(report)
                        if each.excess:
                            octets = made.octets[: each.excess] if each.excess < 0 else made.octets + bytes(each.excess)
                            made = Block(made.protocol_id, octets)
                        if each.count > 1:
                            yield [made]
                        else:
                            blocks.append(made)
        if blocks:
            yield blocks

    def _record_blocks(self, blocks_of: Iterable[Any], step: Beacon, blocks: list[Block]) -> Iterator[list[Block]]:
        """As :meth:`_beacons`, for :class:`Records` of one kind."""
        model = self.model
        most = model.vardis.room.limit
        group: list[VardisRecord] = []
        used = self._builder.container_header_size
        for each, number in (
            (one, place) for one in blocks_of for place in range(one.variable, one.variable + one.count)
        ):
            record = self._record(each, number)
            var_id = record.spec.var_id if isinstance(record, VarCreate) else record.var_id
            event = each.kind if step.fault else model.vardis.event_of(each.kind, record)
            self._count(model.vardis.state_of(var_id), event + (f", {each.fill}" if each.fill else "") + _about(step))
            size = self._builder.record_size(record)
            if group and (used + size > most or len(group) == 255):
                yield [self._builder.vardis(*group)]
                group, used = [], self._builder.container_header_size
            group.append(record)
            used += size
        if group and used <= most:
            made = self._builder.vardis(*group)
            last = blocks[-1] if blocks and blocks[-1].protocol_id == BP_PROTID_VARDIS else None
            if last is not None and len(last.octets) + len(made.octets) <= most:
                blocks[-1] = Block(BP_PROTID_VARDIS, last.octets + made.octets)
            else:
                blocks.append(made)

    def _framed(self, step: Beacon, blocks: list[Block], sender: bytes) -> bytes | None:
        profile = self.executor.codec.profile
        if step.trait != "seqno as before":
            self._seqnos[step.sender] += 1
        network = self.model.values.get("BPPAR_NETWORK_ID")
        lies: dict[str, int | bytes] = {}
        match step.fault:
            case "version":
                lies = {"bp.version": 0x11}
            case "magic":
                lies = {"bp.magicNo": 0x7E49}
            case "no-length" if profile.has_header_field("length"):
                lies = {"bp.length": 0}
            case "no-payloads":
                lies = {"bp.numPayloads": 0}
            case "network" if network is not None:
                network = (network + 1) % (1 << (8 * profile.types.network_id.width))
            case "network-high" if network is not None and profile.types.network_id.width > 1:
                network ^= 1 << 8
            case "" | "own-sender":
                pass
            case _:
                return None
        if not profile.bp.header and step.fault:
            return None
        seqno = self._seqnos[step.sender]
        if step.trait in _NUMBERS:
            seqno = _NUMBERS[step.trait] % (1 << 8 * profile.types.bp_seqno.width)
        if step.trait in ENDS:
            plain = all(isinstance(each, Client) for each in step.blocks) and len(blocks) > 1
            if not plain or not profile.has_header_field("length") or not profile.has_header_field("numPayloads"):
                return None
            octets = self._ending(step.trait, sender, seqno, blocks, network)
        else:
            octets = self._builder.beacon(sender, seqno, blocks, network_id=network, lies=lies)
        if step.trait in _PADDING and profile.has_header_field("length"):
            octets += _PADDING[step.trait]
        return octets if len(octets) <= profile.limits.uwb_max_packet else None

    def _ending(self, trait: Trait, sender: bytes, seqno: int, blocks: list[Block], network: int | None) -> bytes:
        """Return a beacon whose end is as ``trait`` says."""
        make, count = partial(self._builder.beacon, sender, seqno, network_id=network), len(blocks)
        whole = make(blocks)
        if trait == "last block too long":
            # A bearer pads short frames.
            more = 1 if len(whole) > _PADDED else 1000
            return make(blocks, lies={f"payloads[{count - 1}].length": len(blocks[-1].octets) + more})
        if trait == "last block into the padding":
            padding = _PADDING["padded"]
            longer = len(blocks[-1].octets) + len(padding)
            return make(blocks, lies={f"payloads[{count - 1}].length": longer}) + padding
        shorter = make(blocks[:-1], lies={"bp.numPayloads": count} if trait.endswith("counted") else {})
        return shorter + whole[len(shorter) :]

    def _record(self, each: Records, number: int) -> VardisRecord:
        names, profile = self.executor.names, self.executor.codec.profile
        var_id = self._variable(number)
        seqno = each.seqno % (1 << 8 * profile.types.var_seqno.width)
        size = 1 if each.uneven and number % 3 else each.size
        value = self._octets(size, again=each.again, fill=each.fill) if each.kind in ("create", "update") else b""
        if each.kind != "create":
            return self._made.record(_KINDS[each.kind], var_id, seqno, value)
        producer = self.executor.own_id if each.producer == OWN else names.neighbour(each.producer)[0]
        longest = (1 << 8 * profile.types.var_timeout.width) - 1
        descr = _letters(each.descr, wide=each.fill == "ones").encode()
        if each.fill == "zeros" and features(profile.spec_version).string_format != "nul-terminated" and descr:
            place = len(descr) // 2
            descr = descr[:place] + b"\x00" + descr[place + 1 :]
        creation = names.creation(each.creation) if self._made.stamped else 0
        spec = self._made.spec(var_id, producer, each.repetitions, descr, creation, min(each.timeout, longest))
        return self._made.create(spec, seqno, value)

    def _report(self, number: int, each: Report) -> ExtendedSafetyData:
        data = self._safety_data(number if number != OWN else ZERO - 1, each.data)
        names = self.executor.names
        stamp = names.creation(0 if each.earlier else 1 + self._mark % 7)
        node_id = self.executor.own_id if number == OWN else names.neighbour(number)[0]
        return self._made.report(node_id, stamp, each.seqno, data)

    def _event(self, method: str, params: dict[str, Any]) -> str:
        """Return the name of a service; for a payload also how it differs from the one before."""
        if method != "BP-TransmitPayload":
            return method
        payload, prot_id = params["payload"], params["protId"]
        before, self._submitted[prot_id] = self._submitted.get(prot_id), payload
        if before is None:
            return method
        longer = len(payload) - len(before)
        relation = "longer" if longer > 0 else "shorter" if longer else "equal" if payload == before else "as long"
        return f"{method}, {relation}"

    def _state(self, method: str, params: dict[str, Any]) -> str:
        """Return the name of the state of the model that a service depends on."""
        model = self.model
        if "varId" in params:
            return model.vardis.state_of(params["varId"])
        if "protId" in params:
            return model.bp.client_state(params["protId"])
        if method.startswith(("RTDB", "VD")):
            return "VarDis active" if model.vardis.active else "VarDis inactive"
        return f"BP {model.bp.state}"


def shorter(
    execute: Callable[[Sequence[Step]], Counterexample | None], found: Counterexample, *, attempts: int
) -> Counterexample:
    """Return the counterexample without steps that it does not need.

    ``execute`` executes a sequence in an initial state, and is called up to ``attempts`` times.
    """
    place = len(found.steps) - 1
    while place >= 0 and attempts and len(found.steps) > 1:
        fewer = [each for number, each in enumerate(found.steps) if number != place]
        attempts -= 1
        again = execute(fewer)
        if again is not None and again.finding.requirements == found.finding.requirements:
            found = again
        place = min(place, len(found.steps)) - 1
    return found


def _about(step: Beacon) -> str:
    """Return what is wrong or unusual about a beacon, for statistics."""
    notes = step.fault, step.trait, {GROUP: "from a group address", ZERO: "from the identifier 0"}.get(step.sender, "")
    return "".join(f", {each}" for each in notes if each)


def _letters(size: int, *, wide: bool = False) -> str:
    """Return a text of ``size`` octets; ``wide``: of as few characters as possible."""
    if wide:
        return "\N{GREEK SMALL LETTER ALPHA}" * (size // 2) + "a" * (size % 2)
    return ("abcdefghijklmnopqrstuvwxyz" * (size // 26 + 1))[:size]


__all__ = ["Counterexample", "Driver", "Row", "shorter", "table"]
