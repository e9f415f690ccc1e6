"""The current configurable parameters of a VarDis entity (dcp-vardis.md#vardis-configurable-parameters)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import msgspec
from dcp_spec.parameters import Sizes, UnknownParameterError, Violation, parameter, parameters, validate

from dcp_stack.config import NodeConfig

VALUE_LENGTH = "VARDISPAR_MAX_VALUE_LENGTH"
DESCRIPTION_LENGTH = "VARDISPAR_MAX_DESCRIPTION_LENGTH"
REPETITIONS = "VARDISPAR_MAX_REPETITIONS"
PAYLOAD_SIZE = "VARDISPAR_MAX_PAYLOAD_SIZE"
SUMMARIES = "VARDISPAR_MAX_SUMMARIES"
SCRUBBING_PERIOD = "VARDISPAR_SCRUBBING_PERIOD"
BUFFER_CHECK_PERIOD = "VARDISPAR_BUFFER_CHECK_PERIOD"

#: Parameter -> its setting in ``config.vardis``, and the limit of the profile that replaces a missing one. The order
#: is that of validation: the bounds of the later parameters depend on the payload size and the value length.
_SOURCES: Final = {
    PAYLOAD_SIZE: ("max_payload_size", "max_vardis_payload"),
    VALUE_LENGTH: ("max_value_length", "max_value_length"),
    DESCRIPTION_LENGTH: ("max_description_length", "max_description_length"),
    REPETITIONS: ("max_repetitions", "max_repetitions"),
    SUMMARIES: ("max_summaries", "max_summaries"),
    SCRUBBING_PERIOD: ("scrubbing_period_ms", ""),
    BUFFER_CHECK_PERIOD: ("buffer_check_period_ms", ""),
}


class VardisParameters:
    """Current parameters, by the specification's names; lengths and sizes in octets, periods in ms."""

    def __init__(self, config: NodeConfig) -> None:
        """Take the values from ``config.vardis``, and those it leaves open from the limits of the profile.

        A limit of the profile is lowered to the parameter's upper bound. Raises ValueError if the node has no VarDis,
        or if a value in ``config.vardis`` violates a bound.
        """
        values, self._sizes = config.once(_initial)
        self._values = dict(values)
        readings = config.selected_readings
        self._record_bound = readings.value_length_bound == "record-bound"
        self._takes_nearest = readings.value_out_of_bounds == "nearest-value"
        ##= VD-CRE-04
        # The parameter of 1.0 includes the terminating NUL, the limit of a profile does not.
        self._terminator = _terminator(config)

    def as_dict(self) -> dict[str, int]:
        """Return all parameters of the specification's version, in the order of the specification."""
        ##= VD-PAR-09
        return {name: self._values[name] for name in parameters() if name in self._values}

    def set(self, name: str, value: object) -> Violation | None:
        """Change a parameter; returns None, or the violated bound.

        Under reading X39 ``nearest-value`` a value out of bounds is replaced by the nearest legal one. Raises
        ``UnknownParameterError`` if VarDis has no parameter of this name.
        """
        if name not in _SOURCES:
            raise UnknownParameterError(f"VarDis has no parameter {name!r}")
        changed = _changed(name, value, self._values, self._sizes, record_bound=self._record_bound)
        if isinstance(changed, Violation) and self._takes_nearest and isinstance(value, int):
            value = _nearest(name, value, self._sizes)
            changed = _changed(name, value, self._values, self._sizes, record_bound=self._record_bound)
        if isinstance(changed, Violation):
            return changed
        assert isinstance(value, int)
        self._sizes = changed
        ##= VD-PAR-01
        self._values[name] = value
        return None

    @property
    def max_value_length(self) -> int:
        """Longest value in octets."""
        return self._values[VALUE_LENGTH]

    @property
    def longest_description(self) -> int:
        """Longest description in octets, without a terminating NUL."""
        return self._values[DESCRIPTION_LENGTH] - self._terminator

    @property
    def max_repetitions(self) -> int:
        """Highest repetition count."""
        return self._values[REPETITIONS]

    @property
    def max_payload_size(self) -> int:
        """Largest payload in octets."""
        return self._values[PAYLOAD_SIZE]

    @property
    def max_summaries(self) -> int:
        """Maximum number of summaries in a payload; 0 disables summaries."""
        return self._values[SUMMARIES]

    @property
    def scrubbing_period_ms(self) -> int:
        """Time between two runs of scrubbing in ms. Raises KeyError before 2.0, which has no scrubbing."""
        return self._values[SCRUBBING_PERIOD]

    @property
    def buffer_check_period_ms(self) -> int:
        """Time between two checks of the buffer of BP in ms."""
        return self._values[BUFFER_CHECK_PERIOD]


def _nearest(name: str, value: int, sizes: Sizes) -> int:
    """Return the legal value that is nearest to one out of bounds (X39)."""
    lowest, highest = parameter(name).minimum(sizes), parameter(name).maximum(sizes)
    value = value if highest is None else min(value, highest)
    return value if lowest is None else max(value, lowest)


def _terminator(config: NodeConfig) -> int:
    """Return the octets of the terminator of a string: 1 if strings end with NUL, otherwise 0."""
    return int(config.features.string_format == "nul-terminated")


def _initial(config: NodeConfig) -> tuple[Mapping[str, int], Sizes]:
    """Return the initial parameters of a node, and the sizes on which bounds depend.

    Raises ValueError as :class:`VardisParameters` does.
    """
    settings = config.vardis
    if settings is None:
        raise ValueError("the node is configured without VarDis")
    sizes = config.sizes
    record_bound = config.selected_readings.value_length_bound == "record-bound"
    values: dict[str, int] = {}
    for name, (setting, limit) in _SOURCES.items():
        if parameter(name).since > config.profile.spec_version:
            continue
        value = getattr(settings, setting)
        if value is None:
            value = getattr(config.profile.limits, limit)
            if name == DESCRIPTION_LENGTH:
                value += _terminator(config)
            highest = parameter(name).maximum(sizes)
            value = value if highest is None else min(value, highest)
        changed = _changed(name, value, values, sizes, record_bound=record_bound)
        if isinstance(changed, Violation):
            raise ValueError(str(changed))
        values[name], sizes = value, changed
    return MappingProxyType(values), sizes


def _changed(
    name: str, value: object, values: Mapping[str, int], sizes: Sizes, *, record_bound: bool
) -> Sizes | Violation:
    """Return the sizes on which bounds depend after a change of a parameter, or the bound that it violates."""
    violation = validate(name, value, sizes)
    if violation is not None:
        return violation
    assert isinstance(value, int)
    if name == PAYLOAD_SIZE:
        return msgspec.structs.replace(sizes, max_payload_size=value)
    if name == VALUE_LENGTH:
        sizes = msgspec.structs.replace(sizes, max_value_length=value)
        if record_bound and DESCRIPTION_LENGTH in values:
            violation = validate(DESCRIPTION_LENGTH, values[DESCRIPTION_LENGTH], sizes)
    return violation or sizes
