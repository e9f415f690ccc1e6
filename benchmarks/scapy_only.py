# ruff: noqa: RUF012 - class attributes are how scapy packets are described
"""The two layouts of the C++ implementation as scapy packets and nothing else, the way a scapy layer is written.

:class:`Layer` has the packet classes of one layout. Values are read from packets by ``as_tuples`` and put into packets
by ``from_tuples``, in the form that ``handwritten`` documents.
"""

from __future__ import annotations

from scapy.fields import (
    ByteEnumField,
    ByteField,
    Field,
    FieldLenField,
    IEEEDoubleField,
    IntField,
    LEIntField,
    LESignedLongField,
    MACField,
    PacketField,
    PacketLenField,
    PacketListField,
    ShortField,
    StrFixedLenField,
    StrLenField,
    XShortField,
)
from scapy.packet import Packet, Raw

CONTAINERS = {
    1: "SUMMARIES",
    2: "UPDATES",
    3: "REQUEST-VARUPDATES",
    4: "REQUEST-VARCREATES",
    5: "CREATE-VARIABLES",
    6: "DELETE-VARIABLES",
}


class _LEDouble(IEEEDoubleField):
    """scapy's floats are in network order only."""

    def __init__(self, name, default):
        Field.__init__(self, name, default, "<d")


class _Part(Packet):
    """Leave the octets after a part to the list around it."""

    def extract_padding(self, s):
        return b"", s


class VarSumm(_Part):
    name = "VarSumm"
    fields_desc = [ByteField("varId", 0), ByteField("seqno", 0)]


class VarReqUpdate(_Part):
    name = "VarReqUpdate"
    fields_desc = [ByteField("varId", 0), ByteField("seqno", 0)]


class VarReqCreate(_Part):
    name = "VarReqCreate"
    fields_desc = [ByteField("varId", 0)]


class VarDelete(_Part):
    name = "VarDelete"
    fields_desc = [ByteField("varId", 0)]


class VarUpdate(_Part):
    name = "VarUpdate"
    fields_desc = [
        ByteField("varId", 0),
        ByteField("seqno", 0),
        FieldLenField("length", None, fmt="B", length_of="value"),
        StrLenField("value", b"", length_from=lambda packet: packet.length),
    ]


class VarSpec13(_Part):
    name = "VarSpec"
    fields_desc = [
        ByteField("varId", 0),
        MACField("prodId", None),
        ByteField("repCnt", 1),
        FieldLenField("length", None, fmt="B", length_of="descr"),
        StrLenField("descr", b"", length_from=lambda packet: packet.length),
    ]


class VarSpec20(_Part):
    name = "VarSpec"
    fields_desc = [
        ByteField("varId", 0),
        MACField("prodId", None),
        ByteField("repCnt", 1),
        LESignedLongField("creationTime", 0),
        ShortField("timeout", 0),
        FieldLenField("length", None, fmt="B", length_of="descr"),
        StrLenField("descr", b"", length_from=lambda packet: packet.length),
    ]


class VarCreate13(_Part):
    name = "VarCreate"
    fields_desc = [PacketField("spec", None, VarSpec13), PacketField("upd", None, VarUpdate)]


class VarCreate20(_Part):
    name = "VarCreate"
    fields_desc = [PacketField("spec", None, VarSpec20), PacketField("upd", None, VarUpdate)]


def _container(create):
    records = {1: VarSumm, 2: VarUpdate, 3: VarReqUpdate, 4: VarReqCreate, 5: create, 6: VarDelete}

    def next_record(packet, found, current, _rest):
        return records[packet.icType] if len(found) + (current is not None) < packet.icNumRecords else None

    class Container(_Part):
        name = "Container"
        fields_desc = [
            ByteEnumField("icType", 1, CONTAINERS),
            FieldLenField("icNumRecords", None, fmt="B", count_of="records"),
            PacketListField("records", [], next_cls_cb=next_record),
        ]

    return Container


class StateReport(_Part):
    name = "ExtendedSafetyData"
    fields_desc = [
        _LEDouble("x", 0.0),
        _LEDouble("y", 0.0),
        _LEDouble("z", 0.0),
        StrFixedLenField("opaque24", b"", length=8),
        MACField("nodeId", None),
        StrFixedLenField("opaque38", b"", length=2),
        StrFixedLenField("opaque40", b"", length=8),
        LESignedLongField("tStamp", 0),
        LEIntField("seqno", 0),
        StrFixedLenField("opaque60", b"", length=4),
    ]


def _vardis(container):
    class Vardis(_Part):
        name = "VarDis"
        fields_desc = [PacketListField("containers", [], container)]

    return Vardis


def _payload(vardis):
    contents = {1: StateReport, 2: vardis}

    def content(octets, _parent=None):
        return contents.get(_parent.protocolId, Raw)(octets)

    class Payload(_Part):
        name = "Payload"
        fields_desc = [
            ShortField("protocolId", 2),
            FieldLenField("length", None, fmt="H", length_of="content"),
            PacketLenField("content", None, content, length_from=lambda packet: packet.length),
        ]

    return Payload


def _beacon(payload, network_id):
    class Beacon(Packet):
        name = "Beacon"
        fields_desc = [
            ByteField("version", 1),
            XShortField("magicNo", 0x497E),
            MACField("senderId", None),
            *([XShortField("networkId", 0x1111)] if network_id else []),
            FieldLenField("length", None, fmt="H", length_of="payloads"),
            FieldLenField("numPayloads", None, fmt="B", count_of="payloads"),
            IntField("seqno", 0),
            PacketListField("payloads", [], payload, length_from=lambda packet: packet.length),
        ]

    return Beacon


class Layer:
    """The packet classes of one layout."""

    def __init__(self, since_2_0):
        self.since_2_0 = since_2_0
        self.spec = VarSpec20 if since_2_0 else VarSpec13
        self.create = VarCreate20 if since_2_0 else VarCreate13
        self.container = _container(self.create)
        self.vardis = _vardis(self.container)
        self.payload = _payload(self.vardis)
        self.beacon = _beacon(self.payload, since_2_0)

    # -- packet -> tuples ---------------------------------------------------------------------------------------

    def as_tuples(self, packet):
        """The values of a dissected beacon."""
        payloads = []
        for block in packet.payloads:
            content = block.content
            if isinstance(content, StateReport):
                value = (
                    content.x,
                    content.y,
                    content.z,
                    _octets(content.nodeId),
                    content.tStamp,
                    content.seqno,
                    content.opaque24,
                    content.opaque38,
                    content.opaque40,
                    content.opaque60,
                )
            elif isinstance(content, Raw):
                value = content.load
            else:
                value = [
                    (each.icType, [self._record(record) for record in each.records]) for each in content.containers
                ]
            payloads.append((block.protocolId, value))
        network = packet.networkId if self.since_2_0 else None
        return _octets(packet.senderId), packet.seqno, network, payloads

    def _record(self, record):
        match record:
            case VarUpdate():
                return record.varId, record.seqno, record.value
            case VarSumm() | VarReqUpdate():
                return record.varId, record.seqno
            case VarReqCreate() | VarDelete():
                return (record.varId,)
            case _:
                spec = record.spec
                times = (spec.creationTime, spec.timeout) if self.since_2_0 else (None, None)
                first = (spec.varId, _octets(spec.prodId), spec.repCnt, spec.descr, *times)
                return first, (record.upd.varId, record.upd.seqno, record.upd.value)

    # -- tuples -> packet ---------------------------------------------------------------------------------------

    def from_tuples(self, beacon):
        """A beacon packet to be built."""
        sender, seqno, network, payloads = beacon
        blocks = []
        for protocol, content in payloads:
            if isinstance(content, tuple):
                x, y, z, node, stamp, number, r24, r38, r40, r60 = content
                value = StateReport(
                    x=x,
                    y=y,
                    z=z,
                    opaque24=r24,
                    nodeId=node.hex(":"),
                    opaque38=r38,
                    opaque40=r40,
                    tStamp=stamp,
                    seqno=number,
                    opaque60=r60,
                )
            elif isinstance(content, bytes):
                value = Raw(content)
            else:
                value = self.vardis(
                    containers=[
                        self.container(icType=kind, records=[self._packet(kind, record) for record in records])
                        for kind, records in content
                    ]
                )
            blocks.append(self.payload(protocolId=protocol, content=value))
        extra = {"networkId": network} if self.since_2_0 else {}
        return self.beacon(senderId=sender.hex(":"), seqno=seqno, payloads=blocks, **extra)

    def _packet(self, kind, record):
        if kind == 5:
            (var_id, producer, repetitions, descr, created, timeout), update = record
            times = {"creationTime": created, "timeout": timeout} if self.since_2_0 else {}
            spec = self.spec(varId=var_id, prodId=producer.hex(":"), repCnt=repetitions, descr=descr, **times)
            return self.create(spec=spec, upd=self._packet(2, update))
        if kind == 2:
            var_id, seqno, value = record
            return VarUpdate(varId=var_id, seqno=seqno, value=value)
        if kind in (1, 3):
            return (VarSumm if kind == 1 else VarReqUpdate)(varId=record[0], seqno=record[1])
        return (VarReqCreate if kind == 4 else VarDelete)(varId=record[0])


def _octets(address):
    return bytes.fromhex(address.replace(":", ""))
