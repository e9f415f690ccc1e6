"""Steps of behaviour vectors: what the cases of the suite send and call, recorded on the reference node."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

from dcp_conformance.definitions.case import Case
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import Answer
from dcp_conformance.vectors.behaviour import Step

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import VarCreate
from dcp_selftest.runner import cases

MS: Final = 1_000_000
#: Milliseconds before the first step, between a frame and a service, and after the last step.
_BEFORE: Final = 300
_SETTLE: Final = 300
_AFTER: Final = 1500
#: Longest vector, in milliseconds, in steps, and in octets of its frames.
_LONGEST: Final = 40_000
_STEPS: Final = 60
_OCTETS: Final = 12_000
#: Maximum number of variables whose state is queried at the end.
_VARIABLES: Final = 4
_QUERIES: Final = ("-Read", "-Describe", "-Query", "-List", "-Get", "-NeighbourTable")


class Stimulus(NamedTuple):
    """A frame to the node or a service call, at a time in ns."""

    time: int
    octets: bytes = b""
    method: str = ""
    params: dict[str, Any] | None = None


class _Recorder(InProcess):
    """The reference node, with a list of everything that it gets."""

    log: list[Stimulus]

    def deliver(self, octets: bytes) -> None:
        """Deliver a frame, and note it."""
        self.log.append(Stimulus(self.now, octets))
        super().deliver(octets)

    def restart(self) -> None:
        """Restart, and forget what was before."""
        self.log.clear()
        super().restart()

    def upper_tester(self) -> VirtualUpperTester:
        """Return a recorded connection."""
        return _Upper(self)


class _Upper(VirtualUpperTester):
    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a method, and note it."""
        sut = self._sut
        assert isinstance(sut, _Recorder)
        if method == "UT-Reset":
            sut.log.clear()
        elif not method.startswith("UT-"):
            sut.log.append(Stimulus(sut.now, b"", method, params))
        return super().call(method, params)

    def another(self) -> VirtualUpperTester:
        """Return another recorded connection."""
        return _Upper(self._sut)


def recorded(codec: Codec) -> Iterator[tuple[Case, list[Stimulus]]]:
    """Yield the stimuli of each case that the reference node passes."""
    sut = _Recorder.__new__(_Recorder)
    sut.log = []
    InProcess.__init__(sut, reference_config(codec))
    runner = Runner(Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut)
    runner.prepare()
    for case in cases():
        if case.long:
            continue
        sut.log.clear()
        result = runner.run(case)
        if result.verdict in (Verdict.PASS, Verdict.INFO) and sut.log:
            yield case, list(sut.log)


def steps_of(codec: Codec, stimuli: Sequence[Stimulus]) -> tuple[list[Step], int] | None:
    """Return the steps of a vector and its end in ms; None if there are too many, or they take too long."""
    steps: list[Step] = []
    shift, frame = _BEFORE, -_SETTLE
    began = stimuli[0].time
    for place, each in enumerate(stimuli):
        if _polled(stimuli, place):
            continue
        at = (each.time - began) // MS + shift
        if each.octets:
            steps.append(Step(at, receive=each.octets.hex()))
            frame = at
        else:
            late = max(0, frame + _SETTLE - at)
            shift, at = shift + late, at + late
            steps.append(Step(at, call=each.method, params=each.params or {}))
    at = steps[-1].at + _SETTLE
    looks = list(_looks(codec, stimuli))
    steps += [Step(at, call=method, params=params) for method, params in looks]
    end = at + _AFTER
    steps += [Step(end - 100, call=method, params=params) for method, params in looks]
    octets = sum(len(each.octets) for each in stimuli)
    return (steps, end) if end <= _LONGEST and len(steps) <= _STEPS and octets <= _OCTETS else None


def is_query(method: str) -> bool:
    """Return whether a service only shows a state."""
    return any(name in method for name in _QUERIES)


def _polled(stimuli: Sequence[Stimulus], place: int) -> bool:
    """Return whether the stimuli before and after a query are the same query."""
    each = stimuli[place]
    if each.octets or not is_query(each.method) or not 0 < place < len(stimuli) - 1:
        return False
    return all((other.method, other.params) == (each.method, each.params) for other in stimuli[place - 1 : place + 2])


def mentioned(codec: Codec, stimuli: Sequence[Stimulus]) -> tuple[list[int], list[int], list[bytes]]:
    """Return the variables, protocols and neighbours of a sequence, each in the order of their first use."""
    variables: dict[int, None] = {}
    protocols: dict[int, None] = {}
    neighbours: dict[bytes, None] = {}
    for each in stimuli:
        if each.octets:
            try:
                beacon = codec.decode(each.octets)
            except DecodeError:
                continue
            for payload in beacon.payloads:
                for container in payload.vardis or ():
                    for record in container.records:
                        variables[record.spec.var_id if isinstance(record, VarCreate) else record.var_id] = None
                if payload.srp is not None:
                    neighbours[payload.srp.node_id] = None
        else:
            params = each.params or {}
            if isinstance(params.get("varId"), int):
                variables[params["varId"]] = None
            if isinstance(params.get("protId"), int):
                protocols[params["protId"]] = None
    return list(variables), list(protocols), list(neighbours)


def _looks(codec: Codec, stimuli: Sequence[Stimulus]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the queries of the state that a sequence leaves."""
    variables, protocols, neighbours = mentioned(codec, stimuli)
    for var_id in variables[:_VARIABLES]:
        yield "RTDB-Read", {"varId": var_id}
        yield "RTDB-DescribeVariable", {"varId": var_id}
    if len(variables) > _VARIABLES:
        yield "RTDB-DescribeDatabase", {}
    for prot_id in protocols[:_VARIABLES]:
        yield "BP-QueryNumberBufferedPayloads", {"protId": prot_id}
    if protocols:
        yield "BP-ListRegisteredProtocols", {}
    if neighbours:
        yield "SRP-NeighbourTable", {}
    for name in ("BP", "SRP", "VD"):
        if any(each.method == f"{name}-SetParameter" for each in stimuli):
            yield f"{name}-GetParameters", {}


__all__ = ["Stimulus", "is_query", "mentioned", "recorded", "steps_of"]
