"""Runs on a bad link in real time: our node as a process, over Ethernet and over UDP."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.run import ConformanceRun
from dcp_conformance.execution.selection import Selection
from dcp_conformance.execution.target import TargetOptions

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")


@pytest.mark.parametrize(
    ("profile", "impair"),
    [("dcp-2.0", "loss=0.2,delay=2ms,duplicate=0.1,corrupt=0.001"), ("student-2024", "loss=0.2,reorder=0.1")],
    ids=["ethernet", "udp"],
)
def test_a_bad_link_fails_no_case(profile: str, impair: str) -> None:
    options = TargetOptions(profile=profile, impair=(impair,))
    run = ConformanceRun(options, Selection(patterns=("TC_BP_RX_BV_0*",)))
    run.execute()
    assert run.trouble == ""
    assert [f"{each.id}: {each.reason}" for each in run.results if each.verdict in (Verdict.FAIL, Verdict.ERROR)] == []
    assert sum(each.verdict is Verdict.PASS for each in run.results) >= 3
    (note,) = [each for each in run.result().notes if each.startswith("the link was impaired")]
    assert "from it 0 of" not in note, "some beacons were lost"
