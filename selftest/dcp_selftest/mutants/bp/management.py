"""Faults in the management of BP and in its parameters."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_spec.parameters import Violation
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.air import Air
from dcp_selftest.mutants.family import around, attributes, before, instead, then
from dcp_selftest.mutants.mutant import mutant
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.parameters import MAX_PACKET, NETWORK, PERIOD, BPParameters
from dcp_stack.bp.services import StatusConfirm

OK = StatusConfirm(BPStatus.OK)


# -- management --------------------------------------------------------------------------------------------------------


@mutant("ignored", "BP-MGT-02 BP-TX-07", "continues to send beacons after it was deactivated")
class ContinuesWhileInactive(BeaconingProtocol):
    def deactivate(self) -> StatusConfirm:
        super().deactivate()
        self._active = True
        return OK


@mutant("sends", "BP-MGT-02 BP-TX-07", "sends payloads that are submitted while it is inactive")
class SendsInactive(BeaconingProtocol):
    off = False

    def deactivate(self) -> StatusConfirm:
        self.off = True
        return OK

    def activate(self, now: int) -> StatusConfirm:
        self.off = False
        return OK

    def handle_beacon(self, octets: bytes, *, now: int, wall: int) -> None:
        if not self.off:
            super().handle_beacon(octets, now=now, wall=wall)


instead(BeaconingProtocol, BeaconingProtocol.handle_beacon)("receives", "BP-MGT-03 BP-RX-13",
    "delivers payloads received while it is inactive",
    lambda self, octets, *, now, wall: self._receiver.receive(bytes(octets), now))  # fmt: skip


@mutant("later", "BP-MGT-03 BP-RX-13", "delivers payloads received while it was inactive when it is activated")
class DeliversLater(BeaconingProtocol):
    def __init__(self, *args: Any, **times: Any) -> None:
        super().__init__(*args, **times)
        self._kept: list[bytes] = []

    def handle_beacon(self, octets: bytes, *, now: int, wall: int) -> None:
        if not self._active:
            self._kept.append(octets)
        super().handle_beacon(octets, now=now, wall=wall)

    def activate(self, now: int) -> StatusConfirm:
        confirm = super().activate(now)
        kept, self._kept = self._kept, []
        for octets in kept:
            self._receiver.receive(octets, now)
        return confirm


# fmt: off
before(BeaconingProtocol, BeaconingProtocol.activate)("starts-over", "BP-MGT-05 BP-TX-01",
    "starts a new interval whenever it is activated, even while it is active",
    lambda self, now: self._schedule.restart(now))
instead(BeaconingProtocol, BeaconingProtocol.poll_timeout)("on-the-side", "BP-TX-01",
    "has no timer of its own and sends only when another protocol is active",
    lambda self: None)
around(BeaconingProtocol, BeaconingProtocol.transmit_payload)("refuses", "BP-MGT-04",
    "rejects payloads while it is inactive",
    lambda self, proceed, prot_id, payload, *, now: (
        StatusConfirm(BPStatus.UNKNOWN_PROTOCOL) if not self._active else proceed(prot_id, payload, now=now)))
# fmt: on


@mutant("forgets", "BP-MGT-04 BP-MGT-05", "clears all queues when it is deactivated")
class ForgetsPayloads(BeaconingProtocol):
    def deactivate(self) -> StatusConfirm:
        for client in self._clients:
            if client.queue is not None:
                client.queue.clear()
        return super().deactivate()


instead(BeaconingProtocol, BeaconingProtocol.activate)("no-resume", "BP-MGT-05",
    "confirms the activation of BP, which stays inactive",
    lambda self, now: OK)  # fmt: skip
then(BeaconingProtocol, BeaconingProtocol.activate)("receives-only", "BP-MGT-05",
    "receives again when it is activated, but does not send",
    lambda self, confirm, now: self._schedule.restart(now + 10**15))  # fmt: skip


@mutant("inactive", "BP-INI-03", "is inactive until it is activated")
class StartsInactive(BeaconingProtocol):
    def __init__(self, *args: Any, **times: Any) -> None:
        super().__init__(*args, **times)
        self._active = False


@mutant("clients-survive", "BP-INI-01", "keeps its registered clients across a reset")
class ClientsSurvive(Air):
    def reset(self, now: int, wall: int) -> None:
        outside = [client for client in self.bp._clients if client.protocol_id > 2]
        super().reset(now, wall)
        for client in outside:
            self.bp._clients.insert(client)


# -- parameters --------------------------------------------------------------------------------------------------------


instead(BeaconingProtocol, BeaconingProtocol.set_parameter)("ignored", "BP-PAR-02",
    "keeps using the initial beacon period",
    lambda self, name, value: self._parameters.set(name, value))  # fmt: skip


@mutant("network-stays", "BP-HDR-04 BP-PAR-05 BP-PAR-02", "keeps sending the initial network identifier")
class NetworkStays(BPParameters):
    @property
    def network_id(self) -> int | None:
        return self.__dict__.setdefault("first", super().network_id)


@mutant("any-period", "BP-PAR-03 BP-PAR-06", "accepts a beacon period of 0")
class AnyPeriod(BPParameters):
    def set(self, name: str, value: object) -> Violation | None:
        if name == PERIOD and value == 0:
            self._values[PERIOD] = value
            return None
        return super().set(name, value)

    @property
    def period(self) -> int:
        return super().period if self._values[PERIOD] else 100_000_000


class Unbound(BPParameters):
    """Accepts some maximum packet sizes beyond the limits."""

    wrong: ClassVar[range]

    def set(self, name: str, value: object) -> Violation | None:
        violation = super().set(name, value)
        if violation is not None and name == MAX_PACKET and isinstance(value, int) and value in self.wrong:
            self._values[name] = value
            return None
        return violation


TOO_LARGE = range(1001, 1 << 31)


unbound = attributes(Unbound, __name__)
unbound("no-upper-bound", "BP-PAR-04 BP-PAR-06", "accepts a maximum packet size larger than the bearer's",
    wrong=TOO_LARGE)  # fmt: skip
unbound("no-lower-bound", "BP-PAR-04 BP-PAR-06", "accepts a maximum packet size smaller than the headers",
    wrong=range(-(1 << 31), 1000))  # fmt: skip


@mutant("loses-old", "BP-PAR-06", "restores the default when a value is rejected")
class LosesOld(BPParameters):
    def set(self, name: str, value: object) -> Violation | None:
        violation = super().set(name, value)
        if violation is not None and name in self._values:
            self._values[name] = {PERIOD: 100, MAX_PACKET: 1500, NETWORK: 0x1111}[name]
        return violation


@mutant("forgets", "BP-PAR-01", "returns the initial values of parameters")
class TellsOld(BPParameters):
    def as_dict(self) -> dict[str, Any]:
        first: dict[str, Any] = self.__dict__.setdefault("first", super().as_dict())
        return first


@mutant("adds-up", "BP-PAR-08", "allows the bearer's maximum packet size to be set")
class BearerSettable(BPParameters):
    def set(self, name: str, value: object) -> Violation | None:
        violation = super().set(name, value)
        if name in self._fixed:
            self._fixed[name] = value  # type: ignore[assignment]
            return None
        return violation
