"""The independent model of a node beside a vector: it names the requirements, and must not contradict the trace."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dcp_conformance.oracle.judgement import Finding, Timing
from dcp_conformance.oracle.node import NodeModel
from dcp_conformance.upper_tester import Answer
from dcp_conformance.vectors.behaviour import Step

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_stack.virtual.world import EPOCH

_MS: Final = 1_000_000
_OWN_PROTOCOLS: Final = (1, 2)


class Watcher:
    """Follows a trace with the model. After damaged octets the model does not judge any more."""

    def __init__(self, codec: Codec, own_id: bytes, parameters: Mapping[str, Any], variables: list[int]) -> None:
        """``variables``: those of the vector."""
        period = round(parameters["BPPAR_BEACON_PERIOD"] * _MS)
        timing = Timing(period=period, patience=12 * period, clock=5 * _MS, whole=True)
        self._codec = codec
        self._own_id = own_id
        self._model = NodeModel(codec, own_id, parameters, timing)
        self._model.vardis.mine.update(variables)
        self._sure = True
        self._protocols = False
        self.requirements: dict[int, str] = {}
        """By step: the requirement that decides the status of its service."""
        self.finding: Finding | None = None
        """The first contradiction."""

    def _judge(self, findings: Any) -> None:
        found = next(iter(findings), None)
        if found is not None and self._sure:
            self.finding = self.finding or found

    def frame(self, octets: bytes, time: int) -> None:
        """Follow a frame to the node at ``time`` (ns)."""
        try:
            beacon, _ = self._codec.decode_envelope(octets)
            self._codec.decode(octets)
        except DecodeError:
            self._sure = False
            return
        blocks = [(each.protocol_id, each.data or b"") for each in beacon.payloads]
        forbidden: tuple[str, ...] = ()
        if beacon.bp is not None:
            network = self._model.values.get("BPPAR_NETWORK_ID")
            if beacon.bp.network_id is not None and beacon.bp.network_id != network:
                forbidden = ("BP-RX-05",)
            elif beacon.bp.sender_id == self._own_id:
                forbidden = ("BP-RX-06",)
        self._model.received(blocks, time, forbidden)

    def call(self, place: int, step: Step, answer: Answer | None, time: int) -> None:
        """Follow a service call with its answer at ``time`` (ns)."""
        if step.call is None or answer is None or answer.code is not None or not self._sure:
            self._sure = self._sure and (answer is None or answer.code is None)
            return
        model, params, wall = self._model, dict(step.params), EPOCH + time
        self._protocols = self._protocols or params.get("protId", 1) not in _OWN_PROTOCOLS
        expected = model.expect(step.call, params, time)
        fitting = [each for each in expected if each.status == answer.status]
        if fitting and not fitting[0].requirement.startswith("X"):
            self.requirements[place] = fitting[0].requirement
        self._judge(model.judge(step.call, params, expected, answer.status, answer.code))
        if step.call == "RTDB-Create" and answer.ok:
            self._judge(model.created(params, wall, time))
        result = answer.result | {"status": answer.status}
        self._judge(model.confirmed(step.call, params, result, (time, wall), (time, wall)))

    def beacon(self, octets: bytes, time: int) -> None:
        """Follow a beacon of the node."""
        self._judge(self._model.beacon(octets, time))

    def notified(self, method: str, params: Mapping[str, Any], time: int) -> None:
        """Follow a notification at ``time``, ns."""
        self._judge(self._model.notified(method, params, time))

    def passed(self, time: int) -> None:
        """Let time pass."""
        self._judge(self._model.passed(time, notified=self._protocols))


__all__ = ["Watcher"]
