"""The model beside the node in process: how it becomes certain again after a doubt, and what it counts.

Each wrong node is found with few frames; the unchanged node shows nothing in the same frames.
"""

from __future__ import annotations

import random
from typing import Any

import pytest
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.fuzz import Frame, Wait
from dcp_conformance.fuzz.execute.stack import StackTarget
from dcp_conformance.fuzz.generate.sequences import Sequences
from dcp_conformance.fuzz.steps import Call, Step
from dcp_conformance.reference.inprocess import plain_node
from dcp_selftest.fuzz.lifetimes import Lifetimes
from dcp_selftest.fuzz.soak import Soak
from dcp_selftest.fuzz.targets import stack_target
from dcp_selftest.mutants.mutant import all_mutants, node_with

from dcp_codec import Codec
from dcp_codec.testing.mutation import Mutator, drawn_pool
from dcp_codec.values import VarCreate, VarDelete, VardisRecord, VarReqCreate, VarReqUpdate, VarSpec, VarSumm, VarUpdate
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.database import Database, DBEntry
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.wire import Extracted

from ..parts import also

CODEC = Codec("dcp-2.0")
FORGE = FrameBuilder(CODEC)
PEER = b"\x02\xdc\x90\0\0\1"
NETWORK = CODEC.profile.bp.network_id


def frame(*records: VardisRecord, cut: int = 0) -> Frame:
    """A beacon, or one whose VarDis payload lacks the last octets."""
    block = FORGE.vardis(*records)
    octets = FORGE.beacon(PEER, 1, [block._replace(octets=block.octets[: len(block.octets) - cut])], network_id=NETWORK)
    return Frame(octets)


def create(creation: int, seqno: int = 0, timeout: int = 0) -> VarCreate:
    return VarCreate(VarSpec(7, PEER, 2, b"d", creation, timeout), VarUpdate(7, seqno, b"v"))


def damaged() -> Frame:
    """Whether a node processes the update before the truncated record is open."""
    return frame(VarUpdate(7, 9, b"new"), VarUpdate(7, 10, b"cut off"), cut=3)


def target_with(part: type[Any]) -> StackTarget:
    made: type[Node] = node_with(part)

    def make(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Node:
        return made(config, rng=rng, now=now, wall=wall)

    return StackTarget(CODEC, make=make)


class Locks(Receiver):
    """Ignores variables announced in a payload with something that it did not understand."""

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        self.__dict__.setdefault("locked", False)
        super().process(extracted, now=now, wall=wall)
        self.locked = self.locked or bool(extracted.problems)

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        if not self.__dict__["locked"]:
            super()._create(record, offset, now, wall)

    def _delete(self, record: VarDelete, offset: int) -> None:
        if not self.__dict__["locked"]:
            super()._delete(record, offset)


class AddsUp(Database):
    """Answers each request for an update, also while it is answering."""

    def arm_update(self, entry: DBEntry) -> None:
        before = entry.count_update
        super().arm_update(entry)
        entry.count_update += before


class RepeatsLater(Composer):
    """Sends variables again of which it has said everything, a while later."""

    payloads = 0

    def compose(self, room: int) -> Any:
        self.payloads += 1
        if self.payloads == 14:
            for entry in self._database.entries.values():
                self._database.arm_create(entry)
        return super().compose(room)


LATER: list[Step] = [frame(create(1)), damaged(), frame(create(5, 3)), Wait(6.0)]
DELETED: list[Step] = [frame(create(1)), damaged(), frame(VarDelete(7)), Wait(6.0)]
REQUESTS: list[Step] = [frame(create(1, 5)), Wait(4.0), *(frame(VarReqUpdate(7, 4)) for _ in range(6)), Wait(16.0)]
TWICE: list[Step] = [frame(create(1)), Wait(4.0), frame(VarReqCreate(7)), frame(VarReqCreate(7)), Wait(20.0)]


@pytest.mark.parametrize(
    ("part", "steps", "kind"),
    [
        (Locks, LATER, "state"),
        (Locks, DELETED, "state"),
        (AddsUp, REQUESTS, "said"),
        (RepeatsLater, TWICE, "said"),
    ],
)
def test_wrong_nodes_are_found(part: type[Any], steps: list[Step], kind: str):
    effect = target_with(part).run(steps)
    assert effect is not None
    assert effect.kind == kind
    assert StackTarget(CODEC).run(steps) is None


ALIVE: list[Step] = [frame(create(1, 0, 900)), Wait(8.0), frame(VarUpdate(7, 1, b"n")), Wait(3.0)]
SUMMED: list[Step] = [frame(create(1, 0, 900)), *(step for _ in range(3) for step in (Wait(8.0), frame(VarSumm(7, 0))))]
LONG: list[Step] = [frame(create(1, 0, 900)), Wait(25.0)]
QUICKLY: list[Step] = [frame(create(1)), frame(create(2, 3)), Wait(8.0)]


@pytest.mark.parametrize(
    ("mutant", "steps", "kind"),
    [
        ("M-VD-SCR-06-not-refreshed", ALIVE, "said"),
        ("M-VD-SCR-06-summaries-refresh", SUMMED, "said"),
        ("M-VD-INI-06-never", LONG, "said"),
        ("M-VD-SCR-03-half", [frame(create(1, 0, 1900)), Wait(11.0)], "said"),
        ("M-VD-CMP-06-one-more", QUICKLY, "said"),
    ],
)
def test_mutants_are_found_by_newer_rules_of_the_model(mutant: str, steps: list[Step], kind: str):
    effect = stack_target(CODEC, mutant).run(steps)
    assert effect is not None
    assert effect.kind == kind
    assert StackTarget(CODEC).run(steps) is None


def drawn_lives(codec: Codec, seed: int) -> Lifetimes:
    rng = random.Random(seed)
    mutator = Mutator(codec, rng, drawn_pool(codec, rng, 40))
    return Lifetimes(Sequences(codec, rng, StackTarget(codec).own_id, mutator))


@pytest.mark.parametrize(
    ("mutant", "signature"),
    [
        ("M-VD-PS-03-not-taught", "said: missing UPDATES VD-PS-03"),
        *also(
            "suite",
            ("M-VD-PS-04-not-requested", "said: missing REQUEST-VARUPDATES VD-PS-04"),
            ("M-VD-RU-01-ignored", "said: missing REQUEST-VARCREATES VD-RU-01"),
            ("M-VD-RU-04-consumer-silent", "said: missing UPDATES VD-RU-04"),
            ("M-VD-RC-03-consumer-silent", "said: missing CREATE-VARIABLES VD-RC-03"),
            ("M-VD-CRE-02-foreign", "state: RTDB-Create succeeds"),
            ("M-VD-UPD-02-creates", "state: RTDB-Update succeeds"),
            ("M-VD-UPD-03-foreign", "state: RTDB-Update succeeds"),
            ("M-VD-DEL-02-ok", "state: RTDB-Delete succeeds"),
            ("M-VD-DEL-03-foreign", "state: RTDB-Delete succeeds"),
            ("M-VD-REA-03-deleted", "state: RTDB-Read succeeds"),
            ("M-VD-REA-04-first-value", "state: RTDB-Read"),
        ),
        ("M-VD-DEL-05-silent", "said: missing DELETE-VARIABLES VD-DEL-05"),
        ("M-VD-CRE-12-only-summarised", "said: missing CREATE-VARIABLES VD-CRE-12"),
    ],
)
def test_wrong_silence_and_wrong_service_are_found(mutant: str, signature: str):
    target, lives = stack_target(CODEC, mutant), drawn_lives(CODEC, 1)
    effects = (target.run(lives.draw()) for _ in range(2000))
    effect = next((each for each in effects if each is not None), None)
    assert effect is not None
    assert effect.signature == signature


@pytest.mark.parametrize("mutant", ["M-VD-UPD-07-wraps-early", "M-VD-UPD-07-wraps-to-one"])
def test_own_numbers_are_counted_once_around(mutant: str):
    rng = random.Random(1)
    sequences = Sequences(CODEC, rng, StackTarget(CODEC).own_id, Mutator(CODEC, rng, drawn_pool(CODEC, rng, 20)))
    steps = sequences.once_around()
    effect = stack_target(CODEC, mutant).run(steps)
    assert effect is not None
    assert effect.kind == "state"
    assert StackTarget(CODEC).run(steps) is None


@pytest.mark.parametrize("profile", ["dcp-2.0", *also("suite", "dcp-1.3", "dcp-1.1", "dcp-1.0", "cpp-2.0")])
def test_the_unchanged_node_sends_all_required_records(profile: str):
    codec = Codec(profile)
    target, lives = StackTarget(codec), drawn_lives(codec, 3)
    for _ in range(150):
        effect = target.run([*lives.draw(), Wait(9.0)])
        assert effect is None


def test_a_payload_that_found_no_room_beside_a_report_is_older_than_others():
    codec = Codec("cpp-2.0")
    builder, target = FrameBuilder(codec), StackTarget(codec)
    width = codec.profile.types.node_id.width

    def beacon(*records: VardisRecord) -> Frame:
        return Frame(
            builder.beacon(PEER[-width:], 1, [builder.vardis(*records)], network_id=codec.profile.bp.network_id)
        )

    def many(first: int) -> Frame:
        specs = (VarSpec(var_id, PEER[-width:], 9, b"d" * 20, 1, 0) for var_id in range(first, first + 15))
        return beacon(*(VarCreate(spec, VarUpdate(spec.var_id, 0, b"v" * 20)) for spec in specs))

    report = Call("SRP-UpdateSafetyData", {"sData": {"x": 1.5, "y": 1.5, "z": 1.5}})
    deletions = beacon(*map(VarDelete, range(60)))
    effect = target.run([many(0), many(15), many(30), many(45), Wait(3.1), deletions, report, Wait(4.0)])
    assert effect is None


def test_an_own_variable_may_have_been_requested_while_it_was_in_doubt():
    codec = Codec("dcp-1.0")
    builder, target = FrameBuilder(codec), StackTarget(codec)
    request = Frame(builder.beacon(PEER, 1, [builder.vardis(VarReqCreate(2))]))
    own = Call("RTDB-Create", {"varId": 2, "repCnt": 2, "descr": "own", "value": "00"})
    update = Call("RTDB-Update", {"varId": 2, "value": "01"})
    # A receiver that continues after the error may read the 2 as a record about the variable.
    doubtful = Frame(request.octets[:2] + b"\2")
    effect = target.run([own, Wait(2.5), doubtful, request, Wait(0.5), update, Wait(4.0)])
    assert effect is None


def test_a_creation_before_many_updates_is_forgotten_without_a_false_finding():
    create = {"varId": 1, "repCnt": 15, "descr": "own", "value": "00"}
    updates = [Call("RTDB-Update", {"varId": 1, "value": f"{number:02x}"}) for number in range(80)]
    before: list[Step] = [Call("RTDB-Create", create), Call("RTDB-Delete", {"varId": 1}), Wait(0.5)]
    effect = StackTarget(CODEC).run([*before, Call("RTDB-Create", create), *updates, Wait(3.0)])
    assert effect is None


def test_an_overloaded_node_may_be_late():
    rng = random.Random(1)
    target = StackTarget(CODEC)
    sequences = Sequences(CODEC, rng, target.own_id, Mutator(CODEC, rng, drawn_pool(CODEC, rng, 20)))
    effect = target.run([*sequences.all_variables(), Wait(9.0)])
    assert effect is None
    assert target.observer.busy


def test_a_variable_is_in_doubt_until_something_settles_it():
    def doubtful(*steps: Step) -> bool:
        target = StackTarget(CODEC)
        assert target.run(list(steps)) is None
        return target.observer.oracle.variables[7].uncertain

    before = (frame(create(1)), damaged())
    assert doubtful(*before)
    assert doubtful(*before, frame(VarUpdate(7, 11, b"n")))
    assert doubtful(*before, frame(VarSumm(7, 200)))
    assert not doubtful(*before, frame(VarDelete(7)))
    assert not doubtful(*before, frame(create(2)))
    # A creation that the damaged beacon was about may be the later one.
    cut = frame(create(9), VarSumm(7, 1), cut=1)
    assert doubtful(frame(create(1)), cut, frame(create(5)))
    assert not doubtful(frame(create(1)), cut, frame(create(10)))
    # A deletion proves nothing about a variable that may be unknown.
    assert doubtful(cut, frame(VarDelete(7)))


def test_a_service_that_succeeds_settles_an_own_variable():
    target = StackTarget(CODEC)
    own = Call("RTDB-Create", {"varId": 7, "repCnt": 1, "descr": "d", "value": "00"})
    assert target.run([own, damaged()]) is None
    assert target.observer.oracle.variables[7].uncertain
    assert target.run([own, damaged(), Call("RTDB-Update", {"varId": 7, "value": "01"}), Wait(4.0)]) is None
    variable = target.observer.oracle.variables[7]
    assert (variable.uncertain, variable.now.seqno, variable.now.value) == (False, 1, b"\1")


def test_between_timeout_and_scrubbing_any_record_is_permitted():
    target = StackTarget(CODEC)
    for periods, certain in ((8.0, "alive"), (9.5, None), (25.0, "deleted")):
        assert target.run([frame(create(1, 0, 900)), Wait(periods)]) is None
        version = target.observer.oracle.certain(7, round(periods * 100_000_000))
        assert (None if version is None else version.state) == certain


def test_sequences_about_timeouts_are_drawn_where_variables_have_them():
    def kinds(profile: str) -> set[str]:
        codec, rng = Codec(profile), random.Random(1)
        sequences = Sequences(codec, rng, b"\2\0\0\0\0\1", Mutator(codec, rng, drawn_pool(codec, rng, 20)))
        return {sequences.draw() and sequences.kinds[0] for _ in range(400)}

    assert "soft-state" in kinds("dcp-2.0")
    assert "soft-state" not in kinds("dcp-1.3")


def test_late_records_of_a_variable_that_timed_out_may_follow_its_new_creation():
    # Deleted at the first scrubbing, after one second; its VarDelete is composed when the new creation comes.
    steps = [frame(create(1, 0, 300)), Wait(11.0), frame(create(2, 1, 300)), Wait(25.0)]
    assert StackTarget(CODEC).run(steps) is None


@pytest.mark.part("suite")
@pytest.mark.parametrize(("mutant", "kind"), [("M-VD-PD-04-ignored", "state"), ("M-VD-ROB-01-dies-of-type", "raised")])
def test_a_soaked_node_is_compared_in_epochs(mutant: str, kind: str):
    def soaked(make: Any) -> tuple[Soak, str]:
        rng = random.Random(1)
        mutator, soak = Mutator(CODEC, rng, drawn_pool(CODEC, rng, 60)), Soak(CODEC, make=make, one_of=2)
        for _ in range(6000):
            effect = soak.hears(mutator.mutate().octets)
            if effect is not None:
                return soak, effect.kind
        return soak, ""

    assert soaked(all_mutants()[mutant].make)[1] == kind
    healthy, found = soaked(plain_node)
    assert (found, healthy.number, healthy.epochs) == ("", 6000, 60)
    assert healthy.compared > healthy.epochs
