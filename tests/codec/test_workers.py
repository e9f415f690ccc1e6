"""The pool of workers: results, ends, and workers that are lost."""

from __future__ import annotations

import multiprocessing
import os
import signal
from functools import partial
from pathlib import Path

import pytest

from dcp_codec.common.workers import Worker, WorkerLostError, completed

from ..waiting import PATIENCE


def test_results_have_the_places_of_their_items():
    assert sorted(completed(abs, [-3, 4, -5], 2)) == [(0, 3), (1, 4), (2, 5)]


def test_items_are_drawn_when_they_are_needed():
    drawn = []

    def items():
        for number in range(100):
            drawn.append(number)
            yield number

    results = completed(abs, items(), 1, start="thread")
    next(results)
    results.close()
    assert drawn == [0, 1]


def test_state_is_set_once_in_each_worker():
    begin = partial(os.environ.__setitem__, "STATE_OF_WORKERS", "set")
    assert dict(completed(os.getenv, ["STATE_OF_WORKERS"] * 3, 1, begin=begin)) == dict.fromkeys(range(3), "set")
    assert "STATE_OF_WORKERS" not in os.environ


def test_an_exception_of_an_item():
    with pytest.raises(ValueError, match="invalid literal"):
        list(completed(int, ["1", "x"], 1))


def test_a_lost_worker():
    with pytest.raises(WorkerLostError):
        list(completed(end_by, [signal.SIGKILL], 1))


def test_an_interruption_ends_running_items(tmp_path: Path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    results = completed(first_line, [os.devnull, str(pipe)], 2)
    assert next(results) == (0, "")
    with pytest.raises(KeyboardInterrupt):
        results.throw(KeyboardInterrupt)
    assert multiprocessing.active_children() == []


def test_a_single_worker_answers_and_ends():
    worker = Worker(multiprocessing.get_context("fork"), echo, "yes", duplex=True)
    worker.connection.send("no")
    assert worker.connection.recv() == "yes no"
    with pytest.raises(EOFError):
        worker.connection.recv()
    assert worker.status(PATIENCE) == 0
    worker.end()
    assert worker.connection.closed


def test_a_single_worker_that_does_not_end_is_killed():
    worker = Worker(multiprocessing.get_context("fork"), wait_for_ever)
    worker.end(0)
    assert worker.process.exitcode == -signal.SIGKILL


def end_by(number: int) -> None:
    os.kill(os.getpid(), number)


def first_line(path: str) -> str:
    """Read a line; of a pipe without a writer, this does not end."""
    with Path(path).open() as file:
        return file.readline()


def echo(connection, text: str) -> None:
    connection.send(f"{text} {connection.recv()}")


def wait_for_ever(connection) -> None:
    signal.pause()
