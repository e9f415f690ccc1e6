"""A finding names the place of the node that it concerns, also if its frames are those of another node."""

from __future__ import annotations

from dcp_conformance.definitions.verdict import Verdict
from dcp_lab.interop.cell import Cell, run_cell
from dcp_lab.interop.definition import all_tests
from dcp_lab.interop.implementations import built_in


def test_the_node_that_does_not_react_is_blamed_rather_than_the_sender() -> None:
    both = built_in("node:dcp-2.0"), built_in("mutant:M-VD-PU-07-ignored")
    test = all_tests()["IT_VD_LATE-pair"]
    result = run_cell(Cell(a="node", b="mutant", test=test.id, implementations=both), test)
    found = [
        each.observed
        for each in result.checks
        if each.verdict is Verdict.FAIL and each.expected.startswith("CK_VD_TAKES_UPDATE")
    ]
    assert len(found) == 1
    assert found[0].startswith("place 1 (mutant): 02:00:00:00:00:02")
