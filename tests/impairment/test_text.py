"""The text form of impairment: what is read, and what is refused with key and reason."""

from __future__ import annotations

import tomllib

import pytest

from dcp_codec.impairment import Impairment, ImpairmentError, Outage, impairment_of, parse_impairment, text_of

MS = 1_000_000
EVERYTHING = (
    "loss=0.1,burst=3,delay=5ms,jitter=2ms,distribution=normal,duplicate=0.01,reorder=0.02,reorder_delay=30ms,"
    "corrupt=0.001,corrupt_frames=0.1,flips=2,down=10s+5s/30s,down=3s+200ms"
)


def test_every_key_is_read() -> None:
    assert parse_impairment(EVERYTHING) == Impairment(
        loss=0.1,
        burst=3,
        delay=5 * MS,
        jitter=2 * MS,
        distribution="normal",
        duplicate=0.01,
        reorder=0.02,
        reorder_delay=30 * MS,
        corrupt=0.001,
        corrupt_frames=0.1,
        flips=2,
        down=(Outage(10_000 * MS, 5_000 * MS, 30_000 * MS), Outage(3_000 * MS, 200 * MS)),
    )
    assert parse_impairment("") == Impairment()
    assert parse_impairment("p=0.1,r=0.5,bad=0.9").bursts == (0.1, 0.5)


@pytest.mark.parametrize("text", ["", EVERYTHING, "loss=0.3", "p=0.1,r=0.5,bad=0.9", "delay=300us,jitter=17ns"])
def test_the_text_form_survives_a_round_trip(text: str) -> None:
    assert parse_impairment(text_of(parse_impairment(text))) == parse_impairment(text)


def test_a_table_has_the_same_keys() -> None:
    table = tomllib.loads('loss = 0.1\nburst = 3\ndelay = "5ms"\nflips = 2\ndown = ["10s+5s/30s", "3s+200ms"]')
    assert impairment_of(table) == parse_impairment("loss=0.1,burst=3,delay=5ms,flips=2,down=10s+5s/30s,down=3s+200ms")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("los=0.1", "los: unknown key; the keys are loss, burst,"),
        ("loss", "loss: a value is missing; write loss=VALUE"),
        ("loss=", "loss: a value is missing"),
        ("loss=0.1,loss=0.2", "loss: the key is given twice"),
        ("loss=1.5", "loss: 1.5 is not within 0..1"),
        ("loss=-0.1", "loss: -0.1 is not within 0..1"),
        ("loss=nan", "loss: 'nan' is not a number"),
        ("loss=inf", "loss: 'inf' is not a number"),
        ("loss=ten", "loss: 'ten' is not a number"),
        ("burst=3", "burst: without loss there are no bursts"),
        ("loss=0.1,burst=0.5", "burst: 0.5 frames; a burst has at least 1"),
        ("loss=0.9,burst=2", "burst: a loss of 0.9 needs bursts of at least 9 frames"),
        ("loss=1,burst=2", "loss: 1 is not below the loss in the bad state of bursts"),
        ("p=0.1", "r: p and r are given together"),
        ("p=0.1,r=0.2,loss=0.1", "p: p and r replace loss and burst"),
        ("bad=0.5,loss=0.1", "bad: the loss in the bad state needs"),
        ("delay=5", "delay: '5' is not a time; write a number and its unit"),
        ("delay=-5ms", "delay: '-5ms' is not a time"),
        ("distribution=pareto", "distribution: 'pareto' is not one of uniform, normal, exponential"),
        ("flips=1.5", "flips: 1.5 is not an integer"),
        ("flips=0", "flips: 0 is not at least 1"),
        ("down=5s", "down: '5s' is not an outage"),
        ("down=1s+5s/5s", "down: the period of an outage is longer than the outage"),
        ("down=1s+0s", "down: an outage starts at 0 s or later, and lasts longer than 0 s"),
    ],
)
def test_invalid_values_are_refused_with_key_and_reason(text: str, said: str) -> None:
    with pytest.raises(ImpairmentError) as caught:
        parse_impairment(text)
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"delay": 5}, "delay: 5 is not a time"),
        ({"loss": True}, "loss: True is not a number"),
        ({"loss": [1]}, "loss: [1] is not a number"),
        ({"down": 3}, "down: 3 is not an outage"),
        ({"down": [3]}, "down: 3 is not an outage"),
    ],
)
def test_values_of_a_wrong_type_are_refused(table: dict[str, object], said: str) -> None:
    with pytest.raises(ImpairmentError) as caught:
        impairment_of(table)
    assert str(caught.value).startswith(said)
