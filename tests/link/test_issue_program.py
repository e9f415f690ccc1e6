"""The Python program of an issue report sends the frames of the case on a real link, with their times."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.definitions.results import RunResult, Sut
from dcp_conformance.diagnosis import Dictionary, Fault, explain
from dcp_conformance.diagnosis.observation import digest
from dcp_conformance.reference.namespace import SUT_INTERFACE, TESTER_INTERFACE, Namespace, NamespaceError
from dcp_conformance.reporting.issues import write_issues
from dcp_conformance.reporting.issues.stimulus import stimulus
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite, cases

from dcp_codec.codec import Codec

MUTANT = "M-VD-RU-03-equal-answered"
CASE = "TC_VD_SEQ_BV_03-0"


def run() -> RunResult:
    faulty = all_mutants()[MUTANT]
    results = list(Suite("dcp-2.0", faulty.make).run([case for case in cases() if case.id == CASE]))
    failed = next(check for each in results if each.id == CASE for check in each.checks if check.verdict == "fail")
    fault = Fault(
        id=MUTANT, requirements=faulty.requirements, what=faulty.what, fails=frozenset({CASE}), undecided=frozenset(),
        observed=frozenset({(CASE, digest(failed))}),
    )  # fmt: skip
    return RunResult(
        profile="dcp-2.0",
        spec_version="2.0",
        sut=Sut(name="drone", link="eth:uwb0"),
        cases=tuple(results),
        diagnosis=explain(results, Dictionary((fault,))),
    )


@pytest.mark.skipif(os.geteuid() != 0, reason="network namespaces beside the own one are for root")
def test_the_program_sends_the_frames_of_the_tester(tmp_path: Path) -> None:
    found = run()
    (page,) = write_issues(found, tmp_path, Codec("dcp-2.0"))
    fault = found.diagnosis.faults[0]
    case = next(each for each in found.cases if each.id == fault.case)
    steps = [step for step in stimulus(case, fault.check) if step.octets]
    try:
        network = Namespace(b"\x02\x00\x00\x00\x00\x01")
    except NamespaceError as error:
        pytest.skip(str(error))
    try:
        with network.entered():
            link = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x4953))
            link.bind((SUT_INTERFACE, 0x4953))
            program = subprocess.Popen(
                [sys.executable, page.with_suffix(".py"), TESTER_INTERFACE],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                text=True,
            )
        link.settimeout(60)
        with link:
            heard = [link.recv(65535) for _ in steps]
        output, _ = program.communicate(timeout=60)
    finally:
        network.close()
    assert heard == [step.octets for step in steps]
    assert program.returncode == 0
    sent = [line.split() for line in output.splitlines() if " sent " in line]
    assert [(float(line[0]), bytes.fromhex(line[3])) for line in sent] == [
        (pytest.approx(step.time, abs=0.001), step.octets) for step in steps
    ]
    assert msgspec.json.encode(found.diagnosis)
