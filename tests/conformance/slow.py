"""Nodes that are slow in ways that the specification permits, in virtual time."""

from __future__ import annotations

import random
from collections import deque
from typing import Any

import msgspec
from dcp_conformance.bench import MS, Session
from dcp_conformance.pics import Pics
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node, reference_config
from dcp_conformance.runner import Runner
from dcp_conformance.upper import Answer

from dcp_stack.config import NodeConfig, VardisConfig
from dcp_stack.node import Node
from dcp_stack.vardis import Vardis

from .rig import codec_of


class SlowUpper(VirtualUpperTester):
    """An upper tester that takes ``delay`` (ns) for each call: half of it before the node is asked."""

    def __init__(self, sut: InProcess, delay: int, *, without: tuple[str, ...] = ()) -> None:
        self.delay = delay
        self._node = sut
        super().__init__(sut)
        self.methods = self.methods - set(without)

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """As without delay, but time passes, and the node goes on meanwhile."""
        if method == "UT-Reset":
            # Between cases nobody waits for anything.
            return super().call(method, params)
        self._node.elapse(self.delay // 2)
        answer = super().call(method, params)
        self._node.elapse(self.delay - self.delay // 2)
        return answer

    def another(self) -> SlowUpper:
        """A second connection, as slow."""
        return SlowUpper(self._node, self.delay)


def polling(interval_ms: int) -> MakeNode:
    """A node whose VarDis takes one received payload from BP each so many ms, as the C++ implementation 1.2 does."""

    class Polling(Vardis):
        def __init__(self, *args: Any, now: int, **more: Any) -> None:
            super().__init__(*args, now=now, **more)
            self._inbox: deque[bytes] = deque()
            self._polled = now

        def handle_payload(self, payload: bytes, *, now: int, wall: int) -> None:
            if self.active:
                self._inbox.append(payload)

        def _due(self) -> int:
            return self._polled + interval_ms * MS

        def handle_timeout(self, now: int, wall: int) -> None:
            while self._due() <= now:
                self._polled = self._due()
                if self._inbox:
                    super().handle_payload(self._inbox.popleft(), now=now, wall=wall)
            super().handle_timeout(now, wall)

        def poll_timeout(self) -> int | None:
            due = super().poll_timeout()
            return self._due() if due is None else min(due, self._due())

    class PollingNode(Node):
        vardis_class = Polling

    def make(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Any:
        return PollingNode(config, rng=rng, now=now, wall=wall)

    return make


def runner_for(
    profile: str = "dcp-2.0",
    *,
    make: MakeNode = plain_node,
    call_ms: float = 0,
    without: tuple[str, ...] = (),
    pics: Pics | None = None,
    **parameters: int,
) -> Runner:
    """A runner of cases against our node: with an upper tester that takes ``call_ms`` for each call and does not offer
    the methods ``without``, and with these parameters of VarDis.
    """
    codec = codec_of(profile)
    config = msgspec.structs.replace(reference_config(codec), vardis=VardisConfig(**parameters))
    sut = InProcess(config, make=make)
    upper = SlowUpper(sut, round(call_ms * MS), without=without)
    runner = Runner(Session(codec, sut.lower_tester(), upper, pics or Pics()), sut)
    runner.prepare()
    return runner
