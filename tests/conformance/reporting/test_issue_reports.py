"""Reports of probable faults, for the issue tracker of an implementation."""

from __future__ import annotations

import ast
import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.definitions.results import RunResult, Sut
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.diagnosis import Dictionary, Fault, explain
from dcp_conformance.errors import UsageError
from dcp_conformance.reporting.issues import write_issues
from dcp_conformance.reporting.issues.stimulus import needs_calls, stimulus
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite, cases

from dcp_codec.codec import Codec

HOSTILE = 'evil`*/"""\n# [x](javascript:alert(1)) <script>\x1b[31m'
CODEC = Codec("dcp-2.0")


def run_of(mutant: str, *prefixes: str, name: str = "drone") -> RunResult:
    """The results of some cases against a mutant, with the diagnosis that names it."""
    faulty = all_mutants()[mutant]
    chosen = [case for case in cases() if case.id.startswith(prefixes)]
    results = list(Suite("dcp-2.0", faulty.make).run(chosen))
    failed = frozenset(each.id for each in results if each.verdict is Verdict.FAIL)
    assert failed
    known = Fault(id=mutant, requirements=faulty.requirements, what=faulty.what, fails=failed, undecided=frozenset())
    return RunResult(
        tool="dcp-conformance test",
        started="2026-01-01T00:00:00Z",
        profile="dcp-2.0",
        spec_version="2.0",
        sut=Sut(name=name, link="eth:uwb0"),
        cases=tuple(results),
        diagnosis=explain(results, Dictionary((known,))),
    )


@pytest.fixture(scope="module")
def answered() -> RunResult:
    return run_of("M-VD-RU-03-equal-answered", "TC_VD_SEQ_BV_0", "TC_VD_STATE_BO_01-alive")


def test_a_report_states_the_requirement_the_observation_and_the_command(answered: RunResult, tmp_path: Path) -> None:
    (page,) = write_issues(answered, tmp_path, CODEC)
    text = page.read_text()
    fault = answered.diagnosis.faults[0]
    # Two cases do not suffice for a statement about the fault: the title is the observation.
    assert text.startswith("# drone: expected")
    heading = "What was observed"  # prose: data
    for part in ("VD-RU-03", heading, "observed: **", fault.rerun, f"{page.stem}.py", f"`{fault.case}`"):
        assert part in text, part
    assert "```\n0000 " in text
    assert "|" not in text.splitlines()[0]


def test_the_program_and_the_c_array_have_the_frames_that_were_sent(answered: RunResult, tmp_path: Path) -> None:
    (page,) = write_issues(answered, tmp_path, CODEC)
    fault = answered.diagnosis.faults[0]
    case = next(each for each in answered.cases if each.id == fault.case)
    sent = [step for step in stimulus(case, fault.check) if step.octets]
    assert sent
    tree = ast.parse(page.with_suffix(".py").read_text())
    steps = next(
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and node.targets[0].id == "STEPS"
    )
    assert [(round(time, 6), bytes.fromhex(frame)) for time, frame, _ in steps if frame] == [
        (round(step.time, 6), step.octets) for step in sent
    ]
    header = page.with_suffix(".h")
    assert header.read_text().count("static const uint8_t dcp_frame_") == len(sent)
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    program = tmp_path / "use.c"
    program.write_text(
        f'''#include "{header.name}"
#include <stdio.h>
int main(void) {{
    size_t i, j;
    for (i = 0; i < sizeof dcp_stimuli / sizeof *dcp_stimuli; i++) {{
        printf("%u ", dcp_stimuli[i].time_us);
        for (j = 0; j < dcp_stimuli[i].length; j++)
            printf("%02x", dcp_stimuli[i].octets[j]);
        puts("");
    }}
    return 0;
}}
'''
    )
    subprocess.run(
        ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-o", tmp_path / "use", program], check=True, cwd=tmp_path
    )
    lines = subprocess.run([tmp_path / "use"], check=True, capture_output=True, text=True).stdout.splitlines()
    assert lines == [f"{int(step.time * 1e6)} {step.octets.hex()}" for step in sent]


def test_the_program_sends_only_frames_before_the_failure(answered: RunResult) -> None:
    fault = answered.diagnosis.faults[0]
    case = next(each for each in answered.cases if each.id == fault.case)
    steps = stimulus(case, fault.check)
    last = max(event.time for event in case.evidence if event.frame in {mark.frame for mark in fault.check.frames})
    begin = next(event.time for event in case.evidence if event.direction in ("sent", "call"))
    assert steps[0].time == 0
    assert all(step.time <= (last - begin) / 1e9 + 1 for step in steps)


def test_a_fault_of_services_needs_calls(tmp_path: Path) -> None:
    run = run_of("M-BP-QM-01-drops-head", "TC_BP_QM_BV")
    page = write_issues(run, tmp_path, CODEC)[0]
    assert "BP-TransmitPayload" in page.read_text()
    fault = run.diagnosis.faults[0]
    assert needs_calls(stimulus(next(each for each in run.cases if each.id == fault.case), fault.check))


def test_hostile_names_stay_text(answered: RunResult, tmp_path: Path) -> None:
    hostile = msgspec.structs.replace(answered, sut=Sut(name=HOSTILE, link="eth:uwb0"), tool=HOSTILE)
    (page,) = write_issues(hostile, tmp_path, CODEC)
    text = page.read_text()
    assert "<script>" not in text.replace("\\<script\\>", "")
    assert "](javascript" not in text.replace("\\]\\(javascript", "")
    assert "\x1b" not in text
    ast.parse(page.with_suffix(".py").read_text())
    assert '*/"' not in page.with_suffix(".h").read_text()


def test_without_a_fault_there_is_nothing_to_report(answered: RunResult, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no probable fault"):
        write_issues(msgspec.structs.replace(answered, diagnosis=None), tmp_path, CODEC)
