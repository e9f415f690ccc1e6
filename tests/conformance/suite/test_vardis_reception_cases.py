"""The cases about received VarDis payloads in succession, against nodes that cannot be reset or are late."""

from __future__ import annotations

import random
from collections import deque

import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import MS, Session

from dcp_stack.config import NodeConfig
from dcp_stack.node import Node

from ...parts import also
from ..rig import codec_of, ids_of, known_cases

MODULES = (
    "vardis.reception.states",
    "vardis.services.state_services",
    "vardis.reception.split",
    "vardis.reception.receive",
    "vardis.reception.seqno",
    "vardis.composition.forwarding",
    "vardis.reception.scope",
    "vardis.composition.pending",
    "vardis.services.lengths",
    "vardis.reception.robustness",
    "vardis.reception.creation",
    "vardis.services.types",
)
FINE = {Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE}


class Slow(Node):
    """Frames reach it up to a period and a half late, in their order; those of one moment together."""

    def __init__(self, config: NodeConfig, rng: random.Random, now: int, wall: int) -> None:
        super().__init__(config, rng=rng, now=now, wall=wall)
        self._late: deque[tuple[int, bytes]] = deque()
        self._lateness = random.Random(1)
        self._moment = self._due = -1

    def handle_frame(self, octets: bytes, *, now: int, wall: int) -> None:
        if self._moment != now:
            self._moment = now
            self._due = max(self._due, now + self._lateness.randrange(150) * MS)
        self._late.append((self._due, octets))

    def poll_timeout(self) -> int | None:
        due = super().poll_timeout()
        first = self._late[0][0] if self._late else None
        return min((each for each in (due, first) if each is not None), default=None)

    def handle_timeout(self, now: int, wall: int) -> None:
        while self._late and self._late[0][0] <= now:
            super().handle_frame(self._late.popleft()[1], now=now, wall=wall)
        super().handle_timeout(now, wall)


def all_in_one_session(profile: str, *, make: MakeNode | None = None, upper: bool, reset: bool) -> list[str]:
    """The cases that do not pass when they are run in succession against one node."""
    codec = codec_of(profile)
    sut = InProcess(reference_config(codec), make=make or plain_node)
    pics = Pics(pixit=Testing(reset="auto" if reset else "none"))
    session = Session(codec, sut.lower_tester(), sut.upper_tester() if upper else None, pics)
    runner = Runner(session, sut if reset else None)
    runner.prepare()
    results = [runner.run(known_cases()[case_id]) for case_id in ids_of(*MODULES)]
    return [f"{each.id}: {each.verdict}: {each.reason}" for each in results if each.verdict not in FINE]


@pytest.mark.part("suite")
@pytest.mark.parametrize("upper", [True, False], ids=["upper", "wire"])
@pytest.mark.parametrize("profile", ["dcp-2.0", *also("suite", "dcp-1.0", "dcp-1.2")])
def test_a_node_that_cannot_be_reset(profile: str, upper: bool) -> None:
    wrong = all_in_one_session(profile, upper=upper, reset=False)
    # Since 2.0 nothing is forgotten: where identifiers are used up a case says what to give.
    assert not [each for each in wrong if ": inconclusive: " not in each or "provide UT-Reset" not in each]
    assert len(wrong) <= 3


@pytest.mark.part("suite")
@pytest.mark.parametrize("profile", ["dcp-1.2", "dcp-2.0"])
def test_a_node_that_receives_late(profile: str) -> None:
    assert not all_in_one_session(profile, make=Slow, upper=True, reset=True)
