"""How a node is set up: identity, profile, parameters under the specification's names, and chosen readings."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import msgspec
from dcp_spec.catalogue.readings import reading
from dcp_spec.constants import Features, ICType, SpecVersion, features
from dcp_spec.parameters import Sizes
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.usability import refusal

from dcp_codec.codec import Codec
from dcp_codec.plan.measures import least_size, record
from dcp_codec.plan.tree import Scalar

from .own_fields import OwnSpecFields
from .positions.fields import SafetyFields
from .record_sizes import RecordSizes

MS = 1_000_000
"""ns in a millisecond."""
Found = TypeVar("Found")


MAX_NEIGHBOURS = 4096
MAX_VARIABLES = 65_536


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
    triggered: bool = False
    """A new payload brings the next beacon forward to now (BP-TXP-07)."""


class SRPConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """State reporting (dcp-srp.md#srp-configurable-parameters)."""

    neighbour_table_timeout_ms: int = 3000
    """SRPPAR_NEIGHBOUR_TABLE_TIMEOUT (SRP-PAR-01)."""
    max_neighbours: int | None = None
    """Entries of the neighbour table, 1 or more; for a further one an old one is given up: nothing received may use up
    memory. None for the profile's limit, or :data:`MAX_NEIGHBOURS` if it has none."""
    safety_data: Mapping[str, float | int | str] | None = None
    """Safety data handed down at start, by the profile's field names; None for none."""


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
    """How long before a beacon its payload is composed (X54); 0 is in the same step, which misses nothing."""
    max_variables: int | None = None
    """Variables beyond this are not taken from others and refused to applications. None for the profile's limit, or
    :data:`MAX_VARIABLES` if it has none."""
    max_creation_ahead_s: float | None = None
    """Ignore a VarCreate whose creation time is further ahead of the own clock than this (s, 0 or more): a forged one
    in the future keeps the producer from creating its variable again until then. None follows the specification, which
    has no such bound."""
    bp_queue_entries: int = 1
    """maxEntries with which VarDis registers (VD-INI-02): one payload, so that what is sent is fresh."""


class NodeConfig(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """A whole node. ``readings`` chooses among the alternatives of disputed text (docs/readings.md) by id.

    What follows from it alone is found out once, so that many nodes can be made of one configuration.
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
    """Classes derived from ``dcp_stack.vardis.instructions.Instruction``, for container types of the profile's own."""

    def __post_init__(self) -> None:
        """Raises ``ValueError`` for a node id of the wrong width or a choice that a reading does not have.

        Also for a profile with fields of the implementation's own that a node cannot fill
        (``dcp_spec.profile.usability``). Raises ``UnknownReadingError`` for an id that is not a reading's.
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
        """What the specification version of the profile has (C.7)."""
        return features(self.profile.spec_version)

    @functools.cached_property
    def named_version(self) -> SpecVersion:
        """The version in the names under which SRP and VarDis register (X31)."""
        version = self.profile.spec_version
        return min(version, SpecVersion.V1_3) if self.reading("X31") == "as-written" else version

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
    def own_spec_fields(self) -> OwnSpecFields:
        """The fields that the profile adds to VarSpec."""
        return OwnSpecFields(self.codec)

    @functools.cached_property
    def container_numbers(self) -> Mapping[ICType, int]:
        """How the profile numbers the types of instruction containers (VD-IC-02)."""
        numbers = self.profile.vardis.container_types.by_name()
        return {kind: numbers[kind.label] for kind in ICType}

    def once(self, find: Callable[[NodeConfig], Found]) -> Found:
        """What ``find`` makes of this configuration, the first time it is asked for; nobody may change it."""
        if find not in self._once:
            self._once[find] = find(self)
        found: Found = self._once[find]
        return found

    @functools.cached_property
    def _once(self) -> dict[Callable[[NodeConfig], Any], Any]:
        return {}

    def reading(self, identifier: str) -> str:
        """The chosen alternative of a disputed text; ours unless ``readings`` says otherwise."""
        chosen = self._chosen.get(identifier)
        if chosen is None:
            default = reading(identifier).default
            chosen = self._chosen[identifier] = self.readings.get(identifier) or (
                "" if default is None else default.name
            )
        return chosen

    @functools.cached_property
    def _chosen(self) -> dict[str, str]:
        return {}


def _sizes(config: NodeConfig) -> Sizes:
    profile, records, plan = config.profile, config.record_sizes, config.codec.envelope_plan
    header, block = record(plan, "BPHeader"), record(plan, "Payload")
    assert block is not None
    # Identifiers of varying length are counted as long as the own one.
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
        var_spec_fixed=records.var_spec + own_id,
        var_update_fixed=records.var_update,
        var_summ=records.var_summ,
        max_packet_size=config.bp.max_packet_size or profile.limits.max_beacon_size,
        max_payload_size=profile.limits.max_vardis_payload,
        max_value_length=profile.limits.max_value_length,
    )
