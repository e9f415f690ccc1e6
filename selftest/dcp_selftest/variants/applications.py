"""Variants with applications on the node that use its services during the test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final

from dcp_conformance.definitions.pics import Testing
from dcp_conformance.reference.surroundings import Application, Setup
from dcp_spec.constants import QueueingMode

from dcp_stack.config import MS, SRPConfig
from dcp_stack.node import Node

from .variant import Variant, codec_of, has_srp, setup

_CLIENT: Final = 0x7A11
#: Identifier of the applications' variable, and the range that the tester uses instead (pixit.var_ids).
_VARIABLE: Final = 250
_TESTER_VAR_IDS: Final = (0, 239)


class _Periodic:
    """An application that acts once in each period.

    Periods are not multiples of the beacon period, so that the phase varies.
    """

    period_ms: ClassVar[int] = 103

    def __init__(self) -> None:
        self._next = self.period_ms * MS

    def due(self) -> int:
        return self._next

    def act(self, node: Node, now: int, wall: int) -> None:
        self._next = now + self.period_ms * MS
        self.once(node, now, wall)

    def once(self, node: Node, now: int, wall: int) -> None:
        """Act once. Times in ns."""
        raise NotImplementedError


class Pilot(_Periodic):
    """Submits safety data at about 10 Hz, as the architecture expects of an application."""

    period_ms = 103

    def once(self, node: Node, now: int, wall: int) -> None:
        if node.srp is None:
            return
        data = {field.name: 0 for field in node.config.safety_fields.numbers()}
        node.srp.update_safety_data(data, now=now, wall=wall)


class FastPilot(Pilot):
    """Submits safety data at about 50 Hz, more often than the node sends beacons."""

    period_ms = 21


class SlowPilot(Pilot):
    """Submits safety data at about 1 Hz."""

    period_ms = 1009


class Sensor(_Periodic):
    """Updates a variable once a second; creates it if it does not exist."""

    period_ms = 1013
    repetitions: ClassVar[int] = 2

    def __init__(self) -> None:
        super().__init__()
        self._count = 0

    def once(self, node: Node, now: int, wall: int) -> None:
        vardis = node.vardis
        if vardis is None:
            return
        self._count += 1
        value = self._count.to_bytes(4, "big")[-2:]
        if not vardis.update(_VARIABLE, value, now=now, wall=wall).status.is_ok:
            vardis.create(_VARIABLE, None, self.repetitions, b"load", value, now=now, wall=wall)


class FastSensor(Sensor):
    """Updates its variable in each beacon period."""

    period_ms = 103


class Chatter(_Periodic):
    """A client of BP that submits a payload three times a second."""

    period_ms = 331
    mode: ClassVar[str] = "once"

    def once(self, node: Node, now: int, wall: int) -> None:
        bp = node.bp
        if bp.client(_CLIENT) is None:
            mode = QueueingMode.ONCE if self.mode == "once" else QueueingMode.REPEAT
            bp.register(_CLIENT, "chatter", 20, mode, 1, False, now=now, wall=wall)
        bp.transmit_payload(_CLIENT, b"\x55" * 11, now=now)


class Beacon(Chatter):
    """A client of BP with a payload in every beacon (mode REPEAT), so that the node is never silent."""

    mode = "repeat"


class Everything(_Periodic):
    """The applications Pilot, Sensor and Chatter together."""

    period_ms = 97

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[Application] = [Pilot(), Sensor(), Chatter()]

    def once(self, node: Node, now: int, wall: int) -> None:
        for each in self._parts:
            if each.due() <= now:
                each.act(node, now, wall)


def _running(application: Callable[[], Application], **more: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, application=application, pixit=Testing(var_ids=_TESTER_VAR_IDS), **more)


def _configured(profile: str) -> Setup:
    fields = setup(profile).config.safety_fields
    return setup(profile, srp=SRPConfig(safety_data={field.name: 1 for field in fields.numbers()}))


def _one_octet_ids(profile: Any) -> bool:
    return bool(codec_of(profile.name).profile.types.var_id.width == 1)


_SRP_WHY = "dcp-architecture.md: the application frequently submits its state to SRP"
_VD_WHY = "dcp-vardis.md: applications create and update variables at any time; PIXIT var_ids reserves some for them"
_BP_WHY = "dcp-bp.md: any number of client protocols may be registered"

#: Because the application keeps sending, no beacon period is without a payload.
_NO_PAUSE = r"^TC_BP_HDR_BV_(09|12): no beacon during the pause"
#: While BP is inactive, the application replaces the waiting payload.
_REPLACED = r"^TC_SRP_REC_(TI_01|BV_04): .*: an application on the node replaces"
#: The node summarises its own variable in every payload as long as the variable exists.
_SUMMARISED = (
    r"^TC_VD_RUN_TI_0.*: variables from other sources are still summarised"
    r"|^TC_VD_SUM_BV_04: .*: an application on the node has created a variable"
)
#: The reports and payloads of the application delay the VarCreates that would fill the payloads.
_NOT_FULL = r"^TC_VD_SCR_TI_15: payloads full of VarCreates, which this case needs: room for a VarReqUpdate$"

#: The reports of the application are in some beacons only.
_OTHER_ROOM = r"^TC_BP_TX_BV_01-(one-octet|a-header): a beacon with room for exactly these payloads"
#: The variable of the application is in nearly every payload, and its records take room.
_FULL = (
    r"^TC_VD_(PAY_BV_07-updates.*|PAY_BV_10-update-requests.*|ORD_BV_0[13].*): payloads with the records of this case"
    r"|^TC_VD_(ROOM_BV_03|SCR_TI_15): .*which this case needs: (none in time|room for a VarReqUpdate)$"
    f"|{_OTHER_ROOM}"
)

VARIANTS = (
    Variant("V-APP-reports-10Hz", "has an application that submits safety data at 10 Hz", _SRP_WHY, _running(Pilot),
        where=has_srp, explains=(_NO_PAUSE, _REPLACED, _OTHER_ROOM)),
    Variant("V-APP-reports-50Hz", "has an application that submits safety data at 50 Hz", _SRP_WHY, _running(FastPilot),
        where=has_srp, explains=(_NO_PAUSE, _REPLACED, _OTHER_ROOM)),
    Variant("V-APP-reports-1Hz", "has an application that submits safety data at 1 Hz", _SRP_WHY, _running(SlowPilot),
        where=has_srp, explains=(_NO_PAUSE, _REPLACED, _OTHER_ROOM)),
    Variant(
        "V-APP-initial-report",
        "submits configured safety data when it starts",
        _SRP_WHY,
        _configured,
        where=has_srp,
        # Up to 1.2 the report is repeated.
        explains=(_NO_PAUSE,),
    ),
    Variant("V-APP-variable", "has an application that updates a variable once a second", _VD_WHY, _running(Sensor),
        where=_one_octet_ids, explains=(_NO_PAUSE, _SUMMARISED)),
    Variant("V-APP-variable-10Hz", "has an application that updates a variable ten times a second", _VD_WHY,
        _running(FastSensor), where=_one_octet_ids, explains=(_NO_PAUSE, _SUMMARISED, _FULL)),
    Variant("V-APP-variable-10Hz-untold",
        "has an application that updates a variable ten times a second, which the PIXIT does not mention", _VD_WHY,
        lambda profile: setup(profile, application=FastSensor), where=_one_octet_ids,
        explains=(_NO_PAUSE, _SUMMARISED, _FULL)),
    Variant("V-APP-client", "has a client of BP that submits a payload three times a second", _BP_WHY,
        _running(Chatter), explains=(_NO_PAUSE,)),
    Variant("V-APP-every-beacon", "has a client of BP with a payload in every beacon", _BP_WHY, _running(Beacon),
        explains=(_NO_PAUSE,)),
    Variant("V-APP-everything", "has reports at 10 Hz, a variable and a client of BP", f"{_SRP_WHY}; {_VD_WHY}",
        _running(Everything), where=has_srp, explains=(_NO_PAUSE, _SUMMARISED, _REPLACED, _NOT_FULL)),
)  # fmt: skip
