"""How long the tester waits for answers: less after missing ones."""

from __future__ import annotations

import time

import pytest
from dcp_conformance.errors import NeverAnsweredError, NoAnswerError
from dcp_conformance.upper_tester.patience import Patience

READ, LIST = "RTDB-Read", "BP-ListRegisteredProtocols"
ON, OFF = "BP-MGMT-Activate", "BP-MGMT-Deactivate"


def missing(patience: Patience, *methods: str) -> list[float]:
    """Let calls go unanswered; return how long each one waited."""
    waited = []
    for each in methods:
        waited.append(patience.of(each))
        patience.unanswered(each, each, waited[-1])
    return waited


def never(method: str) -> Patience:
    """Return the patience with an adapter that answers all methods but one."""
    patience = Patience(5)
    for _ in range(3):
        missing(patience, method)
        patience.answered(LIST, time.monotonic())
    return patience


def test_it_shrinks_with_each_missing_answer_of_a_method() -> None:
    assert missing(Patience(5), READ, READ, READ) == [5, 1, 0.5]


def test_calls_of_an_adapter_that_answers_nothing_share_it() -> None:
    assert missing(Patience(5), READ, LIST, "RTDB-Create") == [5, 1, 0.5]


def test_another_method_has_all_of_it_once_one_was_answered() -> None:
    patience = Patience(5)
    missing(patience, READ)
    patience.answered(LIST, time.monotonic())
    assert (patience.of(LIST), patience.of("RTDB-Create"), patience.of(READ)) == (5, 5, 1)


def test_a_method_that_is_never_answered_does_not_show_that_the_implementation_hangs() -> None:
    patience = never(READ)
    assert patience.never(READ)
    assert patience.of(READ) == pytest.approx(0.1)
    assert isinstance(patience.unanswered(READ, READ, 0.1), NeverAnsweredError)
    assert isinstance(patience.unanswered(LIST, LIST, 5), NoAnswerError)


def test_it_shrinks_to_no_less_than_slow_answers_take() -> None:
    patience = never(READ)
    patience.answered(LIST, time.monotonic() - 1)
    assert patience.of(READ) == pytest.approx(2, rel=0.1)
    patience.answered("UT-Reset", time.monotonic() - 4)
    assert patience.of(READ) == pytest.approx(2, rel=0.1)


def test_a_late_answer_gives_the_method_all_of_it_again() -> None:
    patience = never(READ)
    patience.late(READ)
    assert (patience.of(READ), patience.never(READ)) == (5, False)


def test_a_restart_forgets_missing_answers_but_not_what_is_never_answered() -> None:
    patience = never(READ)
    missing(patience, LIST, "RTDB-Create")
    patience.renew()
    assert patience.of(LIST) == patience.of("RTDB-Create") == 5
    assert patience.never(READ)


def test_an_entity_that_cannot_be_activated_again_is_not_deactivated() -> None:
    assert never(ON).refused(OFF) == f"{ON} is never answered, while other methods are: it could not undo {OFF}"
    assert never(READ).refused(OFF) == never(ON).refused(ON) == never(ON).refused("VD-MGMT-Deactivate") == ""
