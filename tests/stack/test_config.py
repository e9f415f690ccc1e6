"""Configuration of a node: sizes of a profile, readings by name."""

from __future__ import annotations

import msgspec
import pytest
from dcp_spec.profile.loading import profile_names

from dcp_codec import Codec
from dcp_codec.values import Container, VarDelete
from dcp_stack.config import BPConfig, NodeConfig, VardisConfig
from dcp_stack.readings import Readings
from dcp_stack.vardis.parameters import VardisParameters


def config(profile: str, **rest: object) -> NodeConfig:
    return NodeConfig(node_id=bytes((2, 0, 0, 0, 0, 1)), codec=Codec(profile), **rest)


@pytest.mark.parametrize(
    ("profile", "header", "block", "spec"),
    [
        ("dcp-1.0", 14, 4, 9),
        ("dcp-1.1", 14, 4, 9),
        ("dcp-1.3", 16, 4, 9),
        ("dcp-2.0", 18, 4, 19),
        ("cpp-2.0", 18, 4, 19),
        ("student-2024", 0, 12, 16),
    ],
)
def test_sizes_of_records(profile, header, block, spec):
    found = config(profile).sizes
    assert (found.bp_header, found.bp_payload_header, found.var_spec_fixed) == (header, block, spec)


@pytest.mark.parametrize("profile", profile_names())
def test_every_profile_has_sizes(profile):
    assert config(profile).sizes.version == Codec(profile).profile.spec_version


@pytest.mark.parametrize("profile", profile_names())
@pytest.mark.req("VD-PAY-06")
def test_the_computed_size_of_a_container_is_right(profile):
    found, codec = config(profile), Codec(profile)
    delete = codec.profile.vardis.container_types.by_name()["DELETE-VARIABLES"]
    octets = codec.encode_containers((Container(delete, (VarDelete(1),)),))
    assert len(octets) == found.sizes.ic_header + codec.profile.types.var_id.width


def test_readings_are_chosen_by_name():
    assert config("dcp-2.0").selected_readings == Readings()
    assert config("dcp-2.0", readings={"X04": "blocks-only"}).selected_readings == Readings(packet_size="blocks-only")


@pytest.mark.parametrize("profile", profile_names())
def test_a_profile_states_readings(profile):
    stated = Codec(profile).profile.behaviour
    halves = {"neither": "half-range-neither", "newer": "half-range-answered", "older": "half-range-older"}
    errors = {"skip-element": "skip-container"}.get(stated.vardis_receive_error, stated.vardis_receive_error)
    expected = Readings(half_range=halves[stated.seqno_half_range], receive_errors=errors)
    assert config(profile).selected_readings == expected
    chosen = config(profile, readings={"X28": "half-range-older", "X34": "drop-payload"}).selected_readings
    assert chosen == Readings(half_range="half-range-older", receive_errors="drop-payload")


@pytest.mark.parametrize("readings", [{"X04": "nonsense"}, {"X99": "with-header"}, {"X09": "any"}])
def test_readings_that_do_not_exist_are_refused(readings):
    with pytest.raises((ValueError, KeyError)):
        config("dcp-2.0", readings=readings)


def test_a_node_id_of_another_width_is_refused():
    with pytest.raises(ValueError, match="has 3 octets, not 6"):
        NodeConfig(node_id=b"abc", codec=Codec("dcp-2.0"))


def test_derived_values_are_computed_once_per_configuration():
    asked: list[NodeConfig] = []

    def find(found: NodeConfig) -> int:
        asked.append(found)
        return found.bp.beacon_period_ms

    first = config("dcp-2.0")
    assert (first.once(find), first.once(find), len(asked)) == (100, 100, 1)
    assert first.sizes is first.sizes
    other = msgspec.structs.replace(
        first, bp=BPConfig(beacon_period_ms=50, max_packet_size=300), readings={"X02": "frame-size"}
    )
    assert (other.once(find), len(asked)) == (50, 2)
    assert (other.sizes.max_packet_size, other.selected_readings.beacon_end, first.selected_readings.beacon_end) == (
        300,
        "frame-size",
        "length-field",
    )


def test_errors_of_derived_values_are_raised_each_time():
    wrong = config("dcp-2.0", vardis=VardisConfig(max_repetitions=0))
    for _ in range(2):
        with pytest.raises(ValueError, match="VARDISPAR_MAX_REPETITIONS"):
            VardisParameters(wrong)


def test_parameters_of_nodes_with_one_configuration_are_their_own():
    shared = config("dcp-2.0")
    one, other = VardisParameters(shared), VardisParameters(shared)
    assert one.set("VARDISPAR_MAX_SUMMARIES", 3) is None
    assert (one.max_summaries, other.max_summaries == 3) == (3, False)
    assert VardisParameters(shared).max_summaries == other.max_summaries
