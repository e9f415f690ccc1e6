"""Variants with extreme permitted values of parameters, known to the tester from the node, the PIXIT or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from dcp_conformance.definitions.pics import Testing
from dcp_conformance.reference.surroundings import Setup
from dcp_spec.constants import SpecVersion

from dcp_stack.config import BPConfig, SRPConfig, VardisConfig

from .services import ASSUMED_VALUE, GETTERS
from .variant import Variant, anywhere, has_srp, setup, without

_V = SpecVersion


class _Corner(NamedTuple):
    """A parameter with its extreme values."""

    name: str
    parameter: str
    requirement: str
    configure: Callable[[int], dict[str, Any]]
    pixit: str
    values: tuple[int, ...]
    since: SpecVersion = _V.V1_0


def _vardis(field: str) -> Callable[[int], dict[str, Any]]:
    return lambda value: {"vardis": VardisConfig(**{field: value})}


#: Inconclusive verdicts that follow from a value, by corner.
_EXPLAINS: Final = {
    # No permitted payload size limits the length further.
    "value-255": (r"^TC_VD_PAR_BI_02: a payload size whose limit is below",),
    "description-255": (
        r"^TC_VD_PAR_BI_02: a payload size whose limit is below",
        # The length field cannot express a longer one.
        r"^TC_DCP_DATA_BI_02: a description longer than the maximum",
    ),
    # By the time of the update all repetitions may be over.
    "repetitions-3": (r"^TC_VD_UPD_BV_06: VarCreates with repetitions left",),
    "repetitions-2": (r"^TC_VD_UPD_BV_06: VarCreates with repetitions left",),
    # Without summaries VarDis sends no payloads after the repetitions.
    "summaries-0": (r"^TC_BP_HDR_BV_03: 4 beacons",),
}

_CORNERS = (
    _Corner("value", "VARDISPAR_MAX_VALUE_LENGTH", "VD-PAR-02", _vardis("max_value_length"), "max_value_length",
        (16, 255)),
    _Corner("description", "VARDISPAR_MAX_DESCRIPTION_LENGTH", "VD-PAR-03", _vardis("max_description_length"),
        "max_description_length", (17, 255)),
    _Corner("repetitions", "VARDISPAR_MAX_REPETITIONS", "VD-PAR-04", _vardis("max_repetitions"), "max_repetitions",
        (1, 2, 3)),
    _Corner("payload", "VARDISPAR_MAX_PAYLOAD_SIZE", "VD-PAR-05", _vardis("max_payload_size"), "max_payload_size",
        (120, 400)),
    _Corner("summaries", "VARDISPAR_MAX_SUMMARIES", "VD-PAR-06", _vardis("max_summaries"), "max_summaries",
        (0, 1, 100)),
    _Corner("check", "VARDISPAR_BUFFER_CHECK_PERIOD", "VD-PAR-08", _vardis("buffer_check_period_ms"),
        "buffer_check_period_ms", (3, 150)),
    _Corner("scrubbing", "VARDISPAR_SCRUBBING_PERIOD", "VD-PAR-07", _vardis("scrubbing_period_ms"),
        "scrubbing_period_ms", (10, 3000), _V.V2_0),
    _Corner(
        "packet",
        "BPPAR_MAXIMUM_PACKET_SIZE",
        "BP-PAR-04",
        lambda value: {
            "bp": BPConfig(max_packet_size=value),
            "vardis": VardisConfig(max_payload_size=_payload_in(value)),
        },
        "max_packet_size",
        (300, 600, 1200),
    ),
    _Corner("network", "BPPAR_NETWORK_ID", "BP-PAR-05", lambda value: {"bp": BPConfig(network_id=value)}, "network_id",
        (0, 0xFFFF), _V.V2_0),
    _Corner("neighbours", "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", "SRP-PAR-01",
        lambda value: {"srp": SRPConfig(neighbour_table_timeout_ms=value)}, "neighbour_timeout_ms",
        (500, 5000, 20_000)),
)  # fmt: skip


def _payload_in(packet: int) -> int:
    """Return a size of VarDis payloads, in octets, that fits into packets of ``packet`` octets."""
    return min(packet - 60, 1000)


def _testing(name: str, value: int) -> Testing:
    named: dict[str, Any] = {name: value}
    if name == "max_packet_size":
        named["max_payload_size"] = _payload_in(value)
    return Testing(**named)


def _build(corner: _Corner, value: int, knowledge: str) -> Callable[[str], Setup]:
    def build(profile: str) -> Setup:
        pixit = _testing(corner.pixit, value) if knowledge == "pixit" else Testing()
        hidden = GETTERS if knowledge != "get" else ()
        return setup(profile, **corner.configure(value), pixit=pixit, upper=without(*hidden))

    return build


#: Sources from which the tester gets the value.
_SOURCES = {"get": "reported by its upper tester", "pixit": "stated in the PIXIT", "unknown": "unknown to the tester"}


def _variants() -> Iterator[Variant]:
    for corner in _CORNERS:
        for value in corner.values:
            for knowledge, how in _SOURCES.items():
                if knowledge == "unknown" and corner.name == "network":
                    # With a wrong network identifier all beacons are discarded, and nothing can be tested.
                    continue
                yield Variant(
                    f"V-PAR-{corner.name}-{value}-{knowledge}",
                    f"has {corner.parameter} = {value}, {how}",
                    corner.requirement,
                    _build(corner, value, knowledge),
                    since=corner.since,
                    explains=(
                        *_EXPLAINS.get(f"{corner.name}-{value}", ()),
                        *(() if knowledge == "get" else (ASSUMED_VALUE,)),
                    ),
                    where=has_srp if corner.name == "neighbours" else anywhere,
                )


VARIANTS = tuple(_variants())
