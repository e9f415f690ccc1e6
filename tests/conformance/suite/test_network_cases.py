"""Cases about composing, runtime, scrubbing and networks: their verdicts on slow nodes and on faulty ones."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.pics import Capabilities, Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reference.inprocess import VirtualLowerTester
from dcp_spec.constants import ICType

from dcp_codec import Codec
from dcp_codec.values import Beacon, Container, Payload, VarCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, SendBeacon
from dcp_stack.node import Node

from ..rig import codec_of, ids_of, in_session, one_case

MODULES = (
    "vardis.reception.payload",
    "vardis.composition.composing",
    "vardis.composition.summaries",
    "vardis.lifecycle.runtime",
    "vardis.lifecycle.scrubbing",
    "vardis.lifecycle.timeouts",
    "network.joining",
    "network.forwarding",
    "network.conflicts",
    "network.crowd",
    "network.partition",
    "network.hazards",
)
CASES = ids_of(*MODULES)
GOOD = (Verdict.PASS, Verdict.NOT_APPLICABLE)
MS = 1_000_000


@pytest.mark.parametrize(
    ("claim", "profile", "verdict"),
    [
        (True, "dcp-2.0", Verdict.PASS),
        (False, "dcp-2.0", Verdict.FAIL),
        (None, "dcp-2.0", Verdict.INFO),
        (True, "dcp-1.0", Verdict.PASS),
    ],
)
def test_a_claim_about_several_containers_is_checked(claim, profile, verdict):
    pics = Pics(pics=Capabilities(several_containers=claim))
    assert one_case("TC_VD_PAY_BV_08", profile, pics=pics).verdict is verdict


# -- nodes that differ -------------------------------------------------------------------------------------------------


class Around:
    """A node whose received and sent frames can be changed; everything else is unchanged."""

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        self.inner = Node(config, rng=rng, now=now, wall=wall)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


class Slow(Around):
    """Processes what it receives 70 ms later, and so composes most payloads a period before they matter."""

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        super().__init__(config, rng, now, wall)
        self.waiting: list[tuple[int, bytes]] = []

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        self.waiting.append((now + 70 * MS, octets))

    def handle_timeout(self, now: int, wall: int) -> None:
        while self.waiting and self.waiting[0][0] <= now:
            self.inner.handle_frame(self.waiting.pop(0)[1], now=now, wall=wall)
        self.inner.handle_timeout(now, wall)

    def poll_timeout(self) -> int | None:
        own = [self.waiting[0][0]] if self.waiting else []
        inner = self.inner.poll_timeout()
        return min([*own, *([] if inner is None else [inner])], default=None)


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-1.1", "dcp-2.0"])
def test_slow_nodes_pass_too(profile):
    cases = [each for each in CASES if not each.startswith("TC_VD_RUN_TI")]
    wrong = [each for each in in_session(cases, profile, Slow, upper=False) if each.verdict not in GOOD]
    assert [f"{each.id}: {each.reason}" for each in wrong if "needs a way to be reset" not in each.reason] == []


Rewrite = Callable[[Codec, tuple[Container, ...]], tuple[Container, ...]]


def saying(rewrite: Rewrite) -> Callable[..., Around]:
    """Nodes that say something else than they mean: every VarDis payload goes through ``rewrite``."""

    class Saying(Around):
        def take_effects(self) -> list[Effect]:
            return [self.changed(each) for each in self.inner.take_effects()]

        def changed(self, effect: Effect) -> Effect:
            if not isinstance(effect, SendBeacon):
                return effect
            codec = codec_of(self.inner.config.profile.name)
            beacon = codec.decode(effect.octets)
            payloads = []
            for each in beacon.payloads:
                containers = each.vardis
                if containers is not None:
                    octets = codec.encode_containers(rewrite(codec, containers))
                    each = Payload(each.protocol_id, octets)
                payloads.append(each)
            octets = codec.encode_envelope(Beacon(beacon.bp, tuple(payloads)))
            return SendBeacon(octets, effect.seqno, effect.num_payloads)

    return Saying


def of(codec: Codec, kind: ICType) -> int:
    return codec.profile.vardis.container_types.by_name()[kind.label]


def records_changed(kind: ICType, change: Callable[[Any], Any]) -> Rewrite:
    def rewrite(codec: Codec, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        return tuple(
            Container(each.ic_type, tuple(change(one) for one in each.records))
            if each.ic_type == of(codec, kind)
            else each
            for each in containers
        )

    return rewrite


def without(*kinds: ICType) -> Rewrite:
    return lambda codec, containers: tuple(
        each for each in containers if each.ic_type not in {of(codec, kind) for kind in kinds}
    )


def reversed_order(codec: Codec, containers: tuple[Container, ...]) -> tuple[Container, ...]:
    return containers[::-1]


def first_record_twice(codec: Codec, containers: tuple[Container, ...]) -> tuple[Container, ...]:
    return tuple(Container(each.ic_type, (*each.records, each.records[0])) for each in containers)


def numbered_from_zero(record: VarCreate) -> VarCreate:
    return VarCreate(record.spec, VarUpdate(record.upd.var_id, 0, record.upd.value))


def other_number(record: VarSumm | VarReqUpdate) -> VarSumm | VarReqUpdate:
    return type(record)(record.var_id, (record.seqno + 1) % 256)


def other_producer(record: VarCreate) -> VarCreate:
    return VarCreate(msgspec.structs.replace(record.spec, prod_id=b"\x02" * 6), record.upd)


def one_summary(codec: Codec, containers: tuple[Container, ...]) -> tuple[Container, ...]:
    """Always the variable with the lowest number."""
    number = of(codec, ICType.SUMMARIES)
    return tuple(
        Container(number, (min(each.records, key=lambda record: record.var_id),)) if each.ic_type == number else each
        for each in containers
    )


class EveryOther(Around):
    """Removes the VarDis payload from every second beacon, although it was composed."""

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        super().__init__(config, rng, now, wall)
        self.count = 0

    def take_effects(self) -> list[Effect]:
        effects: list[Effect] = []
        for each in self.inner.take_effects():
            if isinstance(each, SendBeacon):
                self.count += 1
                if self.count % 2:
                    codec = codec_of(self.inner.config.profile.name)
                    other = Beacon(codec.decode(each.octets).bp, (Payload(0x7000, b"something else"),))
                    each = SendBeacon(codec.encode_envelope(other), each.seqno, 1)
            effects.append(each)
        return effects


class Echoing(Around):
    """Repeats everything that it receives, with its own identifier as the sender."""

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        super().__init__(config, rng, now, wall)
        self.received: list[Container] = []

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        codec = codec_of(self.inner.config.profile.name)
        for each in codec.decode(octets).payloads:
            self.received += each.vardis or ()
        self.inner.handle_frame(octets, now=now, wall=wall)

    def take_effects(self) -> list[Effect]:
        effects: list[Effect] = []
        for each in self.inner.take_effects():
            if isinstance(each, SendBeacon) and self.received:
                codec = codec_of(self.inner.config.profile.name)
                beacon = codec.decode(each.octets)
                said = tuple(one for payload in beacon.payloads for one in payload.vardis or ())
                octets = codec.encode_containers((*said, *self.received))
                self.received = []
                each = SendBeacon(codec.encode_envelope(Beacon(beacon.bp, (Payload(2, octets),))), each.seqno, 1)
            effects.append(each)
        return effects


class Stubborn(Around):
    """Takes no updates."""

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        codec = codec_of(self.inner.config.profile.name)
        beacon = codec.decode(octets)
        updates = codec.profile.vardis.container_types.updates
        kept = []
        for payload in beacon.payloads:
            containers = tuple(each for each in payload.vardis or () if each.ic_type != updates)
            if containers:
                kept.append(Payload(payload.protocol_id, codec.encode_containers(containers)))
        if kept:
            self.inner.handle_frame(codec.encode_envelope(Beacon(beacon.bp, tuple(kept))), now=now, wall=wall)


@pytest.mark.parametrize(
    ("make", "case_id", "requirement"),
    [
        (saying(reversed_order), "TC_VD_PAY_BV_01", "VD-PAY-01"),
        (saying(first_record_twice), "TC_VD_PAY_BV_03", "VD-PAY-03"),
        (saying(records_changed(ICType.CREATE_VARIABLES, numbered_from_zero)), "TC_VD_CMP_BV_05", "VD-CMP-07"),
        (saying(records_changed(ICType.SUMMARIES, other_number)), "TC_VD_SUM_BV_06", "VD-CMP-04"),
        (saying(records_changed(ICType.REQUEST_VARUPDATES, other_number)), "TC_VD_CMP_BV_07", "VD-CMP-11"),
        (saying(records_changed(ICType.CREATE_VARIABLES, other_producer)), "TC_NET_HOP_BV_01-2", "VD-PC-10"),
        (saying(one_summary), "TC_VD_SUM_BV_01", "VD-CMP-03"),
        (saying(without(ICType.DELETE_VARIABLES)), "TC_VD_SCR_TI_02", "VD-SCR-01"),
        (saying(without(ICType.REQUEST_VARCREATES)), "TC_NET_JOIN_BV_01-summary", "VD-PS-01"),
        (saying(without(ICType.UPDATES)), "TC_NET_CROWD_BV_02", "VD-PU-07"),
        (EveryOther, "TC_VD_RUN_BV_01", "VD-RUN-01"),
        (EveryOther, "TC_VD_CMP_BV_01", "VD-CMP-06"),
        (Echoing, "TC_NET_HOP_BI_01-request-for-update", "VD-SCP-01"),
        (Echoing, "TC_NET_HOP_BV_02", "VD-SCP-03"),
        (Stubborn, "TC_NET_PART_BV_04", "VD-PU-07"),
    ],
)
def test_wrong_nodes_fail(make, case_id, requirement):
    result = one_case(case_id, "dcp-2.0", make)
    assert result.verdict is Verdict.FAIL, f"{result.verdict}: {result.reason}"
    failed = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    assert requirement in failed


def test_a_lost_create_is_sent_again_before_the_updates_of_thirty_neighbours(monkeypatch) -> None:
    """A node that does not know the variable does not forward its updates."""
    codec, send, lost = codec_of("dcp-2.0"), VirtualLowerTester.send, []

    def lossy(self: VirtualLowerTester, octets: bytes, source: bytes) -> bytes:
        created = [each for each in codec.decode(octets).payloads if each.vardis]
        records = created[0].vardis[0].records if created else ()
        if records and not lost and isinstance(records[0], VarCreate) and records[0].upd.value == b"v":
            lost.append(octets)
            return self.framed(octets, source)
        return send(self, octets, source)

    monkeypatch.setattr(VirtualLowerTester, "send", lossy)
    result = one_case("TC_NET_CROWD_BV_02")
    assert lost
    assert result.verdict is Verdict.PASS, result.reason
