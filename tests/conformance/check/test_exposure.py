"""Link quality where causes are repeated: a summary has several chances to be received, a create has one."""

from __future__ import annotations

import random

import pytest
from dcp_conformance.check.reception.links import Inference, Link, reacts, summary
from dcp_conformance.definitions.verdict import Verdict
from dcp_lab.interop.cell import Cell, run_cell
from dcp_lab.interop.definition import all_tests
from dcp_lab.interop.implementations import built_in

A, B = 1, 2


def outcomes(exposure, share: dict[int, float], trials: int, seed: int = 1) -> dict:
    chance = random.Random(seed)
    hits = sum(chance.random() < reacts(exposure, share) for _ in range(trials))
    return {exposure: (trials - hits, hits)}


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
@pytest.mark.parametrize("beacons", [1, 2, 4])
def test_the_share_is_per_beacon_however_often_a_cause_is_repeated(share: float, beacons: int) -> None:
    seen = outcomes(((A, beacons),), {A: share}, 4000)
    model = Inference(seen)
    assert model.shares[A] == pytest.approx(share, abs=0.08)
    assert model.trials[A] == 4000
    assert model.due[A] == pytest.approx(seen[((A, beacons),)][1])
    assert model.lower_bound(A, 3.0) < share


def test_reactions_to_repeated_causes_do_not_show_how_well_a_link_works() -> None:
    """With five beacons in each trial, half of them lost, nearly every trial is met."""
    assert Inference({((A, 5),): (0, 57)}).lower_bound(A, 1.0) < 0.65
    assert Inference({((A, 1),): (0, 57)}).lower_bound(A, 1.0) > 0.98


def windows(*shown: tuple[float, int], count: int, missed: int = 1) -> list[Link]:
    """Return windows of one pair with these lower bounds and reactions to the speaker alone, and others without.

    ``missed``: number of missing reactions to the speaker alone, in each window.
    """
    rest = [(0.0, 0)] * (count - len(shown))
    return [
        Link(b"a", b"b", n, n + 1, 0.5, 4, 1.5, bound, alone, alone + missed)
        for n, (bound, alone) in enumerate([*shown, *rest])
    ]


def test_a_few_of_many_windows_do_not_show_a_link_by_chance() -> None:
    [few] = summary(windows(*[(0.6, 0)] * 20, *[(0.26, 1)] * 5, count=900)).values()
    assert (few.at_least, few.alone) == (0.0, 0)
    [short] = summary(windows((0.6, 0), (0.26, 1), count=4)).values()
    assert (short.at_least, short.alone) == (0.6, 1)
    [often] = summary(windows(*[(0.6, 1)] * 100, count=900)).values()
    assert (often.at_least, often.alone) == (0.6, 100)
    [alone] = summary(windows(*[(0.3, 1)] * 9, *[(0.3, 0)] * 80, count=900, missed=0)).values()
    assert (alone.at_least, alone.alone) == (0.3, 9)
    [once] = summary(windows((0.8, 3), (0.9, 1), count=900)).values()
    assert (once.at_least, once.alone, once.end) == (0.8, 3, 1)


def test_beacons_of_other_nodes_explain_only_some_reactions() -> None:
    seen = {((A, 1),): (10, 90), ((A, 3), (B, 1)): (0, 50), ((B, 1),): (40, 0)}
    model = Inference(seen)
    assert model.shares[A] == pytest.approx(0.9, abs=0.02)
    assert model.shares[B] < 0.02
    assert model.alone[A] == 90
    assert model.alone[B] == 0


#: Stations that send rarely, or with long gaps, beside ones that send often between two of their beacons.
@pytest.mark.parametrize(
    ("a", "b", "test", "seed"),
    [
        ("variant:V-BP-TX-jitter-95", "variant:V-TIME-beacon-500", "IT_VD_LOSS-pair-50", 1),
        ("node:dcp-2.0", "variant:V-BP-TX-jitter-95", "IT_VD_LOSS-pair-50", 5),
        ("variant:V-BP-TX-jitter-95", "variant:V-TIME-beacon-500", "IT_VD_LOSS-line3-50", 2),
    ],
)
def test_permitted_stations_on_bad_links_are_not_accused(a: str, b: str, test: str, seed: int) -> None:
    cell = Cell(a=a, b=b, test=test, implementations=(built_in(a), built_in(b)), seed=seed)
    result = run_cell(cell, all_tests()[test])
    assert result.verdict is Verdict.PASS, result.reason
