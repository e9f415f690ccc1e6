"""Profiles of users: drafts, weak guesses, and containers of one's own, in every command."""

from __future__ import annotations

import json

from dcp_codec.capture import Frame, create_capture

from ..codec.test_draft import recording as pattern_recording
from ..export.beacons import everything
from ..odd_profiles import codec_of


def test_profiles_new_writes_a_checked_draft(run, tmp_path):
    recording = tmp_path / "flight.pcap"
    with create_capture(recording) as file:
        for frame in pattern_recording([52] * 20):
            file.write(frame)
    out = tmp_path / "mine.toml"
    done = run("profiles", "new", "mine", "--from", recording, "--out", out)
    assert done.status == 0
    assert "20 of 20 frames decode with it, 0 with" in done.out
    assert "opaque = 52" in out.read_text()
    again = run("profiles", "new", "mine", "--from", recording, "--out", out)
    assert (again.status, "--force" in again.err) == (2, True)
    assert run("profiles", "new", "mine", "--from", recording, "--out", out, "--force").status == 0
    stats = json.loads(run("stats", recording, "-p", out, "--format", "json").out)
    assert (stats["beacons"], stats["errors"]) == (20, 0)
    assert run("profiles", "new", "mine").status == 2
    assert run("profiles", "cpp-2.0", "--from", recording).status == 2


def test_a_weak_guess_is_reported_by_every_command(run, tmp_path):
    recording = tmp_path / "flight.pcap"
    with create_capture(recording) as file:
        for frame in pattern_recording([52] * 20):
            file.write(frame)
    for command in (
        ["decode", recording],
        ["stats", recording],
        ["table", recording, "--out", tmp_path / "t"],
        ["convert", recording, tmp_path / "x.mcap"],
    ):
        assert "is a weak guess" in run(*command).err, command
    assert "profileDoubt" in json.loads(run("stats", recording, "--format", "json").out)
    lines = run("decode", recording, "--format", "jsonl").out.splitlines()
    assert all("profileDoubt" in json.loads(line) for line in lines)
    ranked = run("guess", recording).out
    assert "SRP is 52 octets in 20 of 20 payloads" in ranked
    assert "1=" in ranked
    told = json.loads(run("guess", recording, "--format", "json").out)
    assert told["weak"] is True
    assert told["unexplained"][0]["advice"][0] == "[srp]"


def test_a_profile_with_containers_of_its_own_in_every_command(run, tmp_path):
    codec = codec_of("odd-own", tmp_path)
    profile, recording = tmp_path / "odd-own.toml", tmp_path / "own.pcap"
    octets = bytes.fromhex("ffffffffffff0200000000bb4953") + codec.encode(everything(codec))
    with create_capture(recording) as file:
        file.write(Frame(1, 1_750_000_000_000_000_000, octets, len(octets)))
    assert "GEO-FENCE" in run("stats", recording, "-p", profile).out
    assert "GEO-FENCE" in run("decode", recording, "-p", profile).out
    assert (
        run("table", recording, "-p", profile, "--out", tmp_path / "t", "--tables", "geo_fence,own_report").status == 0
    )
    assert sorted(path.name for path in (tmp_path / "t").iterdir()) == ["geo_fence.parquet", "own_report.parquet"]
    wrong = run("table", recording, "--out", tmp_path / "u", "--tables", "geo_fence")
    assert (wrong.status, "geo_fence" in wrong.err) == (2, True)
    for kind in ("lua", "ksy", "jsonschema", "markdown", "scapy"):
        assert run("export", kind, "-p", profile).status == 0
    assert "a node and the test suite" not in run("profiles", "cpp-1.2").err
    assert "vardis.records.VarReqCreate" in run("profiles", profile).err
