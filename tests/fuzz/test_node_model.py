"""The model of a node, and the search for counterexamples, in virtual time."""

from __future__ import annotations

from typing import Any, ClassVar, Final

import msgspec
import pytest
from dcp_conformance.frames.sampling import sampler
from dcp_conformance.oracle.judgement import MS, Timing
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.stateful.corpus import corpus
from dcp_conformance.stateful.driver import Counterexample, Driver
from dcp_conformance.stateful.machine import NodeMachine
from dcp_conformance.stateful.search import search
from dcp_conformance.stateful.steps import (
    ENDS,
    GROUP,
    ZERO,
    Beacon,
    Call,
    Client,
    Damaged,
    Records,
    Report,
    Step,
    Trait,
    Wait,
    text,
)
from dcp_conformance.stateful.virtual import VirtualExecutor
from dcp_lab.fuzz.findings.artefact import load, save
from dcp_lab.fuzz.findings.counterexample import artefact_of, steps_of
from dcp_selftest.mutants import all_mutants
from dcp_selftest.mutants.mutant import maker, node_with
from dcp_selftest.mutants.vardis.queue_order import FaultySenderIgnored
from dcp_spec.constants import ICType, SpecVersion, features
from dcp_spec.status import BPStatus, SRPStatus, VardisStatus

from dcp_codec.codec import get_codec
from dcp_codec.values import VarReqUpdate
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.receive import Receiver as BPReceiver
from dcp_stack.bp.timing import BeaconSchedule
from dcp_stack.bp.wire import Block, BPWire
from dcp_stack.config import NodeConfig
from dcp_stack.effects import PayloadTransmitted
from dcp_stack.node import Node
from dcp_stack.srp.entity import StateReporting, UpdateSafetyDataConfirm
from dcp_stack.srp.neighbour_table import NeighbourTable
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.confirms import Confirm
from dcp_stack.vardis.database import Database
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver

CONFIG = reference_config(get_codec("dcp-2.0"))
DROPTAIL = "BP_QMODE_QUEUE_DROPTAIL"


def judged(*steps: Step, make: MakeNode = plain_node, config: NodeConfig = CONFIG) -> tuple[str, ...]:
    """Return the requirements that a counterexample names; none if the model allows everything."""
    try:
        Driver(VirtualExecutor(config, make=make)).run(steps)
    except Counterexample as found:
        return found.finding.requirements
    return ()


def registering(entries: int, size: int = 20, mode: str = DROPTAIL) -> Call:
    """Return a registration of the first protocol."""
    params: dict[str, Any] = {"protId": 0, "name": 4, "maxPayloadSize": size, "queueingMode": mode}
    return Call("BP-RegisterProtocol", params | {"maxEntries": entries, "allowMultiplePayloads": False})


def submitting(times: int, size: int = 4) -> Call:
    """Return submissions to the first protocol."""
    return Call("BP-TransmitPayload", {"protId": 0, "payload": size}, times)


def with_bp(**methods: Any) -> MakeNode:
    """Return a constructor of nodes whose BP has other methods."""

    def make(config: NodeConfig, rng: Any, now: int, wall: int) -> Any:
        node = plain_node(config, rng, now, wall)
        node.bp.__class__ = type("Changed", (BeaconingProtocol,), methods)
        return node

    return make


OFF, ON = Call("BP-MGMT-Deactivate"), Call("BP-MGMT-Activate")


def test_nothing_is_due_while_payloads_of_vardis_exceed_the_packet_size() -> None:
    sizes = {"name": "BPPAR_MAXIMUM_PACKET_SIZE", "value": 23}
    create = Records("create", variable=0, count=1, seqno=0, size=2, descr=3, repetitions=1, producer=0, creation=1)
    assert judged(Call("BP-SetParameter", sizes), Beacon(0, (create,)), Wait(60)) == ()


@pytest.mark.req("BP-CLR-02")
def test_a_clear_without_effect_while_inactive_is_named() -> None:
    def clear_buffer(self: Any, prot_id: int) -> Any:
        return BeaconingProtocol.clear_buffer(self, prot_id) if self._active else self.deactivate()

    steps = (registering(3), OFF, submitting(2), Call("BP-ClearBuffer", {"protId": 0}))
    assert judged(*steps) == ()
    found = judged(*steps, make=with_bp(clear_buffer=clear_buffer))
    assert "BP-CLR-02" in found


@pytest.mark.req("BP-TXP-02")
def test_a_length_that_is_not_checked_is_named() -> None:
    def transmit_payload(self: Any, prot_id: int, payload: bytes, *, now: int) -> Any:
        return BeaconingProtocol.transmit_payload(self, prot_id, payload[:20], now=now)

    found = judged(registering(3), submitting(1, 21), make=with_bp(transmit_payload=transmit_payload))
    assert found[0] == "BP-TXP-02"


@pytest.mark.req("SRP-RUN-02")
def test_the_reference_node_keeps_to_the_model_when_a_timeout_is_lowered() -> None:
    lowered = Call("SRP-SetParameter", {"name": "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", "value": 1000})
    assert judged(Beacon(0, (Report(0, 5),)), lowered, Wait(2), Wait(25)) == ()


@pytest.mark.req("VD-PAY-02")
def test_the_reference_node_keeps_to_the_model_with_many_unknown_variables() -> None:
    assert judged(Beacon(0, (Records("summary", 6, 200),)), Wait(5)) == ()


def test_a_search_is_the_same_for_the_same_seed() -> None:
    first, second = (search(lambda: VirtualExecutor(CONFIG), sequences=4, steps=6, seed=3) for _ in range(2))
    assert first.counterexample is None
    assert first.reached == second.reached


def test_a_counterexample_is_short_and_its_file_repeats_it(tmp_path: Any) -> None:
    def query_number_buffered(self: Any, prot_id: int) -> Any:
        confirm = BeaconingProtocol.query_number_buffered(self, prot_id)
        return type(confirm)(confirm.status, 7) if confirm.number else confirm

    made = with_bp(query_number_buffered=query_number_buffered)
    found = search(lambda: VirtualExecutor(CONFIG, make=made), sequences=200, steps=8, seed=1)
    assert found.counterexample is not None
    assert len(found.counterexample.steps) <= 4
    artefact = artefact_of(found.counterexample, "dcp-2.0", name="x", options="", seed=1, directory=tmp_path)
    again = load(save(artefact, tmp_path))
    assert judged(*steps_of(again), make=made) == found.counterexample.finding.requirements


def test_the_sequences_of_a_run_reach_every_theme() -> None:
    themes = {each.theme for each in corpus().sequences}
    assert {"registrations", "inactivity", "services", "sizes"} <= themes
    assert all(each.periods <= 60 for each in corpus().sequences)


def test_a_dead_node_is_named() -> None:
    def handle_beacon(self: Any, octets: bytes, **times: int) -> None:
        del self, octets, times
        raise RuntimeError("dead")

    found = judged(Beacon(0, (Records("summary", 0),)), make=with_bp(handle_beacon=handle_beacon))
    assert "BP-RX-16" in found
    assert InProcess(CONFIG).alive()


@pytest.mark.req("VD-PD-04")
def test_the_number_of_a_deleted_variable_is_unknown_after_a_disputed_update() -> None:
    create = Records("create", 0, creation=1)
    opposite, delete = Records("update", 0, seqno=128), Records("delete", 0)
    assert judged(Beacon(0, (create,)), Beacon(0, (opposite,)), Beacon(0, (delete,)), Wait(5)) == ()


@pytest.mark.req("BP-QM-07")
@pytest.mark.parametrize(("several", "allowed"), [(True, range(21)), (False, range(18, 21))])
def test_a_beacon_on_its_way_may_have_all_payloads_of_a_client(several: bool, allowed: range) -> None:
    for number in range(22):
        model = Driver(VirtualExecutor(CONFIG, timing=Timing(period=20 * MS, flight=15 * MS))).model.bp
        params = registering(30).params | {"allowMultiplePayloads": several, "name": "x"}
        confirms = [("BP-RegisterProtocol", params)]
        confirms += [("BP-TransmitPayload", {"protId": 0, "payload": f"{each:04}"}) for each in range(20)]
        confirms.append(("BP-QueryNumberBufferedPayloads", {"protId": 0}))
        result = {"status": "BP-STATUS-OK", "number": number}
        found = [each for method, params in confirms for each in model.confirmed(method, params, result, 1)]
        assert bool(found) is (number not in allowed)


@pytest.mark.req("BP-PTI-01")
def test_notifications_of_a_client_whose_queue_is_unknown_count() -> None:
    timing = Timing(period=20 * MS, flight=15 * MS, notice=50 * MS)
    model = Driver(VirtualExecutor(CONFIG, timing=timing)).model.bp
    ok = {"status": "BP-STATUS-OK"}
    assert not list(model.confirmed("BP-RegisterProtocol", registering(3).params | {"name": "x"}, ok, 1))
    model.unknown_outcome("BP-TransmitPayload", {"protId": 0})
    assert not list(model.beacon([(0, b"1234")], 40, None, 2))
    assert not list(model.transmitted(0, 3))
    assert not list(model.unconfirmed(10_000 * MS))


@pytest.mark.req("BP-PTI-01")
def test_a_notification_without_a_beacon_is_named_although_beacons_may_be_late() -> None:
    def _submit(self: Any, client: Any, payload: bytes, now: int) -> Any:
        before = len(client.queue)
        status = BeaconingProtocol._submit(self, client, payload, now)
        if before >= client.registration.max_entries:
            self._emit(PayloadTransmitted(client.protocol_id, now))
        return status

    period = CONFIG.bp.beacon_period_ms * MS
    timing = Timing(period=period, patience=12 * period, flight=period // 4, notice=period // 4, late=period // 4)
    steps = (registering(2, mode="BP_QMODE_QUEUE_DROPHEAD"), Wait(4), submitting(3), Wait(6), Wait(2))
    for make, expected in ((plain_node, ()), (with_bp(_submit=_submit), ("BP-PTI-01",))):
        try:
            Driver(VirtualExecutor(CONFIG, make=make, timing=timing)).run(steps)
            found: tuple[str, ...] = ()
        except Counterexample as error:
            found = error.finding.requirements
        assert found == expected


@pytest.mark.req("BP-PTI-01")
@pytest.mark.parametrize("shown", [1, 0])
def test_one_notification_of_several_payloads_in_a_beacon_is_enough(shown: int) -> None:
    class Telling(Node):
        def take_effects(self):
            effects = super().take_effects()
            told = [place for place, each in enumerate(effects) if isinstance(each, PayloadTransmitted)]
            return [each for place, each in enumerate(effects) if place not in told[shown:]]

    period = CONFIG.bp.beacon_period_ms * MS
    late = Timing(period=period, patience=12 * period, flight=period // 2, notice=period // 4, late=period // 4)
    params = {**registering(3).params, "allowMultiplePayloads": True}
    steps = (Call("BP-RegisterProtocol", params), Wait(2), submitting(3), Wait(3), submitting(3), Wait(8))
    for timing in (None, late):
        for make, expected in ((plain_node, ()), (maker(node_with(Telling)), () if shown else ("BP-PTI-01",))):
            found: tuple[str, ...] = ()
            try:
                Driver(VirtualExecutor(CONFIG, make=make, timing=timing)).run(steps)
            except Counterexample as error:
                found = error.finding.requirements
            assert found == expected


@pytest.mark.req("SRP-RX-01")
@pytest.mark.parametrize("excess", [1, -1])
def test_a_report_of_a_wrong_length_does_not_renew_an_entry(excess: int) -> None:
    assert judged(*_renewed(excess)) == ()
    found = judged(*_renewed(excess), make=all_mutants()["M-SRP-RX-01-long-record-renews"].make)
    assert ("SRP-RUN-02" in found) is (excess > 0)


def _renewed(excess: int) -> tuple[Step, ...]:
    again = (Wait(20), Beacon(0, (Report(0, 6, excess=excess),)))
    return (Beacon(0, (Report(0, 5),)), *again, *again, Wait(10))


@pytest.mark.req("VD-SCP-01")
def test_a_removed_variable_is_asked_for_after_its_last_deletion_was_composed() -> None:
    steps = (
        Beacon(0, (Records("create", 6, 200, size=1, descr=7, creation=2),)), _SUBMITTED, Wait(1.2), _SUBMITTED,
        Beacon(0, (Records("delete", 6, 30),)), Wait(2), Beacon(0, (Records("summary", 6, 200, 1),)),
    )  # fmt: skip
    assert judged(*steps, config=reference_config(get_codec("cpp-1.3"))) == ()


def test_a_reaction_may_take_some_long_periods() -> None:
    slowed = calling("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=1900)
    for wait in range(550, 570, 4):
        assert judged(slowed, Wait(wait), Beacon(0, (Records("summary", 0),))) == ()


@pytest.mark.req("BP-PAR-06")
def test_a_rejected_period_leaves_the_one_that_is_set() -> None:
    values = [Call("BP-SetParameter", {"name": "BPPAR_BEACON_PERIOD", "value": value}) for value in (400, -100)]
    steps = (registering(2, mode="BP_QMODE_REPEAT"), submitting(1), *values, Wait(130))
    assert judged(*steps) == ()
    assert judged(*steps, make=all_mutants()["M-BP-PAR-06-rejected-default"].make) == ("BP-PAR-02", "BP-TX-01")


@pytest.mark.req("SRP-RX-03")
def test_both_reports_of_a_beacon_are_expected() -> None:
    both = Beacon(0, (Report(0, 5), Report(1, 5)))
    assert judged(both) == ()
    assert "SRP-RX-03" in judged(both, make=all_mutants()["M-SRP-RX-03-first-of-beacon"].make)


def creating(variable: int, creation: int, *, seqno: int = 1, repetitions: int = 1, **more: Any) -> Records:
    """Return a VarCreate of a neighbour's variable."""
    return Records("create", variable, 1, seqno, 2, 3, repetitions, 0, creation, **more)


def setting(name: str, value: int) -> Call:
    """Return a change of a parameter of VarDis."""
    return Call("VD-SetParameter", {"name": f"VARDISPAR_{name}", "value": value})


class FirstNumber(Composer):
    """Requests updates with the number that the variable had at first."""

    def _take(self, kind, var_id):
        record = super()._take(kind, var_id)
        return VarReqUpdate(var_id, 1) if isinstance(record, VarReqUpdate) else record


class KeptRequest(Database):
    """Keeps a request for an update when the variable is created again."""

    def insert(self, spec, value, seqno, *, now, wall):
        pending = spec.var_id in self.req_upd_q
        entry = super().insert(spec, value, seqno, now=now, wall=wall)
        if pending:
            self.req_upd_q.append(spec.var_id)
        return entry


class KeptPlace(Database):
    """Leaves a variable at its place in createQ when it is created again."""

    def insert(self, spec, value, seqno, *, now, wall):
        before = list(self.create_q)
        entry = super().insert(spec, value, seqno, now=now, wall=wall)
        if spec.var_id in before:
            self.create_q.clear()
            for each in before:
                self.create_q.append(each)
        return entry


class OneAnswer(Receiver):
    """Answers an older number once, whatever repCnt is."""

    def _summary(self, record, offset):
        super()._summary(record, offset)
        if record.var_id in self._database.update_q:
            self._database.entries[record.var_id].count_update = 1


_CREATED_AGAIN = Call("RTDB-Create", {"varId": 0, "repCnt": 15, "descr": 3, "value": 2, "timeout": 0})


@pytest.mark.parametrize(
    ("fault", "steps", "requirement"),
    [
        pytest.param(
            FirstNumber,
            (
                Beacon(0, (creating(0, 1),)), Wait(2), Beacon(0, (Records("summary", 0, 1, 9),)),
                Beacon(0, (Records("update", 0, 1, 5),)), Beacon(0, (Records("summary", 0, 1, 9),)), Wait(3),
            ),
            "VD-PS-04", id="outdated number in a request", marks=pytest.mark.req("VD-PS-04"),
        ),
        pytest.param(
            KeptRequest,
            (
                Beacon(0, (creating(0, 1),)), Wait(2), Beacon(0, (Records("summary", 0, 1, 9),)),
                Beacon(0, (creating(0, 2),)), Wait(3),
            ),
            "VD-SCP-01", id="request of an earlier creation", marks=pytest.mark.req("VD-PC-08"),
        ),
        pytest.param(
            OneAnswer,
            (
                Beacon(0, (creating(0, 1, seqno=9, repetitions=3),)), Wait(9),
                Beacon(0, (Records("summary", 0, 1, 5),)), Wait(9),
            ),
            "VD-PS-03", id="one answer to an older number", marks=pytest.mark.req("VD-PS-03"),
        ),
        pytest.param(
            KeptPlace,
            (
                _CREATED_AGAIN, Call("RTDB-Create", _CREATED_AGAIN.params | {"varId": 1}), Wait(3),
                _CREATED_AGAIN, Wait(3),
            ),
            "VD-PAY-06", id="place in createQ", marks=pytest.mark.req("VD-CRE-11"),
        ),
    ],
)  # fmt: skip
def test_a_payload_shows_when_it_was_composed(fault: type, steps: tuple[Step, ...], requirement: str) -> None:
    assert judged(*steps) == ()
    assert requirement in judged(*steps, make=maker(node_with(fault)))


@pytest.mark.req("VD-PAR-01")
def test_a_lowered_limit_does_not_bound_what_the_node_holds() -> None:
    # After its timeout it may be deleted or not (X26), and its VarDeletes have the repCnt that it was created with.
    old = Beacon(0, (creating(0, 1, repetitions=15, timeout=300),))
    deleted = Beacon(0, (Records("delete", 0),))
    assert judged(old, Wait(3.5), setting("MAX_REPETITIONS", 1), deleted, Wait(25)) == ()
    lengths = (setting("MAX_VALUE_LENGTH", 1), setting("MAX_DESCRIPTION_LENGTH", 1), setting("MAX_SUMMARIES", 0))
    assert judged(_CREATED_AGAIN, *lengths, setting("MAX_PAYLOAD_SIZE", 0), Wait(25)) == ()


@pytest.mark.req("VD-RC-03")
def test_a_request_between_timeout_and_scrubbing_may_have_an_effect() -> None:
    ask = Beacon(0, (Records("ask-create", 0),))
    update = Call("RTDB-Update", {"varId": 0, "value": 2})
    timed = Call("RTDB-Create", _CREATED_AGAIN.params | {"timeout": 1200})
    assert judged(timed, Wait(16), ask, update, Wait(16)) == ()


class TwiceListed(NeighbourTable):
    """Lists entries twice."""

    def __iter__(self):
        yield from super().__iter__()
        yield from super().__iter__()


class LateTable(NeighbourTable):
    """Enters reports with a later time of reception."""

    def record(self, report, sender_id, *, now, wall):
        return super().record(report, sender_id, now=now, wall=wall + 300_000_000)


@pytest.mark.req("SRP-NT-01", "SRP-RX-03")
@pytest.mark.parametrize(("fault", "requirement"), [(TwiceListed, "SRP-NT-01"), (LateTable, "SRP-RX-03")])
def test_the_entries_of_the_neighbour_table_are_compared(fault: type, requirement: str) -> None:
    steps = (Beacon(0, (Report(0, 5),)), Beacon(1, (Report(1, 6),)), Wait(2))
    assert judged(*steps) == ()
    assert requirement in judged(*steps, make=maker(node_with(fault)))


@pytest.mark.req("SRP-SRV-04")
@pytest.mark.parametrize(("value", "alone", "named"), [(0, False, False), (0, True, True), (5, False, True)], ids=str)
def test_reports_of_zeros_may_be_of_an_application(value: int, alone: bool, named: bool) -> None:
    executor = VirtualExecutor(CONFIG)
    executor.alone = alone
    model, own = Driver(executor).model.srp, CONFIG.node_id
    model.submitted({"x": value, "y": "00"}, 0, 0, 0)
    made = sampler(CONFIG.codec)
    data = {each.name: 0 for each in CONFIG.profile.srp.safety_data}
    reports = (made.report(own, 0, number, data) for number in range(2))
    findings = [each for report in reports for each in model.sent(report, {"x": value, "y": "00"}, None, own, 0)]
    assert any("SRP-SRV-04" in each.requirements for each in findings) is named


class Picky(BPReceiver):
    """Drops beacons with unusual numbers, padding or senders, which it must take."""

    def receive(self, octets, now):
        length = 18 + int.from_bytes(octets[11:13], "big")
        unusual = octets[3] & 1 or not any(octets[3:9]) or octets[14:18] in (bytes(4), b"\xff" * 4)
        if not unusual and len(octets) == length:
            super().receive(octets, now)


@pytest.mark.req("BP-RX-07", "BP-RX-10", "BP-RX-14")
@pytest.mark.parametrize(
    "beacon",
    [
        *(
            Beacon(0, (Report(0, 5),), trait=each)
            for each in ("seqno 0", "seqno largest", "padded", "padded far")
        ),
        Beacon(GROUP, (Report(0, 5),)),
        Beacon(ZERO, (Report(0, 5),)),
    ],
    ids=text,
)  # fmt: skip
def test_unusual_beacons_are_to_be_received(beacon: Beacon) -> None:
    assert judged(beacon) == ()
    assert "SRP-RX-03" in judged(beacon, make=maker(node_with(Picky)))


@pytest.mark.req("BP-QM-05")
def test_values_of_equal_octets_are_judged_like_others() -> None:
    fills = [Beacon(0, (Client(0, 4, fill=each), creating(0, place, fill=each)))
             for place, each in enumerate(("zeros", "ones"), 1)]  # fmt: skip
    repeated = Call("BP-TransmitPayload", {"protId": 0, "payload": 4, "fill": "zeros"})
    assert judged(registering(2, mode="BP_QMODE_REPEAT"), *fills, repeated, Wait(3), repeated, Wait(3)) == ()


class Lenient(BPWire):
    """Delivers what is there of a block that is too long, and counted blocks after the end of a beacon."""

    def parse(self, octets):
        found = super().parse(octets)
        end = 18 + int.from_bytes(octets[11:13], "big")
        start = 18 + sum(4 + len(each.payload) for each in found.blocks)
        if len(found.blocks) < octets[13] and start + 4 < len(octets):
            rest = octets[start + 4 : end] if start < end else octets[start + 4 :]
            last = Block(int.from_bytes(octets[start : start + 2], "big"), rest, start)
            return msgspec.structs.replace(found, blocks=(*found.blocks, last))
        return found


class Padded(BPWire):
    """Delivers a last block that ends in the padding."""

    def parse(self, octets):
        return super().parse(octets[:11] + (len(octets) - 18).to_bytes(2, "big") + octets[13:])


class Hasty(BeaconingProtocol):
    """Announces the beacon that contains the payload as the next one."""

    def __init__(self, config, *, emit, **more):
        def tell(effect):
            late = type(effect) is PayloadTransmitted
            emit(type(effect)(effect.protocol_id, effect.next_epoch - 500 * MS) if late else effect)

        super().__init__(config, emit=tell, **more)


class Stale(BeaconingProtocol):
    """Announces the time of the beacon that contains the payload."""

    def __init__(self, config, *, emit, **more):
        def tell(effect):
            late = type(effect) is PayloadTransmitted
            emit(
                type(effect)(effect.protocol_id, effect.next_epoch - config.bp.beacon_period_ms * MS)
                if late
                else effect
            )

        super().__init__(config, emit=tell, **more)


class Tired(BeaconingProtocol):
    """Prolongs its beacon period."""

    def handle_timeout(self, now, wall):
        self._schedule._period = 5 * self._parameters.period
        super().handle_timeout(now, wall)


class Thrifty(StateReporting):
    """Does not send safety data again that has not changed."""

    _last = None

    def update_safety_data(self, data, *, now, wall):
        if data == self._last:
            return UpdateSafetyDataConfirm(SRPStatus.OK)
        self._last = data
        return super().update_safety_data(data, now=now, wall=wall)


class Remembering(NeighbourTable):
    """Still finds the entry that it has found last, after that has expired."""

    _found = None

    def lookup(self, node_id):
        entry = super().lookup(node_id)
        self._found = entry or self._found
        return self._found if self._found is not None and self._found.node_id == node_id else entry


class Quiet(Vardis):
    """Sends no VarDelete after the timeout of a variable."""

    def _scrub(self, now):
        alive = [each for each in self._database.entries.values() if not each.is_deleted]
        super()._scrub(now)
        for entry in alive:
            if entry.is_deleted:
                self._database.delete_q.remove(entry.spec.var_id)


class StillAsking(Receiver):
    """Requests an update although the variable was deleted before."""

    def _delete(self, record, offset):
        asks = record.var_id in self._database.req_upd_q
        super()._delete(record, offset)
        if asks:
            self._database.req_upd_q.append(record.var_id)


class Ticking(BeaconSchedule):
    """Rounds a changed period down to ticks of 10 ms."""

    def set_period(self, period):
        super().set_period(period // (10 * MS) * 10 * MS)


class TickingUp(BeaconSchedule):
    """Rounds a changed period up to ticks of 10 ms."""

    def set_period(self, period):
        super().set_period(-(-period // (10 * MS)) * 10 * MS)


class OneOctet(BPWire):
    """Skips blocks by the low octets of their lengths."""

    def parse(self, octets):
        length = int.from_bytes(octets[20:22], "big")
        if length > 255:
            octets = octets[:20] + bytes((0, length % 256)) + octets[22:]
        return super().parse(octets)


class Undated(Vardis):
    """Returns the creation time of a variable as that of its last change."""

    def read(self, var_id):
        created = self._database.entries[var_id].spec.creation_time
        return msgspec.structs.replace(super().read(var_id), t_stamp=self._core.clock.wall(created, near=0))


class Disordered(Vardis):
    """Checks the repetition count before the value."""

    def create(self, var_id, prod_id, rep_cnt, *args, **kwargs):
        if not rep_cnt:
            return Confirm(VardisStatus.ILLEGAL_REPCOUNT)
        return super().create(var_id, prod_id, rep_cnt, *args, **kwargs)


class Packing(Composer):
    """Passes a record over that does not fit, and takes smaller ones after it."""

    def _fitting(self, kind, queue, room, largest):
        chosen, used = [], self._sizes.ic_header
        for var_id in queue:
            size = self._record_size(kind, var_id)
            if used + size <= room and (kind is not ICType.SUMMARIES or len(chosen) < 20):
                chosen.append(var_id)
                used += size
        return chosen, used if chosen else 0


class NeverRenewed(Receiver):
    """Counts the timeout of a variable from its creation."""

    def _update(self, record, offset, now, wall):
        entry = self._database.lookup(record.var_id)
        since = None if entry is None else entry.refreshed
        super()._update(record, offset, now, wall)
        if entry is not None:
            entry.refreshed = since


class EmptyFirst(BeaconingProtocol):
    """Refuses an empty payload before it looks for the client protocol."""

    def transmit_payload(self, prot_id, payload, *, now):
        confirm = super().transmit_payload(prot_id, payload, now=now)
        return confirm if payload else msgspec.structs.replace(confirm, status=BPStatus.EMPTY_PAYLOAD)


class OldOrder(Composer):
    """Composes containers in the order of version 1.0."""

    def __init__(self, core, instructions=None):
        super().__init__(core, instructions)
        order = features(SpecVersion.V1_0).container_order
        self._order = tuple((kind, self._queues[kind]) for kind in order)


class TellsOnce(Vardis):
    """Sends the VarDelete of a variable whose timeout has passed once, whatever repCnt is."""

    def _scrub(self, now):
        alive = [each for each in self._database.entries.values() if not each.is_deleted]
        super()._scrub(now)
        for each in alive:
            each.count_delete = min(each.count_delete, 1)


def calling(method: str, **params: Any) -> Call:
    """Return a service request."""
    return Call(method, params)


def ending(trait: Trait) -> Beacon:
    """Return a beacon whose last block is not one."""
    return Beacon(0, (Client(0, 4), Client(0, 60)), trait=trait)


_SUBMITTED: Final = Call("SRP-UpdateSafetyData")
_HASTENED: Final = calling("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=25)
_CREATED: Final = Call("RTDB-Create", {"varId": 0, "repCnt": 1, "descr": 3, "value": 2, "timeout": 0})


@pytest.mark.req("BP-RX-09", "BP-RX-14", "BP-PTI-02", "BP-TX-01", "SRP-SRV-03", "SRP-NT-01", "VD-SCR-05", "VD-PD-04")
@pytest.mark.req("BP-RX-08", "VD-DB-03", "VD-CRE-13", "VD-PAY-06", "VD-PU-07", "VD-ROB-01")
@pytest.mark.parametrize(
    ("fault", "steps", "requirement"),
    [
        (Lenient, (registering(2, 100), ending("last block too long")), "BP-RX-09"),
        (Lenient, (registering(2, 100), ending("last block after the end, counted")), "BP-RX-14"),
        (Padded, (registering(2, 200), ending("last block into the padding")), "BP-RX-09"),
        (Hasty, (registering(2), submitting(1), Wait(2)), "BP-PTI-02"),
        (Stale, (registering(1, mode="BP_QMODE_REPEAT"), submitting(1), Wait(30)), "BP-PTI-02"),
        (Tired, (registering(1, mode="BP_QMODE_REPEAT"), submitting(1), Wait(130)), "BP-TX-01"),
        (Thrifty, (_SUBMITTED, Wait(3), Call(_SUBMITTED.method, {"data": "again"}), Wait(3)), "SRP-SRV-03"),
        (Remembering, (Beacon(0, (Report(0, 5),)), Wait(2), Wait(40)), "SRP-RUN-02"),
        (Ticking, (registering(1, mode="BP_QMODE_REPEAT"), submitting(1), _HASTENED, Wait(20)), "BP-TX-01"),
        (TickingUp, (registering(1, mode="BP_QMODE_REPEAT"), submitting(1), _HASTENED, Wait(20)), "BP-TX-01"),
        (OneOctet, (registering(1), Beacon(0, (Client(4, 300), Client(0, 4)))), "BP-RX-08"),
        (Undated, (_CREATED, Wait(3), calling("RTDB-Update", varId=0, value=2), Wait(1)), "VD-DB-03"),
        (Disordered, (calling("RTDB-Create", varId=0, repCnt=0, descr=3, value=0, timeout=0),), "VD-CRE-13"),
        (
            Packing,
            (Beacon(0, (Records("create", 6, 40, size=32, descr=2, repetitions=1, creation=1, uneven=True),)), Wait(1)),
            "VD-PAY-06",
        ),
        (
            NeverRenewed,
            (
                Beacon(0, (creating(0, 1, timeout=1200),)), Wait(11), Beacon(0, (Records("update", 0, 1, 2),)),
                Wait(11),
            ),
            "VD-PU-07",
        ),
        (Quiet, (Beacon(0, (creating(0, 1, timeout=1200),)), Wait(40)), "VD-SCR-04"),
        (
            StillAsking,
            (
                Beacon(0, (creating(0, 1),)), Wait(3), Beacon(0, (Records("summary", 0, 1, 9),)),
                Beacon(0, (Records("delete", 0),)), Wait(3),
            ),
            "VD-PS-02",
        ),
        (EmptyFirst, (registering(1), calling("BP-TransmitPayload", protId=5, payload=0)), "BP-TXP-01"),
        (OldOrder, (_CREATED, Wait(2), calling("RTDB-Update", varId=0, value=2), Wait(3)), "VD-PAY-01"),
        (TellsOnce, (Beacon(0, (creating(0, 1, repetitions=3, timeout=1200),)), Wait(40)), "VD-SCR-04"),
        (
            FaultySenderIgnored,
            (
                Beacon(0, (creating(0, 1),)), Wait(2), *(Beacon(0, (Damaged(),)),) * 9,
                Beacon(0, (Records("update", 0, 1, 2),)), Wait(4),
            ),
            "VD-ROB-01",
        ),
    ],
)  # fmt: skip
def test_a_fault_is_named(fault: type, steps: tuple[Step, ...], requirement: str) -> None:
    assert judged(*steps) == ()
    assert requirement in judged(*steps, make=maker(node_with(fault)))


@pytest.mark.req("BP-PTI-02")
def test_an_announced_slot_without_a_payload_has_no_beacon() -> None:
    pauses = (submitting(1), Wait(4)) * 8
    assert judged(registering(3), *pauses, Wait(8), submitting(1), Wait(16)) == ()


@pytest.mark.req("BP-RX-12", "BP-RX-09")
@pytest.mark.parametrize("reading", [{}, {"X02": "frame-size"}, {"X48": "discard-beacon"}], ids=str)
@pytest.mark.parametrize("trait", ENDS, ids=str)
def test_each_reading_of_the_end_of_a_beacon_is_allowed(trait: Trait, reading: dict[str, str]) -> None:
    config = msgspec.structs.replace(CONFIG, readings=reading)
    steps = (registering(2, 100), ending(trait), Wait(2), Beacon(0, (Client(0, 5),)))
    for readings in (None, {}):
        Driver(VirtualExecutor(config, readings=readings)).run(steps)


def test_a_search_draws_independent_sequences() -> None:
    class Noting(NodeMachine):
        titles: ClassVar[list[str]] = []

        def teardown(self) -> None:
            super().teardown()
            self.titles.append(self.title)

    search(lambda: VirtualExecutor(CONFIG), sequences=27, steps=1, seed=3, machine=Noting)
    assert len(set(Noting.titles)) > 10
