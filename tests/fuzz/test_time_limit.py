"""Ending what does not come back."""

from __future__ import annotations

import threading

import pytest
from dcp_lab.fuzz.execute.time_limit import TimeLimit, TimeLimitExceeded


def forever():
    while True:
        pass


def test_a_call_that_hangs_is_ended_each_time():
    limit = TimeLimit(0.05)
    for _ in range(3):
        with pytest.raises(TimeLimitExceeded), limit:
            forever()
        with limit:
            pass


class NeverGone:
    def __del__(self):
        forever()


def swallow(left: list[NeverGone]) -> None:
    left.clear()
    for _ in range(10_000_000):
        pass


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_call_that_swallowed_the_exception_is_ended_later():
    """Exceptions in a finaliser are discarded."""
    left = [NeverGone()]
    with pytest.raises(TimeLimitExceeded), TimeLimit(0.05):
        swallow(left)


def test_no_exception_is_raised_after_the_limited_block():
    limit, spent = TimeLimit(0.02), 0
    with limit:
        pass
    for _ in range(3_000_000):
        spent += 1
    assert spent == 3_000_000


def test_a_time_limit_has_no_effect_in_another_thread():
    raised: list[BaseException] = []

    def work():
        try:
            with TimeLimit(0.001):
                sum(range(1_000_000))
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert not raised
