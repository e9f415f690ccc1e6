"""Configuration of a node: identity, profile, parameters by their names in the specification, and readings."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeVar

import msgspec
from dcp_spec.catalogue.readings import reading
from dcp_spec.constants import Features, ICType, SpecVersion, features
from dcp_spec.parameters import Sizes
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.usability import refusal

from dcp_codec.codec import Codec
from dcp_codec.plan.measures import least_size, record
from dcp_codec.plan.tree import Scalar

from .own_fields import OwnFields, Rule
from .positions.fields import SafetyFields
from .readings import HalfRange, Readings, ReceiveErrors
from .record_sizes import RecordSizes

MS = 1_000_000
"""ns in a millisecond."""
Found = TypeVar("Found")


MAX_NEIGHBOURS = 4096
MAX_VARIABLES = 65_536
#: The alternatives of X28 and X34 for the behaviour that a profile states.
_HALF_RANGE: Mapping[str, HalfRange] = {
    "neither": "half-range-neither",
    "newer": "half-range-answered",
    "older": "half-range-older",
}
_RECEIVE_ERRORS: Mapping[str, ReceiveErrors] = {
    "keep-prefix": "keep-prefix",
    "drop-payload": "drop-payload",
    "skip-element": "skip-container",
}


class BPConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Beaconing (dcp-bp.md#bp-interface-configurable-parameters). Sizes in octets, the period in ms."""

    beacon_period_ms: int = 100
    """BPPAR_BEACON_PERIOD (BP-PAR-03)."""
    max_packet_size: int | None = None
    """BPPAR_MAXIMUM_PACKET_SIZE; None for the profile's max_beacon_size (BP-PAR-04)."""
    network_id: int | None = None
    """BPPAR_NETWORK_ID; None for the profile's value (BP-PAR-05)."""
    jitter: float = 0.1
    """Each interval is the period times a uniform factor in 1 - jitter .. 1 + jitter (BP-TX-02); 0 is strict."""
    intervals: Literal["uniform", "fixed", "exponential"] = "uniform"
    """Distribution of the intervals: ``uniform`` as ``jitter`` says, ``fixed`` without jitter, or ``exponential`` with
    the period as the mean."""
    triggered: bool = False
    """A new payload brings the next beacon forward to now (BP-TXP-07)."""


class SRPConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """State reporting (dcp-srp.md#srp-configurable-parameters)."""

    neighbour_table_timeout_ms: int = 3000
    """SRPPAR_NEIGHBOUR_TABLE_TIMEOUT (SRP-PAR-01)."""
    max_neighbours: int | None = None
    """Entries of the neighbour table, 1 or more. A full table replaces an old entry, so that received frames cannot use
    up memory. None for the profile's limit, or :data:`MAX_NEIGHBOURS` if it has none."""
    safety_data: Mapping[str, float | int | str] | None = None
    """Safety data submitted at start, by the profile's field names; None to submit none."""


class VardisConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Variable dissemination (dcp-vardis.md#vardis-configurable-parameters); None takes the profile's limit."""

    max_value_length: int | None = None
    max_description_length: int | None = None
    max_repetitions: int | None = None
    max_payload_size: int | None = None
    max_summaries: int | None = None
    scrubbing_period_ms: int = 1000
    buffer_check_period_ms: int = 50
    compose_lead_ms: float = 0.0
    """Time in ms from the composition of a payload to its beacon (X54). 0 composes it in the step of the beacon."""
    max_variables: int | None = None
    """Size of the database. A full one ignores new variables of other nodes and refuses those of applications. None for
    the profile's limit, or :data:`MAX_VARIABLES` if it has none."""
    max_creation_ahead_s: float | None = None
    """A VarCreate is ignored if its creation time is later than the own clock by more than this (s, 0 or more).
    A forged creation time in the future prevents the producer from creating its variable again until then. None
    follows the specification, which has no such bound."""
    seqno_modulus: int | None = None
    """Number of sequence numbers (2 or more), for studies of their wrap in small networks; all nodes of a network need
    the same. None: those that the field of the profile can hold."""
    bp_queue_entries: int = 1
    """maxEntries with which VarDis registers (VD-INI-02): one payload, so that a beacon carries the latest."""


class NodeConfig(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """Configuration of a node. ``readings`` selects alternatives of ambiguous text (docs/readings.md) by id.

    Values derived from it are computed once and shared by all nodes with this configuration.
    """

    node_id: bytes
    codec: Codec
    bp: BPConfig = BPConfig()
    srp: SRPConfig | None = SRPConfig()
    """None: no SRP on this node."""
    vardis: VardisConfig | None = VardisConfig()
    """None: no VarDis on this node."""
    readings: Mapping[str, str] = msgspec.field(default_factory=dict)
    instructions: tuple[Callable[[Any], Any], ...] = ()
    """Subclasses of ``dcp_stack.vardis.instructions.Instruction`` for container types that the profile adds."""
    field_rules: Mapping[str, Rule] = msgspec.field(default_factory=dict)
    """Values of fields that the profile adds, in records of this node (``dcp_stack.own_fields.FIELD_RULES``)."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises ``ValueError`` for a node id of the wrong width, for an alternative that a reading does not have, and
        for a profile with additional fields that a node cannot fill (``dcp_spec.profile.usability``). Raises
        ``UnknownReadingError`` for the id of an unknown reading.
        """
        if (unusable := refusal(self.profile)) is not None:
            raise ValueError(unusable)
        layout = self.profile.types.node_id
        if layout.length is None and len(self.node_id) != layout.width:
            raise ValueError(f"node id {self.node_id.hex(':')} has {len(self.node_id)} octets, not {layout.width}")
        for identifier, choice in self.readings.items():
            reading(identifier).alternative(choice)

    @property
    def profile(self) -> Profile:
        """The wire profile."""
        return self.codec.profile

    @functools.cached_property
    def features(self) -> Features:
        """Features of the profile's specification version (C.7)."""
        return features(self.profile.spec_version)

    @functools.cached_property
    def named_version(self) -> SpecVersion:
        """The version in the names under which SRP and VarDis register (X31)."""
        version = self.profile.spec_version
        return min(version, SpecVersion.V1_3) if self.selected_readings.registered_version == "as-written" else version

    @functools.cached_property
    def selected_readings(self) -> Readings:
        """The alternatives in ``readings``; for others what the profile states (X28, X34), or the default."""
        stated = self.profile.behaviour
        alternatives = {
            "X28": _HALF_RANGE[stated.seqno_half_range],
            "X34": _RECEIVE_ERRORS[stated.vardis_receive_error],
            **self.readings,
        }
        return msgspec.convert(alternatives, Readings)

    @functools.cached_property
    def sizes(self) -> Sizes:
        """The serialized sizes that bounds of parameters depend on."""
        return _sizes(self)

    @functools.cached_property
    def record_sizes(self) -> RecordSizes:
        """Sizes of VarDis records, and the ranges of their fields."""
        return RecordSizes(self.codec)

    @functools.cached_property
    def safety_fields(self) -> SafetyFields:
        """The safety data of the profile."""
        return SafetyFields(self.profile)

    @functools.cached_property
    def own_fields(self) -> OwnFields:
        """The fields that the profile adds to records."""
        return OwnFields(self.codec, self.field_rules)

    @functools.cached_property
    def container_numbers(self) -> Mapping[ICType, int]:
        """The numbers of the instruction container types in the profile (VD-IC-02)."""
        numbers = self.profile.vardis.container_types.by_name()
        return {kind: numbers[kind.label] for kind in ICType}

    def once(self, find: Callable[[NodeConfig], Found]) -> Found:
        """Return ``find(self)``, computed at the first call and shared afterwards; callers must not modify it."""
        if find not in self._once:
            self._once[find] = find(self)
        found: Found = self._once[find]
        return found

    @functools.cached_property
    def _once(self) -> dict[Callable[[NodeConfig], Any], Any]:
        return {}


def _sizes(config: NodeConfig) -> Sizes:
    profile, records, plan = config.profile, config.record_sizes, config.codec.envelope_plan
    header, block = record(plan, "BPHeader"), record(plan, "Payload")
    assert block is not None
    # The size of a variable-length identifier is taken to be that of the own identifier.
    own_id = 0 if records.node_id_width is not None else len(config.node_id)
    return Sizes(
        version=profile.spec_version,
        uwb_max_packet_size=profile.limits.uwb_max_packet,
        node_id=profile.types.node_id.width,
        network_id=profile.types.network_id.width,
        var_len=records.value_length_width,
        bp_header=0 if header is None else least_size(header),
        bp_payload_header=sum(each.size for each in block.members if isinstance(each, Scalar)),
        ic_header=records.ic_header,
        # With the fields that the profile adds to VarCreate itself.
        var_spec_fixed=records.var_create - records.var_update + own_id,
        var_update_fixed=records.var_update,
        var_summ=records.var_summ,
        max_packet_size=config.bp.max_packet_size or profile.limits.max_beacon_size,
        max_payload_size=profile.limits.max_vardis_payload,
        max_value_length=profile.limits.max_value_length,
    )
