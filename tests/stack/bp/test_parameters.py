"""The parameters of BP: values, bounds, defaults, and that invalid ones change nothing."""

from __future__ import annotations

import math

import msgspec
import pytest
from dcp_spec.parameters import UnknownParameterError, Violation

from dcp_codec.codec import Codec, get_codec

from ..bp_rig import ME, ONCE, REPEAT, SINCE_1_1, VERSIONS, Rig

PERIOD, SIZE, NETWORK = "BPPAR_BEACON_PERIOD", "BPPAR_MAXIMUM_PACKET_SIZE", "BPPAR_NETWORK_ID"


@pytest.mark.req("BP-PAR-01")
@pytest.mark.req("BP-PAR-03")
@pytest.mark.req("BP-PAR-04")
@pytest.mark.req("BP-PAR-08")
@pytest.mark.req("BP-PAR-10")
@pytest.mark.parametrize("version", VERSIONS)
def test_defaults(version):
    expected = {
        PERIOD: 100,
        SIZE: 1500,
        "UWB-MaxPacketSize": 1500,
        "ownNodeIdentifier": ME,
        "protocol type": 0x4953,
    }
    if version == "2.0":
        expected[NETWORK] = 0x1111
    assert Rig(version).bp.parameters() == expected


def test_values_of_the_configuration():
    rig = Rig(beacon_period_ms=40, max_packet_size=300, network_id=7)
    found = rig.bp.parameters()
    assert (found[PERIOD], found[SIZE], found[NETWORK]) == (40, 300, 7)


def test_limits_of_the_profile():
    found = Rig(profile="cpp-2.0").bp.parameters()
    assert (found[SIZE], found["UWB-MaxPacketSize"]) == (1000, 1492)


@pytest.mark.req("BP-PAR-01")
@pytest.mark.req("BP-PAR-06")
@pytest.mark.req("BP-PAR-07")
@pytest.mark.parametrize(
    ("name", "valid", "invalid"),
    [
        (PERIOD, [1, 0.5, 250, 10**6], [0, -1, math.inf, math.nan, "100", None, True]),
        (SIZE, [22, 23, 1499, 1500], [21, 1501, 0, -1, 100.0, "100", None, True]),
        (NETWORK, [0, 1, 0xFFFF], [-1, 0x10000, 1.0, "1", None, False]),
    ],
)
def test_valid_values_are_set_and_invalid_ones_are_refused(name, valid, invalid):
    rig = Rig()
    for value in valid:
        assert rig.bp.set_parameter(name, value) is None
        assert rig.bp.parameters()[name] == value
    before = rig.bp.parameters()
    for value in invalid:
        violation = rig.bp.set_parameter(name, value)
        assert isinstance(violation, Violation)
        assert violation.parameter == name
        assert violation.requirement.startswith("BP-PAR-")
        assert str(violation)
        assert rig.bp.parameters() == before


@pytest.mark.req("BP-PAR-04")
@pytest.mark.parametrize("version", SINCE_1_1)
def test_bounds_of_the_packet_size(version):
    rig = Rig(version)
    assert rig.bp.set_parameter(SIZE, rig.header + 4) is None
    assert rig.bp.set_parameter(SIZE, rig.header + 3) is not None
    assert rig.bp.set_parameter(SIZE, 1500) is None
    assert rig.bp.set_parameter(SIZE, 1501) is not None


@pytest.mark.req("BP-PAR-04")
def test_the_least_size_leaves_no_registration():
    rig = Rig(max_packet_size=22)
    assert rig.register(size=1).status == "BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE"


@pytest.mark.parametrize("version", SINCE_1_1)
def test_reading_x05(version):
    rig = Rig(version, readings={"X05": "usable-minimum"})
    assert "X05" in str(rig.bp.set_parameter(SIZE, rig.header + 4))
    assert rig.bp.set_parameter(SIZE, rig.header + 5) is None
    assert rig.bp.set_parameter(PERIOD, 1) is None


@pytest.mark.req("BP-PAR-05")
@pytest.mark.parametrize("version", VERSIONS[:-1])
def test_the_network_identifier_exists_since_2_0(version):
    rig = Rig(version)
    assert "before version 2.0" in str(rig.bp.set_parameter(NETWORK, 1))
    assert NETWORK not in rig.bp.parameters()


@pytest.mark.req("BP-PAR-08")
@pytest.mark.req("BP-PAR-09")
@pytest.mark.parametrize(
    ("name", "value"), [("UWB-MaxPacketSize", 1400), ("ownNodeIdentifier", bytes(6)), ("protocol type", 0x0800)]
)
def test_fixed_parameters_cannot_be_set(name, value):
    rig = Rig()
    before = rig.bp.parameters()
    assert "left alone" in str(rig.bp.set_parameter(name, value))
    assert rig.bp.parameters() == before


@pytest.mark.parametrize("name", ["BP_BEACON_PERIOD", "", "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", "VARDISPAR_MAX_SUMMARIES"])
def test_unknown_parameters(name):
    with pytest.raises(UnknownParameterError):
        Rig().bp.set_parameter(name, 1)


@pytest.mark.parametrize(
    "settings",
    [
        {"beacon_period_ms": 0},
        {"max_packet_size": 21},
        {"max_packet_size": 1501},
        {"network_id": 0x10000},
        {"network_id": -1},
    ],
)
def test_a_configuration_out_of_bounds(settings):
    with pytest.raises(ValueError, match=r"BPPAR_.* must be"):
        Rig(**settings)


@pytest.mark.req("UWB-03")
@pytest.mark.parametrize(("version", "size", "good"), [("2.0", 256, True), ("2.0", 255, False), ("1.0", 255, True)])
def test_a_bearer_must_carry_at_least_256_octets(version, size, good):
    profile = get_codec(f"dcp-{version}").profile
    limits = msgspec.structs.replace(profile.limits, uwb_max_packet=size, max_beacon_size=size)
    codec = Codec(msgspec.structs.replace(profile, name="small", limits=limits))
    if good:
        assert Rig(codec=codec).bp.parameters()["UWB-MaxPacketSize"] == size
    else:
        with pytest.raises(ValueError, match="UWB-MaxPacketSize must be at least 256"):
            Rig(codec=codec)


@pytest.mark.req("BP-PAR-02")
@pytest.mark.req("BP-PAR-05")
@pytest.mark.req("BP-HDR-04")
def test_a_network_identifier_is_in_the_next_beacon():
    rig = Rig()
    rig.register(7, REPEAT)
    rig.submit(b"A")
    assert rig.beacon().bp.network_id == 0x1111
    rig.bp.set_parameter(NETWORK, 0xFFFE)
    assert rig.beacon().bp.network_id == 0xFFFE
    rig.bp.set_parameter(NETWORK, -1)
    assert rig.beacon().bp.network_id == 0xFFFE


@pytest.mark.req("BP-PAR-02")
@pytest.mark.req("BP-PAR-06")
def test_a_packet_size_holds_from_the_next_beacon_on():
    rig = Rig()
    for protocol in (1, 2):
        rig.register(protocol, REPEAT)
        rig.submit(bytes(50), protocol)
    assert len(rig.tick()) == 2
    rig.bp.set_parameter(SIZE, 100)
    assert len(rig.tick()) == 1
    rig.bp.set_parameter(SIZE, 0)
    assert len(rig.tick()) == 1
    rig.bp.set_parameter(SIZE, 1500)
    assert len(rig.tick()) == 2


@pytest.mark.req("BP-PAR-02")
def test_a_packet_size_holds_for_the_next_registration():
    rig = Rig()
    rig.register(7, ONCE, size=1478)
    rig.bp.set_parameter(SIZE, 100)
    assert rig.register(8, ONCE, size=79).status == "BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE"
    assert [entry.max_payload_size for entry in rig.bp.list_registered().protocols] == [1478]
