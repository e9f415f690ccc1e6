"""Fuzz a sans-IO stack in this process: does it crash, hang, fall silent or send invalid beacons?

Time is virtual and no frame is lost, so every finding is reproducible. ``make`` builds the node, so that a mutant or
another node can be tested. What a node must do is judged by ``fuzz model``.
"""

from __future__ import annotations

import traceback

from dcp_conformance.errors import UpperTesterError
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node, reference_config

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import VarReqCreate, VarSumm
from dcp_lab.fuzz.steps import Effect, Frame, Step, Wait

from .liveness import bad_beacon
from .time_limit import TIME_LIMIT, TimeLimit, TimeLimitExceeded

#: ns in a millisecond.
_MS = 1_000_000
#: Beacon periods until a probe must be answered, after all other records of a full database.
_PATIENCE = 300
#: Code of a JSON-RPC error of an upper tester that failed.
INTERNAL_ERROR = -32603
#: Node identifier of the sender of probes.
_PROBER = b"\x02\xdc\x91\x00\x00\x01"


class _Answered(Exception):  # noqa: N818 - the result of a search
    """The node has answered the probe."""


class _Watched(InProcess):
    """A node that stores where it raised an exception."""

    place = ""

    def fail(self, error: Exception) -> None:
        super().fail(error)
        last = traceback.extract_tb(error.__traceback__)[-1]
        self.place = f"{type(error).__name__} in {last.name}"


class StackTarget:
    """A target that makes a new node for each sequence."""

    def __init__(
        self,
        codec: Codec,
        *,
        make: MakeNode = plain_node,
        seed: int = 1,
        time_limit: float = TIME_LIMIT,
        name: str = "our own node in this process",
    ) -> None:
        """``time_limit``: maximum CPU time of one sequence in seconds; longer ones have the effect ``hang``."""
        self.name = name
        self.codec = codec
        self.config = reference_config(codec)
        self.own_id = self.config.node_id
        self._make = make
        self._seed = seed
        self._limit = TimeLimit(time_limit)
        self._builder = FrameBuilder(codec)
        self._period = self.config.bp.beacon_period_ms * _MS
        self._ids = range(min(256, 1 << (8 * codec.profile.types.var_id.width)))
        # A queue contains each variable at most once.
        self._longest = min(1 << (8 * min(codec.profile.types.var_id.width, 2)), 4096)
        self.frames = 0
        """Number of frames delivered in all sequences."""

    def run(self, steps: list[Step]) -> Effect | None:
        """See :class:`~dcp_lab.fuzz.steps.Target`."""
        at = -1
        try:
            with self._limit:
                sut = _Watched(self.config, seed=self._seed, make=self._make)
                upper = VirtualUpperTester(sut, greet=False)
                for at, step in enumerate(steps):
                    if effect := self._step(sut, upper, step, at) or self._seen(sut, at):
                        return effect
                at = max(at, 0)
                return self._unbounded(sut, at) or self._probed(sut, at)
        except TimeLimitExceeded:
            return Effect("hang", f"no end after {self._limit.seconds:g} s of CPU time", max(at, 0))
        except Exception as error:
            # Raised outside of InProcess: while the node was made, or by a query of its deadline or state.
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{type(error).__name__} in {last.name}"
            return Effect("raised", f"{type(error).__name__}: {error}", max(at, 0), place)

    def _step(self, sut: _Watched, upper: VirtualUpperTester, step: Step, at: int) -> Effect | None:
        if isinstance(step, Frame):
            self.frames += 1
            sut.deliver(step.octets)
        elif isinstance(step, Wait):
            return self._wait(sut, step.periods, at)
        else:
            try:
                answer = upper.call(step.method, step.params)
            except UpperTesterError:
                return self._seen(sut, at) or Effect("mute", f"no answer to {step.method}", at)
            if answer.code == INTERNAL_ERROR:
                return Effect("raised", f"{step.method}: {answer.message}", at, f"{step.method}: internal error")
        return None

    def _wait(self, sut: _Watched, periods: float, at: int) -> Effect | None:
        until = sut.now + round(periods * self._period)
        while sut.now < until:
            sut.advance(until)
            if effect := self._seen(sut, at):
                return effect
        return None

    def _seen(self, sut: _Watched, at: int, asked: int | None = None) -> Effect | None:
        """Return the effect if the node has raised an exception, or has sent an invalid beacon.

        ``asked``: a variable; :class:`_Answered` is raised if the node requests it.
        """
        if sut.died:
            return Effect("raised", sut.died, at, sut.place)
        most = self.codec.profile.limits.max_beacon_size
        while sut.arrivals:
            octets = sut.arrivals.popleft().octets
            if len(octets) > most:
                return Effect("bad-beacon", f"a beacon of {len(octets)} octets, where {most} are allowed", at)
            try:
                beacon = self.codec.decode(octets)
            except DecodeError as error:
                return bad_beacon(self.codec, octets, error.problem, at)
            if beacon.bp is not None and beacon.bp.sender_id != self.own_id:
                return Effect("bad-beacon", f"a beacon of {beacon.bp.sender_id.hex(':')}", at, "sender")
            if asked is not None and any(
                isinstance(record, VarReqCreate) and record.var_id == asked
                for payload in beacon.payloads
                for container in payload.vardis or ()
                for record in container.records
            ):
                raise _Answered
        return None

    # -- after the last step -----------------------------------------------------------------------------------

    def _unbounded(self, sut: InProcess, at: int) -> Effect | None:
        """Return the effect of a queue with more entries than there are variables, or None."""
        for name, length in sut.node.vardis.queue_lengths().items():
            if length > self._longest:
                return Effect("unbounded", f"{name} has {length} entries", at, name)
        return None

    def _probed(self, sut: _Watched, at: int) -> Effect | None:
        """Send a summary of a variable that the node does not have, and expect a request for it."""
        var_id = next((number for number in reversed(self._ids) if sut.node.vardis.entry(number) is None), None)
        if var_id is not None:
            sut.deliver(self._probe(var_id))
        until = sut.now + (2 if var_id is None else _PATIENCE) * self._period
        try:
            while sut.now < until:
                sut.advance(until)
                if effect := self._seen(sut, at, var_id):
                    return effect
        except _Answered:
            return None
        what = "VarDis does not answer a summary of a variable that it does not have"
        return None if var_id is None else Effect("mute", what, at)

    def _probe(self, var_id: int) -> bytes:
        profile = self.codec.profile
        return self._builder.beacon(
            profile.types.node_id.of(_PROBER),
            1,
            [self._builder.vardis(VarSumm(var_id, 1))],
            network_id=profile.bp.network_id if profile.has_header_field("networkId") else None,
        )
