"""DCP layers for scapy sessions::

    >>> from dcp_codec.scapy.layers import *
    >>> use_profile("cpp-2.0")
    >>> rdpcap("flight.pcap")[0][DCPBeacon].show()
    >>> sendp(Ether()/DCPBeacon(senderId="02:00:00:00:00:01", seqno=41)/VarSumm(varId=7, seqno=3), iface="uwb0")

A beacon is one layer: its header fields are those of :class:`DCPBeacon`, its blocks the list ``payloads``. Inner fields
have the paths of the rest of the codec, such as ``payloads[0].srp.sData.x`` or
``payloads[1].vardis[0].records[2].seqno``. Records stacked on a beacon with ``/`` go into these lists. All fields are
made from the profile's plan (:mod:`dcp_codec.plan.tree`), so user-defined profiles need no further code. The profile is
``dcp-2.0`` until :func:`use_profile` is called.

Building derives lengths, counts, ``protocolId`` and ``icType`` that are None. A value that the user sets is sent
unchanged, also a wrong one; for this purpose the length of a string or value is a separate field (``valueLength``).
Dissecting never raises; ``beacon.problems`` lists the problems of a beacon.

Importing this module imports scapy, which is licensed GPL-2.0-only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from dcp_spec.profile.definition import Link, Profile
from dcp_spec.profile.loading import load_profile
from scapy.config import conf
from scapy.layers.l2 import Dot1Q, Ether
from scapy.packet import Packet, bind_bottom_up, bind_top_down, split_bottom_up, split_top_down

from dcp_codec.codec import Codec, get_codec
from dcp_codec.errors import Problem
from dcp_codec.plan.layout import walk
from dcp_codec.plan.tree import Group, Many, Rest
from dcp_codec.values import Beacon

from .fields import Octets
from .packets import PlanPacket
from .shape import Shape

__all__ = [
    "DCPBeacon",
    "DCPPayload",
    "Octets",
    "SRPReport",
    "SafetyData",
    "VarCreate",
    "VarDelete",
    "VarReqCreate",
    "VarReqUpdate",
    "VarSpec",
    "VarSumm",
    "VarUpdate",
    "VardisContainer",
    "VardisPayload",
    "export_script",
    "own_layer",
    "use_profile",
]

DEFAULT_PROFILE = "dcp-2.0"
BROADCAST = "ff:ff:ff:ff:ff:ff"


class _Layer(PlanPacket):
    """Base of all layers: a record stacked on it with ``/`` goes into its list for that type, if it has one."""

    def add_payload(self, payload: Any) -> None:
        if isinstance(payload, _Layer):
            above = payload.payload
            if isinstance(above, _Layer):
                payload.remove_payload()
            if self._place(payload):
                if isinstance(above, _Layer):
                    self.add_payload(above)
                return
            if isinstance(above, _Layer):
                payload.add_payload(above)
        super().add_payload(payload)

    def _place(self, layer: _Layer) -> bool:  # noqa: ARG002 - most layers have no place for others
        """Put ``layer`` into the matching list; return False if there is none."""
        return False

    def _append(self, name: str, element: Any) -> None:
        self.setfieldval(name, [*self.getfieldval(name), element])


class SafetyData(_Layer):
    """``SafetyDataT``: the data that the application reports, in the fields of the profile."""

    name = "SafetyData"


class SRPReport(_Layer):
    """``ExtendedSafetyDataT``: a state report."""

    name = "SRP report"

    def mysummary(self) -> str:
        return f"SRP {self.nodeId} seqno {self.seqno}" if "nodeId" in self.fieldtype else "SRP"


class VarSpec(_Layer):
    """``VarSpecT``: the static attributes of a variable."""

    name = "VarSpec"


class VarUpdate(_Layer):
    """``VarUpdateT``: a new value."""

    name = "VarUpdate"


class VarCreate(_Layer):
    """``VarCreateT``: attributes (``spec``) and value (``upd``) of a new variable."""

    name = "VarCreate"


class VarDelete(_Layer):
    """``VarDeleteT``."""

    name = "VarDelete"


class VarSumm(_Layer):
    """``VarSummT``: the newest sequence number that the sender has."""

    name = "VarSumm"


class VarReqUpdate(_Layer):
    """``VarReqUpdateT``: ``seqno`` is the requester's own, outdated number."""

    name = "VarReqUpdate"


class VarReqCreate(_Layer):
    """``VarReqCreateT``."""

    name = "VarReqCreate"


class _OwnRecord(_Layer):
    """An instruction record that only the profile defines."""


_RECORDS = (VarCreate, VarDelete, VarUpdate, VarSumm, VarReqUpdate, VarReqCreate, _OwnRecord)


class VardisContainer(_Layer):
    """An instruction container: ``records`` of the one type that ``icType`` selects."""

    name = "VarDis container"

    def _place(self, layer: _Layer) -> bool:
        if isinstance(layer, _RECORDS):
            self._append("records", layer)
            return True
        return False

    def mysummary(self) -> str:
        number = self.getfieldval("icType")
        number = self._choice(self.shape.chosen["icType"]) if number is None else number
        label = self._field("icType").names.get(number, f"type {number}")
        return f"{label} {len(self.getfieldval('records'))}"


class _Containers(_Layer):
    """Base of layers with a list ``vardis`` of containers."""

    def _place(self, layer: _Layer) -> bool:
        if isinstance(layer, VardisContainer):
            self._append("vardis", layer)
        elif isinstance(layer, _RECORDS):
            containers = self.getfieldval("vardis")
            last = containers[-1] if containers and isinstance(containers[-1], VardisContainer) else None
            if last is None or any(type(record) is not type(layer) for record in last.getfieldval("records")):
                last = VardisContainer()
                self._append("vardis", last)
            last._place(layer)
        else:
            return False
        return True


class VardisPayload(_Containers):
    """A VarDis payload without the header of its block."""

    name = "VarDis payload"


class DCPPayload(_Containers):
    """A block of a beacon: its header and ``srp`` (a state report), ``vardis`` (containers) or ``data`` (octets)."""

    name = "DCP payload"

    def _place(self, layer: _Layer) -> bool:
        if isinstance(layer, SRPReport):
            if "srp" not in self.fieldtype:
                name = _session.codec.profile.name
                raise ValueError(
                    f"profile {name} cannot encode state reports: use DCPPayload(protocolId=1, data=b'...')"
                )
            self.srp = layer
            return True
        if isinstance(layer, VardisPayload):
            for container in layer.getfieldval("vardis"):
                self._append("vardis", container)
            return True
        return super()._place(layer)

    def mysummary(self) -> str:
        content = self.chosen("protocolId")
        if content == "srp":
            return "SRP"
        if content == "vardis":
            inside = [each.mysummary() or each.name for each in self.getfieldval("vardis")]
            return f"VarDis [{', '.join(inside)}]"
        return f"protocol {self.getfieldval('protocolId')} ({len(self.getfieldval('data'))} octets)"


class DCPBeacon(_Layer):
    """A whole beacon: the BP header and the blocks in ``payloads``."""

    name = "DCP beacon"

    def _place(self, layer: _Layer) -> bool:
        blocks = self.getfieldval("payloads")
        if isinstance(layer, DCPPayload):
            self._append("payloads", layer)
            return True
        continued = isinstance(layer, (VardisContainer, *_RECORDS))
        if continued and blocks and isinstance(blocks[-1], DCPPayload) and blocks[-1].getfieldval("vardis"):
            return blocks[-1]._place(layer)
        block = DCPPayload()
        if not block._place(layer):
            return False
        self._append("payloads", block)
        return True

    @property
    def problems(self) -> list[Problem]:
        """Return the errors and warnings of the codec for the octets of the beacon."""
        return _session.codec.dissect(self.do_build()).problems

    def decode(self) -> Beacon:
        """Return the beacon as a value of the codec. Raises ``dcp_codec.DecodeError`` if the octets are not a
        beacon.
        """
        return _session.codec.decode(self.do_build())

    def mysummary(self) -> str:
        text = "DCP"
        if "senderId" in self.fieldtype:
            sender = self._field("senderId").i2repr(self, self.getfieldval("senderId"))
            text += f" {sender} seqno {self.getfieldval('seqno')!r}"
        blocks = [each.mysummary() or each.name for each in self.getfieldval("payloads")]
        text += f": {', '.join(blocks)}" if blocks else ""
        try:
            errors = [problem for problem in self.problems if problem.severity == "error"]
        except (ValueError, RuntimeError):
            return text
        return f"{text} ({errors[0].reason})" if errors else text


# The order matters: inner records are laid out before the records around them.
_BY_TYPE: dict[str, type[_Layer]] = {
    "SafetyData": SafetyData,
    "ExtendedSafetyData": SRPReport,
    "VarSpec": VarSpec,
    "VarUpdate": VarUpdate,
    "VarCreate": VarCreate,
    "VarDelete": VarDelete,
    "VarSumm": VarSumm,
    "VarReqUpdate": VarReqUpdate,
    "VarReqCreate": VarReqCreate,
    "Container": VardisContainer,
    "VardisPayload": VardisPayload,
    "Payload": DCPPayload,
    "Beacon": DCPBeacon,
}


def _own_layers(groups: Mapping[str, Group]) -> dict[str, type[_Layer]]:
    """Return a layer for each record type that only the profile defines. A header is part of the beacon and needs
    none.
    """
    names = [name for name in groups if name not in _BY_TYPE and name != "BPHeader"]
    return {
        name: type(name, (_Layer if name == "OwnReport" else _OwnRecord,), {"name": name, "__module__": __name__})
        for name in names
    }


class _Session:
    """The current profile. It is global because scapy's layers and their bindings are global."""

    def __init__(self) -> None:
        self.codec = get_codec(DEFAULT_PROFILE)
        self.unbind: list[Callable[[], None]] = []
        self.own: dict[str, type[_Layer]] = {}

    def use(self, codec: Codec) -> None:
        """Lay out the layers for the profile and bind them to its EtherType or UDP port."""
        profile = codec.profile
        groups = {node.type_name: node for node in walk(codec.beacon_plan) if isinstance(node, Group)}
        containers = codec.containers_plan
        assert isinstance(containers, Many)
        packets = {**_own_layers(groups), **_BY_TYPE}
        groups["VardisPayload"] = Group("", "VardisPayload", (replace(containers, name="vardis"),), None)
        for type_name, layer in packets.items():
            # A profile that does not define a record still has a layer of that name, which holds any octets.
            group = groups.get(type_name) or Group("", type_name, (Rest("data"),), None)
            shape = Shape(
                group,
                packets=packets,
                representation=profile.types.node_id.representation,
                defaults={"network-id": profile.bp.network_id or 0},
                base=PlanPacket,
                opened="BPHeader",
            )
            layer.lay_out(codec.report_plan or group if layer is SRPReport else group, shape)
        self.own = {name: layer for name, layer in packets.items() if name not in _BY_TYPE}
        self.codec = codec
        for undo in self.unbind:
            undo()
        self.unbind = [self._bound(lower, fields) for lower, fields in _places(profile.link)]

    def _bound(self, lower: type[Packet], fields: dict[str, int]) -> Callable[[], None]:
        bind_bottom_up(lower, DCPBeacon, **{name: value for name, value in fields.items() if name != "sport"})
        bind_top_down(lower, DCPBeacon, **fields)

        def undo() -> None:
            split_bottom_up(lower, DCPBeacon)
            split_top_down(lower, DCPBeacon, **fields)

        return undo


def _places(link: Link) -> list[tuple[type[Packet], dict[str, int]]]:
    """Return the layers that carry beacons, and the field values that identify beacons."""
    if link.transport == "udp":
        from scapy.layers.inet import UDP

        # The student implementation only accepts datagrams that also have this source port.
        return [(UDP, {"dport": link.udp_port or 0, "sport": link.udp_port or 0})]
    return [(Ether, {"type": link.ether_type or 0}), (Dot1Q, {"type": link.ether_type or 0})]


_session = _Session()
_session.use(_session.codec)
# Beacons are broadcast (UWB-01); without this scapy would try to resolve a neighbour's address.
conf.neighbor.register_l3(Ether, DCPBeacon, lambda _l2, _l3: BROADCAST)


def use_profile(profile: Profile | str | Path) -> Codec:
    """Lay out all layers for ``profile``: a loaded one, the name of a built-in one, or the path of a TOML file.

    Binds :class:`DCPBeacon` to the profile's EtherType (also after VLAN tags) or UDP port, and removes the binding of
    the profile before. Packets of another profile keep their values but cannot be built any more: make or dissect them
    again. Returns the codec of the profile. Raises ``dcp_spec.profile.loading.ProfileError``.
    """
    codec = Codec(profile)
    if codec.profile != _session.codec.profile:
        _session.use(codec)
    return _session.codec


def own_layer(type_name: str) -> type[Packet]:
    """Return the layer of a record type that only the current profile defines, such as ``GeoFence`` or ``OwnReport``.

    Raises KeyError if the profile has no such record type.
    """
    return _session.own[type_name]


def export_script(profile_name_or_path: str) -> str:
    """Return a start-up script: ``scapy -c FILE`` starts a session with the layers of that profile.

    Raises ``dcp_spec.profile.loading.ProfileError`` if there is no such profile.
    """
    profile = load_profile(profile_name_or_path)
    path = Path(profile_name_or_path)
    # An absolute path, because the script may be started from any folder.
    argument = str(path.resolve()) if path.suffix == ".toml" else profile.name
    return f"""# A scapy session with the layers of the Drone Coordination Protocol: scapy -c THIS_FILE
# {profile.title}
from dcp_codec.scapy.layers import *

use_profile({argument!r})
print("DCP layers, profile {profile.name}: try ls(DCPBeacon), or rdpcap(...)[0][DCPBeacon].show()")
"""
