"""Known properties of the implementation: where values come from, and which are assumed."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.test_system.known import Reaction
from dcp_conformance.test_system.sut_properties import FLOOR

from .parts import PERIOD, Parts

LONGEST = "VARDISPAR_MAX_VALUE_LENGTH"


def test_a_reported_value_precedes_the_pixit_and_the_pixit_precedes_the_profile():
    parts = Parts()
    assert parts.sut.parameter(LONGEST) == parts.codec.profile.limits.max_value_length
    parts = Parts(pics=Pics(pixit=Testing(max_value_length=7)))
    assert parts.sut.parameter(LONGEST) == 7
    parts.run.parameters[LONGEST] = 9
    assert parts.sut.parameter(LONGEST) == 9


def test_an_unknown_parameter_is_an_error_and_has_no_initial_value():
    parts = Parts()
    with pytest.raises(KeyError):
        parts.sut.parameter("VARDISPAR_NOTHING")
    assert parts.sut.initial("VARDISPAR_NOTHING") is None


def test_only_assumed_values_are_assumptions():
    parts = Parts()
    parts.run.parameters[LONGEST] = 9
    parts.sut.bound(LONGEST)
    assert parts.assumptions.text() == ""
    parts.sut.bound("VARDISPAR_MAX_SUMMARIES")
    assert "pixit.max_summaries" in parts.assumptions.text()
    parts.assumptions.discard()
    assert parts.assumptions.text_of_all() == ""


def test_a_stimulus_that_may_be_rejected_is_an_assumption_about_stimuli():
    parts = Parts()
    assert parts.sut.rep_cnt(1) == 1
    assert parts.assumptions.text_of_all() == ""
    assert parts.sut.rep_cnt(3) == 3
    assert parts.assumptions.text() == ""
    assert "pixit.max_repetitions" in parts.assumptions.text_of_all()
    parts.run.parameters["VARDISPAR_MAX_REPETITIONS"] = 2
    assert parts.sut.rep_cnt(3) == 2


def test_the_reaction_time_is_measured_and_the_pixit_overrides_it():
    parts = Parts()
    assert (parts.sut.reaction, parts.sut.slowness, parts.sut.ahead) == (FLOOR, 1.0, 2)
    parts.run.known.reaction = Reaction(2 * FLOOR, samples=(3.2,))
    assert (parts.sut.reaction, parts.sut.slowness, parts.sut.ahead) == (2 * FLOOR, 2.0, 4)
    parts = Parts(pics=Pics(pixit=Testing(reaction_periods=3.0)))
    parts.run.known.reaction = Reaction(2 * FLOOR)
    assert (parts.sut.reaction, parts.sut.slowness) == (3.0, 1.0)


def test_payloads_that_are_processed_one_at_a_time_extend_the_reaction_time():
    parts = Parts()
    parts.sut.load(3)
    assert parts.sut.reaction == FLOOR
    parts.run.known.reaction = Reaction(FLOOR, per_payload=0.5)
    assert parts.sut.one_by_one
    parts.sut.load(3)
    parts.sut.load(1)
    assert parts.sut.reaction == FLOOR + 2.0
    parts.link.time = parts.sut.busy_until
    assert parts.sut.reaction == FLOOR


def test_the_timing_scale_extends_the_period():
    parts = Parts()
    assert parts.sut.period == PERIOD
    parts.run.timing_scale = 1.5
    assert parts.sut.period == 150_000_000
