"""Settings: what a file and flags say becomes a node, or a message that names the key."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import pytest
from dcp_lab.sim.virtual.network import Network

from dcp_codec import Codec
from dcp_stack.config import BPConfig, VardisConfig
from dcp_stack.runtime.settings import (
    Settings,
    SettingsError,
    SRPSettings,
    VardisSettings,
    load_settings,
    node_config,
    parse_node_id,
    random_node_id,
    settings_text,
)

FULL = """
node_id = "02:00:00:00:00:01"
profile = "cpp-2.0"
link = "udp"
control = "/run/dcp/node.sock"
record = "flight.mcap"
record_decoded = false
position = "track:circle"
neighbour_file = "/dev/shm/dcp"
metrics = 9469
user = "dcp"
seed = 7
log_level = "warning"
log_format = "json"

[bp]
beacon_period_ms = 200
network_id = 0x2222
jitter = 0.0

[srp]
enabled = true
neighbour_table_timeout_ms = 2000
safety_data = { x = 1.5, y = 2, z = 0 }

[vardis]
max_summaries = 5

[readings]
X05 = "usable-minimum"
"""


def write(tmp_path, text):
    path = tmp_path / "node.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_whole_file(tmp_path):
    settings = load_settings(write(tmp_path, FULL), {})
    config = node_config(settings, Codec(settings.profile))
    assert config.node_id == bytes.fromhex("020000000001")
    assert (config.bp.beacon_period_ms, config.bp.network_id) == (200, 0x2222)
    assert config.srp.neighbour_table_timeout_ms == 2000
    assert config.vardis.max_summaries == 5
    assert config.selected_readings.smallest_packet == "usable-minimum"


def test_settings_are_shown_as_an_equivalent_file(tmp_path):
    settings = load_settings(write(tmp_path, FULL), {})
    assert load_settings(write(tmp_path, settings_text(settings)), {}) == settings
    defaults = load_settings(None, {})
    assert defaults == Settings()
    assert load_settings(write(tmp_path, settings_text(defaults)), {}) == defaults
    assert tomllib.loads(settings_text(defaults))["bp"]["beacon_period_ms"] == 100


def test_the_documentation_names_every_key():
    text = (Path(__file__).parents[3] / "docs" / "dcp-node.md").read_text(encoding="utf-8")
    sections = {"bp", "srp", "vardis", "readings"}
    for name in {*Settings.__struct_fields__} - sections:
        assert f"| `{name}` |" in text, name
    for kind in (BPConfig, SRPSettings, VardisSettings):
        for name in kind.__struct_fields__:
            assert f"`{name}`" in text, name
    for name in sections:
        assert f"`[{name}]`" in text, name


def test_flags_take_precedence_over_the_file(tmp_path):
    path = write(tmp_path, FULL)
    settings = load_settings(path, {"bp.beacon_period_ms": 50, "node_id": "02:00:00:00:00:02", "profile": None})
    assert settings.bp.beacon_period_ms == 50
    assert settings.bp.network_id == 0x2222
    assert settings.node_id == "02:00:00:00:00:02"
    assert settings.profile == "cpp-2.0"
    # One of the two ways to name a link takes the place of the other.
    assert load_settings(path, {"interface": "wlan0"}).link is None
    assert load_settings(path, {"link": "udp:239.1.1.1"}).interface is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("beacon_period = 1", "unknown key 'beacon_period'"),
        ("nodeid = '02'", "did you mean 'node_id'?"),
        ("[bp]\nbeacon_period = 1", "unknown key 'bp.beacon_period'; did you mean 'beacon_period_ms'?"),
        ("[vardis]\nx = 1", "unknown key 'vardis.x'; known keys are"),
        ("[bp]\nbeacon_period_ms = 'fast'", "bp.beacon_period_ms: expected int, got str"),
        ("bp = 3", "bp: expected table, got int"),
        ("metrics = 70000", "metrics: expected int <= 65535"),
        ("log_level = 'loud'", "log_level: Invalid enum value 'loud'"),
        ("[readings]\nX05 = 3", "readings[...]: expected str, got int"),
        ("node_id = ", "not TOML"),
        ("a = 1\na = 2", "not TOML"),
    ],
)
def test_errors_name_file_and_key(tmp_path, text, message):
    path = write(tmp_path, text)
    with pytest.raises(SettingsError) as caught:
        load_settings(path, {})
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(SettingsError, match=r"missing\.toml: cannot be read: No such file"):
        load_settings(tmp_path / "missing.toml", {})
    with pytest.raises(SettingsError, match="Is a directory"):
        load_settings(tmp_path, {})
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(SettingsError, match="not TOML"):
        load_settings(path, {})


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ({"node_id": "02:00"}, "has 2 octets; identifiers of profile dcp-2.0 have 6"),
        ({"node_id": "me"}, "is not hex"),
        ({"readings": {"X99": "y"}}, "no reading 'X99'"),
        ({"readings": {"X05": "y"}}, "no alternative 'y'"),
        ({"position": "track:circle", "srp.enabled": False}, "runs without SRP"),
        ({"neighbour_file": "/dev/shm/x", "srp.enabled": False}, "runs without SRP"),
    ],
)
def test_settings_that_make_a_node_impossible(flags, message):
    settings = load_settings(None, flags)
    with pytest.raises(SettingsError) as caught:
        node_config(settings, Codec(settings.profile))
    assert message in str(caught.value)


def test_whether_there_are_state_reports_follows_from_the_profile():
    without = next(name for name in ("student-2024", "sim-1.0", "dcp-1.0") if Codec(name).report_plan is None)
    assert node_config(load_settings(None, {"profile": without}), Codec(without)).srp is None
    assert node_config(Settings(), Codec("dcp-2.0")).srp is not None
    assert node_config(load_settings(None, {"vardis.enabled": False}), Codec("dcp-2.0")).vardis is None


def test_node_identifiers():
    profile = Codec("dcp-2.0").profile
    assert parse_node_id("020000000001", profile) == parse_node_id("02:00:00:00:00:01", profile)
    first, second = random_node_id(profile), random_node_id(profile)
    assert first != second
    # Locally administered, and not of a group.
    assert first[0] & 3 == 2
    address = bytes.fromhex("0a0000000009")
    assert node_config(Settings(), Codec("dcp-2.0"), default_id=address).node_id == address
    # An interface without an address (lo) does not make one.
    assert node_config(Settings(), Codec("dcp-2.0"), default_id=bytes(6)).node_id != bytes(6)


def test_recommended_settings_of_a_profile_apply():
    def limits(**flags):
        settings = load_settings(None, {"profile": "cpp-2.0", **flags})
        vardis = node_config(settings, Codec("cpp-2.0")).vardis
        return vardis.max_payload_size, vardis.max_summaries, vardis.max_repetitions

    # The limits apply to the records that this node sends only, not to received ones.
    assert limits() == (600, 2, None)
    assert limits(**{"vardis.max_summaries": 9}) == (600, 9, None)
    assert limits(**{"vardis.max_summaries": 0}) == (600, 0, None)
    assert limits(**{"vardis.recommended": False}) == (None, None, None)
    assert node_config(Settings(), Codec("dcp-2.0")).vardis.max_payload_size is None


@pytest.mark.parametrize(("recommended", "known"), [(True, 60), (False, 5)])
def test_many_long_variables_reach_nodes_that_discard_long_payloads(recommended, known):
    settings = load_settings(None, {"profile": "cpp-2.0", "vardis.recommended": recommended})
    codec = Codec("cpp-2.0")
    # The limits that nodes of the C++ implementation usually have.
    others = VardisConfig(max_payload_size=600, max_repetitions=1)
    net = Network(3, codec, vardis=others, readings={"X49": "discard-larger"})
    first = net.stations[0]
    first.config = msgspec.structs.replace(first.config, vardis=node_config(settings, codec).vardis)
    for number in range(3):
        net.start(number)
    for variable in range(60):
        first.node.vardis.create(variable, None, 1, b"d" * 32, bytes(32), now=net.now, wall=net.wall)
    net.run_until(2_000_000_000)
    assert [len(each.node.vardis.describe_database().variables) for each in net.stations] == [60, known, known]
