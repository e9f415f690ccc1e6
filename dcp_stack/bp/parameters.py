"""The parameters of BP (dcp-bp.md#bp-interface-configurable-parameters and -non-configurable-parameters)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from dcp_spec.constants import SpecVersion
from dcp_spec.parameters import Sizes, UnknownParameterError, Violation, parameter, validate

from dcp_stack.config import MS, NodeConfig

PERIOD: Final = "BPPAR_BEACON_PERIOD"
MAX_PACKET: Final = "BPPAR_MAXIMUM_PACKET_SIZE"
NETWORK: Final = "BPPAR_NETWORK_ID"
UWB_MAX_PACKET: Final = "UWB-MaxPacketSize"
OWN_NODE: Final = "ownNodeIdentifier"
PROTOCOL_TYPE: Final = "protocol type"

LONGEST_PERIOD: Final = 1 << 43
"""ms. The specification has no upper bound; this one keeps the period in ns below 2^63."""


class BPParameters:
    """Current values under the specification's names: the period in ms, sizes in octets."""

    def __init__(self, config: NodeConfig) -> None:
        """Raises ValueError, naming the parameter and its bound, for a configuration that is out of bounds."""
        profile = config.profile
        self._sizes = config.sizes
        self._usable_minimum = _has_usable_minimum(config)
        # Read-only after construction.
        self._fixed: dict[str, int | bytes] = {
            ##= BP-PAR-08 UWB-03
            UWB_MAX_PACKET: profile.limits.uwb_max_packet,
            ##= BP-PAR-09 DATA-14
            OWN_NODE: config.node_id,
        }
        ##= BP-PAR-10
        # Only the link uses it; the entity keeps it for queries.
        if profile.link.ether_type is not None:
            self._fixed[PROTOCOL_TYPE] = profile.link.ether_type
        self._values = dict(config.once(_initial))

    ##= BP-PAR-01 BP-PAR-12
    def as_dict(self) -> dict[str, Any]:
        """Return all values by name, configurable ones first."""
        return {**self._values, **self._fixed}

    def set(self, name: str, value: object) -> Violation | None:
        """Set a value; a returned violation means that the old value was kept.

        Raises ``UnknownParameterError`` for a name that is not a parameter of BP.
        """
        entry = parameter(name)
        if entry.protocol != "BP":
            raise UnknownParameterError(f"BP has no parameter {name!r}")
        if not entry.configurable:
            bound = "left alone: it is determined once, during initialization"
            return Violation(parameter=name, value=value, bound=bound, requirement=entry.requirement)
        violation = validate(name, value, self._sizes) or _unusable(name, value, self._sizes, self._usable_minimum)
        ##= BP-PAR-06 BP-PAR-13
        if violation is None:
            self._values[name] = value
        ##= BP-PAR-07
        return violation

    @property
    def period(self) -> int:
        """BPPAR_BEACON_PERIOD in ns, 1 to ``LONGEST_PERIOD``."""
        period: float = self._values[PERIOD]
        return max(round(min(period, LONGEST_PERIOD) * MS), 1)

    @property
    def max_packet_size(self) -> int:
        """BPPAR_MAXIMUM_PACKET_SIZE in octets."""
        size: int = self._values[MAX_PACKET]
        return size

    @property
    def uwb_max_packet_size(self) -> int:
        """UWB-MaxPacketSize in octets."""
        size = self._fixed[UWB_MAX_PACKET]
        assert isinstance(size, int)
        return size

    @property
    def network_id(self) -> int | None:
        """BPPAR_NETWORK_ID; None where beacons have no such field."""
        network: int | None = self._values.get(NETWORK)
        return network


def _initial(config: NodeConfig) -> Mapping[str, Any]:
    """The initial values of a node."""
    profile, settings = config.profile, config.bp
    ##= BP-PAR-14 | exception: a profile or a configuration may say that an implementation starts with another size
    max_packet = settings.max_packet_size
    initial: dict[str, Any] = {
        ##= BP-PAR-15
        PERIOD: settings.beacon_period_ms,
        MAX_PACKET: profile.limits.max_beacon_size if max_packet is None else max_packet,
    }
    if config.features.network_id and profile.has_header_field("networkId"):
        ##= BP-PAR-05
        network = profile.bp.network_id if settings.network_id is None else settings.network_id
        initial[NETWORK] = 0 if network is None else network
    bearer = {UWB_MAX_PACKET: profile.limits.uwb_max_packet}
    for name, value in (*bearer.items(), *initial.items()):
        violation = validate(name, value, config.sizes)
        violation = violation or _unusable(name, value, config.sizes, _has_usable_minimum(config))
        if violation is not None:
            raise ValueError(str(violation))
    return MappingProxyType(initial)


def _has_usable_minimum(config: NodeConfig) -> bool:
    return config.selected_readings.smallest_packet == "usable-minimum" and config.features.version >= SpecVersion.V1_1


def _unusable(name: str, value: object, sizes: Sizes, usable_minimum: bool) -> Violation | None:
    """Return a violation under reading X05 ``usable-minimum`` if not one octet of payload fits."""
    least = sizes.bp_header + sizes.bp_payload_header + 1
    if name != MAX_PACKET or not usable_minimum or (isinstance(value, int) and value >= least):
        return None
    bound = f"at least {least} (BPHeaderT + BPPayloadHeaderT + 1 by reading X05)"
    return Violation(parameter=name, value=value, bound=bound, requirement="BP-PAR-04")
