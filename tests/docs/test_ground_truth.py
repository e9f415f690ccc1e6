"""A short version of ``benchmarks/ground_truth.py``: databases, findings, pages and answers agree."""

from __future__ import annotations

import pytest

from benchmarks import ground_truth


@pytest.mark.part("suite")
def test_the_page_of_ground_truth(capsys):
    assert ground_truth.main(["--short"]) == 0
    page = capsys.readouterr().out
    assert page.count("The answer agrees") == 2
    assert "False findings: 0." in page
    assert page.count("| yes |") == 2
