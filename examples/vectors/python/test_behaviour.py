"""The behaviour vectors with pytest: ``DCP_VECTORS=folder/dcp-2.0 pytest test_behaviour.py``.

With a node of your own, replace :class:`Node`.
"""

import os
from pathlib import Path
from typing import Any

import msgspec
import pytest
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.vectors.behaviour import Event, Vector, answered, events_of, judged
from dcp_conformance.vectors.files import BehaviourFile

from dcp_codec import Codec

FOLDER = Path(os.environ.get("DCP_VECTORS", "."))
CODEC = Codec(FOLDER.name)
(GROUP,) = msgspec.json.decode((FOLDER / "behaviour.json").read_bytes(), type=BehaviourFile).test_groups
MS = 1_000_000


class Node:
    """A node that has just been started: ours, in virtual time. Times are milliseconds since the start."""

    def __init__(self) -> None:
        self._node = InProcess(reference_config(CODEC))
        self._services = VirtualUpperTester(self._node)
        self.events: list[Event] = []

    def receive(self, octets: bytes) -> None:
        """Hand a frame to the node."""
        self._node.deliver(octets)
        self._take()

    def call(self, method: str, params: dict[str, Any]) -> tuple[str, dict[str, Any]]:
        """Call a service; return the status of its confirm, and its members."""
        try:
            answer = self._services.call(method, params)
        except UpperTesterError:
            return "", {}
        return answer.status, answer.result

    def advance(self, time: int) -> None:
        """Set the clock, and let the node do what is due until then."""
        while self._node.now < time * MS:
            self._node.advance(time * MS)
            self._take()

    def _take(self) -> None:
        while self._node.arrivals:
            beacon = self._node.arrivals.popleft()
            self.events += events_of(CODEC, beacon.octets, beacon.time / MS)
        for each in self._services.poll():
            if each.method == "BP-ReceivePayload.indication":
                self.events.append(Event(each.time / MS, "indication", each.params["protId"], each.params["payload"]))
            elif each.method == "BP-PayloadTransmitted.indication":
                self.events.append(Event(each.time / MS, "transmitted", each.params["protId"], ""))


@pytest.mark.parametrize("vector", GROUP.tests, ids=[each.tc_id for each in GROUP.tests])
def test_behaviour(vector: Vector) -> None:
    node = Node()
    wrong: list[str] = []
    for step in vector.steps:
        node.advance(step.at)
        if step.call is None:
            node.receive(bytes.fromhex(step.receive or ""))
        else:
            wrong += answered(step, *node.call(step.call, dict(step.params)))
    node.advance(vector.end)
    wrong += judged(vector, node.events)
    assert not wrong, "\n".join(wrong)
