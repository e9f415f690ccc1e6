import math
import re

import pytest
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion
from dcp_spec.parameters import Sizes, UnknownParameterError, parameter, parameters, validate
from hypothesis import given
from hypothesis import strategies as st

# The C++ implementation of the draft 2.0: 18-byte BP header, MTU 1492.
CPP = Sizes(uwb_max_packet_size=1492)
V1_0 = Sizes(version=SpecVersion.V1_0, uwb_max_packet_size=1492, bp_header=14, var_spec_fixed=8)
V1_1 = Sizes(version=SpecVersion.V1_1, uwb_max_packet_size=1492, bp_header=14, var_spec_fixed=9)
V1_3 = Sizes(version=SpecVersion.V1_3, uwb_max_packet_size=1492, bp_header=16, var_spec_fixed=9)
SMALL = Sizes(uwb_max_packet_size=1492, max_packet_size=256, max_payload_size=100, max_value_length=40)

BOUNDARIES = [
    # name, sizes, least valid value, greatest valid value
    ("BPPAR_MAXIMUM_PACKET_SIZE", CPP, 18 + 4, 1492),
    ("BPPAR_MAXIMUM_PACKET_SIZE", V1_3, 16 + 4, 1492),
    ("BPPAR_NETWORK_ID", CPP, 0, 0xFFFF),
    ("BPPAR_NETWORK_ID", Sizes(uwb_max_packet_size=1492, network_id=4), 0, 0xFFFFFFFF),
    ("UWB-MaxPacketSize", CPP, 256, None),
    ("protocol type", CPP, 0x0600, 0xFFFF),
    ("VARDISPAR_MAX_VALUE_LENGTH", CPP, 1, 255),
    ("VARDISPAR_MAX_VALUE_LENGTH", SMALL, 1, 100 - 2),
    ("VARDISPAR_MAX_VALUE_LENGTH", V1_0, 1, 255),
    ("VARDISPAR_MAX_DESCRIPTION_LENGTH", CPP, 1, 1470 - (2 + 19 + 3 + 32)),
    ("VARDISPAR_MAX_DESCRIPTION_LENGTH", SMALL, 1, 100 - (2 + 19 + 3 + 40)),
    ("VARDISPAR_MAX_DESCRIPTION_LENGTH", V1_3, 1, 1472 - (2 + 9 + 3 + 32)),
    ("VARDISPAR_MAX_DESCRIPTION_LENGTH", V1_0, 1, 1474 - (2 + 8 + 3 + 32)),
    ("VARDISPAR_MAX_REPETITIONS", CPP, 1, 15),
    ("VARDISPAR_MAX_REPETITIONS", V1_0, 1, 15),
    ("VARDISPAR_MAX_REPETITIONS", V1_1, 1, None),
    ("VARDISPAR_MAX_PAYLOAD_SIZE", CPP, 1, 1492 - 22),
    ("VARDISPAR_MAX_PAYLOAD_SIZE", SMALL, 1, 256 - 22),
    ("VARDISPAR_MAX_PAYLOAD_SIZE", V1_0, 1, None),
    ("VARDISPAR_MAX_SUMMARIES", CPP, 0, (1470 - 2) // 2),
    # 101 bytes leave 99 for summaries of two bytes: the half one does not count.
    ("VARDISPAR_MAX_SUMMARIES", Sizes(uwb_max_packet_size=1492, max_payload_size=101), 0, 49),
    ("VARDISPAR_MAX_SUMMARIES", V1_0, 0, None),
    ("VARDISPAR_SCRUBBING_PERIOD", CPP, 1, 65000),
    ("VARDISPAR_BUFFER_CHECK_PERIOD", CPP, 1, 65000),
    ("VARDISPAR_BUFFER_CHECK_PERIOD", V1_1, 1, None),
]


@pytest.mark.req("BP-PAR-04")
@pytest.mark.req("BP-PAR-05")
@pytest.mark.req("UWB-03")
@pytest.mark.req("VD-PAR-02")
@pytest.mark.req("VD-PAR-03")
@pytest.mark.req("VD-PAR-04")
@pytest.mark.req("VD-PAR-05")
@pytest.mark.req("VD-PAR-06")
@pytest.mark.req("VD-PAR-07")
@pytest.mark.req("VD-PAR-08")
@pytest.mark.parametrize(("name", "sizes", "least", "greatest"), BOUNDARIES)
def test_integer_bounds(name, sizes, least, greatest):
    assert validate(name, least, sizes) is None
    below = validate(name, least - 1, sizes)
    assert below is not None
    assert below.bound.startswith(f"at least {least}")
    if greatest is None:
        assert validate(name, 10**9, sizes) is None
        assert parameter(name).maximum(sizes) is None
    else:
        assert validate(name, greatest, sizes) is None
        above = validate(name, greatest + 1, sizes)
        assert above is not None
        assert above.bound.startswith(f"at most {greatest}")
        assert parameter(name).maximum(sizes) == greatest
    assert parameter(name).minimum(sizes) == least


@pytest.mark.req("BP-PAR-03")
def test_the_beacon_period_is_positive():
    assert validate("BPPAR_BEACON_PERIOD", 0.5, CPP) is None
    assert validate("BPPAR_BEACON_PERIOD", 86_400_000, CPP) is None
    for bad in (0, -1, -0.5):
        violation = validate("BPPAR_BEACON_PERIOD", bad, CPP)
        assert violation is not None
        assert (violation.value, violation.requirement) == (bad, "BP-PAR-03")
    # The text of 1.0 states no bound, but these are not periods.
    assert validate("BPPAR_BEACON_PERIOD", 0, V1_0) is not None
    assert validate("BPPAR_BEACON_PERIOD", -100, V1_0) is not None


@pytest.mark.req("SRP-PAR-01")
def test_the_neighbour_timeout_is_positive():
    assert validate("SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", 1, CPP) is None
    assert validate("SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", 0, CPP) is not None


@pytest.mark.req("BP-PAR-09")
def test_the_node_identifier_has_the_width_of_the_profile():
    assert validate("ownNodeIdentifier", b"\x02\0\0\0\0\xbb", CPP) is None
    assert validate("ownNodeIdentifier", b"\x02\0\0\0\0", CPP) is not None
    assert validate("ownNodeIdentifier", "02:00:00:00:00:bb", CPP) is not None


@pytest.mark.parametrize("bad", [True, "32", None, 32.0, 32.5, b"\x20"])
def test_an_integer_parameter_takes_integers_only(bad):
    violation = validate("VARDISPAR_MAX_VALUE_LENGTH", bad, CPP)
    assert violation is not None
    assert violation.bound == "an integer"


@pytest.mark.parametrize("bad", [True, "100", None, math.nan, math.inf])
def test_a_duration_takes_finite_numbers_only(bad):
    violation = validate("BPPAR_BEACON_PERIOD", bad, CPP)
    assert violation is not None
    assert violation.bound in {"a number", "a finite number"}


@pytest.mark.parametrize("name", ["BPPAR_NETWORK_ID", "VARDISPAR_SCRUBBING_PERIOD"])
def test_a_parameter_cannot_be_set_before_it_exists(name):
    violation = validate(name, 1, V1_3)
    assert violation is not None
    assert violation.bound == "left alone before version 2.0"
    assert validate(name, 1, CPP) is None


@pytest.mark.parametrize("entry", parameters().values(), ids=lambda entry: entry.name)
def test_every_parameter_cites_a_requirement_of_its_own(entry):
    cited = requirement(entry.requirement)
    assert entry.requirement.startswith(entry.protocol) or entry.requirement == "UWB-03"
    if re.match(r"[A-Z]+PAR_", entry.name):
        assert entry.configurable
        # The catalogue names the parameter, so citing the wrong one of its neighbours is noticed.
        assert entry.name in cited.statement
    else:
        assert not entry.configurable
    assert entry.meaning[0].isupper()
    assert entry.meaning.endswith(".")


def test_the_specification_has_eleven_configurable_parameters():
    assert sum(entry.configurable for entry in parameters().values()) == 11


def test_a_violation_explains_itself():
    violation = validate("VARDISPAR_MAX_PAYLOAD_SIZE", 1471, CPP)
    assert str(violation) == (
        "VARDISPAR_MAX_PAYLOAD_SIZE must be at most 1470 "
        "(BPPAR_MAXIMUM_PACKET_SIZE - (BPHeaderT + BPPayloadHeaderT)), not 1471 (VD-PAR-05)"
    )


def test_large_bounds_are_written_out():
    sizes = Sizes(uwb_max_packet_size=1492, network_id=8)
    violation = validate("BPPAR_NETWORK_ID", 1 << 64, sizes)
    assert violation is not None
    assert str((1 << 64) - 1) in violation.bound


def test_an_unknown_parameter_is_misuse():
    with pytest.raises(UnknownParameterError) as caught:
        validate("VARDISPAR_MAX_SUMMARIE", 1, CPP)
    assert isinstance(caught.value, KeyError)
    assert str(caught.value).startswith("no parameter 'VARDISPAR_MAX_SUMMARIE'; did you mean VARDISPAR_MAX_SUMMARIES")


def test_sizes_are_not_negative():
    with pytest.raises(ValueError, match="ic_header"):
        Sizes(uwb_max_packet_size=1492, ic_header=-1)


@given(
    max_packet=st.integers(22, 1492),
    payload=st.integers(1, 1492),
    value=st.integers(1, 300),
    description=st.integers(1, 1500),
)
@pytest.mark.req("VD-PAR-03")
def test_valid_parameters_leave_room_for_the_largest_create(max_packet, payload, value, description):
    """Parameters within all bounds let the longest description and value travel in one beacon (X23)."""
    sizes = Sizes(
        uwb_max_packet_size=1492,
        max_packet_size=max_packet,
        max_payload_size=payload,
        max_value_length=value,
    )
    chosen = {
        "BPPAR_MAXIMUM_PACKET_SIZE": max_packet,
        "VARDISPAR_MAX_PAYLOAD_SIZE": payload,
        "VARDISPAR_MAX_VALUE_LENGTH": value,
        "VARDISPAR_MAX_DESCRIPTION_LENGTH": description,
    }
    if all(validate(name, each, sizes) is None for name, each in chosen.items()):
        container = 2 + (6 + 1 + 1 + 1 + 8 + 2 + 1 + description) + (1 + 1 + 1 + value)
        assert container <= payload
        assert 18 + 4 + payload <= max_packet


@pytest.mark.parametrize("value", [10**400, -(10**400)])
def test_integers_beyond_every_float_are_violations(value):
    sizes = Sizes(uwb_max_packet_size=1500)
    for name in ("BPPAR_MAXIMUM_PACKET_SIZE", "VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_SCRUBBING_PERIOD"):
        assert validate(name, value, sizes) is not None
