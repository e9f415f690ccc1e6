"""Ending processes that a search finds, tested without processes: the signals, and when the search ends."""

from __future__ import annotations

import signal
from signal import SIGKILL, SIGTERM

from dcp_codec.common import processes
from dcp_codec.common.processes import end_all


class Process:
    """Ends when it gets one of the signals ``ends``; ``refused``: the user may not send any."""

    def __init__(self, pid: int, *ends: signal.Signals, refused: bool = False) -> None:
        self.pid = pid
        self.refused = False
        self.got: list[signal.Signals] = []
        self._ends, self._refuses = ends, refused

    def ended(self, patience: float = 0.0) -> bool:
        return any(each in self._ends for each in self.got)

    def signal(self, number: signal.Signals) -> None:
        self.refused = self._refuses
        if not self.refused:
            self.got.append(number)


def ended_from(*finds: list[Process], patience: float = 3600.0) -> int:
    """End what the searches find, the last of them again and again; returns how many searches that took."""
    searches = 0

    def search() -> list[Process]:
        nonlocal searches
        searches += 1
        return [each for each in finds[min(searches, len(finds)) - 1] if not each.ended()]

    end_all(search, patience)
    return searches


def test_each_process_gets_one_signal():
    one, other = Process(1, SIGTERM), Process(2, SIGTERM)
    # The second search finds none; so does that before SIGKILL.
    assert ended_from([one, other]) == 3
    assert one.got == other.got == [SIGTERM]


def test_sigkill_for_those_that_ignore_sigterm():
    stubborn = Process(1, SIGKILL)
    ended_from([stubborn], patience=0.01)
    assert stubborn.got == [SIGTERM, SIGKILL]


def test_processes_started_during_the_end_are_found():
    """Each of them starts the next one before it ends."""
    family = [Process(pid, SIGTERM) for pid in range(1, 6)]
    ended_from(*([each] for each in family), [])
    assert [each.got for each in family] == [[SIGTERM]] * 5


def test_a_number_that_is_used_again_is_another_process():
    first, second = Process(1, SIGTERM), Process(1, SIGTERM)
    ended_from([first], [second], [])
    assert first.got == second.got == [SIGTERM]


def test_processes_of_another_user_are_not_waited_for(monkeypatch):
    monkeypatch.setattr(processes, "_KILLED", 3600.0)
    foreign, own = Process(1, refused=True), Process(2, SIGTERM)
    ended_from([foreign, own])
    assert (foreign.got, own.got) == ([], [SIGTERM])
