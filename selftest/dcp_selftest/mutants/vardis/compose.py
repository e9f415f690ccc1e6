"""Faults in composing VarDis payloads: selection and order of records."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_codec.values import Container, VarReqCreate, VarReqUpdate, VarSumm
from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.family import after, around, attributes, instead
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.database import IdQueue
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.wire import ContainerType

C, D, U = ICType.CREATE_VARIABLES, ICType.DELETE_VARIABLES, ICType.UPDATES
S, RC, RU = ICType.SUMMARIES, ICType.REQUEST_VARCREATES, ICType.REQUEST_VARUPDATES


# -- how many, and in which order --------------------------------------------------------------------------------------


@mutant("one-more", "VD-CMP-02", "sends one summary more than VARDISPAR_MAX_SUMMARIES")
class SummaryMore(Composer):
    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, used = super()._fitting(kind, queue, room, largest)
        if kind is S and len(chosen) == self._parameters.max_summaries:
            more = [each for each in queue if each not in chosen][:1]
            chosen, used = chosen + more, used + len(more) * self._sizes.var_summ
        return chosen, used


@mutant(
    "unlimited",
    "VD-CMP-02 VD-CMP-01 VD-PAR-06",
    "sends all summaries that fit, whatever the value of VARDISPAR_MAX_SUMMARIES",
)
class SummariesUnlimited(Composer):
    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        if kind is not S:
            return super()._fitting(kind, queue, room, largest)
        chosen = list(queue)[: max((room - self._sizes.ic_header) // self._sizes.var_summ, 0)]
        return chosen, self._sizes.ic_header + len(chosen) * self._sizes.var_summ


# fmt: off
around(SummariesUnlimited, SummariesUnlimited._fitting)("zero-is-all", "VD-CMP-01 VD-PAR-06",
    "sends all summaries when VARDISPAR_MAX_SUMMARIES is 0",
    lambda self, proceed, kind, queue, room, largest: (
        proceed(kind, queue, room, largest)
        if kind is S and not self._parameters.max_summaries else Composer._fitting(self, kind, queue, room, largest)))
# fmt: on


@mutant("stays", "VD-CMP-03", "summarises the same variables in every payload")
class SummariesStay(Composer):
    def _take(self, kind: ContainerType, var_id: int) -> Any:
        before = list(self._database.summary_q)
        record = super()._take(kind, var_id)
        if kind is S:
            for each in before:
                self._database.summary_q.rotate(each)
        return record


@mutant("half-turn", "VD-CMP-03", "moves a summarised variable to the middle of summaryQ")
class HalfTurn(Composer):
    def _take(self, kind: ContainerType, var_id: int) -> Any:
        record = super()._take(kind, var_id)
        if kind is S:
            others = [each for each in self._database.summary_q if each != var_id]
            for each in others[len(others) // 2 :]:
                self._database.summary_q.rotate(each)
        return record


class Ordered(Composer):
    """Composes containers in another order."""

    order: ClassVar[tuple[ICType, ...]] = (C, D, RC, S, U, RU)

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._order = tuple((kind, self._queues[kind]) for kind in self.order)


ordered = attributes(Ordered, __name__)
ordered("reversed", "VD-PAY-01", "composes containers in the reverse order", order=(RU, U, S, RC, D, C))
ordered("updates-early", "VD-PAY-01", "composes updates before summaries, as 1.0 did",
    since=SpecVersion.V1_1, order=(C, D, U, S, RC, RU))  # fmt: skip
ordered("requests-late", "VD-PAY-01", "composes requests for variables after summaries",
    since=SpecVersion.V1_1, order=(C, D, S, RC, U, RU))  # fmt: skip
ordered("later-order", "VD-PAY-07", "composes containers in the order of later versions")


@mutant("summaries-missing", "VD-PAY-01 VD-PAY-02", "sends no summaries while it has VarCreates to send")
class SummariesMissing(Composer):
    def compose(self, room: int) -> tuple[Container, ...]:
        order = self._order
        if self._database.create_q:
            self._order = tuple(each for each in order if each[0] is not S)
        composed = super().compose(room)
        self._order = order
        return composed


class Fitting(Composer):
    """Changes the selection of records."""

    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        chosen, _ = super()._fitting(kind, queue, room, largest)
        chosen = self.chosen(chosen, kind)
        size = sum(self._record_size(kind, each) for each in chosen)
        return chosen, size + self._sizes.ic_header * (-(-len(chosen) // 255))

    def chosen(self, chosen: list[int], kind: ContainerType) -> list[int]:
        """Return the variables whose records are sent."""
        return chosen


chosen = instead(Fitting, Fitting.chosen)
chosen("one-record", "VD-PAY-02", "sends only one record in each container", lambda self, chosen, kind: chosen[:1])
chosen("five-records", "VD-PAY-02", "sends at most five records in each container",
    lambda self, chosen, kind: chosen if kind is S else chosen[:5])  # fmt: skip
chosen("one-request", "VD-PAY-02", "sends one request of each type in a payload",
    lambda self, chosen, kind: chosen[:1] if kind in (RC, RU) else chosen)  # fmt: skip
chosen("sorted", "VD-PAY-06", "sends records in the order of their identifiers",
    lambda self, chosen, kind: sorted(chosen, reverse=True))  # fmt: skip


@mutant("skips", "VD-PAY-06 VD-CMP-08", "continues with the next record after one that does not fit")
class Skips(Composer):
    def _fitting(self, kind: ContainerType, queue: IdQueue, room: int, largest: int) -> tuple[list[int], int]:
        if kind is S:
            return super()._fitting(kind, queue, room, largest)
        chosen: list[int] = []
        used = self._sizes.ic_header
        for var_id in queue:
            size = self._record_size(kind, var_id)
            if used + size <= room and len(chosen) < 255:
                chosen.append(var_id)
                used += size
        return chosen, used if chosen else 0


# fmt: off
after(Composer, Composer._fitting)("stops", "VD-CMP-08",
    "sends no further container after one whose first record does not fit",
    lambda self, fitting, kind, queue, room, largest: fitting if fitting[0] or kind is S else (fitting[0], room))
around(Composer, Composer.compose)("doubled", "VD-PAY-03", "sends each record twice in a container if there is room",
    lambda self, proceed, room: (
        tuple(Container(each.ic_type, (*each.records, *each.records)[:255]) for each in proceed(room // 2))))
# fmt: on


@mutant("too-large", "VD-IC-05", "ignores the headers of containers when it fills a payload")
class TooLarge(Composer):
    def compose(self, room: int) -> tuple[Container, ...]:
        header, self._sizes.ic_header = self._sizes.ic_header, 0
        composed = super().compose(room)
        self._sizes.ic_header = header
        return composed


class Generates(Vardis):
    """Changes the octets of payloads."""

    spared: ClassVar[int] = 0
    """Octets of the registered size that containers do not use."""

    def _generate(self, now: int, wall: int) -> None:
        containers = self._composer.compose(self._registered_size - self.spared) if self.active else ()
        if containers:
            self._bp.transmit_payload(BP_PROTID_VARDIS, self.payload(containers), now=now)

    def payload(self, containers: tuple[Container, ...]) -> bytes:
        """Return the octets of the payload."""
        return self._core.config.codec.encode_containers(containers)


# fmt: off
attributes(Generates, __name__)("parameter", "VD-IC-05 VD-PAR-05",
    "fills payloads to the size registered with BP, whatever the value of VARDISPAR_MAX_PAYLOAD_SIZE")
payload = after(Generates, Generates.payload)
payload("empty", "VD-IC-03", "sends an empty container for every type without records",
    lambda self, octets, containers: octets + b"".join(
        bytes([kind, 0]) for kind in range(1, 7) if kind not in {each.ic_type for each in containers}), spared=12)
payload("unknown-behind", "VD-IC-02", "ends every payload with a container of an unknown type",
    lambda self, octets, containers: octets + b"\x77\x01\x05\x06", spared=4)
# fmt: on


@mutant("types-exchanged", "VD-IC-02", "exchanges the numbers of CREATE-VARIABLES and DELETE-VARIABLES")
class TypesExchanged(Vardis):
    def _generate(self, now: int, wall: int) -> None:
        if not self.active:
            return
        containers = self._composer.compose(min(self._parameters.max_payload_size, self._registered_size))
        encode = self._core.config.codec.encode_containers
        numbers = self._core.config.profile.vardis.container_types.by_name()
        create, delete = numbers[C.label], numbers[D.label]
        exchanged = {create: delete, delete: create}
        payload = b""
        for each in containers:
            octets = encode((each,))
            payload += bytes([exchanged.get(octets[0], octets[0])]) + octets[1:]
        if payload:
            self._bp.transmit_payload(BP_PROTID_VARDIS, payload, now=now)


@mutant("request-types-exchanged", "VD-IC-02", "exchanges the numbers of the two types of requests")
class RequestsExchanged(Air):
    def containers(self, containers: tuple[Container, ...]) -> Iterable[Container]:
        for each in containers:
            if self.kind(each) is RC:
                yield Container(RU.value, tuple(VarReqUpdate(record.var_id, 0) for record in each.records))
            elif self.kind(each) is RU:
                yield Container(RC.value, tuple(VarReqCreate(record.var_id) for record in each.records))
            else:
                yield each


@mutant("unknown-summarised", "VD-TYP-08 VD-SCP-01", "summarises variables that it knows only from summaries")
class UnknownSummarised(Air):
    def _build(self, now: int, wall: int) -> None:
        super()._build(now, wall)
        self.heard: list[VarSumm] = []

    def hears(self, octets: bytes) -> Iterable[bytes]:
        for each in self.instructions(octets):
            if self.kind(each) is S and self.vardis is not None:
                self.heard += [record for record in each.records if record.var_id not in self.vardis._database.entries]
        yield octets

    def containers(self, containers: tuple[Container, ...]) -> Iterable[Container]:
        heard, self.heard = self.heard[:20], []
        number = self.config.profile.vardis.container_types.by_name()[S.label]
        if not heard:
            return containers
        return (*(each for each in containers if each.ic_type != number), Container(number, tuple(heard)))
