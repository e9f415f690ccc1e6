"""``dcp-selftest citations``: a citation over the wrong code is noticed."""

from __future__ import annotations

import ast
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.errors import UsageError
from dcp_selftest.citations import campaign, unit_tests
from dcp_selftest.citations.campaign import chosen, run
from dcp_selftest.citations.changes import changes_under
from dcp_selftest.citations.ledger import _File, key, ledger
from dcp_selftest.citations.places import Citation, citations, citations_in

from ..conformance.command import Command

ROOT = Path(__file__).parents[2]
SOURCE = '''\
"""A module."""

TABLE = {
    ##= BP-QM-01
    # A comment between them.
    "a": (1, "x"),
    ##= BP-QM-02
    "b": (2, "y"),
}


class Some:
    ##= BP-REG-01
    def method(self, value):
        ##= BP-REG-02
        ##= BP-REG-03 | exception: for a reason
        limit = 3
        low, high = limit, 4
        if value > limit:
            return low
        ##= BP-REG-04 BP-REG-05
        return high


##= VD-PC-01 is cited, "##= VD-PC-02" in a string is not
def last(kind):
    match kind:
        ##= VD-PC-03
        case 1:
            return 2
'''


def test_the_lines_that_a_citation_covers():
    listed = list(citations_in("p/m.py", SOURCE))
    found = {each.requirement: (each.line, each.first, each.last, each.function) for each in listed}
    assert found == {
        "BP-QM-01": (4, 6, 6, ""),
        "BP-QM-02": (7, 8, 8, ""),
        "BP-REG-01": (13, 14, 22, "Some.method"),
        "BP-REG-02": (15, 17, 20, "Some.method"),
        "BP-REG-03": (16, 17, 20, "Some.method"),
        "BP-REG-04": (21, 22, 22, "Some.method"),
        "BP-REG-05": (21, 22, 22, "Some.method"),
        "VD-PC-01": (25, 26, 30, "last"),
        "VD-PC-03": (28, 29, 30, "last"),
    }
    assert [each.remark for each in listed if each.remark] == ["exception: for a reason"]


def citation(requirement: str, file: str = "") -> Citation:
    return next(each for each in citations() if each.requirement == requirement and file in each.path)


@pytest.mark.part("suite")
def test_changes_are_in_the_cited_code():
    for each in citations():
        for change in changes_under(each):
            assert each.first <= change.line <= each.last
            assert change.module == "dcp_stack." + each.module


def test_entries_of_tables_are_exchanged():
    droptail = citation("BP-QM-01", "bp/queue.py")
    changes = changes_under(droptail)
    assert len(changes) >= 3
    for change in changes:
        assert "QUEUE_DROPTAIL" in change.text
        assert ast.unparse(change.tree()) != ast.unparse(ast.parse((ROOT / droptail.path).read_text()))


def misplaced(requirement: str, code_of: Citation) -> Citation:
    """A citation of ``requirement`` where that of another one stands."""
    return code_of._replace(requirement=requirement)


def test_two_ids_in_each_others_place_are_noticed():
    """A real mistake that was overlooked: drop-tail and repeat in the table of queueing modes."""
    droptail, repeat = citation("BP-QM-01", "bp/queue.py"), citation("BP-QM-05", "bp/queue.py")
    right = run([droptail, repeat], jobs=1)
    assert [each.proof for each in right.verdicts] == ["case", "case"]
    assert right.unproved == ()
    wrong = run([misplaced("BP-QM-05", droptail), misplaced("BP-QM-01", repeat)], jobs=1)
    assert [each.proof for each in wrong.verdicts] == ["none", "none"]
    assert len(wrong.unproved) == 2


@pytest.mark.part("suite")
def test_unit_tests_with_the_requirement_count_as_well():
    droptail = citation("BP-QM-01", "bp/queue.py")
    (change, *_) = [each for each in changes_under(droptail) if "discard-new" in each.text.partition("->")[0]]
    source = ast.unparse(change.tree()).replace("'discard-new', 'remove', True", "'displace-oldest', 'remove', True", 1)
    failed = unit_tests.failing_test(ROOT, "BP-QM-01", change.module, source)
    assert failed.startswith("FAILED tests/stack/bp/test_transmit.py")
    assert unit_tests.failing_test(ROOT, "BP-QM-01", change.module, (ROOT / droptail.path).read_text()) == ""


def test_a_reason_in_the_ledger_counts_until_the_citation_is_proved(monkeypatch):
    droptail, repeat = citation("BP-QM-01", "bp/queue.py"), citation("BP-QM-05", "bp/queue.py")
    monkeypatch.setattr(campaign, "ledger", lambda: {key(droptail): "cannot be seen", key(repeat): "cannot be seen"})
    result = run([droptail, misplaced("BP-QM-05", droptail)], jobs=1)
    assert result.unproved == ()
    assert [each.citation.requirement for each in result.outdated] == ["BP-QM-01"]


def test_the_ledger_names_citations_that_exist():
    assert set(ledger()) <= {key(each) for each in citations()}
    assert all(reason.strip() for reason in ledger().values())


def test_the_ledger_is_well_formed():
    text = (ROOT / "selftest/dcp_selftest/data/unproved-citations.toml").read_bytes()
    listed = [each for entry in msgspec.toml.decode(text, type=_File).entry for each in entry.citations]
    assert len(listed) == len(set(listed))


class TestCommand:
    def test_the_list(self, dcp_selftest: Command):
        done = dcp_selftest("citations", "--list", "bp/queue.py")
        assert done.status == 0
        assert "BP-QM-01    dcp_stack/bp/queue.py:" in done.out

    def test_usage(self, dcp_selftest: Command):
        done = dcp_selftest("citations", "NO-SUCH")
        assert done.status == 2
        assert "neither a cited requirement" in done.err

    def test_proved_and_unproved(self, dcp_selftest: Command, monkeypatch, tmp_path):
        droptail = citation("BP-QM-01", "bp/queue.py")
        monkeypatch.setattr(campaign, "citations", lambda: (droptail, misplaced("BP-QM-05", droptail)))
        monkeypatch.setattr(unit_tests, "checkout", lambda: None)
        done = dcp_selftest("citations", "--verbose", "--report-dir", tmp_path, "--jobs", "1")
        assert done.status == 1
        assert f"unproved BP-QM-05 {droptail}: no change of the cited code is detected" in done.out
        assert "2 citations: 1 proved by a case, 0 by a test, 0 in the ledger, 1 unproved" in done.out
        assert (tmp_path / "citations.json").exists()


def test_a_pattern_means_ids_or_files():
    assert {each.requirement for each in chosen(["BP-QM-0*"])} >= {"BP-QM-01", "BP-QM-05"}
    assert {each.path for each in chosen(["bp/queue.py"])} == {"dcp_stack/bp/queue.py"}
    assert len(chosen([])) == len(citations())
    with pytest.raises(UsageError):
        chosen(["XX-01"])
