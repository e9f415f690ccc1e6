"""Nodes that are slow in ways that the specification permits, in virtual time."""

from __future__ import annotations

from typing import Any

import msgspec
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, MakeNode, VirtualUpperTester, plain_node, reference_config
from dcp_conformance.reference.surroundings import Upper
from dcp_conformance.test_system.bench import MS, Session
from dcp_conformance.upper_tester import Answer
from dcp_selftest.variants.timing import polling
from dcp_selftest.variants.variant import slow

from dcp_stack.config import VardisConfig

from .rig import codec_of

__all__ = ["LateAnswers", "SlowUpper", "polling", "runner_for"]


class SlowUpper(Upper):
    """An upper tester that takes ``delay`` (ns) for each call: half of it before the node is asked."""

    def __init__(self, sut: InProcess, delay: int, *, without: tuple[str, ...] = ()) -> None:
        super().__init__(sut, slow(delay / MS, frozenset(without)))


class LateAnswers(Upper):
    """An upper tester whose requests arrive at once, and whose answers and notifications are late by ``delay`` (ns)."""

    def __init__(self, sut: InProcess, delay: int) -> None:
        self._delay = delay
        super().__init__(sut, slow(delay / MS))

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        answer = VirtualUpperTester.call(self, method, params)
        self._node.elapse(self._delay)
        return answer


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
