"""The generated C codec has the verdicts, reasons, offsets and values of the Python codec, for every profile."""

from __future__ import annotations

import random
import subprocess
from pathlib import Path

import pytest
from dcp_lab.testing.mutation import Mutator, drawn_pool

from dcp_codec.export.c import files
from dcp_codec.export.c.files import codec_files
from tests.ccodec.peer import SANITIZED, STRICT, Comparison, Peer, build
from tests.odd_profiles import CORE, NAMES, codec_of

pytestmark = pytest.mark.tool("gcc")

#: Mutated frames for each profile; ``python -m tests.ccodec`` takes any number.
FRAMES = 1500


def test_c_and_python_agree(tmp_path: Path) -> None:
    reasons = set()
    for name in NAMES:
        folder = tmp_path / name
        folder.mkdir()
        codec = codec_of(name, folder)
        rng = random.Random(f"C {name}")
        pool = drawn_pool(codec, rng, 100)
        mutator, found = Mutator(codec, rng, pool), Comparison()
        frames = [b"", *pool, *(mutator.mutate().octets for _ in range(FRAMES))]
        options = SANITIZED if name in CORE else ("-O0",)
        Peer(codec, build(codec, folder, "gcc", options)).compare(frames, found)
        assert not found.differences, f"{name}: {found.differences[0]}"
        assert found.valid > 100, name
        reasons |= set(found.reasons)
    assert len(reasons) >= 15, reasons


def test_a_difference_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A codec that accepts one octet more, or reports another offset, differs from the Python codec."""
    codec = codec_of("dcp-2.0", tmp_path)
    rng = random.Random(1)
    mutator = Mutator(codec, rng, drawn_pool(codec, rng, 50))
    frames = [mutator.mutate().octets for _ in range(1000)]
    original = codec_files(codec)["dcp_codec.c"]
    for before, after in (
        ("v->seqno = dcp_be4(p + 14);", "v->seqno = dcp_be4(p + 13);"),
        ("r.end - r.at < beacon->bp.length", "r.end - r.at + 1u < beacon->bp.length"),
        ("f->size, r->end - r->at);", "f->size, r->end - r->at + 1u);"),
        ("dcp_put_be4(p + 14, v->seqno);", "dcp_put_be4(p + 14, 0);"),
        ("*length_at = r->at + 2u;", "*length_at = r->at;"),
    ):
        assert original.count(before) >= 1, before
        wrong = original.replace(before, after)
        monkeypatch.setattr(
            "tests.ccodec.peer.codec_files",
            lambda codec, wrong=wrong: {**files.codec_files(codec), "dcp_codec.c": wrong},
        )
        found = Comparison()
        Peer(codec, build(codec, tmp_path, "gcc", ("-O0",))).compare(frames, found)
        assert found.differences, f"{after} is not noticed"


@pytest.mark.tool("g++")
def test_header_is_good_cpp(tmp_path: Path) -> None:
    for name in NAMES:
        folder = tmp_path / name
        folder.mkdir()
        (folder / "dcp_codec.h").write_text(codec_files(codec_of(name, folder))["dcp_codec.h"])
        options = ["-std=c++17", *STRICT[1:], "-fsyntax-only", "-x", "c++", "dcp_codec.h"]
        found = subprocess.run(["g++", *options], cwd=folder, capture_output=True, text=True)
        assert not found.returncode, f"{name}: {found.stderr}"


def test_codec_needs_no_library(tmp_path: Path) -> None:
    for name, text in codec_files(codec_of("dcp-2.0", tmp_path)).items():
        (tmp_path / name).write_text(text)
    command = ["gcc", *STRICT, "-ffreestanding", "-Os", "-c", "dcp_codec.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    needed = subprocess.run(["nm", "-u", "dcp_codec.o"], cwd=tmp_path, check=True, capture_output=True, text=True)
    # The four that every compiler may call, even for a freestanding program.
    assert set(needed.stdout.split()) <= {"U", "memcpy", "memmove", "memset", "memcmp", "_GLOBAL_OFFSET_TABLE_"}


@pytest.mark.parametrize(
    ("compiler", "emulator"),
    [
        pytest.param(*names, marks=pytest.mark.tool(*names))
        for names in (("arm-linux-gnueabihf-gcc", "qemu-arm"), ("powerpc-linux-gnu-gcc", "qemu-ppc"))
    ],
)
def test_other_processors(compiler: str, emulator: str, tmp_path: Path) -> None:
    """32 bits, and big-endian."""
    for name in ("student-2024", "odd-widths"):
        folder = tmp_path / name
        folder.mkdir()
        codec = codec_of(name, folder)
        rng = random.Random(f"C {name}")
        pool = drawn_pool(codec, rng, 50)
        mutator, found = Mutator(codec, rng, pool), Comparison()
        peer = Peer(codec, build(codec, folder, compiler, ("-O1", "-static")), [emulator])
        peer.compare([*pool, *(mutator.mutate().octets for _ in range(1000))], found)
        assert not found.differences, f"{name}: {found.differences[0]}"
