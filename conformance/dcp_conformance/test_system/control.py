"""Control of the implementation's process and link in a case."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, Protocol

from dcp_conformance.errors import ConformanceError, CouldNotAskError

from .judgement.verdicts import Verdicts
from .probes import Probes
from .reception.receiver import Receiver
from .reception.waiting import Waiting
from .services.changes import Changes
from .steps import Clock, Steps
from .sut_properties import SutProperties
from .traffic import Traffic

#: Number of probes after a restart.
_PROBES: Final = 5


class RunControl(Protocol):
    """The means of a run to control the implementation."""

    restart: Callable[[], None] | None
    switch_link: Callable[[bool], None] | None
    beside: bool

    def forget(self) -> None:
        """Record that the implementation is in its initial state."""
        ...

    def interrupted(self) -> None:
        """Record that the sequence of beacons was interrupted."""
        ...


@dataclass(eq=False)
class Control:
    """Restarts the implementation, and takes its link down, for cases whose needs say ``restart`` or ``link``."""

    _run: RunControl
    _clock: Clock
    _traffic: Traffic
    _steps: Steps
    _sut: SutProperties
    _verdicts: Verdicts
    _changes: Changes
    _receiver: Receiver
    _waiting: Waiting
    _probes: Probes

    def restart(self) -> None:
        """Restart the implementation and wait until it answers; inconclusive if that fails."""
        if self._run.restart is None:
            self._verdicts.inconclusive("a restart of the implementation", "no command to restart it")
        self._traffic.note("note", self._clock.wall(), "restart of the implementation")
        self._run.restart()
        self._changes.forget()
        self._run.forget()
        self._steps.forget()
        if self._sut.pics.vardis is False:
            # Without VarDis no beacon is answered.
            self._waiting.wait(self._sut.reaction)
            return
        for _ in range(_PROBES):
            if self._probes.probe(self._sut.reaction):
                return
            self._receiver.take_newcomer()
        self._verdicts.inconclusive("an answer of the implementation after its restart", "no answer to five probes")

    def needs_whole_beacons(self) -> None:
        """Refuse to continue beside other cases, whose payloads take room: the stimulus would not come about.

        Raise ``CouldNotAskError``, after which the case is executed alone.
        """
        if self._run.beside:
            raise CouldNotAskError("other cases are executed at the same time, and take room in the beacons")

    @contextmanager
    def link_down(self) -> Iterator[None]:
        """Take the implementation's link down within the block.

        Stops as inconclusive if the tester cannot do that. The link is up again however the block ends.
        """
        self._switch_link(False)
        try:
            yield
        finally:
            self._switch_link(True)

    def _switch_link(self, up: bool) -> None:
        how = "up" if up else "down"
        self._traffic.note("note", self._clock.wall(), f"the implementation's link is taken {how}")
        try:
            if self._run.switch_link is None:
                raise ConformanceError("no commands for it (pixit.link_down, pixit.link_up)")
            self._run.switch_link(up)
        except ConformanceError as error:
            self._verdicts.inconclusive(f"the implementation's link is taken {how}", str(error))
        self._run.interrupted()
