"""The command: usage errors, output files, and exit status."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dcp_codec.capture import open_capture


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from dcp_conformance.cli import main; main()", "fuzz", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.parametrize("mode", ["live", "model"])
def test_frames_are_sent_only_on_the_named_interface(mode):
    done = fuzz(mode)
    assert done.returncode == 2
    assert "name the i" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_dry_run_writes_the_frames(tmp_path):
    out = tmp_path / "frames.mcap"
    done = fuzz("live", "--dry-run", str(out), "--interface", "none0", "--max-cases", "3")
    assert done.returncode == 0, done.stderr
    with open_capture(out) as reader:
        frames = list(reader)
    assert f"{len(frames)} frames written" in done.stdout
    assert len(frames) > 20


def test_a_live_campaign_in_process_ends_well():
    done = fuzz("live", "--in-process", "--max-cases", "5", "--rate", "400")
    assert done.returncode == 0, done.stderr
    assert "0 findings" in done.stdout
