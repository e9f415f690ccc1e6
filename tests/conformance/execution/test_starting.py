"""Waiting for a started implementation: duration, messages to the user, and silence that is excused."""

from __future__ import annotations

import contextlib
import os
import socket

import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import NoListenerError
from dcp_conformance.execution import target
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.survival.life import READY_PATIENCE, SILENT, START_PATIENCE, Life
from dcp_conformance.execution.target import TargetOptions
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.sut.process import has_link_socket
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import opening

from ..rig import codec_of, known_cases

NEVER = 10_000.0


class Starting(InProcess):
    """Hears nothing until some seconds after its start; its sockets can be seen from ``opens`` s on."""

    def __init__(self, hears_after: float, opens: float = NEVER) -> None:
        super().__init__(reference_config(codec_of("dcp-2.0")))
        self._begun = self.now
        self._hears_after, self._opens = hears_after, opens

    @property
    def passed(self) -> float:
        """Seconds since it was started."""
        return (self.now - self._begun) / 1e9

    def deliver(self, octets: bytes) -> None:
        if self.passed >= self._hears_after:
            super().deliver(octets)

    def on_link(self) -> bool:
        return self.passed >= self._opens


def started(sut: Starting, timeout: float | None = None) -> tuple[str, list[str]]:
    """Return why waiting has ended (empty: the implementation answers), and the messages to the user."""
    said: list[str] = []
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), None, Pics())
    return Life(session, sut, timeout).await_start(known_cases()[SANITY], said.append), said


def test_an_implementation_that_answers_at_once_is_not_waited_for():
    sut = Starting(0, 0)
    assert started(sut) == ("", [])
    assert sut.passed < 1


def test_the_reason_for_waiting_is_reported():
    sut = Starting(NEVER)
    why, [said] = started(sut)
    assert why == f"does not answer within {START_PATIENCE:g} s"
    assert START_PATIENCE <= sut.passed < START_PATIENCE + 2
    assert said == (
        "waiting for the implementation to start: its process runs, nothing heard on in process; "
        "at most 26 s more (access.start_timeout)"
    )


@pytest.mark.parametrize("opens", [0.0, 10.0])
def test_an_implementation_that_opened_the_link_counts_as_started(opens: float):
    sut = Starting(NEVER, opens)
    why, [said] = started(sut)
    assert "does not answer, though it opened the link" in why
    assert opens + READY_PATIENCE <= sut.passed < opens + READY_PATIENCE + 2
    assert ("it has opened the link" in said) == (opens < SILENT)


@pytest.mark.parametrize("timeout", [5.0, 60.0])
def test_the_timeout_of_the_user_is_used(timeout: float):
    sut = Starting(NEVER, 0)
    assert started(sut, timeout)[0] == f"does not answer within {timeout:g} s"
    assert timeout <= sut.passed < timeout + 2


def test_an_implementation_that_starts_slowly_is_waited_for():
    sut = Starting(20)
    assert started(sut)[0] == ""
    assert 20 <= sut.passed < 22
    sut = Starting(50, 0)
    assert started(sut, 60)[0] == ""


def test_a_dead_implementation_is_not_waited_for():
    sut = Starting(NEVER)
    sut.died = "RuntimeError: a word"
    assert started(sut) == ("is dead again: RuntimeError: a word", [])
    assert sut.passed < 2


# -- sockets -----------------------------------------------------------------------------------------------------------


def test_a_socket_on_the_port_of_the_link_is_seen():
    here = os.getpid()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        port = made.getsockname()[1]
        assert has_link_socket(here, port)
    assert not has_link_socket(here, port)
    assert not has_link_socket(0, port)


def test_a_packet_socket_is_seen():
    here = os.getpid()
    assert not has_link_socket(here, None)
    try:
        made = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    except PermissionError:
        pytest.skip("packet sockets need CAP_NET_RAW")
    with made:
        assert has_link_socket(here, None)


# -- the sanity case ---------------------------------------------------------------------------------------------------


def sanity(sut: InProcess) -> tuple[Check, ...]:
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), None, Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return runner.run(known_cases()[SANITY]).checks


def test_starting_during_the_sanity_case_is_not_silence():
    """The first summaries were sent before it was there, and the VarCreates after them are answered."""
    # The measurement gets no answer for 5 s; three questions of 8 periods follow.
    for after in (5.5, 7.0, 7.6, 8.0):
        [check] = sanity(Starting(after))
        assert check.verdict is Verdict.PASS, (after, check.observed)


class Alive:
    """A started process that runs."""

    def alive(self) -> bool:
        return True


@pytest.mark.parametrize(("timeout", "opened"), [(60.0, True), (1e-9, False)])
def test_the_upper_tester_of_a_started_implementation_is_waited_for_as_long_as_a_start_may_take(
    monkeypatch: pytest.MonkeyPatch, timeout: float, opened: bool
):
    """It is not opened within the timeout of a call."""
    attempts = iter([NoListenerError("no such socket"), NoListenerError("no such socket"), "the upper tester"])

    def open_upper(*_: object, **__: object) -> object:
        if isinstance(found := next(attempts), Exception):
            raise found
        return found

    monkeypatch.setattr(opening, "open_upper", open_upper)
    options = TargetOptions(link="udp", start="node", start_timeout=timeout)
    with contextlib.nullcontext() if opened else pytest.raises(NoListenerError):
        assert target._open_upper(options, "unix:/tmp/n", Pics(), Alive()) == "the upper tester"


@pytest.mark.parametrize(("seconds", "connected"), [(60.0, True), (1e-9, False)])
def test_the_upper_tester_is_waited_for_as_long_as_a_start_may_take_after_each_restart(seconds: float, connected: bool):
    attempts = iter([NoListenerError("no such socket"), NoListenerError("cannot be reached"), None])

    def reconnect() -> None:
        if (found := next(attempts)) is not None:
            raise found

    with contextlib.nullcontext() if connected else pytest.raises(NoListenerError):
        target._connected(Alive(), seconds, reconnect)
    assert (next(attempts, "none left") == "none left") is connected
