# ruff: noqa: SIM109 - "in" would build a tuple on the hot path
"""Codec written by hand with ``struct``, by a careful programmer, for the two layouts of the C++ implementation.

Complete: all six containers, state reports with their opaque regions, payloads of unknown protocols, every length and
count checked. Wrong octets are a ``ValueError``. There are two pairs of functions. ``decode_tuples`` and
``encode_tuples`` use plain tuples and lists::

    (sender_id, seqno, network_id or None, [(protocol_id, content), ...])

where content is a tuple (state report: x, y, z, node_id, t_stamp, seqno, and the four opaque regions), a list of
(ic_type, [record tuples]), or octets. ``decode_values`` and ``encode_values`` do the same with the value classes of
dcp_codec, for comparison with our codec. Both lack field paths, offsets and requirement ids of errors, and other
layouts.
"""

from __future__ import annotations

from struct import Struct, error
from typing import NamedTuple

from dcp_codec import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

VERSION, MAGIC = 1, 0x497E
SRP, VARDIS = 1, 2
SUMMARIES, UPDATES, REQ_UPDATES, REQ_CREATES, CREATES, DELETES = 1, 2, 3, 4, 5, 6

HEADER_13 = Struct(">BH6sHBI")
HEADER_20 = Struct(">BH6sHHBI")
BLOCK = Struct(">HH")
REPORT = Struct("<ddd8s6s2s8sqI4s")
PAIR = Struct("BB")
UPDATE = Struct("BBB")
SPEC_13 = Struct("B6sBB")
# The creation time is little-endian, the timeout after it big-endian.
SPEC_20_START = Struct("<B6sBq")
SPEC_20_END = Struct(">HB")


class Layout(NamedTuple):
    """Differences between releases: since 2.0 a network identifier, and variables with creation time and timeout."""

    since_2_0: bool
    safety_data: type


# -- plain tuples -----------------------------------------------------------------------------------------------


def decode_tuples(octets, layout):
    """Decode a beacon; octets after it are padding."""
    if layout.since_2_0:
        if len(octets) < 18:
            raise ValueError("header cut off")
        version, magic, sender, network, length, count, seqno = HEADER_20.unpack_from(octets)
        position = 18
    else:
        if len(octets) < 16:
            raise ValueError("header cut off")
        version, magic, sender, length, count, seqno = HEADER_13.unpack_from(octets)
        network = None
        position = 16
    if version != VERSION or magic != MAGIC:
        raise ValueError("not a beacon")
    if not length or not count:
        raise ValueError("empty beacon")
    end = position + length
    if end > len(octets):
        raise ValueError("beacon longer than the frame")
    payloads = []
    while position < end:
        if position + 4 > end:
            raise ValueError("payload header cut off")
        protocol, size = BLOCK.unpack_from(octets, position)
        position += 4
        stop = position + size
        if stop > end:
            raise ValueError("payload longer than the beacon")
        if protocol == VARDIS:
            payloads.append((protocol, _containers_tuples(octets, position, stop, layout.since_2_0)))
        elif protocol == SRP:
            if size != 64:
                raise ValueError("state report of another size")
            x, y, z, r24, node, r38, r40, stamp, number, r60 = REPORT.unpack_from(octets, position)
            payloads.append((protocol, (x, y, z, node, stamp, number, r24, r38, r40, r60)))
        else:
            payloads.append((protocol, octets[position:stop]))
        position = stop
    if count != len(payloads):
        raise ValueError("wrong number of payloads")
    return sender, seqno, network, payloads


def _containers_tuples(octets, position, end, since_2_0):
    containers = []
    while position < end:
        if position + 2 > end:
            raise ValueError("container header cut off")
        kind = octets[position]
        count = octets[position + 1]
        position += 2
        if not count:
            raise ValueError("empty container")
        if kind == SUMMARIES or kind == REQ_UPDATES:
            stop = position + 2 * count
            if stop > end:
                raise ValueError("records cut off")
            records = list(PAIR.iter_unpack(octets[position:stop]))
            position = stop
        elif kind == UPDATES:
            records = []
            for _ in range(count):
                if position + 3 > end:
                    raise ValueError("update cut off")
                var_id, seqno, size = UPDATE.unpack_from(octets, position)
                position += 3
                stop = position + size
                if stop > end:
                    raise ValueError("value cut off")
                records.append((var_id, seqno, octets[position:stop]))
                position = stop
        elif kind == REQ_CREATES or kind == DELETES:
            stop = position + count
            if stop > end:
                raise ValueError("records cut off")
            records = [(var_id,) for var_id in octets[position:stop]]
            position = stop
        elif kind == CREATES:
            records = []
            for _ in range(count):
                if since_2_0:
                    if position + 19 > end:
                        raise ValueError("specification cut off")
                    var_id, producer, repetitions, created = SPEC_20_START.unpack_from(octets, position)
                    timeout, size = SPEC_20_END.unpack_from(octets, position + 16)
                    position += 19
                else:
                    if position + 9 > end:
                        raise ValueError("specification cut off")
                    var_id, producer, repetitions, size = SPEC_13.unpack_from(octets, position)
                    created = timeout = None
                    position += 9
                stop = position + size
                if stop + 3 > end:
                    raise ValueError("description cut off")
                descr = octets[position:stop]
                upd_id, seqno, size = UPDATE.unpack_from(octets, stop)
                position = stop + 3
                stop = position + size
                if stop > end:
                    raise ValueError("value cut off")
                records.append(
                    (
                        (var_id, producer, repetitions, descr, created, timeout),
                        (upd_id, seqno, octets[position:stop]),
                    )
                )
                position = stop
        else:
            raise ValueError("unknown container")
        containers.append((kind, records))
    return containers


def encode_tuples(beacon, layout):
    """Encode what ``decode_tuples`` returns."""
    sender, seqno, network, payloads = beacon
    parts = []
    try:
        for protocol, content in payloads:
            if protocol == VARDIS:
                octets = _encode_containers_tuples(content, layout.since_2_0)
            elif protocol == SRP:
                x, y, z, node, stamp, number, r24, r38, r40, r60 = content
                if len(node) != 6:
                    raise ValueError("node identifier of another size")
                if len(r24) != 8 or len(r38) != 2 or len(r40) != 8 or len(r60) != 4:
                    raise ValueError("opaque region of another size")
                octets = REPORT.pack(x, y, z, r24, node, r38, r40, stamp, number, r60)
            else:
                octets = content
            parts.append(BLOCK.pack(protocol, len(octets)))
            parts.append(octets)
        body = b"".join(parts)
        if len(sender) != 6:
            raise ValueError("sender of another size")
        if not payloads:
            raise ValueError("no payloads")
        if layout.since_2_0:
            return HEADER_20.pack(VERSION, MAGIC, sender, network, len(body), len(payloads), seqno) + body
        return HEADER_13.pack(VERSION, MAGIC, sender, len(body), len(payloads), seqno) + body
    except (error, TypeError) as reason:
        raise ValueError(str(reason)) from None


def _encode_containers_tuples(containers, since_2_0):
    parts = []
    for kind, records in containers:
        if not records:
            raise ValueError("empty container")
        parts.append(PAIR.pack(kind, len(records)))
        if kind == SUMMARIES or kind == REQ_UPDATES:
            for var_id, seqno in records:
                parts.append(PAIR.pack(var_id, seqno))
        elif kind == UPDATES:
            for var_id, seqno, value in records:
                parts.append(UPDATE.pack(var_id, seqno, len(value)))
                parts.append(value)
        elif kind == REQ_CREATES or kind == DELETES:
            parts.append(bytes([var_id for (var_id,) in records]))
        elif kind == CREATES:
            for (var_id, producer, repetitions, descr, created, timeout), (upd_id, seqno, value) in records:
                if len(producer) != 6:
                    raise ValueError("producer of another size")
                if since_2_0:
                    parts.append(SPEC_20_START.pack(var_id, producer, repetitions, created))
                    parts.append(SPEC_20_END.pack(timeout, len(descr)))
                else:
                    parts.append(SPEC_13.pack(var_id, producer, repetitions, len(descr)))
                parts.append(descr)
                parts.append(UPDATE.pack(upd_id, seqno, len(value)))
                parts.append(value)
        else:
            raise ValueError("unknown container")
    return b"".join(parts)


# -- the value classes of dcp_codec -----------------------------------------------------------------------------


def decode_values(octets, layout):
    """As ``decode_tuples`` with value classes."""
    if layout.since_2_0:
        if len(octets) < 18:
            raise ValueError("header cut off")
        version, magic, sender, network, length, count, seqno = HEADER_20.unpack_from(octets)
        position = 18
    else:
        if len(octets) < 16:
            raise ValueError("header cut off")
        version, magic, sender, length, count, seqno = HEADER_13.unpack_from(octets)
        network = None
        position = 16
    if version != VERSION or magic != MAGIC:
        raise ValueError("not a beacon")
    if not length or not count:
        raise ValueError("empty beacon")
    end = position + length
    if end > len(octets):
        raise ValueError("beacon longer than the frame")
    payloads = []
    while position < end:
        if position + 4 > end:
            raise ValueError("payload header cut off")
        protocol, size = BLOCK.unpack_from(octets, position)
        position += 4
        stop = position + size
        if stop > end:
            raise ValueError("payload longer than the beacon")
        if protocol == VARDIS:
            payloads.append(Payload(protocol, _containers_values(octets, position, stop, layout.since_2_0)))
        elif protocol == SRP:
            if size != 64:
                raise ValueError("state report of another size")
            x, y, z, r24, node, r38, r40, stamp, number, r60 = REPORT.unpack_from(octets, position)
            report = ExtendedSafetyData(layout.safety_data(x, y, z), node, stamp, number, (r24, r38, r40, r60))
            payloads.append(Payload(protocol, report))
        else:
            payloads.append(Payload(protocol, octets[position:stop]))
        position = stop
    if count != len(payloads):
        raise ValueError("wrong number of payloads")
    return Beacon(BPHeader(sender, seqno, network), tuple(payloads))


def _containers_values(octets, position, end, since_2_0):
    containers = []
    while position < end:
        if position + 2 > end:
            raise ValueError("container header cut off")
        kind = octets[position]
        count = octets[position + 1]
        position += 2
        if not count:
            raise ValueError("empty container")
        if kind == SUMMARIES or kind == REQ_UPDATES:
            stop = position + 2 * count
            if stop > end:
                raise ValueError("records cut off")
            cls = VarSumm if kind == SUMMARIES else VarReqUpdate
            records = tuple([cls(var_id, seqno) for var_id, seqno in PAIR.iter_unpack(octets[position:stop])])
            position = stop
        elif kind == UPDATES:
            updates = []
            for _ in range(count):
                if position + 3 > end:
                    raise ValueError("update cut off")
                var_id, seqno, size = UPDATE.unpack_from(octets, position)
                position += 3
                stop = position + size
                if stop > end:
                    raise ValueError("value cut off")
                updates.append(VarUpdate(var_id, seqno, octets[position:stop]))
                position = stop
            records = tuple(updates)
        elif kind == REQ_CREATES or kind == DELETES:
            stop = position + count
            if stop > end:
                raise ValueError("records cut off")
            one = VarReqCreate if kind == REQ_CREATES else VarDelete
            records = tuple([one(var_id) for var_id in octets[position:stop]])
            position = stop
        elif kind == CREATES:
            creates = []
            for _ in range(count):
                if since_2_0:
                    if position + 19 > end:
                        raise ValueError("specification cut off")
                    var_id, producer, repetitions, created = SPEC_20_START.unpack_from(octets, position)
                    timeout, size = SPEC_20_END.unpack_from(octets, position + 16)
                    position += 19
                else:
                    if position + 9 > end:
                        raise ValueError("specification cut off")
                    var_id, producer, repetitions, size = SPEC_13.unpack_from(octets, position)
                    created = timeout = None
                    position += 9
                stop = position + size
                if stop + 3 > end:
                    raise ValueError("description cut off")
                spec = VarSpec(var_id, producer, repetitions, octets[position:stop], created, timeout)
                upd_id, seqno, size = UPDATE.unpack_from(octets, stop)
                position = stop + 3
                stop = position + size
                if stop > end:
                    raise ValueError("value cut off")
                creates.append(VarCreate(spec, VarUpdate(upd_id, seqno, octets[position:stop])))
                position = stop
            records = tuple(creates)
        else:
            raise ValueError("unknown container")
        containers.append(Container(kind, records))
    return tuple(containers)


def encode_values(beacon, layout):
    """As ``encode_tuples`` for value classes."""
    parts = []
    try:
        for payload in beacon.payloads:
            protocol = payload.protocol_id
            if protocol == VARDIS:
                octets = _encode_containers_values(payload.content, layout.since_2_0)
            elif protocol == SRP:
                report = payload.content
                data = report.s_data
                if len(report.node_id) != 6:
                    raise ValueError("node identifier of another size")
                r24, r38, r40, r60 = report.extra or (bytes(8), bytes(2), bytes(8), bytes(4))
                if len(r24) != 8 or len(r38) != 2 or len(r40) != 8 or len(r60) != 4:
                    raise ValueError("opaque region of another size")
                octets = REPORT.pack(
                    data.x, data.y, data.z, r24, report.node_id, r38, r40, report.t_stamp, report.seqno, r60
                )
            else:
                octets = payload.content
            parts.append(BLOCK.pack(protocol, len(octets)))
            parts.append(octets)
        body = b"".join(parts)
        header = beacon.bp
        count = len(beacon.payloads)
        if len(header.sender_id) != 6:
            raise ValueError("sender of another size")
        if not count:
            raise ValueError("no payloads")
        if layout.since_2_0:
            head = HEADER_20.pack(VERSION, MAGIC, header.sender_id, header.network_id, len(body), count, header.seqno)
        else:
            head = HEADER_13.pack(VERSION, MAGIC, header.sender_id, len(body), count, header.seqno)
        return head + body
    except (error, TypeError, AttributeError) as reason:
        raise ValueError(str(reason)) from None


def _encode_containers_values(containers, since_2_0):
    parts = []
    for container in containers:
        kind = container.ic_type
        records = container.records
        if not records:
            raise ValueError("empty container")
        parts.append(PAIR.pack(kind, len(records)))
        if kind == SUMMARIES or kind == REQ_UPDATES:
            for record in records:
                parts.append(PAIR.pack(record.var_id, record.seqno))
        elif kind == UPDATES:
            for record in records:
                value = record.value
                parts.append(UPDATE.pack(record.var_id, record.seqno, len(value)))
                parts.append(value)
        elif kind == REQ_CREATES or kind == DELETES:
            parts.append(bytes([record.var_id for record in records]))
        elif kind == CREATES:
            for record in records:
                spec = record.spec
                if len(spec.prod_id) != 6:
                    raise ValueError("producer of another size")
                if since_2_0:
                    parts.append(SPEC_20_START.pack(spec.var_id, spec.prod_id, spec.rep_cnt, spec.creation_time))
                    parts.append(SPEC_20_END.pack(spec.timeout, len(spec.descr)))
                else:
                    parts.append(SPEC_13.pack(spec.var_id, spec.prod_id, spec.rep_cnt, len(spec.descr)))
                parts.append(spec.descr)
                upd = record.upd
                parts.append(UPDATE.pack(upd.var_id, upd.seqno, len(upd.value)))
                parts.append(upd.value)
        else:
            raise ValueError("unknown container")
    return b"".join(parts)
