"""The command that a result shows reproduces the result when it is run exactly as printed."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest
from dcp_conformance.cli.options import TARGET_SECTIONS, target_options
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.reporting import load_results
from hypothesis import given
from hypothesis import strategies as st

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
TOOLS = Path(sys.executable).parent
BAD = (Verdict.FAIL, Verdict.INCONCLUSIVE)


def run(words: list[str], where: Path) -> tuple[int, str]:
    """Run a command as a user would, in a directory; its status, and what it printed."""
    done = subprocess.run([TOOLS / words[0], *words[1:]], cwd=where, capture_output=True, text=True, timeout=300,
                          check=False)  # fmt: skip
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout


def verdicts(cases: tuple[CaseResult, ...]) -> dict[str, Verdict]:
    return {case.id: case.verdict for case in cases if case.verdict in BAD}


def again(out: str) -> list[list[str]]:
    """The printed commands, as a shell takes them apart."""
    return [shlex.split(line) for line in re.findall(r"^ +again +(.*)$", out, re.MULTILINE)]


TEXT = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=12)
WORD = TEXT.map(lambda text: f"a {text} 'b\" $x")


@given(
    st.builds(
        TargetOptions,
        profile=st.none() | WORD,
        interface=st.none() | WORD,
        ether_type=st.none() | st.integers(0x0600, 0xFFFF),
        link=st.none() | WORD,
        in_process=st.booleans(),
        ut=st.none() | WORD,
        pics=st.none() | WORD.map(Path),
        start=st.none() | WORD,
        restart=st.none() | WORD,
        pid=st.none() | st.integers(1, 2**22),
        beacon_period_ms=st.none() | st.floats(0.001, 1e6),
        timing_scale=st.floats(0.001, 1e3),
        seed=st.integers(-(2**63), 2**63),
    )
)
def test_all_options_of_a_target_are_in_the_command(options: TargetOptions):
    words = shlex.split(options.command_line())
    assert words[:2] == ["dcp-conformance", "run"]
    taken: list[TargetOptions] = []

    @click.command()
    @target_options
    def command(**told: Any) -> None:
        # Not target_of: it reads the PICS file, which is none here.
        taken.append(TargetOptions(**{name: told[name] for name in " ".join(TARGET_SECTIONS.values()).split()}))

    command.main(words[2:], standalone_mode=False)
    assert taken == [options]


@pytest.mark.part("tools")
def test_a_case_that_fails_with_its_pics(tmp_path: Path):
    pics = tmp_path / "my node's.toml"
    pics.write_text("[pics]\ntriggered_beacons = true\n")
    case = "TC_BP_CLAIM_TI_01"
    words = ["dcp-conformance", "run", "--in-process", "--pics", pics.name, "--seed", "7", "--beacon-period", "99.5",
             "-x", "TC_DCP_SANITY_BV_01", case, "TC_VD_CRE_BV_01"]  # fmt: skip
    status, out = run([*words, "--report-dir", "first"], tmp_path)
    assert status == 1
    [command] = again(out)
    assert command[command.index("--seed") :][:2] == ["--seed", "7"]
    status, out = run([*command, "--report-dir", "second"], tmp_path)
    assert status == 1
    second = load_results(tmp_path / "second")
    assert verdicts(second.cases) == {case: Verdict.FAIL}
    assert [each.id for each in second.cases] == [case]
    assert again(out) == [command]


@pytest.mark.part("tools")
def test_a_finding_of_the_fuzzer_as_a_case(tmp_path: Path):
    folder = "finds of 'Monday'"
    mutant = "M-BP-RX-15-dies"
    words = ["dcp-selftest", "fuzz", "stack", "--mutant", mutant, "--max-cases", "400", "--artefacts", folder, "-q"]
    status, _ = run(words, tmp_path)
    found = sorted((tmp_path / folder).glob("*.json"))
    found = [each for each in found if each.name != "campaign.json"]
    if status != 1 or not found:
        pytest.fail("the fuzzer finds nothing any more: take another mutant")
    name = f"TC_DCP_FUZZ_BI_01-{found[0].stem}"
    # Our node without changes passes; that is the verdict to be reproduced.
    run(["dcp-conformance", "run", "--in-process", "--artefacts", folder, name, "--report-dir", "r"], tmp_path)
    case = next(each for each in load_results(tmp_path / "r").cases if each.id == name)
    status, _ = run([*shlex.split(case.rerun), "--report-dir", "r2"], tmp_path)
    assert next(each for each in load_results(tmp_path / "r2").cases if each.id == name).verdict is case.verdict
    assert status == (0 if case.verdict is Verdict.PASS else 1)


@pytest.mark.part("tools")
def test_a_recording_that_is_judged(tmp_path: Path):
    shutil.copy(CAPTURES / "b_crud.mcap", tmp_path / "the 'first' flight.mcap")
    (tmp_path / "pics.toml").write_text("[pixit]\nbeacon_period_ms = 100.0\n")
    words = ["dcp-conformance", "check", "the 'first' flight.mcap", "--pics", "pics.toml", "--profile", "cpp-2.0",
             "--ether-type", "0x4953", "--beacon-period", "130.5"]  # fmt: skip
    status, out = run([*words, "--report-dir", "first"], tmp_path)
    assert status == 1
    first = load_results(tmp_path / "first")
    assert "CK_BP_PERIOD" in verdicts(first.cases)
    [command] = {tuple(each) for each in again(out)}
    assert run([*command, "--report-dir", "second"], tmp_path)[0] == 1
    assert verdicts(load_results(tmp_path / "second").cases) == verdicts(first.cases)


@pytest.mark.part("tools")
def test_a_recording_that_is_played(tmp_path: Path):
    shutil.copy(CAPTURES / "b_crud.mcap", tmp_path / "a flight.mcap")
    words = ["dcp-conformance", "replay", "a flight.mcap", "--in-process", "--speed", "0", "--seed", "3"]
    status, _ = run([*words, "--report-dir", "first dir"], tmp_path)
    first = load_results(tmp_path / "first dir")
    command = shlex.split(first.cases[0].rerun)
    assert command[:3] == words[:3]
    assert run(command, tmp_path)[0] == status
    assert {each.id: each.verdict for each in load_results(tmp_path / "first dir").cases} == {
        each.id: each.verdict for each in first.cases
    }
