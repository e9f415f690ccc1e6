"""Faults in the parameters of VarDis."""

from __future__ import annotations

from typing import ClassVar

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.parameters import Violation

from dcp_stack.config import NodeConfig
from dcp_stack.vardis import Vardis
from dcp_stack.vardis_parameters import (
    BUFFER_CHECK_PERIOD,
    DESCRIPTION_LENGTH,
    PAYLOAD_SIZE,
    REPETITIONS,
    SCRUBBING_PERIOD,
    SUMMARIES,
    VALUE_LENGTH,
    VardisParameters,
)

from .mutant import mutant

V2 = SpecVersion.V2_0
V1_2 = SpecVersion.V1_2


class Unbound(VardisParameters):
    """Takes some values that are out of bounds."""

    name: ClassVar[str] = ""
    wrong: ClassVar[range] = range(1, 1 << 31)

    def set(self, name: str, value: object) -> Violation | None:
        violation = super().set(name, value)
        if violation is not None and name == self.name and isinstance(value, int) and value in self.wrong:
            self._values[name] = value
            return None
        return violation


@mutant("zero", "VD-PAR-02", "takes 0 as the longest value")
class ValueZero(Unbound):
    name = VALUE_LENGTH
    wrong = range(1)


@mutant("no-bound", "VD-PAR-02", "takes lengths of values that no payload can hold")
class ValueUnbound(Unbound):
    name = VALUE_LENGTH


@mutant("zero", "VD-PAR-03", "takes 0 as the longest description")
class DescriptionZero(Unbound):
    name = DESCRIPTION_LENGTH
    wrong = range(1)


@mutant("no-bound", "VD-PAR-03", "takes lengths of descriptions that no payload can hold")
class DescriptionUnbound(Unbound):
    name = DESCRIPTION_LENGTH


@mutant("zero", "VD-PAR-04", "takes 0 as the highest repetition count", unseen={"1.1": "VD-PAR-10 says it there"})
class RepetitionsZero(Unbound):
    name = REPETITIONS
    wrong = range(1)


@mutant("sixteen", "VD-PAR-04", "takes repetition counts up to 255", unseen={"1.1": "1.1 has no upper bound"})
class RepetitionsUnbound(Unbound):
    name = REPETITIONS
    wrong = range(16, 256)


@mutant("fifteen", "VD-PAR-10", "takes no repetition counts above 15, as all other versions")
class RepetitionsBound(VardisParameters):
    def set(self, name: str, value: object) -> Violation | None:
        if name == REPETITIONS and isinstance(value, int) and value > 15:
            return super().set(name, 0)
        return super().set(name, value)


@mutant("zero", "VD-PAR-10", "takes 0 as the highest repetition count")
class RepetitionsZeroToo(RepetitionsZero):
    """Which is the fault of the class it derives from, in 1.1."""


@mutant("zero", "VD-PAR-05", "takes 0 as the largest payload")
class PayloadZero(Unbound):
    name = PAYLOAD_SIZE
    wrong = range(1)

    @property
    def max_payload_size(self) -> int:
        return super().max_payload_size or 1000


@mutant("no-bound", "VD-PAR-05", "takes payload sizes that no beacon can hold")
class PayloadUnbound(Unbound):
    name = PAYLOAD_SIZE

    @property
    def max_payload_size(self) -> int:
        return min(super().max_payload_size, 1000)


@mutant("no-bound", "VD-PAR-06", "takes numbers of summaries that no payload can hold")
class SummariesUnbound(Unbound):
    name = SUMMARIES


@mutant("no-zero", "VD-PAR-06", "refuses 0 as the number of summaries")
class SummariesNoZero(VardisParameters):
    def set(self, name: str, value: object) -> Violation | None:
        if name == SUMMARIES and value == 0:
            return Violation(parameter=name, value=value, bound="at least 1", requirement="VD-PAR-06")
        return super().set(name, value)


@mutant("zero", "VD-PAR-07", "takes 0 ms between two runs of scrubbing", since=V2)
class ScrubbingZero(Unbound):
    name = SCRUBBING_PERIOD
    wrong = range(1)

    @property
    def scrubbing_period_ms(self) -> int:
        return super().scrubbing_period_ms or 1000


@mutant("no-bound", "VD-PAR-07", "takes more than 65000 ms between two runs of scrubbing", since=V2)
class ScrubbingUnbound(Unbound):
    name = SCRUBBING_PERIOD


@mutant("no-bound", "VD-PAR-08", "takes more than 65000 ms between two looks at the buffer")
class CheckUnbound(Unbound):
    name = BUFFER_CHECK_PERIOD


@mutant("zero", "VD-PAR-08", "takes 0 ms between two looks at the buffer")
class CheckZero(Unbound):
    name = BUFFER_CHECK_PERIOD
    wrong = range(1)

    @property
    def buffer_check_period_ms(self) -> int:
        return super().buffer_check_period_ms or 50


@mutant("forgets", "VD-PAR-01", "goes on with the parameters that it started with")
class Forgets(VardisParameters):
    def __init__(self, config: NodeConfig) -> None:
        super().__init__(config)
        self._used = dict(self._values)

    @property
    def max_value_length(self) -> int:
        return self._used[VALUE_LENGTH]

    @property
    def longest_description(self) -> int:
        return self._used[DESCRIPTION_LENGTH] - self._terminator

    @property
    def max_repetitions(self) -> int:
        return self._used[REPETITIONS]

    @property
    def max_summaries(self) -> int:
        return self._used[SUMMARIES]


@mutant("retroactive", "VD-PAR-01", "deletes variables whose value is longer than a lowered limit")
class Retroactive(Vardis):
    def set_parameter(self, name: str, value: object) -> Violation | None:
        violation = super().set_parameter(name, value)
        if violation is None and name in (VALUE_LENGTH, DESCRIPTION_LENGTH):
            for entry in list(self._database.entries.values()):
                long = len(entry.value) > self._parameters.max_value_length
                if (long or len(entry.spec.descr) > self._parameters.longest_description) and not entry.is_deleted:
                    self._database.mark_deleted(entry)
        return violation


@mutant("check-period-fixed", "VD-PAR-09 VD-PAR-08", "has no VARDISPAR_BUFFER_CHECK_PERIOD that could be told or set")
class NoCheckPeriod(VardisParameters):
    def as_dict(self) -> dict[str, int]:
        return {name: value for name, value in super().as_dict().items() if name != "VARDISPAR_BUFFER_CHECK_PERIOD"}


@mutant(
    "beside-the-first-value-length",
    "VD-PAR-03",
    "checks the description length against the value length that it was started with",
    unseen={"1.0": "1.0 bounds the sum of both lengths apart from the parameters"},
)
class FormerValueLength(VardisParameters):
    def set(self, name: str, value: object) -> Violation | None:
        before = self._sizes.max_value_length
        violation = super().set(name, value)
        self._sizes = msgspec.structs.replace(self._sizes, max_value_length=before)
        return violation
