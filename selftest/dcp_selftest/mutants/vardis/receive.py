"""Faults in extracting containers from VarDis payloads, and in the order of processing."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, pairwise
from typing import Any, ClassVar

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.errors import DecodeError
from dcp_codec.values import Container
from dcp_selftest.mutants.family import attributes, before, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.wire import Extracted, Extractor, Records

C, D, U = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
S, RC, RU = ICType.SUMMARIES, ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


# -- extraction --------------------------------------------------------------------------------------------------------


class Containers(Extractor):
    """Changes the containers extracted from a payload."""

    def _collect(self, containers: tuple[Container, ...], offset: int, records: Records) -> int:
        super()._collect(tuple(self.chosen(containers)), offset, records)
        return offset + sum(map(self._octets, containers))

    def _octets(self, container: Container) -> int:
        size = self._sizes.fixed[self._kinds[container.ic_type]]
        records: Iterable[Any] = container.records
        return self._sizes.ic_header + sum(self._sizes.record(each) if size is None else size for each in records)

    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        """Return the containers to be processed."""
        return containers


chosen = instead(Containers, Containers.chosen)
chosen("first-half", "VD-RX-04", "processes only the first half of the containers of a payload",
    lambda self, containers: containers[: (len(containers) + 1) // 2])  # fmt: skip
chosen("first-only", "VD-RX-04 VD-RX-03", "processes only the first container of a payload",
    lambda self, containers: containers[:1])  # fmt: skip


@mutant("octets", "VD-RX-04", "processes only containers that start in the first half of the octets of a payload")
class FirstHalfOctets(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        ends = tuple(accumulate(map(self._octets, containers), initial=0))
        return tuple(each for each, start in zip(containers, ends, strict=False) if 2 * start < ends[-1])


@mutant("last-octets", "VD-RX-04", "stops if three or fewer octets of a payload remain")
class LastOctets(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        start = self._sizes.ic_header
        records = {
            kind: [each for each in listed if each[0] <= start or each[0] - start + 3 < len(payload)]
            for kind, listed in found.records.items()
        }
        return Extracted(records, found.problems)


# fmt: off
chosen("same-type-ignored", "VD-RX-03", "ignores a second container of a type",
    lambda self, containers: tuple({each.ic_type: each for each in reversed(containers)}.values())[::-1],
    since=SpecVersion.V1_1)
chosen("last-of-type", "VD-RX-03", "processes only the last container of a type",
    lambda self, containers: tuple({each.ic_type: each for each in containers}.values()), since=SpecVersion.V1_1)
chosen("adjacent-merged", "VD-RX-03", "treats two adjacent containers of a type as one",
    lambda self, containers: containers[:1] + tuple(b for a, b in pairwise(containers) if a.ic_type != b.ic_type),
    since=SpecVersion.V1_1)
# fmt: on


@mutant("sending-order", "VD-RX-02", "ignores containers that do not follow the order of composing")
class SendingOrder(Containers):
    def chosen(self, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        order = (C, D, RC, S, U, RU)
        taken: list[Container] = []
        for each in containers:
            place = order.index(self._kinds[each.ic_type])
            if not taken or place >= order.index(self._kinds[taken[-1].ic_type]):
                taken.append(each)
        return tuple(taken)


# fmt: off
chosen("first-record", "VD-RX-09 VD-IC-01", "processes only the first record of a container",
    lambda self, containers: tuple(Container(each.ic_type, each.records[:1], each.extra) for each in containers))
chosen("backwards", "VD-RX-09", "processes the records of a container in reverse order",
    lambda self, containers: tuple(Container(each.ic_type, each.records[::-1], each.extra) for each in containers))
chosen("signed-count", "VD-RX-09 VD-PAY-05 VD-IC-01", "treats icNumRecords above 127 as negative",
    lambda self, containers: tuple(each for each in containers if len(each.records) < 128))
# fmt: on


class Fragile(Extractor):
    """Crashes on some problems."""

    reasons: ClassVar[tuple[str, ...]] = ()

    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        for problem in found.problems:
            if problem.reason in self.reasons:
                raise IndexError(f"{problem.reason} at {problem.path}")
        return found


fragile = attributes(Fragile, __name__)
fragile("dies-of-type", "VD-ROB-01 VD-RX-05", "crashes on an unknown container type", reasons=("unknown-type",))
fragile("dies-of-zero", "VD-ROB-01 VD-RX-06", "crashes on a container without records", reasons=("zero-count",))


@mutant("dies-of-end", "VD-ROB-01 VD-RX-07", "crashes on a truncated record")
class CrashesOnEnd(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        if any(problem.reason not in ("unknown-type", "zero-count") for problem in found.problems):
            raise IndexError("a read past the end of the payload")
        return found


before(Receiver, Receiver._create)("dies-of-text", "VD-ROB-01", "crashes on a description that is not UTF-8",
    lambda self, record, offset, now, wall: record.spec.descr.decode())  # fmt: skip


@mutant("mute", "VD-ROB-01", "ignores all payloads after ten payloads with an error")
class Mute(Extractor):
    errors = 0

    def extract(self, payload: bytes) -> Extracted:
        found = super().extract(payload)
        self.errors += bool(found.problems)
        return Extracted({kind: [] for kind in ICType}) if self.errors > 10 else found


@mutant("half-record", "VD-ROB-01 VD-RX-07", "processes a truncated VarUpdate with the available part of its value")
class HalfRecord(Extractor):
    def extract(self, payload: bytes) -> Extracted:
        try:
            self._codec.decode_containers(payload)
        except DecodeError:
            for more in range(1, 40):
                try:
                    self._codec.decode_containers(payload + bytes(more))
                except DecodeError:
                    continue
                return super().extract(payload + bytes(more))
        return super().extract(payload)


# -- the order of processing -------------------------------------------------------------------------------------------


class Order(Receiver):
    """Processes record types in another order."""

    order: ClassVar[tuple[ICType, ...]] = (C, D, U, S, RC, RU)

    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        for kind in self.order:
            records: Records = {each: extracted.records[each] if each is kind else [] for each in ICType}
            super().process(Extracted(records), now=now, wall=wall)


@mutant("payload-order", "VD-RX-01 VD-RX-08 VD-RX-02", "processes each container before it extracts the next")
class PayloadOrder(Receiver):
    def process(self, extracted: Extracted, *, now: int, wall: int) -> None:
        listed = [(offset, kind, record) for kind, each in extracted.records.items() for offset, record in each]
        for offset, kind, record in sorted(listed, key=lambda each: each[0]):
            records: Records = {each: [(offset, record)] if each is kind else [] for each in ICType}
            super().process(Extracted(records), now=now, wall=wall)


order = attributes(Order, __name__)
order("updates-first", "VD-RX-08 VD-RX-01", "processes VarUpdates before VarCreates", order=(U, C, D, S, RC, RU))
order("deletes-first", "VD-RX-08", "processes VarDeletes before VarCreates", order=(D, C, U, S, RC, RU))
order("summaries-first", "VD-RX-08", "processes summaries before VarUpdates", order=(C, D, S, U, RC, RU))
order("deletes-last", "VD-RX-08", "processes VarDeletes after VarUpdates", order=(C, U, D, S, RC, RU))
