"""The Kaitai Struct export, compiled to Python, reads what the codec reads and refuses the rest."""

from __future__ import annotations

import fcntl
import json
import os
import re
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from dcp_lab.testing import strategies
from dcp_spec.profile.loading import ProfileError

from dcp_codec import Codec, DecodeError, Field, get_codec
from dcp_codec.capture import open_capture
from dcp_codec.export.ksy import kaitai_struct
from dcp_codec.export.wording import snake_name
from dcp_codec.framing.frames import DissectedFrame, FrameDissector
from dcp_codec.plan.tree import Many, Text

from ..odd_profiles import NAMES, codec_of
from .beacons import RECORDINGS, drawn, everything, malformed

pytestmark = pytest.mark.part("tools")

ROOT = Path(__file__).parent.parent.parent
COMPILER = ROOT / "node_modules" / "kaitai-struct-compiler"

#: Reads a list of .ksy as JSON, writes {file name: source} for each; the YAML itself is read by PyYAML.
COMPILE = """
const compiler = require(process.argv[1]);
const chunks = [];
process.stdin.on("data", (chunk) => chunks.push(chunk)).on("end", () =>
    Promise.all(JSON.parse(Buffer.concat(chunks)).map((each) => compiler.compile("python", each, null, false)))
        .then((all) => process.stdout.write(JSON.stringify(all)))
        .catch((error) => { process.stderr.write(String(error)); process.exitCode = 1; }));
"""


@pytest.fixture(scope="session")
def compiler() -> Path:
    """The Kaitai Struct compiler of package.json, installed into node_modules when it is not there."""
    # Workers of pytest-xdist wait for the one that installs.
    with Path(tempfile.gettempdir(), f"dcp-npm-{os.getuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not COMPILER.exists():
            command = ["npm", "install", "--no-package-lock", "--no-audit", "--no-fund", "--ignore-scripts"]
            try:
                done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
                why = done.stderr
            except (OSError, subprocess.TimeoutExpired) as error:
                why = str(error)
            if not COMPILER.exists():
                message = f"the npm package kaitai-struct-compiler cannot be had: {why}"
                if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
                    pytest.fail(message, pytrace=False)
                pytest.skip(message)
    return COMPILER


@pytest.fixture(scope="session")
def root_types(compiler: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The root class that Kaitai generates for each profile; all at once, since most of the time is for starting."""
    folder = tmp_path_factory.mktemp("profiles")
    documents = [yaml.safe_load(kaitai_struct(codec_of(name, folder))) for name in NAMES]
    command = ["node", "-e", COMPILE, str(compiler)]
    done = subprocess.run(command, input=json.dumps(documents), capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stderr) == (0, "")
    return {name: loaded(files) for name, files in zip(NAMES, json.loads(done.stdout), strict=True)}


def loaded(files: dict[str, str]) -> Any:
    """The root class of a generated module."""
    [(name, source)] = files.items()
    module = ModuleType(name.removesuffix(".py"))
    sys.modules[module.__name__] = module
    exec(compile(source, name, "exec"), module.__dict__)
    return getattr(module, "".join(word.capitalize() for word in module.__name__.split("_")))


@pytest.fixture(scope="module")
def root_type(codec: Codec, root_types: dict[str, Any]) -> Any:
    return root_types[codec.profile.name]


def reached(root: Any, path: str) -> Any:
    """The value that Kaitai has at a path of ours."""
    here = root
    for part in path.split("."):
        name, _, index = part.partition("[")
        attribute = snake_name(name)
        # A client payload goes by its label with us, and always is the content of its block in Kaitai.
        here = getattr(here, attribute) if hasattr(here, attribute) else here.content
        if index:
            # The list of a region has a type of its own around it.
            here = (here if isinstance(here, list) else getattr(here, attribute))[int(index.rstrip("]"))]
    return here


def plain(value: Any) -> Any:
    """A value that compares equal when it is the same, also if it is not a number."""
    value = getattr(value, "value", value)
    return struct.pack(">d", value) if isinstance(value, float) else value


def compare(dissected: Field, root: Any) -> int:
    """Compare every field of a message; returns how many there were."""
    compared = 0
    fields = {field.path: field for field in dissected.walk()}
    for path, field in fields.items():
        layout = field.layout
        if isinstance(layout, Text) and field.name == "data":
            continue
        if isinstance(layout, Many):
            found = reached(root, path)
            found = found if isinstance(found, list) else getattr(found, snake_name(field.name))
            assert len(found) == len(field.children), path
            continue
        if field.value is None:
            continue
        if length := re.fullmatch(r"(.*?)([^.]+)\.length(\d*)", path):
            text, name = fields.get(f"{length[1]}{length[2]}"), f"len_{snake_name(length[2])}"
            if text is not None and isinstance(text.layout, Text):
                path = f"{length[1]}{name}" + (f"_{length[3]}" if length[3] else "")
        assert plain(reached(root, path)) == plain(field.value), path
        compared += 1
    return compared


def parsed(root_type: Any, octets: bytes) -> Any:
    """The message as Kaitai reads it, None if it refuses."""
    from kaitaistruct import KaitaiStructError

    try:
        return root_type.from_bytes(octets)
    except (KaitaiStructError, EOFError, ValueError):
        return None


def refusal(codec: Codec, octets: bytes) -> str | None:
    """Why the codec refuses octets, None if it accepts them."""
    try:
        codec.decode(octets)
    except DecodeError as error:
        return error.problem.reason
    return None


@pytest.mark.tool("node", "npm")
@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda path: path.stem)
def test_every_field_of_the_recordings_agrees(recording: Path, root_types: dict[str, Any]) -> None:
    codec = get_codec("cpp-1.3" if "v1.3" in recording.stem else "cpp-2.0")
    root_type, dissector, compared = root_types[codec.profile.name], FrameDissector(codec), 0
    with open_capture(recording) as frames:
        for frame in frames:
            ours = dissector.dissect(frame)
            if isinstance(ours, DissectedFrame):
                root = root_type.from_bytes(frame.data[ours.framing.start : ours.framing.end])
                compared += compare(ours.dissection.root, root)
                assert root.padding == ours.dissection.padding
    assert compared > 7_000


@pytest.mark.tool("node", "npm")
def test_every_field_of_every_layout_agrees(codec: Codec, root_type: Any) -> None:
    octets = codec.encode(everything(codec))
    for beacon in [octets, *drawn(strategies.beacons(codec).map(codec.encode), 100)]:
        root = root_type.from_bytes(beacon)
        assert compare(codec.dissect(beacon).root, root) >= len(codec.profile.bp.header)


@pytest.mark.tool("node", "npm")
def test_octets_that_the_codec_refuses_are_refused(codec: Codec, root_type: Any) -> None:
    beacons = strategies.beacons(codec).map(codec.encode)
    octets = codec.encode(everything(codec))
    # Profiles take turns with the changes, as in test_lua.py.
    changes = list(malformed(codec, octets))[NAMES.index(codec.profile.name) % 3 :: 3]
    wrong = [*changes, *drawn(strategies.mutations(beacons, codec.dissect), 300)]
    refused = 0
    for candidate in wrong:
        reason = refusal(codec, candidate)
        refused += reason is not None
        if reason != "bad-terminator":
            # Kaitai has no check that counted octets hold no further NUL.
            assert (parsed(root_type, candidate) is None) == (reason is not None), (reason, candidate.hex())
    assert refused > 100


def test_the_file_cites_the_specification() -> None:
    text = kaitai_struct(get_codec("cpp-2.0"))
    document = yaml.safe_load(text)
    assert text.startswith("# Generated by dcp-codec ")
    assert "        valid: 0x497e\n" in text
    assert document["meta"]["id"] == "dcp_cpp_2_0"
    assert document["enums"]["ic_type"][5] == {"id": "create_variables", "-orig-id": "CREATE-VARIABLES"}
    header = document["types"]["bp_header"]
    assert header["-orig-id"] == "BPHeader"
    assert [field["-orig-id"] for field in header["seq"]] == list(get_codec("cpp-2.0").profile.bp.header)
    assert "(BP-HDR-10)" in header["doc-ref"]


def test_descriptions_are_decoded_on_demand() -> None:
    spec = yaml.safe_load(kaitai_struct(get_codec("dcp-2.0")))["types"]["var_spec"]
    assert spec["instances"]["descr_text"]["value"] == 'descr.to_s("UTF-8")'


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("numPayloads", "num_payloads"),
        ("BPHeader", "bp_header"),
        ("REQUEST-VARUPDATES", "request_varupdates"),
        ("sData", "s_data"),
        ("Größe 2", "gr_e_2"),
        ("7up", "f_7up"),
        ("°", "f"),
    ],
)
def test_names(name: str, expected: str) -> None:
    assert snake_name(name) == expected


def test_two_members_with_one_name_are_refused(tmp_path: Path) -> None:
    members = '{ name = "aB", type = "u8" }, { name = "a_b", type = "u8" }'
    path = tmp_path / "own.toml"
    path.write_text(f'extends = "dcp-2.0"\nname = "own"\n[srp]\nsafety_data = [{members}]\n', encoding="utf-8")
    # The profile itself is refused: every view would have to give one of them another name.
    with pytest.raises(ProfileError, match=r"field name 'aB' is used twice.*field name 'a_b' is used twice"):
        kaitai_struct(Codec(path))
