"""Passive findings about a node over UDP, started by a command with quotes: the printed command shows them again."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

from dcp_conformance.definitions.results import RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.reporting import load_results

from ..ports import own_port

TOOLS = Path(sys.executable).parent


def run(words: list[str], where: Path) -> str:
    done = subprocess.run([TOOLS / words[0], *words[1:]], cwd=where, capture_output=True, text=True, timeout=60,
                          check=False)  # fmt: skip
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


def finding(run: RunResult) -> tuple[Verdict, str]:
    found = next(case for case in run.cases if case.id == "CK_BP_SEQNO")
    return found.verdict, " ".join(found.requirements)


def test_a_counter_that_counts_in_its_first_octet(tmp_path: Path):
    profile = tmp_path / "mine.toml"
    profile.write_text('extends = "dcp-2.0"\nname = "mine"\n[types.bp_seqno]\nbyte_order = "little"\n')
    link = f"udp:239.73.126.9:{own_port()}"
    start = shlex.join([str(TOOLS / "dcp-node"), "run", "--link", link, "--profile", str(profile), "--node-id",
                        "02:00:00:00:00:01", "--beacon-period", "30"])  # fmt: skip
    words = ["dcp-conformance", "run", "--link", link, "--start", start, "--beacon-period", "30"]
    out = run([*words, "TC_BP_TX_TI_01", "--report-dir", "first"], tmp_path)
    first = load_results(tmp_path / "first")
    assert finding(first) == (Verdict.FAIL, "BP-HDR-08")
    # The numbers are wrong, not the times.
    assert next(case for case in first.cases if case.id == "TC_BP_TX_TI_01").verdict is Verdict.PASS
    shown = out[out.index("CK_BP_SEQNO") :]
    match = re.search(r"^ +again +(.*)$", shown, re.MULTILINE)
    assert match is not None
    command = shlex.split(match[1])
    assert command[command.index("--start") + 1] == start
    # Not the whole suite, though the finding is about all beacons together and cites none.
    assert command[command.index("--beacon-period") + 2 :] == ["TC_BP_TX_TI_01"]
    run([*command, "--report-dir", "second"], tmp_path)
    assert finding(load_results(tmp_path / "second")) == (Verdict.FAIL, "BP-HDR-08")
