"""A short version of ``benchmarks/validate.py``: simulations agree with closed forms."""

from __future__ import annotations

import pytest

from benchmarks import validate

pytestmark = pytest.mark.part("suite")


def test_simulations_agree_with_closed_forms(capsys):
    assert validate.main(["--short"]) == 0, capsys.readouterr().err


def test_a_difference_is_found():
    assert validate.Row("", 1.0, [1.0, 1.1, 0.9]).z == pytest.approx(0)
    assert validate.Row("", 2.0, [1.0, 1.1, 0.9]).is_far
    assert not validate.Row("", 1.05, [1.0, 1.001, 0.999]).is_far
    assert validate.Row("", 12.0, [8.0, 8.0]).is_far
