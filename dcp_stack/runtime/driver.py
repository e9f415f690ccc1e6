"""The main loop of a node: wait for frames, clients, positions and deadlines, and carry out the node's effects.

Everything runs in one thread. Timers of the node have priority over input: they are checked between any two frames,
and each turn answers a limited number of client requests.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import msgspec

from dcp_stack.config import MS
from dcp_stack.control.server import ControlServer
from dcp_stack.effects import Dropped, Effect, NeighbourExpired, NeighbourSeen, SendBeacon
from dcp_stack.links.base import Link, TimedLink
from dcp_stack.links.rotation import RotatingRecorder
from dcp_stack.neighbour_file import NeighbourFileWriter
from dcp_stack.node import Node
from dcp_stack.positions.base import PositionSource

from .channels import Listener, StandardStreams
from .reactor import READ, Reactor

log = logging.getLogger(__name__)

PUBLISH_INTERVAL: Final = 20 * MS
"""Minimum ns between two versions of the neighbour file, which costs microseconds for each neighbour."""
HEARTBEAT_INTERVAL: Final = 100 * MS
HOUSEKEEPING_INTERVAL: Final = 1000 * MS
HOLD: Final = 150 * MS
"""ns before a beacon from which on frames, positions and housekeeping wait for it.

A wake-up costs more than a frame: without this a quiet node among three takes nearly twice the CPU time
(``benchmarks/quiet.py``, "no hold"). Nothing is lost: frames wait in the kernel with their time of arrival. They are
processed before the beacon is built and before a client is answered.
"""
FLOOD: Final = 64
"""Maximum number of waiting frames that are processed before an overdue beacon. If more arrive at once it is a
flood, after which frames do not wait for the next beacon."""
OBSTACLE_INTERVAL: Final = 10_000 * MS
"""Minimum ns between two log lines about obstacles: variables that do not reach a neighbour."""
MOST_TOLD: Final = 100
"""Maximum number of such lines while the process runs."""
_NEIGHBOURS: Final = (NeighbourSeen, NeighbourExpired)
#: Signals that end the node in an orderly way. SIGHUP is one of them, because otherwise a recording would be truncated.
SIGNALS: Final = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


class Driver:
    """A running node with its surroundings. It closes all objects that are passed to its constructor."""

    def __init__(
        self,
        node: Node,
        link: Link,
        *,
        recorder: RotatingRecorder | None = None,
        positions: PositionSource | None = None,
        neighbour_file: NeighbourFileWriter | None = None,
    ) -> None:
        """``recorder``: records the frames that the link receives and sends."""
        self.node = node
        self.link = link
        self.server = ControlServer(node, runtime=self.describe)
        self.started = time.monotonic_ns()
        self.late_ns = 0
        """The greatest delay of a timer of the node since the start, in ns."""
        self.reactor = Reactor()
        self._recorder = recorder
        self._positions = positions
        self._neighbour_file = neighbour_file
        self._controls: list[Listener | StandardStreams] = []
        self._stopping = False
        self._wake: int | None = None
        self._arrived = self.started
        self._holding = self._flooded = False
        # Only links without a descriptor have to be polled. The check is too slow for each turn.
        self._timed = link if link.fileno() < 0 and isinstance(link, TimedLink) else None
        self._housekeeping = self.started + HOUSEKEEPING_INTERVAL
        self._dirty = True
        self._published = self._heartbeat = 0
        self._bad_samples = 0
        self._told: set[tuple[str, int, str]] = set()
        self._obstacles_told = self.started - OBSTACLE_INTERVAL

    def add_control(self, control: Listener | StandardStreams) -> None:
        """Accept clients from ``control``, and close it at the end."""
        self._controls.append(control)
        control.attach(self.server, self.reactor)

    def stop(self) -> None:
        """Let :meth:`run` return soon; may be called from a callback or a signal handler."""
        self._stopping = True

    def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Start the node and run it until :meth:`stop` or a signal; then deregister its protocols and close everything.

        ``on_ready`` is called once the node has started.
        """
        with contextlib.ExitStack() as cleanup:
            cleanup.callback(self._close)
            cleanup.enter_context(_signals(self.stop, self.reactor))
            self.node.start(*_times())
            if self._positions is not None:
                self._poll_positions()
            self._after_turn(*_times())
            on_ready()
            while not self._stopping:
                self._turn()
            now, wall = _times()
            self.node.shutdown(now, wall)
            self._after_turn(now, wall)

    # -- one turn -------------------------------------------------------------------------------------------------

    def _turn(self) -> None:
        """Wait for a ready descriptor or the next deadline, and process both."""
        self.reactor.wait(self._patience())
        now = time.monotonic_ns()
        if self._holding or (self._timed is not None and _reached(self._timed.poll_timeout(), now)):
            self._on_link()
            now = time.monotonic_ns()
        # Positions are read before the beacon is built, so that it contains the newest.
        if self._positions is not None and _reached(self._positions.poll_timeout(), now):
            self._poll_positions()
        if _reached(self._wake, now):
            self._timeout(now, time.time_ns())
        if now >= self._housekeeping:
            self._housekeep(now)
        self._after_turn(*_times())

    def _patience(self) -> float:
        """Return how long to wait for descriptors, in s."""
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
        """Whether a client has requests to be answered now."""
        for control in self._controls:
            for channel in control.channels:
                if channel.busy:
                    return True
        return False

    def _after_turn(self, now: int, wall: int) -> None:
        """Answer clients, carry out the effects of the node, and plan the next turn."""
        self._serve(now, wall)
        effects = self.node.take_effects()
        if effects:
            self._carry_out(effects, now, wall)
            self._serve(now, wall)
        self._plan()
        if self._neighbour_file is not None:
            self._write_neighbours(self._neighbour_file, now, wall)

    def _serve(self, now: int, wall: int) -> None:
        """Answer clients and send their pending output."""
        self.server.pressing = False
        for control in self._controls:
            for channel in control.channels:
                if channel.busy or channel.session.output:
                    channel.advance(now, wall)

    def _on_link(self, _events: int = 0) -> None:
        """Process the frames that have arrived, and serve the timers of the node between them."""
        # Frames that waited for the beacon are processed before it; a small delay of the beacon does not matter.
        before_it = FLOOD if self._holding else 0
        node = self.node
        receptions = self.link.receive()
        self._flooded = len(receptions) > FLOOD
        if self._recorder is not None:
            for each in receptions:
                self._recorder.saw(each.octets, each.wall, outgoing=False, source=each.source)
        # Difference of the clocks: the kernel stamps frames with wall time.
        offset = time.time_ns() - time.monotonic_ns()
        for number, reception in enumerate(receptions):
            now = time.monotonic_ns()
            if number >= before_it and _reached(self._wake, now):
                self._timeout(now, time.time_ns())
            # The age of soft state counts from the arrival of its frame, even if that waited in the kernel. The time
            # never decreases from frame to frame, even if the wall clock is set.
            arrived = self._arrived = min(max(reception.wall - offset, self._arrived), now)
            node.handle_frame(reception.octets, now=arrived, wall=reception.wall)
            effects = node.take_effects()
            if effects:
                self._carry_out(effects, now, reception.wall)
                if self.server.pressing:
                    self._serve(now, time.time_ns())

    def _timeout(self, now: int, wall: int) -> None:
        """Serve the timers of the node, and note how late they are."""
        if self._wake is not None:
            self.late_ns = max(self.late_ns, now - self._wake)
        self.node.handle_timeout(now, wall)
        self._carry_out(self.node.take_effects(), now, wall)
        self._wake = self.node.poll_timeout()

    def _plan(self) -> None:
        """Set the next deadline, and determine whether frames can wait until then."""
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
        """Send beacons, note changes of neighbours, and pass the effects to the clients."""
        for effect in effects:
            if type(effect) is Dropped:
                # Checked first: by far the most frequent effect.
                continue
            if isinstance(effect, SendBeacon):
                self._send(effect.octets)
            elif isinstance(effect, _NEIGHBOURS):
                self._dirty = True
        self.server.indicate(effects, now=now, wall=wall)

    def _send(self, octets: bytes) -> None:
        """Send a beacon, and record it if it was sent."""
        # Taken before sending: in the recording an answer must not be older than the frame it answers.
        wall = time.time_ns()
        if self.link.send(octets) and self._recorder is not None:
            self._recorder.saw(octets, wall, outgoing=True, source=self.link.source)

    # -- surroundings ---------------------------------------------------------------------------------------------

    def _poll_positions(self, _events: int = 0) -> None:
        """Pass the newest position of the source to SRP; older ones would not be sent anyway."""
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
        """Publish the neighbour table if it has changed and it is time, otherwise write heartbeats."""
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
            # A reset removes entries without an effect, so publish at each heartbeat.
            self._dirty = True

    def _housekeep(self, now: int) -> None:
        """Do the work of each second: recording, obstacles, slow clients."""
        self._housekeeping = now + HOUSEKEEPING_INTERVAL
        if self._recorder is not None:
            self._recorder.tick()
        self._log_obstacles(now)
        for control in self._controls:
            for channel in control.channels:
                channel.busy = True

    def _log_obstacles(self, now: int) -> None:
        """Log obstacles: each kind, variable and neighbour once, at most one line per ``OBSTACLE_INTERVAL``."""
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
        """Return the state of link, recording and position source as JSON data, for the method ``status``."""
        shown: dict[str, Any] = {
            "uptime_ms": (time.monotonic_ns() - self.started) // MS,
            "cpu_ms": time.process_time_ns() // MS,
            "pid": os.getpid(),
            "link": {
                "name": self.link.name,
                "up": self.link.up,
                "max_packet_size": self.link.max_packet_size,
                **msgspec.structs.asdict(self.link.counters),
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
        """Close everything, even if closing one part fails."""
        with contextlib.ExitStack() as closing:
            closing.callback(self.reactor.close)
            closing.callback(self.link.close)
            for each in (self._recorder, self._positions, self._neighbour_file, *self._controls):
                if each is not None:
                    closing.callback(each.close)


@contextlib.contextmanager
def _signals(stop: Callable[[], None], reactor: Reactor) -> Iterator[None]:
    """Call ``stop`` on a signal. A pipe wakes the reactor: Python resumes its wait after a signal handler."""
    reader, writer = os.pipe()
    for fd in (reader, writer):
        os.set_blocking(fd, False)
    try:
        woken_before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    except ValueError:
        # Not in the main thread (a test): handlers cannot be set.
        os.close(reader)
        os.close(writer)
        yield
        return

    def on_signal(number: int, _frame: object) -> None:
        log.info("%s: shutting down", signal.Signals(number).name)
        stop()
        # A second signal ends the process at once.
        signal.signal(number, signal.SIG_DFL)

    # Ignored signals stay ignored: nohup relies on it for SIGHUP.
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
