"""Link quality where causes are repeated: a summary has several chances to be received, a create has one."""

from __future__ import annotations

import random

import pytest
from dcp_conformance.check.reception.links import Inference, reacts
from dcp_conformance.interop.cell import Cell, run_cell
from dcp_conformance.interop.definition import all_tests
from dcp_conformance.interop.implementations import built_in
from dcp_conformance.model.verdict import Verdict

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
