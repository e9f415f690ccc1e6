"""Parameters of BP, SRP and VarDis with their bounds (the sections "Configurable Parameters").

Many bounds depend on the sizes of records and on other parameters, so they are functions of a `Sizes` value
and hold from a certain version on. `validate` names the bound that a value violates. Bounds that the
specification does not state are not invented; a comment marks the two that follow from other statements.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache, partial
from types import MappingProxyType
from typing import Final, Literal

import msgspec

from .catalogue.entries import UnknownEntryError
from .constants import ETHERTYPE_MIN, UWB_MIN_MTU, SpecVersion

_V = SpecVersion


class Sizes(msgspec.Struct, frozen=True, kw_only=True):
    """The values that bounds depend on: serialized sizes in octets, and current values of other parameters.

    The defaults are the sizes of the C++ implementation of the draft 2.0. A negative size raises ValueError.
    """

    version: SpecVersion = SpecVersion.V2_0
    uwb_max_packet_size: int
    """Maximum packet size of the bearer."""
    node_id: int = 6
    network_id: int = 2
    var_len: int = 1
    bp_header: int = 18
    """BPHeaderT."""
    bp_payload_header: int = 4
    """BPPayloadHeaderT."""
    ic_header: int = 2
    """ICHeaderT."""
    var_spec_fixed: int = 19
    """VarSpecT without the bytes of the description, but with its length byte."""
    var_update_fixed: int = 3
    """VarUpdateT without the bytes of the value, but with its VarLenT."""
    var_summ: int = 2
    """VarSummT."""
    max_packet_size: int | None = None
    """Current BPPAR_MAXIMUM_PACKET_SIZE; None for its default, the maximum of the bearer."""
    max_payload_size: int | None = None
    """Current VARDISPAR_MAX_PAYLOAD_SIZE; None for the largest that BP can take."""
    max_value_length: int = 32
    """Current VARDISPAR_MAX_VALUE_LENGTH."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            size = getattr(self, name)
            if name != "version" and size is not None and size < 0:
                raise ValueError(f"{name} is a number of bytes, not {size}")

    @property
    def packet(self) -> int:
        """The maximum packet size in force, in bytes."""
        return self.uwb_max_packet_size if self.max_packet_size is None else self.max_packet_size

    @property
    def largest_client_payload(self) -> int:
        """The largest payload that a client of BP can register, in bytes (BP-REG-04); may be negative."""
        return self.packet - (self.bp_header + self.bp_payload_header)

    @property
    def payload(self) -> int:
        """The maximum VarDis payload in force, in bytes."""
        return self.largest_client_payload if self.max_payload_size is None else self.max_payload_size

    @property
    def var_create_without_description(self) -> int:
        """A container with one VarCreate of the longest value and no description, in bytes (VD-PAR-03)."""
        return self.ic_header + self.var_spec_fixed + self.var_update_fixed + self.max_value_length


class Bound(msgspec.Struct, frozen=True, kw_only=True):
    """One inclusive bound of a parameter."""

    side: Literal["minimum", "maximum"]
    expression: str
    """The bound in the specification's names."""
    evaluate: Callable[[Sizes], int]
    since: SpecVersion = SpecVersion.V1_0
    not_in: tuple[SpecVersion, ...] = ()
    exclusive: bool = False
    """True where the bound itself is not allowed."""

    def holds_in(self, version: SpecVersion) -> bool:
        """Whether the bound exists in `version`."""
        return version >= self.since and version not in self.not_in

    def allows(self, value: float, sizes: Sizes) -> bool:
        """Whether `value` is on the right side of the bound."""
        limit = self.evaluate(sizes)
        if value == limit:
            return not self.exclusive
        return value > limit if self.side == "minimum" else value < limit

    def describe(self, sizes: Sizes) -> str:
        """The bound as words with its current value, for messages."""
        words = {
            ("minimum", False): "at least",
            ("minimum", True): "greater than",
            ("maximum", False): "at most",
            ("maximum", True): "less than",
        }[self.side, self.exclusive]
        limit = str(self.evaluate(sizes))
        return f"{words} {limit}" if limit == self.expression else f"{words} {limit} ({self.expression})"


class Parameter(msgspec.Struct, frozen=True, kw_only=True):
    """One parameter of a protocol, named as in the specification."""

    name: str
    protocol: Literal["BP", "SRP", "VD"]
    type: Literal["integer", "duration", "bytes"] = "integer"
    """A duration may have a fraction, an integer may not; bytes are an identifier."""
    unit: Literal["bytes", "ms", "records", "repetitions", "none"]
    requirement: str
    """Id of the requirement that the bounds follow."""
    meaning: str
    bounds: tuple[Bound, ...] = ()
    since: SpecVersion = SpecVersion.V1_0
    configurable: bool = True
    """False for values that are determined once, during initialization."""

    def minimum(self, sizes: Sizes) -> int | None:
        """The tightest lower bound in force, None without one; `validate` knows whether it is excluded."""
        limits = [bound.evaluate(sizes) for bound in self._in_force("minimum", sizes)]
        return max(limits) if limits else None

    def maximum(self, sizes: Sizes) -> int | None:
        """The tightest upper bound in force, None without one."""
        limits = [bound.evaluate(sizes) for bound in self._in_force("maximum", sizes)]
        return min(limits) if limits else None

    def _in_force(self, side: str, sizes: Sizes) -> list[Bound]:
        return [bound for bound in self.bounds if bound.side == side and bound.holds_in(sizes.version)]


class Violation(msgspec.Struct, frozen=True, kw_only=True):
    """Why a value is not valid for a parameter."""

    parameter: str
    value: object
    bound: str
    """Return the condition for a valid value, with current numbers."""
    requirement: str

    def __str__(self) -> str:
        return f"{self.parameter} must be {self.bound}, not {self.value!r} ({self.requirement})"


class UnknownParameterError(UnknownEntryError):
    """No parameter has this name; the message may name some that look like it."""


def _at_least(limit: int, since: SpecVersion = _V.V1_0) -> Bound:
    return Bound(side="minimum", expression=str(limit), evaluate=lambda _: limit, since=since)


def _at_most(limit: int, since: SpecVersion = _V.V1_0, not_in: tuple[SpecVersion, ...] = ()) -> Bound:
    expression = str(limit)
    return Bound(side="maximum", expression=expression, evaluate=lambda _: limit, since=since, not_in=not_in)


def _up_to(expression: str, evaluate: Callable[[Sizes], int], since: SpecVersion = _V.V1_0) -> Bound:
    return Bound(side="maximum", expression=expression, evaluate=evaluate, since=since)


def _positive(since: SpecVersion = _V.V1_0) -> Bound:
    return Bound(side="minimum", expression="0", evaluate=lambda _: 0, since=since, exclusive=True)


def _largest_unsigned(width: int) -> int:
    return (1 << (8 * width)) - 1


_bp, _srp, _vardis = (partial(Parameter, protocol=protocol) for protocol in ("BP", "SRP", "VD"))

_BP: Final = (
    _bp(
        name="BPPAR_BEACON_PERIOD",
        type="duration",
        unit="ms",  # The specification leaves unit and resolution open; this code base counts milliseconds.
        requirement="BP-PAR-03",
        meaning="Mean time between beacons.",
        # Version 1.0 does not state it, but no beacon comes every 0 ms.
        bounds=(_positive(),),
    ),
    _bp(
        name="BPPAR_MAXIMUM_PACKET_SIZE",
        unit="bytes",
        requirement="BP-PAR-04",
        meaning="Largest bearer payload, BP header included.",
        bounds=(
            Bound(
                side="minimum",
                expression="BPHeaderT + BPPayloadHeaderT",
                evaluate=lambda sizes: sizes.bp_header + sizes.bp_payload_header,
                since=_V.V1_1,
            ),
            _up_to("UWB-MaxPacketSize", lambda sizes: sizes.uwb_max_packet_size),
        ),
    ),
    _bp(
        name="BPPAR_NETWORK_ID",
        unit="none",
        requirement="BP-PAR-05",
        meaning="Network that the node belongs to; beacons of others are discarded.",
        bounds=(
            _at_least(0),
            _up_to("largest BPNetworkIdentifierT", lambda sizes: _largest_unsigned(sizes.network_id)),
        ),
        since=_V.V2_0,
    ),
    _bp(
        name="UWB-MaxPacketSize",
        unit="bytes",
        requirement="UWB-03",
        meaning="Maximum packet size of the bearer, read during initialization (BP-PAR-08).",
        bounds=(_at_least(UWB_MIN_MTU, _V.V1_1),),
        configurable=False,
    ),
    _bp(
        name="ownNodeIdentifier",
        type="bytes",
        unit="bytes",
        requirement="BP-PAR-09",
        meaning="Identifier of the node, determined during initialization.",
        configurable=False,
    ),
    _bp(
        # The specification speaks of the "protocol type" of the LLC header and has no name for the value.
        name="protocol type",
        unit="none",
        requirement="BP-PAR-10",
        meaning="EtherType by which the bearer tells BP packets from others.",
        # Not stated, but a smaller number in its place is a length to every receiver (IEEE 802.3).
        bounds=(_at_least(ETHERTYPE_MIN), _at_most(0xFFFF)),
        since=_V.V1_1,
        configurable=False,
    ),
)

_SRP: Final = (
    _srp(
        name="SRPPAR_NEIGHBOUR_TABLE_TIMEOUT",
        type="duration",
        unit="ms",
        requirement="SRP-PAR-01",
        meaning="Time after its last record at which a neighbour is dropped from the table.",
        # Not stated, but no traversal happens five times within no time (SRP-RUN-01).
        bounds=(_positive(),),
    ),
)

_VARDIS: Final = (
    _vardis(
        name="VARDISPAR_MAX_VALUE_LENGTH",
        unit="bytes",
        requirement="VD-PAR-02",
        meaning="Longest value of a variable.",
        bounds=(
            _at_least(1),
            _up_to("largest VarLenT", lambda sizes: _largest_unsigned(sizes.var_len)),
            _up_to(
                "VARDISPAR_MAX_PAYLOAD_SIZE - ICHeaderT",
                lambda sizes: sizes.payload - sizes.ic_header,
                _V.V1_1,
            ),
        ),
    ),
    _vardis(
        name="VARDISPAR_MAX_DESCRIPTION_LENGTH",
        unit="bytes",
        requirement="VD-PAR-03",
        meaning="Longest description of a variable.",
        bounds=(
            _at_least(1),
            _up_to(
                "VARDISPAR_MAX_PAYLOAD_SIZE - (ICHeaderT + VarSpecT + VarUpdateT + VARDISPAR_MAX_VALUE_LENGTH)",
                lambda sizes: sizes.payload - sizes.var_create_without_description,
            ),
        ),
    ),
    _vardis(
        name="VARDISPAR_MAX_REPETITIONS",
        unit="repetitions",
        requirement="VD-PAR-04",
        meaning="Largest repetition count of a variable.",
        ##= VD-PAR-10
        bounds=(_at_least(1), _at_most(15, not_in=(_V.V1_1,))),
    ),
    _vardis(
        name="VARDISPAR_MAX_PAYLOAD_SIZE",
        unit="bytes",
        requirement="VD-PAR-05",
        meaning="Largest payload that VarDis hands to BP.",
        bounds=(
            _at_least(1),
            _up_to(
                "BPPAR_MAXIMUM_PACKET_SIZE - (BPHeaderT + BPPayloadHeaderT)",
                lambda sizes: sizes.largest_client_payload,
                _V.V1_1,
            ),
        ),
    ),
    _vardis(
        name="VARDISPAR_MAX_SUMMARIES",
        unit="records",
        requirement="VD-PAR-06",
        meaning="Most summaries in a payload, 0 for none.",
        bounds=(
            _at_least(0),
            _up_to(
                "(VARDISPAR_MAX_PAYLOAD_SIZE - ICHeaderT) / VarSummT",
                lambda sizes: (sizes.payload - sizes.ic_header) // sizes.var_summ,
                _V.V1_1,
            ),
        ),
    ),
    _vardis(
        name="VARDISPAR_SCRUBBING_PERIOD",
        unit="ms",
        requirement="VD-PAR-07",
        meaning="Time between two runs of the scrubbing process.",
        bounds=(_at_least(1), _at_most(65000)),
        since=_V.V2_0,
    ),
    _vardis(
        name="VARDISPAR_BUFFER_CHECK_PERIOD",
        unit="ms",  # A period without unit up to 1.1.
        requirement="VD-PAR-08",
        meaning="Time between two queries of the number of payloads that BP holds for VarDis.",
        bounds=(_at_least(1), _at_most(65000, _V.V1_2)),
    ),
)


@cache
def parameters() -> Mapping[str, Parameter]:
    """All parameters by name: those of BP, then SRP, then VarDis."""
    return MappingProxyType({entry.name: entry for entry in (*_BP, *_SRP, *_VARDIS)})


def parameter(name: str) -> Parameter:
    """The parameter with this name. Raises UnknownParameterError, a KeyError."""
    try:
        return parameters()[name]
    except KeyError:
        raise UnknownParameterError.among("parameter", name, parameters()) from None


def validate(name: str, value: object, sizes: Sizes) -> Violation | None:
    """Check a value for a parameter in the version and with the sizes given.

    Returns None for a valid value, otherwise the first violation: version, then type, then bounds in the
    order of the specification. Raises UnknownParameterError for a name that no version has.
    """
    entry = parameter(name)
    if sizes.version < entry.since:
        return _violation(entry, value, f"left alone before version {entry.since}")
    if entry.type == "bytes":
        if not isinstance(value, bytes) or len(value) != sizes.node_id:
            return _violation(entry, value, f"a string of {sizes.node_id} bytes")
        return None
    # bool is an int to Python, but never a length or a period.
    if isinstance(value, bool) or not isinstance(value, int | float):
        return _violation(entry, value, "an integer" if entry.type == "integer" else "a number")
    # An int is finite however large; math.isfinite would try to make a float of it.
    finite = isinstance(value, int) or math.isfinite(value)
    if not finite or (entry.type == "integer" and not isinstance(value, int)):
        return _violation(entry, value, "an integer" if entry.type == "integer" else "a finite number")
    for bound in entry.bounds:
        if bound.holds_in(sizes.version) and not bound.allows(value, sizes):
            return _violation(entry, value, bound.describe(sizes))
    return None


def _violation(entry: Parameter, value: object, bound: str) -> Violation:
    return Violation(parameter=entry.name, value=value, bound=bound, requirement=entry.requirement)
