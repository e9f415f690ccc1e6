"""Coverage of states by messages: it is complete where sequences aim at what is missing, and says what is not there."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from dcp_conformance.fuzz.execute.stack import StackTarget
from dcp_conformance.fuzz.generate.coverage import shown, tables
from dcp_conformance.fuzz.generate.directed import Directed, possible_states
from dcp_conformance.fuzz.generate.sequences import Sequences

from dcp_codec import Codec
from dcp_codec.testing.mutation import Mutator, drawn_pool


@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.1", "cpp-2.0"])
def test_every_pair_of_state_and_message_is_reached_by_a_directed_sequence(profile):
    codec = Codec(profile)
    target = StackTarget(codec)
    rng = random.Random(1)
    reached: Counter[tuple[str, str]] = Counter()
    sequences = Sequences(codec, rng, target.own_id, Mutator(codec, rng, drawn_pool(codec, rng, 40)))
    directed = Directed(sequences, reached)
    possible = possible_states(codec)
    for pair in sorted(possible):
        assert target.run(directed.towards(*pair)) is None
        assert pair in target.observer.reached
    assert len(possible) > 60


def test_missing_pairs_are_targeted_until_all_are_reached():
    codec = Codec("dcp-2.0")
    rng = random.Random(1)
    possible = possible_states(codec)
    reached = Counter(possible)
    sequences = Sequences(codec, rng, b"\x02\0\0\0\0\x01", Mutator(codec, rng, drawn_pool(codec, rng, 40)))
    directed = Directed(sequences, reached)
    kinds = Counter()
    for _ in range(200):
        directed.draw()
        kinds.update(directed.kinds)
    assert kinds["directed"] == 0
    del reached["deleted own", "create later"]
    for _ in range(200):
        directed.draw()
        kinds.update(directed.kinds)
    assert 20 <= kinds["directed"] <= 80


def test_the_tables_show_coverage_and_missing_pairs():
    coverage = tables(
        Counter({("bp.length", "max"): 3}),
        Counter({("unknown", "delete"): 2}),
        {("bp.length", "max"), ("", "bomb")},
        0,
        {("unknown", "delete"), ("alive own", "summary newer")},
    )
    assert coverage.missing == ["message bomb"]
    assert coverage.missing_states == ["alive own: summary newer"]
    assert shown(coverage) == [
        "field x what was done to it: 1 of 2 pairs; how often each",
        "                        below      plus minus           bytes  bit  cut",
        "              zero  one   top  top  one   one unknown swapped flip  off",
        "    bp.length                    3",
        "  whole message: all counts raised 0",
        "message x state of the variable: 1 of 2 pairs",
        "                        alive   alive deleted deleted",
        "                unknown   own foreign     own foreign",
        "  delete              2",
        "  summary newer             0",
    ]


@pytest.mark.parametrize(
    ("count", "text"), [(9_999, "9999"), (10_000, "10k"), (999_999, "999k"), (1_000_000, "1M"), (10**9, "999M")]
)
def test_counts_fit_into_their_columns(count, text):
    coverage = tables(Counter({("bp.length", "max"): count}), Counter(), {("bp.length", "max")})
    assert shown(coverage)[-1].split() == ["bp.length", text]
