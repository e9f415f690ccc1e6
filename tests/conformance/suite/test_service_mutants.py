"""Nodes that are wrong in one thing: the cases about SRP and services must notice, and name the requirement."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType
from dcp_spec.status import VardisStatus

from dcp_codec import Codec
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, Payload, VarReqCreate
from dcp_stack.config import NodeConfig
from dcp_stack.effects import Effect, SendBeacon
from dcp_stack.node import Node
from dcp_stack.vardis.services import Confirm, ReadConfirm

from ..rig import one_case


class Proxy:
    """Something in place of a part of a node; what it does not have is the part's."""

    def __init__(self, part: Any) -> None:
        self.part = part

    def __getattr__(self, name: str) -> Any:
        return getattr(self.part, name)


class Wrong:
    """A node with proxies for SRP and VarDis whose received and sent frames can be changed."""

    srp_proxy: type[Proxy] = Proxy
    vardis_proxy: type[Proxy] = Proxy

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        self.inner = Node(config, rng=rng, now=now, wall=wall)
        self.codec: Codec = config.codec
        self.wall = wall

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    @property
    def srp(self) -> Proxy:
        return self.srp_proxy(self.inner.srp)

    @property
    def vardis(self) -> Proxy:
        return self.vardis_proxy(self.inner.vardis)

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        envelope, _ = self.codec.decode_envelope(octets)
        blocks = tuple(self.hears(each) for each in envelope.payloads)
        octets = self.codec.encode_envelope(Beacon(envelope.bp, blocks))
        self.inner.handle_frame(octets, now=now, wall=wall)

    def handle_timeout(self, now: int, wall: int) -> None:
        self.wall = wall
        self.inner.handle_timeout(now, wall)

    def take_effects(self) -> list[Effect]:
        return [self.rewritten(each) for each in self.inner.take_effects()]

    def rewritten(self, effect: Effect) -> Effect:
        if not isinstance(effect, SendBeacon):
            return effect
        beacon = self.codec.decode(effect.octets)
        blocks: list[Payload] = []
        for each in self.says(beacon):
            content = each.content
            if isinstance(content, ExtendedSafetyData):
                content = self.codec.encode_report(content)
            elif not isinstance(content, bytes):
                content = self.codec.encode_containers(content)
            blocks.append(Payload(each.protocol_id, content))
        if not blocks:
            # A beacon without payloads cannot be sent, and one that is not sent looks like a loss of the tester.
            kind = self.codec.profile.vardis.container_types.by_name()["REQUEST-VARCREATES"]
            harmless = self.codec.encode_containers((Container(kind, (VarReqCreate(0),)),))
            blocks.append(Payload(BP_PROTID_VARDIS, harmless))
        octets = self.codec.encode_envelope(Beacon(beacon.bp, tuple(blocks)))
        return SendBeacon(octets, effect.seqno, len(blocks))

    def hears(self, block: Payload) -> Payload:
        return block

    def says(self, beacon: Beacon) -> Iterator[Payload]:
        for each in beacon.payloads:
            if each.srp is not None:
                yield Payload(each.protocol_id, self.reports(each.srp))
            elif each.vardis is not None:
                containers = tuple(c for c in map(self.contains, each.vardis) if c.records)
                if containers:
                    yield Payload(each.protocol_id, containers)
            else:
                yield each

    def reports(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        return report

    def contains(self, container: Container) -> Container:
        return container

    def is_of(self, kind: ICType, container: Container) -> bool:
        return container.ic_type == self.codec.profile.vardis.container_types.by_name()[kind.label]


# -- SRP ---------------------------------------------------------------------------------------------------------------


class OtherIdentifier(Wrong):
    def reports(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        return msgspec.structs.replace(report, node_id=b"\x02" * 6)


class TimeOfTransmission(Wrong):
    def reports(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        return msgspec.structs.replace(report, t_stamp=self.wall)


class SameNumber(Wrong):
    def reports(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        return msgspec.structs.replace(report, seqno=7)


class EveryOther(Wrong):
    def reports(self, report: ExtendedSafetyData) -> ExtendedSafetyData:
        return msgspec.structs.replace(report, seqno=2 * report.seqno)


class Repeats(Wrong):
    last: Payload | None = None

    def says(self, beacon: Beacon) -> Iterator[Payload]:
        own = [each for each in beacon.payloads if each.srp is not None]
        self.last = own[0] if own else self.last
        yield from super().says(beacon)
        if not own and self.last is not None:
            yield self.last


class Forwards(Wrong):
    heard: Payload | None = None

    def hears(self, block: Payload) -> Payload:
        if block.protocol_id == BP_PROTID_SRP:
            self.heard = block
        return block

    def says(self, beacon: Beacon) -> Iterator[Payload]:
        yield from super().says(beacon)
        if self.heard is not None:
            yield self.heard


class AnyLength(Wrong):
    def hears(self, block: Payload) -> Payload:
        if block.protocol_id != BP_PROTID_SRP:
            return block
        size = len(self.codec.encode_report(self.codec.decode_report(bytes(self.inner.srp.record_size))))
        return Payload(block.protocol_id, (block.data or b"")[:size].ljust(size, b"\1"))


class AnyProtocol(Wrong):
    def hears(self, block: Payload) -> Payload:
        return Payload(int(BP_PROTID_SRP), block.content) if block.protocol_id == 3 else block


class ShortLived(Wrong):
    class srp_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def parameters(self) -> dict[str, float]:
            return {"SRPPAR_NEIGHBOUR_TABLE_TIMEOUT": 5000}


class LongLived(Wrong):
    class srp_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def parameters(self) -> dict[str, float]:
            return {"SRPPAR_NEIGHBOUR_TABLE_TIMEOUT": 1000}


class NeverReset(Wrong):
    def reset(self, now: int, wall: int) -> None:
        pass


# -- VarDis ------------------------------------------------------------------------------------------------------------


class OneMore(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def create(self, var_id: int, producer: Any, rep_cnt: int, *rest: Any, **times: int) -> Confirm:
            more = rep_cnt + 1 if 0 < rep_cnt < 15 else rep_cnt
            return self.part.create(var_id, producer, more, *rest, **times)


class CountFirst(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def create(self, var_id: int, producer: Any, rep_cnt: int, *rest: Any, **times: int) -> Confirm:
            if not 0 < rep_cnt <= 15:
                return Confirm(VardisStatus.ILLEGAL_REPCOUNT)
            return self.part.create(var_id, producer, rep_cnt, *rest, **times)


class Unlimited(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def create(self, var_id: int, producer: Any, rep: int, descr: bytes, value: bytes, *rest: Any, **t: int) -> Any:
            return self.part.create(var_id, producer, min(rep, 15), descr[:32], value[:32], *rest, **t)

        def update(self, var_id: int, value: bytes, **times: int) -> Confirm:
            return self.part.update(var_id, value[:32], **times)


class NumberStays(Wrong):
    def contains(self, container: Container) -> Container:
        if not self.is_of(ICType.UPDATES, container):
            return container
        records = tuple(msgspec.structs.replace(each, seqno=1) for each in container.records)
        return Container(container.ic_type, records)


class Halves(Wrong):
    """Leaves out every other container of a kind."""

    kind = ICType.DELETE_VARIABLES
    odd = False

    def contains(self, container: Container) -> Container:
        if self.is_of(self.kind, container):
            self.odd = not self.odd
            if self.odd:
                return Container(container.ic_type, ())
        return container


class HalvesUpdates(Halves):
    kind = ICType.UPDATES


class Doubles(Wrong):
    def contains(self, container: Container) -> Container:
        if self.is_of(ICType.UPDATES, container):
            return Container(container.ic_type, container.records * 2)
        return container


class FirstValue(Wrong):
    """Repeats creations with the value that they had at first."""

    first: Any = None

    def contains(self, container: Container) -> Container:
        if not self.is_of(ICType.CREATE_VARIABLES, container):
            return container
        self.first = self.first or {}
        records = [self.first.setdefault(each.spec, each) for each in container.records]
        return Container(container.ic_type, tuple(records))


class NoProducer(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def update(self, var_id: int, value: bytes, **times: int) -> Confirm:
            confirm = self.part.update(var_id, value, **times)
            return Confirm(VardisStatus.OK) if confirm.status is VardisStatus.NOT_PRODUCER else confirm

        def delete(self, var_id: int, **times: int) -> Confirm:
            confirm = self.part.delete(var_id, **times)
            return Confirm(VardisStatus.OK) if confirm.status is VardisStatus.VARIABLE_IS_DELETED else confirm


class OldValue(Wrong):
    @property
    def vardis(self) -> Proxy:
        known = self.__dict__.setdefault("known", {})

        class Reading(Proxy):
            def read(self, var_id: int) -> ReadConfirm:
                return known.setdefault(var_id, self.part.read(var_id))

        return Reading(self.inner.vardis)


class NeverInactive(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def deactivate(self) -> Confirm:
            return Confirm(VardisStatus.OK)


class HidesDeleted(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def describe_database(self) -> Any:
            confirm = self.part.describe_database()
            live = tuple(each for each in confirm.variables if not each.is_deleted)
            return msgspec.structs.replace(confirm, variables=live)


class FixedParameters(Wrong):
    class vardis_proxy(Proxy):  # noqa: N801 - takes the place of an attribute
        def set_parameter(self, name: str, value: object) -> None:
            return None


class OtherTime(Wrong):
    def contains(self, container: Container) -> Container:
        if not self.is_of(ICType.CREATE_VARIABLES, container):
            return container
        records = []
        for each in container.records:
            spec = msgspec.structs.replace(each.spec, creation_time=12345)
            records.append(msgspec.structs.replace(each, spec=spec))
        return Container(container.ic_type, tuple(records))


WRONG = [
    (OtherIdentifier, "TC_SRP_REC_BV_01", "SRP-TYP-04"),
    (TimeOfTransmission, "TC_SRP_REC_TI_01", "SRP-TYP-05"),
    (SameNumber, "TC_SRP_REC_BV_05", "SRP-TYP-06"),
    (EveryOther, "TC_SRP_REC_BV_05", "SRP-SEQ-01"),
    (Repeats, "TC_SRP_REC_BV_06", "SRP-SRV-04"),
    (Forwards, "TC_SRP_FWD_BV_01", "SRP-RX-06"),
    (AnyLength, "TC_SRP_RX_BI_01-one-short", "SRP-RX-01"),
    (AnyLength, "TC_SRP_RX_BI_01-one-long", "SRP-RX-01"),
    (AnyProtocol, "TC_SRP_RX_BI_02", "SRP-RX-01"),
    (ShortLived, "TC_SRP_NT_TI_01", "SRP-RUN-02"),
    (LongLived, "TC_SRP_NT_TI_01", "SRP-RUN-01"),
    (NeverReset, "TC_SRP_INI_BV_04", "SRP-INI-05"),
    (NeverReset, "TC_VD_INI_BV_03", "VD-INI-04"),
    (OneMore, "TC_VD_CRE_BV_03-2", "VD-CRE-12"),
    (CountFirst, "TC_VD_CRE_BI_05-descr+repcnt", "VD-CRE-13"),
    (CountFirst, "TC_VD_CRE_BI_05-empty+repcnt", "VD-CRE-13"),
    (Unlimited, "TC_VD_CRE_BI_01", "VD-CRE-04"),
    (Unlimited, "TC_VD_CRE_BI_02", "VD-CRE-05"),
    (Unlimited, "TC_VD_CRE_BI_04", "VD-CRE-07"),
    (Unlimited, "TC_VD_UPD_BI_02", "VD-UPD-05"),
    (OtherTime, "TC_VD_CRE_BV_02", "VD-CRE-09"),
    (OtherTime, "TC_VD_CRE_BO_04", "VD-CRE-09"),
    (NumberStays, "TC_VD_UPD_BV_01", "VD-UPD-07"),
    (HalvesUpdates, "TC_VD_UPD_BV_03-most", "VD-UPD-08"),
    (Doubles, "TC_VD_UPD_BV_05", "VD-UPD-09"),
    (FirstValue, "TC_VD_UPD_BV_06", "VD-UPD-10"),
    (NoProducer, "TC_VD_UPD_BO_01", "VD-UPD-03"),
    (NoProducer, "TC_VD_DEL_BO_03", "VD-DEL-04"),
    (Halves, "TC_VD_DEL_BV_01-most", "VD-DEL-05"),
    (OldValue, "TC_VD_REA_BV_01", "VD-REA-04"),
    (OldValue, "TC_VD_REA_BV_02", "VD-REA-04"),
    (NeverInactive, "TC_VD_MGT_BO_01", "VD-MGT-02"),
    (NeverInactive, "TC_VD_MGT_BO_02", "VD-MGT-03"),
    (NeverInactive, "TC_VD_MGT_BO_03", "VD-CRE-01"),
    (HidesDeleted, "TC_VD_DDB_BO_01", "VD-DDB-02"),
    (FixedParameters, "TC_VD_PAR_BI_04", "VD-PAR-04"),
    (FixedParameters, "TC_VD_PAR_BV_02", "VD-PAR-01"),
]


@pytest.mark.parametrize(
    ("make", "case_id", "requirement"), WRONG, ids=[f"{make.__name__}-{case_id}" for make, case_id, _ in WRONG]
)
def test_a_faulty_node_is_detected(make, case_id, requirement):
    result = one_case(case_id, "dcp-2.0", make)
    failed = [check for check in result.checks if check.verdict is Verdict.FAIL]
    assert any(requirement in check.requirements for check in failed), (result.verdict, result.reason)


def test_the_wrapping_alone_changes_nothing():
    for _, case_id, _ in WRONG:
        result = one_case(case_id, "dcp-2.0", Wrong)
        assert result.verdict is Verdict.PASS, f"{case_id}: {result.reason} {result.error_detail}"
