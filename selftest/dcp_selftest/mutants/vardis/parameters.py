"""Faults in the parameters of VarDis."""

from __future__ import annotations

from typing import ClassVar

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.parameters import Violation

from dcp_selftest.mutants.family import after, around, attributes
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.config import NodeConfig
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.parameters import (
    BUFFER_CHECK_PERIOD,
    DESCRIPTION_LENGTH,
    PAYLOAD_SIZE,
    REPETITIONS,
    SCRUBBING_PERIOD,
    SUMMARIES,
    VALUE_LENGTH,
    VardisParameters,
)

V2 = SpecVersion.V2_0
V1_2 = SpecVersion.V1_2


class Unbound(VardisParameters):
    """Accepts some values beyond the limits."""

    name: ClassVar[str] = ""
    wrong: ClassVar[range] = range(1, 1 << 31)

    def set(self, name: str, value: object) -> Violation | None:
        violation = super().set(name, value)
        if violation is not None and name == self.name and isinstance(value, int) and value in self.wrong:
            self._values[name] = value
            return None
        return violation


# fmt: off
unbound = attributes(Unbound, __name__)
unbound("zero", "VD-PAR-02", "accepts 0 as the maximum length of values", name=VALUE_LENGTH, wrong=range(1))
unbound("no-bound", "VD-PAR-02", "accepts a maximum length of values that does not fit into a payload",
    name=VALUE_LENGTH)
unbound("zero", "VD-PAR-03", "accepts 0 as the maximum length of descriptions", name=DESCRIPTION_LENGTH, wrong=range(1))
unbound("no-bound", "VD-PAR-03", "accepts a maximum length of descriptions that does not fit into a payload",
    name=DESCRIPTION_LENGTH)
unbound("zero", "VD-PAR-04", "accepts 0 as the maximum repetition count",
    unseen={"1.1": "in 1.1 this is VD-PAR-10"}, name=REPETITIONS, wrong=range(1))
unbound("sixteen", "VD-PAR-04", "accepts maximum repetition counts up to 255",
    unseen={"1.1": "1.1 has no upper limit"}, name=REPETITIONS, wrong=range(16, 256))
around_set = around(VardisParameters, VardisParameters.set)
around_set("fifteen", "VD-PAR-10", "accepts no maximum repetition count above 15, as in all other versions",
    lambda self, proceed, name, value: (
        proceed(name, 0) if name == REPETITIONS and isinstance(value, int) and value > 15 else proceed(name, value)))
unbound("zero", "VD-PAR-10", "accepts 0 as the maximum repetition count", name=REPETITIONS, wrong=range(1))
after_max_payload_size = after(Unbound, Unbound.max_payload_size)
after_max_payload_size("zero", "VD-PAR-05", "accepts 0 as the maximum payload size",
    lambda self, size: size or 1000, name=PAYLOAD_SIZE, wrong=range(1))
after_max_payload_size("no-bound", "VD-PAR-05", "accepts a maximum payload size that does not fit into a beacon",
    lambda self, size: min(size, 1000), name=PAYLOAD_SIZE)
unbound("no-bound", "VD-PAR-06", "accepts a maximum number of summaries that does not fit into a payload",
    name=SUMMARIES)
around_set("no-zero", "VD-PAR-06", "rejects 0 as the maximum number of summaries",
    lambda self, proceed, name, value: (
        Violation(parameter=name, value=value, bound="at least 1", requirement="VD-PAR-06")
        if name == SUMMARIES and value == 0 else proceed(name, value)))
after(Unbound, Unbound.scrubbing_period_ms)("zero", "VD-PAR-07", "accepts a scrubbing period of 0 ms",
    lambda self, period: period or 1000, since=V2, name=SCRUBBING_PERIOD, wrong=range(1))
unbound("no-bound", "VD-PAR-07", "accepts a scrubbing period above 65000 ms", since=V2, name=SCRUBBING_PERIOD)
unbound("no-bound", "VD-PAR-08", "accepts a buffer check period above 65000 ms", name=BUFFER_CHECK_PERIOD)
after(Unbound, Unbound.buffer_check_period_ms)("zero", "VD-PAR-08", "accepts a buffer check period of 0 ms",
    lambda self, period: period or 50, name=BUFFER_CHECK_PERIOD, wrong=range(1))
# fmt: on


@mutant("forgets", "VD-PAR-01", "keeps using the initial values of parameters")
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


@mutant("retroactive", "VD-PAR-01", "deletes variables whose value is longer than a reduced maximum")
class Retroactive(Vardis):
    def set_parameter(self, name: str, value: object) -> Violation | None:
        violation = super().set_parameter(name, value)
        if violation is None and name in (VALUE_LENGTH, DESCRIPTION_LENGTH):
            for entry in list(self._database.entries.values()):
                long = len(entry.value) > self._parameters.max_value_length
                if (long or len(entry.spec.descr) > self._parameters.longest_description) and not entry.is_deleted:
                    self._database.mark_deleted(entry)
        return violation


# fmt: off
around(VardisParameters, VardisParameters.as_dict)("check-period-fixed", "VD-PAR-09 VD-PAR-08",
    "has no VARDISPAR_BUFFER_CHECK_PERIOD that can be read or set",
    lambda self, proceed: {name: value for name, value in proceed().items() if name != "VARDISPAR_BUFFER_CHECK_PERIOD"})
# fmt: on


@mutant(
    "beside-the-first-value-length",
    "VD-PAR-03",
    "uses the initial maximum value length in the limit of the description length",
    unseen={"1.0": "in 1.0 the limit of the sum of both lengths does not depend on parameters"},
)
class FormerValueLength(VardisParameters):
    def set(self, name: str, value: object) -> Violation | None:
        before = self._sizes.max_value_length
        violation = super().set(name, value)
        self._sizes = msgspec.structs.replace(self._sizes, max_value_length=before)
        return violation
