"""Fuzz a sans-IO stack in this process: thousands of sequences a second, compared with the model after each step.

Time is virtual and no frame is lost, so every finding is reproducible. ``make`` builds the node, so that a mutant or
another node can be tested.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from typing import Any

from dcp_codec.codec import Codec
from dcp_codec.values import VarSumm
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.fuzz.steps import Call, Effect, Frame, Step, Wait
from dcp_conformance.oracle import Version
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node, reference_config

from .model_monitor import Observer
from .time_limit import TIME_LIMIT, TimeLimit, TimeLimitExceeded

#: ns in a millisecond.
_MS = 1_000_000
#: Beacon periods until a probe must be answered, after all other records of a full database.
_PATIENCE = 300
#: Node identifier of the sender of probes.
_PROBER = b"\x02\xdc\x91\x00\x00\x01"


def observer_of(config: Any) -> Observer:
    """Return a model of a node with this configuration."""
    profile, vardis = config.profile, config.vardis
    return Observer(
        config.codec,
        config.node_id,
        config.bp.beacon_period_ms * _MS,
        network=profile.bp.network_id,
        scrubbing=None if vardis is None else vardis.scrubbing_period_ms * _MS,
        room=profile.limits.max_vardis_payload,
    )


def difference(vardis: Any, certain: Iterable[tuple[int, Version]], own_id: bytes) -> str | None:
    """Return the first difference between a VarDis entity and the versions that a model is certain of, or None."""
    for var_id, version in certain:
        entry = vardis.entry(var_id)
        alive = entry is not None and not entry.is_deleted
        if alive != (version.state == "alive"):
            observed = "alive" if alive else "not alive"
            return f"variable {var_id} is {observed}, where the model has it {version.state}"
        if not alive:
            continue
        if entry.seqno != version.seqno or entry.value != version.value:
            held = f"number {entry.seqno} value {entry.value.hex()!r}"
            expected = f"number {version.seqno} value {version.value.hex()!r}"
            return f"variable {var_id} has {held}, where the model has {expected}"
        spec = version.spec
        if spec is not None and spec.prod_id != own_id and entry.spec != spec:
            return f"variable {var_id} has other attributes than the model"
    return None


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
        self._forge = FrameBuilder(codec)
        self._period = self.config.bp.beacon_period_ms * _MS
        self._network = codec.profile.bp.network_id
        self._most = codec.profile.limits.max_beacon_size
        # A queue contains each variable at most once.
        self._longest = min(1 << (8 * min(codec.profile.types.var_id.width, 2)), 4096)
        self.observer = self._observer()
        """The model of the last sequence."""
        self.frames = 0
        """Number of frames delivered in all sequences."""
        self._probes: dict[int, bytes] = {}
        """Encoded probes, by variable."""

    def _observer(self) -> Observer:
        return observer_of(self.config)

    def run(self, steps: list[Step]) -> Effect | None:
        """See :class:`~dcp_conformance.fuzz.steps.Target`."""
        self.observer = self._observer()
        self._number = 0
        at = -1
        try:
            with self._limit:
                self._sut = sut = _Watched(self.config, seed=self._seed, make=self._make)
                self._upper: VirtualUpperTester | None = None
                for at, step in enumerate(steps):
                    effect = self._step(step, at)
                    if effect is not None:
                        return effect
                return self._final(sut, at)
        except TimeLimitExceeded:
            return Effect("hang", f"no end after {self._limit.seconds:g} s of CPU time", max(at, 0))
        except Exception as error:
            # Raised outside of InProcess: while the node was made, or by a query of its deadline or state.
            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{type(error).__name__} in {last.name}"
            return Effect("raised", f"{type(error).__name__}: {error}", max(at, 0), place)

    def _step(self, step: Step, at: int) -> Effect | None:
        sut = self._sut
        touched: list[int] = []
        if type(step) is Frame:
            self._number += 1
            self.frames += 1
            # Earlier beacons of the node have been judged before the model receives the frame.
            touched = self.observer.hears(step.octets, sut.now, self._number)
            sut.deliver(step.octets)
        elif type(step) is Wait:
            return self._wait(step.periods, at)
        elif type(step) is Call:
            effect, touched = self._call(step, at)
            if effect is not None:
                return effect
        return self._died(at) or self._drained(at) or self._compare(touched, at)

    def _died(self, at: int) -> Effect | None:
        return Effect("raised", self._sut.died, at, self._sut.place) if self._sut.died else None

    def _drained(self, at: int) -> Effect | None:
        """Judge the beacons that the node has sent."""
        sut = self._sut
        while sut.arrivals:
            arrival = sut.arrivals.popleft()
            effect = self.observer.says(arrival.octets, self._most, arrival.time, self._number, at)
            if effect is not None:
                return effect
        return None

    def _wait(self, periods: float, at: int) -> Effect | None:
        sut = self._sut
        until = sut.now + round(periods * self._period)
        while True:
            sut.advance(until)
            effect = self._died(at) or self._drained(at)
            if effect is not None:
                return effect
            if sut.now >= until:
                return self._missing(at)

    def _missing(self, at: int) -> Effect | None:
        return self.observer.missing(self._sut.now, at, busy=self.observer.busy)

    def _compare(self, var_ids: list[int], at: int) -> Effect | None:
        """Compare these variables in the database of the node with the model."""
        certain = self.observer.certain(dict.fromkeys(var_ids), self._sut.now)
        different = difference(self._sut.node.vardis, certain, self.own_id) if certain else None
        return None if different is None else Effect("state", different, at)

    # -- services ----------------------------------------------------------------------------------------------

    def _call(self, step: Call, at: int) -> tuple[Effect | None, list[int]]:
        sut, oracle = self._sut, self.observer.oracle
        if self._upper is None:
            self._upper = VirtualUpperTester(sut, greet=False)
        try:
            answer = self._upper.call(step.method, step.params)
        except UpperTesterError:
            return self._died(at) or Effect("mute", f"no answer to {step.method}", at), []
        if answer.code == -32603:
            return Effect("raised", f"{step.method}: {answer.message}", at, f"{step.method}: internal error"), []
        var_id = step.params.get("varId")
        if type(var_id) is not int:
            return None, []
        expected = self.observer.expects(step.method, var_id)
        if answer.code is None and expected is not None and expected != answer.ok:
            what = "succeeds" if answer.ok else f"is refused with {answer.status}"
            return Effect("state", f"{step.method} of variable {var_id} {what}", at, f"{step.method} {what}"), []
        if not answer.ok:
            return None, []
        match step.method:
            case "RTDB-Create":
                entry = sut.node.vardis.entry(var_id)
                if entry is not None:
                    self.observer.created(entry.spec, bytes.fromhex(step.params["value"]), sut.now)
            case "RTDB-Update":
                oracle.updated(var_id, bytes.fromhex(step.params["value"]), sut.now)
            case "RTDB-Delete":
                oracle.deleted(var_id, sut.now)
            case "RTDB-Read":
                for _, version in self.observer.certain((var_id,), sut.now):
                    if answer.result["value"] != version.value.hex():
                        detail = f"variable {var_id} is read as {answer.result['value']}, not {version.value.hex()}"
                        return Effect("state", detail, at, "RTDB-Read"), []
        return None, [var_id]

    # -- after the last step -----------------------------------------------------------------------------------

    def _final(self, sut: InProcess, at: int) -> Effect | None:
        at = max(at, 0)
        held = self._compare(list(self.observer.oracle.variables), at)
        return held or self._unbounded(sut.node, at) or self._probed(sut, at) or self._missing(at)

    def _unbounded(self, node: Any, at: int) -> Effect | None:
        """Return the effect of a queue with more entries than there are variables, or None."""
        for name, length in node.vardis.queue_lengths().items():
            if length > self._longest:
                return Effect("unbounded", f"{name} has {length} entries", at, name)
        return None

    def _probed(self, sut: InProcess, at: int) -> Effect | None:
        """Send a summary of a variable that the node cannot know, and expect a request for it."""
        top = min(255, (1 << (8 * self.codec.profile.types.var_id.width)) - 1)
        known = self.observer.oracle.variables
        var_id = next((number for number in range(top, -1, -1) if number not in known), None)
        if var_id is None:
            return self._wait(2.0, at)
        octets = self._probes.get(var_id)
        if octets is None:
            octets = self._probes[var_id] = self._probe(var_id)
        self.observer.hears(octets, sut.now, self._number)
        sut.deliver(octets)
        until = sut.now + _PATIENCE * self._period
        while sut.now < until:
            sut.advance(until)
            effect = self._died(at)
            if effect is not None:
                return effect
            effect = self._drained(at)
            if effect is not None or var_id in self.observer.requested:
                return effect
        return Effect("mute", "VarDis does not answer a summary of a variable that it cannot know", at)

    def _probe(self, var_id: int) -> bytes:
        profile = self.codec.profile
        width = profile.types.node_id.width
        text = profile.types.node_id.representation == "text"
        return self._forge.beacon(
            _PROBER.hex(":").encode() if text else _PROBER[-width:].rjust(width, b"\2"),
            1,
            [self._forge.vardis(VarSumm(var_id, 1))],
            network_id=self._network if profile.has_header_field("networkId") else None,
        )


__all__ = ["StackTarget", "difference", "observer_of"]
