"""The generated module in Rust has the verdicts, reasons, offsets and values of the Python codec."""

from __future__ import annotations

import random
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from dcp_conformance.vectors import wire
from dcp_lab.testing.mutation import Mutator, drawn_pool

from dcp_codec import Codec, DecodeError
from dcp_codec.export.rust.module import rust_module
from tests.odd_profiles import CORE, codec_of

pytestmark = pytest.mark.tool("rustc")

RUNNER = Path(__file__).resolve().parents[2] / "examples" / "vectors" / "rust" / "wire.rs"
CRATE = "#![no_std]\n#![forbid(unsafe_code)]\n#![deny(warnings)]\npub mod dcp_codec;\npub use dcp_codec::*;\n"
RUSTC = ("rustc", "--edition", "2021")
FRAMES = 1500


def build(text: str, folder: Path) -> None:
    """Build the module and the runner, with checks of overflows."""
    (folder / "dcp_codec.rs").write_text(text)
    (folder / "crate.rs").write_text(CRATE)
    library = [*RUSTC, "--crate-type", "rlib", "--crate-name", "dcp_codec", "crate.rs"]
    runner = [*RUSTC, "-D", "warnings", "--extern", "dcp_codec=libdcp_codec.rlib", RUNNER, "-o", "wire"]
    for command in (library, runner):
        found = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert not found.returncode, found.stderr


def run(codec: Codec, found: list[wire.Vector], folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "wire.txt").write_text("\n".join(wire.lines(codec, found)) + "\n")
    return subprocess.run(["./wire", "wire.txt"], cwd=folder, capture_output=True, text=True)


def mutated(codec: Codec, count: int, seed: str) -> Iterator[wire.Vector]:
    """Mutated frames as vectors, with what the Python codec finds."""
    rng = random.Random(seed)
    mutator = Mutator(codec, rng, drawn_pool(codec, rng, 100))
    for number in range(count):
        octets = mutator.mutate().octets
        named = f"frame {number}", "", (), (), octets.hex()
        try:
            beacon, end = codec.decode_from(octets)
        except DecodeError as error:
            yield wire.Vector(*named, "invalid", problem=wire.expected_of(error.problem))
        else:
            yield wire.Vector(*named, "valid", "both" if codec.encode(beacon) == octets else "decode", end)


def test_rust_and_python_agree(tmp_path: Path) -> None:
    for name in sorted({*CORE, "odd-texts"}):
        folder = tmp_path / name
        folder.mkdir()
        codec = codec_of(name, folder)
        build(rust_module(codec), folder)
        frames = [*wire.vectors(codec), *mutated(codec, FRAMES, f"Rust {name}")]
        found = run(codec, frames, folder)
        assert found.stdout == f"{len(frames)} vectors, 0 failed\n", f"{name}: {found.stdout[:2000]}{found.stderr}"


def test_a_difference_is_noticed(tmp_path: Path) -> None:
    codec = codec_of("dcp-2.0", tmp_path)
    text = rust_module(codec)
    assert text.count("let v_seqno = raw as u32;") >= 1
    build(text.replace("let v_seqno = raw as u32;", "let v_seqno = raw as u32 ^ 1;", 1), tmp_path)
    found = run(codec, wire.vectors(codec)[:50], tmp_path)
    assert found.returncode == 1
    assert "FAIL dcp-2.0/wire/example" in found.stdout


def test_the_example_of_the_page_compiles(tmp_path: Path) -> None:
    page = (RUNNER.parents[3] / "docs" / "c.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```rust\n(.*?)```", page, re.DOTALL)
    (tmp_path / "dcp_codec.rs").write_text(rust_module(codec_of("dcp-2.0", tmp_path)))
    (tmp_path / "main.rs").write_text(f"{example}\nfn main() {{\n    let _ = numbers(&[]);\n}}\n")
    command = [*RUSTC, "--emit", "metadata", "-A", "dead_code", "-D", "warnings", "main.rs"]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert not found.returncode, found.stderr
