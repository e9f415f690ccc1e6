"""Drives a node: waits for link, clients, positions and time, and does what the node says.

One thread. However much arrives, the timers of the node come first: they are looked at between any two frames, and
of clients some requests are answered in each turn.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, Protocol

from dcp_stack.config import MS
from dcp_stack.control.server import ControlServer
from dcp_stack.effects import Dropped, Effect, NeighbourExpired, NeighbourSeen, SendBeacon
from dcp_stack.links.base import Link, TimedLink
from dcp_stack.links.rotation import RotatingRecorder
from dcp_stack.neighbour_file import NeighbourFileWriter
from dcp_stack.node import Node
from dcp_stack.positions import PositionSource

from .channels import ControlSocket, StandardStreams
from .reactor import READ, Reactor

log = logging.getLogger(__name__)

PUBLISH_INTERVAL: Final = 20 * MS
"""Least time between two versions of the neighbour file, which costs microseconds for each neighbour."""
HEARTBEAT_INTERVAL: Final = 100 * MS
HOUSEKEEPING_INTERVAL: Final = 1000 * MS
HOLD: Final = 150 * MS
"""While the next beacon is at most this far away, frames, positions and housekeeping wait for it.

A wake-up costs more than a frame: without this a quiet node among three takes nearly twice the CPU time
(``benchmarks/quiet.py``, "no hold"). Nothing is lost: frames wait in the kernel with their time of arrival, and are
processed before the beacon is made and before a client is answered.
"""
FLOOD: Final = 64
"""At most this many frames that waited for a beacon are processed before it, however late it is. More at once are a
flood, after which frames do not wait for the next beacon."""
OBSTACLE_INTERVAL: Final = 10_000 * MS
"""Least time between two lines of the log about variables that do not get through."""
MOST_TOLD: Final = 100
"""Most lines about them while the process runs."""
_NEIGHBOURS: Final = (NeighbourSeen, NeighbourExpired)
#: Signals that end the node in an orderly way; hanging up is one of them, or a recording would be cut off.
SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


class Attachment(Protocol):
    """Something else that wants to be called back, such as the metrics server."""

    def attach(self, reactor: Reactor) -> None:
        """Begin."""
        ...

    def tick(self, now: int) -> None:
        """About a second has passed."""
        ...

    def close(self) -> None:
        """End."""
        ...


class Driver:
    """A node at work. It closes what it was given."""

    def __init__(
        self,
        node: Node,
        link: Link,
        *,
        recorder: RotatingRecorder | None = None,
        positions: PositionSource | None = None,
        neighbour_file: NeighbourFileWriter | None = None,
        attachments: tuple[Attachment, ...] = (),
    ) -> None:
        self.node = node
        self.link = link
        self.server = ControlServer(node, runtime=self.describe)
        self.started = time.monotonic_ns()
        self.late_ns = 0
        """The latest that a timer was looked at, since the start."""
        self.reactor = Reactor()
        self._recorder = recorder
        self._positions = positions
        self._neighbour_file = neighbour_file
        self._attachments = attachments
        self._controls: list[ControlSocket | StandardStreams] = []
        self._stopping = False
        self._wake: int | None = None
        self._arrived = self.started
        self._holding = self._flooded = False
        # Only links without a descriptor have to be asked; whether this is one is too slow to find out each time.
        self._timed = link if link.fileno() < 0 and isinstance(link, TimedLink) else None
        self._housekeeping = self.started + HOUSEKEEPING_INTERVAL
        self._dirty = True
        self._published = self._heartbeat = 0
        self._bad_samples = 0
        self._told: set[tuple[str, int, str]] = set()
        self._obstacles_told = self.started - OBSTACLE_INTERVAL

    def add_control(self, control: ControlSocket | StandardStreams) -> None:
        """Let clients in by this."""
        self._controls.append(control)
        control.attach(self.server, self.reactor)

    def stop(self) -> None:
        """Let :meth:`run` return soon; from a callback or a signal handler."""
        self._stopping = True

    def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Start the node and drive it until :meth:`stop` or a signal; then let it deregister and close everything."""
        with contextlib.ExitStack() as cleanup:
            cleanup.callback(self._close)
            cleanup.enter_context(_signals(self.stop, self.reactor))
            self.node.start(*_times())
            if self._positions is not None:
                self._poll_positions()
            for attachment in self._attachments:
                attachment.attach(self.reactor)
            self._after_turn(*_times())
            on_ready()
            while not self._stopping:
                self._turn()
            now, wall = _times()
            self.node.shutdown(now, wall)
            self._after_turn(now, wall)

    # -- one turn -------------------------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Wait until a descriptor is ready or a deadline has come, and do all that is to be done then."""
        self.reactor.wait(self._patience())
        now = time.monotonic_ns()
        if self._holding or (self._timed is not None and _reached(self._timed.poll_timeout(), now)):
            self._on_link()
            now = time.monotonic_ns()
        # Positions before the beacon: the newest goes into it.
        if self._positions is not None and _reached(self._positions.poll_timeout(), now):
            self._poll_positions()
        if _reached(self._wake, now):
            self._timeout(now, time.time_ns())
        if now >= self._housekeeping:
            self._housekeep(now)
        self._after_turn(*_times())

    def _patience(self) -> float:
        """How long to wait in s."""
        if self._busy():
            return 0
        deadlines = [self._wake]
        if not self._holding:
            deadlines.append(self._housekeeping)
            deadlines += [each.poll_timeout() for each in (self._positions, self._timed) if each is not None]
        if self._neighbour_file is not None:
            deadlines.append(
                self._published + PUBLISH_INTERVAL if self._dirty else self._heartbeat + HEARTBEAT_INTERVAL
            )
        due = min(deadline for deadline in deadlines if deadline is not None)
        return max(due - time.monotonic_ns(), 0) / 1e9

    def _busy(self) -> bool:
        """Whether a client is to be answered."""
        for control in self._controls:
            for channel in control.channels:
                if channel.busy:
                    return True
        return False

    def _after_turn(self, now: int, wall: int) -> None:
        """Answer clients, do what the node wants done, and plan the next turn."""
        self._serve(now, wall)
        effects = self.node.take_effects()
        if effects:
            self._carry_out(effects, now, wall)
            self._serve(now, wall)
        self._plan()
        if self._neighbour_file is not None:
            self._write_neighbours(self._neighbour_file, now, wall)

    def _serve(self, now: int, wall: int) -> None:
        """Answer clients and send them what there is."""
        self.server.pressing = False
        for control in self._controls:
            for channel in control.channels:
                if channel.busy or channel.session.output:
                    channel.advance(now, wall)

    def _on_link(self, _events: int = 0) -> None:
        """Take what has arrived, and keep the node's time while doing so."""
        # Frames that waited for a beacon belong before it, and the beacon can wait for them a little.
        before_it = FLOOD if self._holding else 0
        node = self.node
        receptions = self.link.receive()
        self._flooded = len(receptions) > FLOOD
        # Between the two clocks: frames carry the time of day at which the kernel received them.
        offset = time.time_ns() - time.monotonic_ns()
        for number, reception in enumerate(receptions):
            now = time.monotonic_ns()
            if number >= before_it and _reached(self._wake, now):
                self._timeout(now, time.time_ns())
            # Soft state is as old as its frame, also if that waited in the kernel. From frame to frame time goes
            # forward, whatever the clocks do.
            arrived = self._arrived = min(max(reception.wall - offset, self._arrived), now)
            node.handle_frame(reception.octets, now=arrived, wall=reception.wall)
            effects = node.take_effects()
            if effects:
                self._carry_out(effects, now, reception.wall)
                if self.server.pressing:
                    self._serve(now, time.time_ns())

    def _timeout(self, now: int, wall: int) -> None:
        if self._wake is not None:
            self.late_ns = max(self.late_ns, now - self._wake)
        self.node.handle_timeout(now, wall)
        self._carry_out(self.node.take_effects(), now, wall)
        self._wake = self.node.poll_timeout()

    def _plan(self) -> None:
        """When to wake next, and whether frames can wait until then."""
        self._wake = self.node.poll_timeout()
        beacon = self.node.bp.poll_timeout()
        self._holding = (
            beacon is not None
            and beacon - time.monotonic_ns() <= HOLD
            and not self._flooded
            and self._neighbour_file is None
            and not self.server.listening
        )
        if self.link.fileno() >= 0:
            self.reactor.watch(self.link.fileno(), 0 if self._holding else READ, self._on_link)

    def _carry_out(self, effects: list[Effect], now: int, wall: int) -> None:
        for effect in effects:
            if type(effect) is Dropped:
                # Most of what there is.
                continue
            if isinstance(effect, SendBeacon):
                self.link.send(effect.octets)
            elif isinstance(effect, _NEIGHBOURS):
                self._dirty = True
        self.server.indicate(effects, now=now, wall=wall)

    # -- beside the protocol --------------------------------------------------------------------------------------

    def _poll_positions(self, _events: int = 0) -> None:
        """Hand down what the position source has, the newest only: SRP sends no other."""
        source, srp = self._positions, self.node.srp
        if source is None or srp is None:
            return
        fd = source.fileno()
        now, wall = _times()
        samples = source.poll(now, wall)
        for complaint in source.take_complaints():
            log.warning("%s", complaint)
        if samples:
            try:
                srp.update_safety_data(samples[-1], now=now, wall=wall)
            except ValueError as error:
                self._bad_samples += 1
                if self._bad_samples == 1:
                    log.warning("position source %s: %s", source.name, error)
            self.node.settle(now, wall)
        if fd >= 0 and fd != source.fileno():
            self.reactor.forget(fd)
        if source.fileno() >= 0:
            self.reactor.watch(source.fileno(), READ, self._poll_positions)

    def _write_neighbours(self, file: NeighbourFileWriter, now: int, wall: int) -> None:
        srp = self.node.srp
        if srp is None or not srp.registered:
            self._dirty = False
        if self._dirty and srp is not None and now - self._published >= PUBLISH_INTERVAL:
            file.publish(srp.neighbours, now=now, wall=wall)
            self._dirty = False
            self._published = self._heartbeat = now
        elif now - self._heartbeat >= HEARTBEAT_INTERVAL:
            file.heartbeat(now=now, wall=wall)
            self._heartbeat = now
            # An entry may also have gone with a reset, which has no effect to tell of.
            self._dirty = True

    def _housekeep(self, now: int) -> None:
        self._housekeeping = now + HOUSEKEEPING_INTERVAL
        if self._recorder is not None:
            self._recorder.tick()
        self._tell_obstacles(now)
        for attachment in self._attachments:
            attachment.tick(now)
        for control in self._controls:
            for channel in control.channels:
                if channel.stalled_since is not None:
                    channel.busy = True

    def _tell_obstacles(self, now: int) -> None:
        """Log what does not get through: each kind and variable once, and at most one line in a while."""
        if self.node.vardis is None or now < self._obstacles_told + OBSTACLE_INTERVAL:
            return
        for obstacle in self.node.vardis.obstacles(now):
            key = (obstacle.kind, obstacle.var_id, obstacle.peer)
            if key not in self._told and len(self._told) < MOST_TOLD:
                self._told.add(key)
                self._obstacles_told = now
                log.warning("%s", obstacle)
                return

    def describe(self) -> dict[str, Any]:
        """What is around the node, as plain data."""
        counters = self.link.counters
        shown: dict[str, Any] = {
            "uptime_ms": (time.monotonic_ns() - self.started) // MS,
            "cpu_ms": time.process_time_ns() // MS,
            "pid": os.getpid(),
            "link": {
                "name": self.link.name,
                "up": self.link.up,
                "max_packet_size": self.link.max_packet_size,
                **{name: getattr(counters, name) for name in counters.__struct_fields__},
            },
            "timer_late_ms": self.late_ns / MS,
        }
        if self._recorder is not None:
            recorder = self._recorder
            shown["recording"] = {
                "path": str(recorder.path),
                "frames": recorder.frames,
                "recording": recorder.recording,
                "problem": recorder.problem,
                "interruptions": recorder.interruptions,
                "frames_lost": recorder.frames_lost,
            }
        if self._positions is not None:
            source = self._positions
            shown["positions"] = {
                "source": source.name,
                "finished": source.finished,
                "complaints": {**source.counts, "refused": self._bad_samples},
            }
        return shown

    def _close(self) -> None:
        """Close everything, whatever fails of it."""
        with contextlib.ExitStack() as closing:
            closing.callback(self.reactor.close)
            closing.callback(self.link.close)
            if self._recorder is not None:
                closing.callback(self._recorder.close)
            for each in (self._positions, self._neighbour_file, *self._attachments, *self._controls):
                if each is not None:
                    closing.callback(each.close)


@contextlib.contextmanager
def _signals(stop: Callable[[], None], reactor: Reactor) -> Iterator[None]:
    """End on a signal. A descriptor wakes the reactor, since Python goes on waiting after a handler has run."""
    reader, writer = os.pipe()
    for fd in (reader, writer):
        os.set_blocking(fd, False)
    try:
        woken_before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    except ValueError:
        # Not the main thread (a test): signals are somebody else's.
        os.close(reader)
        os.close(writer)
        yield
        return

    def on_signal(number: int, _frame: object) -> None:
        log.info("%s: shutting down", signal.Signals(number).name)
        stop()
        # Whoever is impatient may interrupt the shutdown.
        signal.signal(number, signal.SIG_DFL)

    # What was set to be ignored stays ignored: nohup does so with SIGHUP.
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in before.items():
        if handler != signal.SIG_IGN:
            signal.signal(number, on_signal)

    def on_wakeup(_events: int) -> None:
        os.read(reader, 64)

    reactor.watch(reader, READ, on_wakeup)
    try:
        yield
    finally:
        reactor.forget(reader)
        signal.set_wakeup_fd(woken_before)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(reader)
        os.close(writer)


def _reached(deadline: int | None, now: int) -> bool:
    return deadline is not None and now >= deadline


def _times() -> tuple[int, int]:
    return time.monotonic_ns(), time.time_ns()
