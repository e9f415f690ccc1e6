"""The atheris engine, if it is installed; otherwise its error message."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import pytest

HAS_ATHERIS = importlib.util.find_spec("atheris") is not None


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from dcp_selftest.cli import main; main()", "fuzz", "codec", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.skipif(HAS_ATHERIS, reason="atheris is installed")
def test_without_the_extra_the_error_says_how_to_install_it():
    done = fuzz("--engine", "atheris", "--max-cases", "1")
    assert done.returncode == 2
    assert "pip install 'atheris>=3.0'" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_engine_fuzzes_one_part_at_a_time():
    done = fuzz("beacon", "pics", "--engine", "atheris")
    assert done.returncode == 2
    assert "one part at a time" in done.stderr


@pytest.mark.skipif(not HAS_ATHERIS, reason="needs atheris: pip install 'atheris>=3.0'")
@pytest.mark.parametrize("part", ["beacon", "pics"])
def test_the_engine_runs_to_its_limit_and_keeps_its_corpus(tmp_path, part):
    done = fuzz(part, "--engine", "atheris", "--max-cases", "600", "--artefacts", str(tmp_path))
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(list((tmp_path / f"corpus-{part}").iterdir())) > 1
    assert json.loads((tmp_path / "campaign.json").read_text())["cases"] >= 600


@pytest.mark.skipif(not HAS_ATHERIS, reason="needs atheris: pip install 'atheris>=3.0'")
def test_findings_are_collected_and_the_input_of_a_crash_is_kept(tmp_path):
    from dcp_selftest.fuzz.atheris_engine import gathered

    (tmp_path / "findings").write_text("00ff\n\n")
    (tmp_path / "timeout-1").write_bytes(b"slow")
    assert gathered(tmp_path) == ([b"\0\xff", b""], [b"slow"])
