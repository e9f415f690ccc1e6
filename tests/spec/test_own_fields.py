"""Implementation-specific fields, records and containers in a profile: permitted ones, and those a node refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_spec.profile.deviations import deviations
from dcp_spec.profile.loading import ProfileError, load_profile, profile_names
from dcp_spec.profile.usability import refusal, unusable_keys

from ..odd_profiles import write_profile


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(f'extends = "dcp-2.0"\nname = "mine"\n{text}', encoding="utf-8")
    return path


@pytest.mark.parametrize("name", profile_names())
def test_every_builtin_profile_can_be_used(name: str) -> None:
    assert unusable_keys(load_profile(name)) == {}
    assert refusal(load_profile(name)) is None


def test_each_key_that_a_node_cannot_use_is_named(tmp_path: Path) -> None:
    profile = load_profile(write_profile("odd-own", tmp_path))
    assert list(unusable_keys(profile)) == [
        "bp.header",
        "bp.payload_header",
        "vardis.records.VarReqCreate",
        "vardis.container_extra",
    ]
    reason = refusal(profile)
    assert reason is not None
    assert "bp.header: has hops, load; nothing says what to send there" in reason
    assert "vardis.records.VarReqCreate: has reason; a node needs a fixed number of octets" in reason
    assert "vardis.container_extra: has" in reason
    assert "Use it with dcp-codec" in reason


def test_a_node_can_use_fields_of_records_and_reports_with_a_fixed_size(tmp_path: Path) -> None:
    report = 'record = ["sData", "nodeId", "tStamp", "seqno", { name = "battery", extra = { width = 1 } }]'
    records = 'records.VarSumm = ["varId", "seqno", { name = "age", real = { width = 4 } }]'
    assert refusal(load_profile(written(tmp_path, f"[srp]\n{report}\n[vardis]\n{records}"))) is None
    varying = report.replace("extra = { width = 1 }", "block = { terminated = true }")
    assert list(unusable_keys(load_profile(written(tmp_path, f"[srp]\n{varying}")))) == ["srp.record"]


def test_a_node_can_use_octets_without_a_meaning(tmp_path: Path) -> None:
    path = written(tmp_path, '[bp]\npayload_header = ["protocolId", { name = "gap", opaque = 2 }, "length"]')
    assert refusal(load_profile(path)) is None


def test_own_fields_are_declared_deviations(tmp_path: Path) -> None:
    found = deviations(load_profile(write_profile("odd-own", tmp_path)))
    assert found["BP-HDR-10"].startswith("the header is version, magicNo, hops")
    assert found["BP-HDR-11"] == "the header of a payload also has priority"
    assert found["SRP-FMT-01"] == "a payload of SRP is not a state report, but counter, pattern, battery"
    assert "a VarSumm is seqno, varId, age" in found["VD-TYP-07"]
    assert found["VD-IC-02"] == "container type 9 is GEO-FENCE; container type 10 is Ping"


def test_a_pattern_in_place_of_reports_leaks_no_memory() -> None:
    assert set(deviations(load_profile("cpp-1.2"))) == {"SRP-FMT-01"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[srp]\nrecord = [{ name = "a" }]', "srp.record: field 'a' needs exactly one of opaque, extra, real, block"),
        ('[srp]\nrecord = [{ name = "a", opaque = 1, extra = { width = 1 } }]', "it has opaque and extra"),
        ('[srp]\nrecord = [{ name = "a", opaque = 1, text = true }]', "text belongs to a block, and only there"),
        ('[srp]\nrecord = [{ name = "a", block = { lengths = [] } }]', "block 'a' needs a length or a terminator"),
        ('[srp]\nrecord = [{ name = "a", opaque = 0 }]', "srp.record[0]"),
        ('[srp]\nrecord = ["seqno", { name = "a", opaque = 1 }]', "srp.record lacks sData"),
        ('[srp]\nrecord = [{ name = "a", opaque = 3 }]\nrecord_size = 4', "the listed fields add up to 3 octets"),
        (
            '[bp]\npayload_header = ["protocolId", "length", { name = "a", block = {} }]',
            "bp.payload_header: field 'a' must have a fixed size",
        ),
        ('[vardis.records]\nVarSumm = ["varId"]', "vardis.records.VarSumm lacks seqno"),
        (
            '[vardis.records]\nVarSumm = ["varId", "seqno", "value"]',
            "vardis.records.VarSumm has 'value'; expected one of",
        ),
        ('[vardis.records]\nVarSumm = ["varId", "seqno", { name = "var_id", opaque = 1 }]', "'var_id' is taken"),
        (
            '[[vardis.own_containers]]\nname = "A"\nnumber = 5\nrecord = ["varId"]',
            "vardis.own_containers 'A': the number 5 is that of CREATE-VARIABLES",
        ),
        ('[[vardis.own_containers]]\nname = "A"\nnumber = 9\nrecord = []', "vardis.own_containers 'A': record lists"),
        (
            '[[vardis.own_containers]]\nname = "UPDATES"\nnumber = 9\nrecord = ["varId"]',
            "the name of a container type of the specification",
        ),
        ('[[vardis.own_containers]]\nname = "var-summ"\nnumber = 9\nrecord = ["varId"]', "which is taken (VarSumm)"),
        ('[[vardis.own_containers]]\nname = "a b"\nnumber = 9\nrecord = ["varId"]', "this is not a plain name"),
    ],
)
def test_contradictory_profiles_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ProfileError) as caught:
        load_profile(path)
    assert message in str(caught.value)
