"""The command ``dcp-selftest fuzz``: usage errors, output files, resuming, and exit status."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from dcp_selftest.cli import main


def fuzz(*words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from dcp_selftest.cli import main; main()", "fuzz", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=600)


@pytest.mark.part("tools")
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("codec", "nothing"), "unknown part 'nothing'"),
        (("stack", "--mutant", "M-NOTHING"), "no mutant"),
        (("stack", "--profile", "none-such"), "none-such"),
        (("stack", "--dry-run", "x.txt"), "x.txt: "),
        (("stack", "--resume"), "--artefacts DIR"),
        (("stack", "--resume", "--artefacts", "/nonexistent"), "no campaign"),
        (("stack", "--recording", "/nonexistent.mcap"), "/nonexistent.mcap"),
        (("stack", "--artefacts", "/dev/null/x"), "/dev/null/x: cannot be written"),
        (("codec", "--artefacts", "/dev/null"), "exists and is not a folder"),
        (("replay", "/nonexistent"), "/nonexistent"),
        (("stack", "--jobs", "0"), "0 is not in the range"),
        (("stack", "--jobs", "many"), "'many' is not a valid integer range"),
        (("stack", "--jobs", "2", "--dry-run", "x.mcap"), "leave out --jobs"),
        (("codec", "--jobs", "2", "--engine", "atheris"), "leave out --jobs"),
    ],
)
def test_invalid_options_are_refused_in_one_line(words, says, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["fuzz", *words])
    said = capsys.readouterr()
    assert stop.value.code in (2, 4)
    assert says in said.err + said.out
    assert "Traceback" not in said.err


@pytest.mark.part("tools")
def test_findings_are_saved_and_replayed_and_campaigns_resumed(tmp_path):
    folder = tmp_path / "findings"
    options = ("--seed", "1", "--artefacts", str(folder), "--mutant", "M-BP-RX-15-dies")
    done = fuzz("stack", "--max-cases", "60", *options)
    assert done.returncode == 1
    [artefact] = folder.glob("raised-*.json")
    # Coverage is shown when it is asked for: what was found comes last, and is not scrolled away.
    assert "pairs" not in done.stdout
    told = done.stdout.splitlines()
    assert told[-7].startswith("beacon-overrun at bp.length: raised: IndexError")
    assert told[-6].startswith(f"  {artefact.stem}: IndexError")
    assert told[-5].startswith("  sent      ")
    assert told[-4] == "  cause     beacon-overrun at bp.length (without it nothing shows)"
    assert told[-3].startswith("  decides   BP-RX-15 (dcp-bp.md")
    assert told[-2] == f"  again     dcp-selftest fuzz replay {artefact}"
    assert told[-1].startswith("60 cases, ")
    again = fuzz("replay", str(folder))
    assert again.returncode == 1
    assert again.stdout.startswith("failed ")
    content = json.loads(artefact.read_text())
    del content["target"]["mutant"]
    artefact.write_text(json.dumps(content))
    fixed = fuzz("replay", str(artefact))
    assert (fixed.returncode, fixed.stdout[:6]) == (0, "fixed ")

    more = fuzz("stack", "--max-cases", "40", "--resume", *options)
    assert more.returncode == 1
    state = json.loads((folder / "campaign.json").read_text())
    assert state["cases"] == 100
    # Known findings are not minimised again.
    assert len(state["findings"]) == 1


@pytest.mark.part("tools")
def test_coverage_is_written_with_missing_pairs(tmp_path):
    path = tmp_path / "coverage.json"
    done = fuzz("stack", "--max-cases", "5", "--coverage", str(path))
    assert done.returncode == 0, done.stderr
    coverage = json.loads(path.read_text())
    assert len(coverage["missing"]) > 10
    assert f"done to it: {coverage['possible'] - len(coverage['missing'])} of" in done.stdout
    shown = fuzz("stack", "--max-cases", "5", "--coverage")
    assert shown.stdout.splitlines()[:-1] == done.stdout.splitlines()[:-1]
    assert fuzz("codec", "--coverage", "beacon").returncode == 2
    done = fuzz("stack", "--max-cases", "1", "--coverage", str(path / "x"))
    assert done.returncode == 2
    assert "1 cases" in done.stdout


@pytest.mark.part("tools")
def test_a_recording_and_lines_of_code_guide(tmp_path):
    out = tmp_path / "frames.mcap"
    assert fuzz("stack", "--dry-run", str(out), "--max-cases", "20").returncode == 0
    done = fuzz("stack", "--guided", "--recording", str(out), "--max-cases", "30", "--coverage")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "lines of the target: " in done.stdout
    assert fuzz("codec", "beacon", "--guided", "--max-cases", "50", "-q").returncode == 0
