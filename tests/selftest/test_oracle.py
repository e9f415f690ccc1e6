"""The model of VarDis: it agrees with our node for any input, and detects forbidden behaviour."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.oracle import Complaint, Limits, Obligation, Oracle
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_spec.constants import ICType, features

from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    Payload,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

from ..conformance.air import KINDS, MS
from ..conformance.rig import codec_of

PROFILES = ("dcp-2.0", "dcp-1.3", "dcp-1.2", "dcp-1.1", "dcp-1.0")
PERIOD = 100 * MS
LATENCY = round(1.6 * PERIOD)
WINDOW = 6 * PERIOD
OWN = b"\2\0\0\0\0\1"
IDS = range(6)
STRANGE = range(90, 93)
"""Variables that are never created."""


class Duel:
    """Our node and the model of it, told the same."""

    def __init__(self, profile: str, seed: int, make: MakeNode = plain_node) -> None:
        self.codec = codec_of(profile)
        self.features = features(self.codec.profile.spec_version)
        self.rng = random.Random(f"duel/{seed}")
        self.sut = InProcess(reference_config(self.codec), seed=seed, make=make)
        self.air, self.upper = self.sut.lower_tester(), self.sut.upper_tester()
        limits = self.codec.profile.limits
        self.limits = Limits(limits.max_value_length, limits.max_description_length, limits.max_repetitions)
        self.oracle = Oracle(
            OWN, self.features, self.codec.profile.types.var_seqno.width, self.limits, latency=LATENCY, window=WINDOW
        )
        self.complaints: list[Complaint] = []
        self.late: list[Obligation] = []
        self.seqno = [0, 0, 0]
        self.frame = 0

    # -- input ---------------------------------------------------------------------------------------------------

    def peer(self, number: int) -> bytes:
        return b"\2\0\0\0\1" + bytes([number])

    def hears(self, number: int, *records: VardisRecord) -> None:
        """A peer says something, one container for each record."""
        types = self.codec.profile.vardis.container_types.by_name()
        containers = tuple(Container(types[KINDS[type(each)]], (each,)) for each in records)
        if not self.features.several_containers_per_type:
            # 1.0 allows one container of each kind.
            kinds = dict.fromkeys(type(each) for each in records)
            containers = tuple(
                Container(types[KINDS[kind]], tuple(each for each in records if type(each) is kind)) for kind in kinds
            )
        network = 0x1111 if self.codec.profile.has_header_field("networkId") else None
        self.seqno[number] += 1
        beacon = Beacon(BPHeader(self.peer(number), self.seqno[number], network_id=network), (Payload(2, containers),))
        self.frame += 1
        self.air.send(self.codec.encode(beacon), self.peer(number))
        self.oracle.hear(records, self.sut.now, self.frame)

    def asked(self, method: str, **params: Any) -> None:
        """An application asks for something."""
        if not self.upper.call(method, params).ok:
            return
        now, var_id = self.sut.now, params["varId"]
        if method == "RTDB-Create":
            stamp = self.sut.wall() if self.features.creation_time else None
            spec = VarSpec(var_id, OWN, params["repCnt"], params["descr"].encode(), stamp, 0)
            self.oracle.created(spec, bytes.fromhex(params["value"]), now)
        elif method == "RTDB-Update":
            self.oracle.updated(var_id, bytes.fromhex(params["value"]), now)
        else:
            self.oracle.deleted(var_id, now)

    def wait(self, periods: float) -> None:
        """Time passes; what it says is judged."""
        until = self.sut.now + round(periods * PERIOD)
        while (arrival := self.air.receive(until)) is not None:
            self.frame += 1
            heard = ReceivedBeacon(self.codec, self.frame, arrival.time, arrival.wall, arrival.octets, arrival.source)
            said = [(each.kind, each.record) for each in heard.instructions()]
            self.complaints += self.oracle.transmitted(said, self.sut.now, self.frame)
        self.late += self.oracle.overdue(self.sut.now - PERIOD)

    # -- at random -------------------------------------------------------------------------------------------------

    def record(self) -> VardisRecord:
        rng, var_id = self.rng, self.rng.choice(IDS)
        number = rng.choice([0, 1, 2, 3, 4, 5, 6, 126, 127, 129, 200, 255])
        value = rng.randbytes(rng.choice([1, 2, 8, 32, *([0, 33] if rng.random() < 0.2 else [])]))
        kind = rng.choices([VarCreate, VarUpdate, VarSumm, VarReqUpdate, VarReqCreate, VarDelete], [4, 6, 5, 3, 3, 1])[
            0
        ]
        if kind is VarCreate:
            producer = self.peer(rng.randrange(3)) if rng.random() < 0.9 else OWN
            repetitions = rng.choice([1, 2, 3, *([0, 15, 16] if rng.random() < 0.2 else [])])
            described = bytes(rng.choices(b"abc", k=rng.choice([1, 3, *([0, 32, 33] if rng.random() < 0.2 else [])])))
            has_time = self.features.creation_time
            created = self.sut.wall() + rng.randrange(-5, 5) * 1000 * MS if has_time else None
            spec = VarSpec(var_id, producer, repetitions, described, created, 0 if has_time else None)
            return VarCreate(spec, VarUpdate(var_id, number, value))
        if kind is VarUpdate:
            return VarUpdate(var_id, number, value)
        return kind(var_id, number) if kind in (VarSumm, VarReqUpdate) else kind(var_id)

    def step(self) -> None:
        rng, choice = self.rng, self.rng.random()
        if choice < 0.55:
            records = [self.record() for _ in range(rng.choice([1, 1, 2, 4]))]
            # Within a container no identifier twice (VD-PAY-03).
            unique = {(type(each), each.spec.var_id if isinstance(each, VarCreate) else each.var_id): each
                      for each in records}  # fmt: skip
            self.hears(rng.randrange(3), *unique.values())
        elif choice < 0.75:
            var_id = rng.choice(IDS)
            value = rng.randbytes(rng.randrange(1, 9)).hex()
            method = rng.choices(["RTDB-Create", "RTDB-Update", "RTDB-Delete"], [3, 6, 1])[0]
            params: dict[str, Any] = {"varId": var_id}
            if method == "RTDB-Create":
                params |= {"repCnt": rng.randrange(1, 4), "descr": "mine", "value": value}
            elif method == "RTDB-Update":
                params["value"] = value
            self.asked(method, **params)
        else:
            self.wait(rng.choice([0.1, 0.3, 1, 1, 2, 5]))

    def holdings(self) -> dict[int, tuple[str, int, str]]:
        """Variables that the node reports to hold."""
        listed = self.upper.call("RTDB-DescribeDatabase", {}).result["variables"]
        found = {}
        for each in listed:
            about = self.upper.call("RTDB-DescribeVariable", {"varId": each["varId"]}).result["variable"]
            state = "deleted" if about.get("isDeleted") else "alive"
            found[each["varId"]] = (state, about["seqno"], about["value"])
        return found


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("seed", range(12))
def test_the_model_agrees_with_our_node_for_any_input(profile: str, seed: int):
    duel = Duel(profile, seed)
    for _ in range(150):
        duel.step()
        assert duel.complaints == []
        assert duel.late == []
    duel.wait(WINDOW / PERIOD + 12)
    assert duel.complaints == []
    assert duel.late == []
    held = duel.holdings()
    modelled = {
        var_id: (version.state, version.seqno, version.value.hex()) for var_id, version in duel.oracle.holdings()
    }
    certain = [
        var_id for var_id in IDS if var_id in duel.oracle.variables and not duel.oracle.variables[var_id].uncertain
    ]
    for var_id in certain:
        ours, theirs = modelled.get(var_id), held.get(var_id)
        assert ours == theirs or (ours is not None and theirs is not None and ours[0] == theirs[0] == "deleted"), var_id
    # A model that is never certain would agree with any node.
    assert certain or not duel.features.creation_time


# -- what no node may do ----------------------------------------------------------------------------------------------


class Model:
    """The model of a node, told and heard by hand. ``at`` counts beacon periods."""

    def __init__(self, profile: str = "dcp-2.0") -> None:
        codec = codec_of(profile)
        self.oracle = Oracle(
            OWN, features(codec.profile.spec_version), 1, Limits(32, 32, 15), latency=LATENCY, window=WINDOW
        )
        self.has_time = features(codec.profile.spec_version).creation_time

    def create(
        self, var_id: int = 7, *, seqno: int = 5, value: bytes = b"five", by: bytes = b"\2peer1", age: int = 10,
        rep_cnt: int = 2, descr: bytes = b"d",
    ) -> VarCreate:  # fmt: skip
        created = 1000 - age if self.has_time else None
        return VarCreate(
            VarSpec(var_id, by, rep_cnt, descr, created, 0 if self.has_time else None), VarUpdate(var_id, seqno, value)
        )

    def hear(self, at: float, *records: VardisRecord) -> None:
        self.oracle.hear(records, round(at * PERIOD), 1)

    def say(self, at: float, *records: VardisRecord) -> list[str]:
        """Requirements that the node breaks by saying this."""
        kinds = {
            VarCreate: ICType.CREATE_VARIABLES,
            VarUpdate: ICType.UPDATES,
            VarSumm: ICType.SUMMARIES,
            VarDelete: ICType.DELETE_VARIABLES,
            VarReqCreate: ICType.REQUEST_VARCREATES,
            VarReqUpdate: ICType.REQUEST_VARUPDATES,
        }
        said = [(kinds[type(each)], each) for each in records]
        return [each.requirement for each in self.oracle.transmitted(said, round(at * PERIOD), 2)]

    def late(self, at: float) -> list[str]:
        """Requirements that the node has broken by not saying anything until now."""
        return [each.requirement for each in self.oracle.overdue(round(at * PERIOD))]

    def settled(self) -> VarCreate:
        """Let the node store variable 7 and forward it, until nothing is pending."""
        create = self.create()
        self.hear(0, create)
        assert self.say(1, create) == self.say(2, create) == []
        assert self.say(3, VarSumm(7, 5)) == []
        return create


def creates_nothing(model: Model) -> list[str]:
    model.hear(0, model.create())
    return model.late(10)


def repeats_a_create_too_often(model: Model) -> list[str]:
    return model.say(4, model.settled())


def changes_the_description(model: Model) -> list[str]:
    model.hear(0, model.create())
    return model.say(1, model.create(descr=b"other"))


def changes_the_producer(model: Model) -> list[str]:
    model.hear(0, model.create())
    return model.say(1, model.create(by=OWN))


def changes_the_value(model: Model) -> list[str]:
    model.hear(0, model.create())
    return model.say(1, model.create(value=b"six"))


def sends_an_older_number(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarUpdate(7, 6, b"six"))
    assert model.say(5, VarUpdate(7, 6, b"six")) == []
    return model.say(8, VarSumm(7, 5))


def ignores_an_update(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarUpdate(7, 6, b"six"))
    return model.late(12)


def repeats_an_update_too_often(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarUpdate(7, 6, b"six"))
    for at in (7, 8):
        assert model.say(at, VarUpdate(7, 6, b"six")) == []
    return model.say(9, VarUpdate(7, 6, b"six"))


def takes_an_older_update(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarUpdate(7, 4, b"four"))
    return model.say(5, VarUpdate(7, 4, b"four"))


def does_not_teach(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarSumm(7, 4))
    return model.late(12)


def does_not_ask_for_an_update(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarSumm(7, 9))
    return model.late(12)


def asks_with_a_wrong_number(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarSumm(7, 9))
    return model.say(5, VarReqUpdate(7, 9))


def asks_twice(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarSumm(7, 9))
    assert model.say(6, VarReqUpdate(7, 5)) == []
    return model.say(7, VarReqUpdate(7, 5))


def asks_for_what_it_has(model: Model) -> list[str]:
    model.settled()
    return model.say(5, VarReqCreate(7))


def does_not_ask_for_an_unknown_variable(model: Model) -> list[str]:
    model.hear(0, VarSumm(9, 0))
    return model.late(10)


def invents_a_variable(model: Model) -> list[str]:
    return model.say(1, VarSumm(9, 0))


def does_not_answer_a_request_for_an_update(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarReqUpdate(7, 3))
    return model.late(12)


def answers_a_request_with_an_equal_number(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarReqUpdate(7, 5))
    return model.say(5, VarUpdate(7, 5, b"five"))


def does_not_answer_a_request_for_a_create(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarReqCreate(7))
    return model.late(12)


def does_not_pass_a_deletion_on(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarDelete(7))
    return model.late(12)


def announces_a_deleted_variable(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarDelete(7))
    assert model.say(5, VarDelete(7)) == []
    return model.say(8, VarSumm(7, 5))


def announces_a_deletion_that_never_happened(model: Model) -> list[str]:
    model.settled()
    return model.say(5, VarDelete(7))


def takes_an_empty_value(model: Model) -> list[str]:
    model.settled()
    model.hear(4, VarUpdate(7, 6, b""))
    return model.say(5, VarUpdate(7, 6, b""))


def takes_its_own_variable_back(model: Model) -> list[str]:
    model.hear(0, model.create(by=OWN))
    return model.say(1, VarSumm(7, 5))


def forgets_what_its_application_wrote(model: Model) -> list[str]:
    model.oracle.created(model.create(by=OWN, seqno=0).spec, b"zero", 0)
    assert model.say(1, model.create(by=OWN, seqno=0, value=b"zero")) == []
    model.oracle.updated(7, b"one", 2 * PERIOD)
    return model.late(10)


def does_not_announce_what_its_application_created(model: Model) -> list[str]:
    model.oracle.created(model.create(by=OWN, seqno=0).spec, b"zero", 0)
    return model.late(10)


def keeps_an_older_creation(model: Model) -> list[str]:
    old = model.settled()
    model.hear(4, model.create(seqno=0, value=b"new", age=1))
    return model.say(8, old)


WRONG: dict[Callable[[Model], list[str]], str] = {
    creates_nothing: "VD-PC-09",
    repeats_a_create_too_often: "VD-SCP-02",
    changes_the_description: "VD-PC-10",
    changes_the_producer: "VD-PC-10",
    changes_the_value: "VD-PU-07",
    sends_an_older_number: "VD-CMP-04",
    ignores_an_update: "VD-PU-07",
    repeats_an_update_too_often: "VD-SCP-02",
    takes_an_older_update: "VD-UPD-10",
    does_not_teach: "VD-PS-03",
    does_not_ask_for_an_update: "VD-PS-04",
    asks_with_a_wrong_number: "VD-PS-04",
    asks_twice: "VD-SCP-01",
    asks_for_what_it_has: "VD-PS-02",
    does_not_ask_for_an_unknown_variable: "VD-PS-01",
    invents_a_variable: "VD-CMP-05",
    does_not_answer_a_request_for_an_update: "VD-RU-04",
    answers_a_request_with_an_equal_number: "VD-SCP-02",
    does_not_answer_a_request_for_a_create: "VD-RC-03",
    does_not_pass_a_deletion_on: "VD-PD-04",
    announces_a_deleted_variable: "VD-CMP-05",
    announces_a_deletion_that_never_happened: "VD-PD-04",
    takes_an_empty_value: "VD-UPD-10",
    takes_its_own_variable_back: "VD-CMP-05",
    forgets_what_its_application_wrote: "VD-UPD-08",
    does_not_announce_what_its_application_created: "VD-CRE-12",
    keeps_an_older_creation: "VD-PC-10",
}


@pytest.mark.parametrize("behave", WRONG, ids=lambda behave: behave.__name__)
def test_wrong_behaviour_is_noticed(behave: Callable[[Model], list[str]]):
    assert behave(Model()) == [WRONG[behave]]


class TestWhatIsLeftOpen:
    def test_a_sequence_number_half_the_range_away_is_undefined(self):
        model = Model()
        model.settled()
        model.hear(4, VarUpdate(7, 5 + 128, b"far"))
        assert model.say(5, VarUpdate(7, 133, b"far")) == []
        assert model.late(20) == []
        assert list(model.oracle.holdings()) == []

    def test_a_record_composed_before_the_update_is_accepted(self):
        model = Model()
        model.settled()
        model.hear(4, VarUpdate(7, 6, b"six"))
        assert model.say(5, VarSumm(7, 5)) == []
        assert model.say(5.7, VarSumm(7, 5)) == ["VD-CMP-04"]

    def test_a_doubtful_payload_makes_its_variables_uncertain_and_no_others(self):
        model = Model()
        model.settled()
        model.hear(0, model.create(8, rep_cnt=1))
        model.oracle.doubt(7)
        assert model.say(4, VarSumm(7, 99)) == []
        assert model.say(5, VarSumm(8, 99)) == ["VD-CMP-04"]

    @pytest.mark.parametrize(("profile", "asked"), [("dcp-1.0", []), ("dcp-1.3", ["VD-RC-01"])])
    def test_requests_of_others_are_a_reason_to_ask_since_1_1(self, profile: str, asked: list[str]):
        model = Model(profile)
        model.hear(0, VarReqCreate(9))
        assert model.late(10) == asked

    def test_before_2_0_a_variable_is_gone_once_its_deletion_was_announced(self):
        model = Model("dcp-1.3")
        model.settled()
        model.hear(4, VarDelete(7))
        assert model.say(5, VarDelete(7)) == model.say(6, VarDelete(7)) == []
        model.hear(8, VarSumm(7, 5))
        assert model.say(9, VarReqCreate(7)) == []
