"""Wire vectors: they have the published form, keep their meaning, and every codec passes them."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import resources
from pathlib import Path

import jsonschema
import pytest
from dcp_conformance.vectors import wire
from dcp_conformance.vectors.files import files, wire_digests
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.profile.loading import profile_names

from dcp_codec import get_codec
from dcp_codec.export.c.files import codec_files

ROOT = Path(__file__).parents[2]
RUNNERS = ROOT / "examples" / "vectors"


def kept(name: str) -> dict[str, set[str]]:
    """The committed digests of a profile, by message."""
    text = resources.files("dcp_conformance").joinpath("data", "vector-digests.json").read_text()
    return {
        message: {listed[at : at + 6] for at in range(0, len(listed), 6)}
        for message, listed in json.loads(text)[name].items()
        if "/wire/" in message
    }


def check(name: str) -> None:
    found = wire.vectors(get_codec(name))
    assert len({each.tc_id for each in found}) == len(found)
    now = wire_digests(found)
    for message, digests in kept(name).items():
        lost = digests - set(now.get(message, ()))
        assert not lost, f"{len(lost)} vectors of {message!r} are gone or mean something else"
    for each in found:
        assert each.requirements, each.tc_id
        for identifier in each.requirements:
            assert requirement(identifier).holds_in(get_codec(name).profile.spec_version), f"{each.tc_id}: {identifier}"


def test_vectors_keep_their_meaning() -> None:
    check("dcp-2.0")


@pytest.mark.part("tools")
def test_vectors_of_all_profiles_keep_their_meaning() -> None:
    for name in profile_names():
        check(name)


def test_every_kind_of_damage_is_there() -> None:
    """The construct schema, which shares no code with the generated decoders, refuses what is invalid."""
    codec = get_codec("dcp-2.0")
    found = wire.vectors(codec)
    for each in found[::9]:
        octets = bytes.fromhex(each.octets)
        try:
            parsed = codec.schema.beacon.parse(octets)
        except Exception:
            parsed = None
        assert (parsed is not None) == (each.result == "valid"), each.tc_id
    reasons = {each.problem.reason for each in found if each.problem}
    assert len(reasons) == 10, reasons


@pytest.mark.part("tools")
def test_files_have_their_schema(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("dcp-conformance")
    command = [program, "vectors", tmp_path, "--profile", "dcp-2.0", "--archive", tmp_path / "v.zip"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    for kind in ("wire", "behaviour"):
        schema = json.loads((tmp_path / f"{kind}.schema.json").read_text())
        content = json.loads((tmp_path / "dcp-2.0" / f"{kind}.json").read_text())
        jsonschema.Draft202012Validator.check_schema(schema)
        jsonschema.Draft202012Validator(schema).validate(content)
    beacon = jsonschema.Draft202012Validator(json.loads((tmp_path / "dcp-2.0" / "beacon.schema.json").read_text()))
    for test in json.loads((tmp_path / "dcp-2.0" / "wire.json").read_text())["testGroups"][0]["tests"]:
        beacon.validate(test["values"])
    again = dict(files(["dcp-2.0"]))
    assert all((tmp_path / name).read_bytes() == octets for name, octets in again.items())


def written(name: str, folder: Path) -> Path:
    for path, octets in files([name]):
        if path.startswith(name):
            (folder / Path(path).name).write_bytes(octets)
    for path, text in codec_files(get_codec(name)).items():
        (folder / path).write_text(text)
    return folder


@pytest.mark.tool("gcc")
def test_generated_c_passes(tmp_path: Path) -> None:
    for name in ("dcp-1.0", "dcp-1.3", "dcp-2.0", "cpp-2.0", "student-2024"):
        folder = tmp_path / name
        folder.mkdir()
        written(name, folder)
        strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror"]
        # Damaged octets of all profiles are decoded under sanitizers in tests/ccodec.
        sanitized = ["-fsanitize=address,undefined"] if name == "dcp-2.0" else []
        command = ["gcc", *strict, *sanitized, "-I.", str(RUNNERS / "c" / "wire.c"), "dcp_codec.c", "-o", "wire"]
        subprocess.run(command, cwd=folder, check=True)
        found = subprocess.run(["./wire", "wire.txt"], cwd=folder, capture_output=True, text=True)
        assert found.returncode == 0, f"{name}: {found.stdout}{found.stderr}"


@pytest.mark.tool("gcc")
def test_a_wrong_codec_fails(tmp_path: Path) -> None:
    written("dcp-2.0", tmp_path)
    source = tmp_path / "dcp_codec.c"
    source.write_text(source.read_text().replace("v->seqno = dcp_be4(p + 14);", "v->seqno = dcp_be4(p + 13);"))
    subprocess.run(["gcc", "-I.", str(RUNNERS / "c" / "wire.c"), "dcp_codec.c", "-o", "wire"], cwd=tmp_path, check=True)
    found = subprocess.run(["./wire", "wire.txt"], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 1
    assert "FAIL dcp-2.0/wire/example" in found.stdout
