"""C program that decodes and encodes frames from a pipe with the generated codec, one for each profile.

It reads frames (length of 4 octets, little-endian, and octets) and writes one :data:`RESULT` for each. The values are
reduced to a CRC of a plain form (:mod:`tests.ccodec.values` makes the same form in Python). Every valid frame is
encoded again from its values, into a buffer of exactly its size and into one that lacks an octet.
"""

from __future__ import annotations

import struct

from dcp_codec import Codec
from dcp_codec.export.c.names import member_name, stem
from dcp_codec.export.shape import Record, Shape, shape_of
from dcp_codec.plan.tree import Scalar, Text

#: reason, faults of encoding, CRC of the values, offset, needed, available, requirement, field
RESULT = struct.Struct("<BBxxIQQQ16s48s")


def harness(codec: Codec) -> str:
    """Return the source of the program."""
    shape = shape_of(codec)
    records = [record for record in (shape.header, shape.payload, shape.srp, shape.container) if record is not None]
    records += shape.all_records()
    return "\n".join([_START, *(_dump(record) for record in records), _walk(shape), _rewrite(shape), _END])


def _dump(record: Record) -> str:
    lines = [f"static void dump_{stem(record.group)}(const dcp_{stem(record.group)}_t *v)", "{", "    (void)v;"]
    for part in record.parts():
        value = "v->" + ".".join(member_name(name) for name in part.path)
        if isinstance(part.node, Text):
            lines.append(f"    dump_octets({value}.data, {value}.size);")
        elif isinstance(part.node, Scalar) and part.node.stored:
            if part.node.kind == "bytes":
                lines.append(f"    dump_octets({value}, {part.node.size}u);")
            elif part.node.kind == "float":
                lines.append(f"    dump_real((double){value});")
            else:
                lines.append(f"    dump_number((uint64_t){value});")
    return "\n".join([*lines, "}", ""])


def _walk(shape: Shape) -> str:
    """Return the function that dumps a valid beacon through the iterators."""
    lines = ["static void walk(const uint8_t *octets, size_t size)", "{", "    dcp_beacon_t beacon;"]
    lines += ["    dcp_payload_t payload;", "    dcp_container_t container;", "    dcp_problem_t problem;"]
    lines += ["    need(dcp_read_beacon(octets, size, &beacon, &problem));"]
    if shape.header is not None:
        lines.append(f"    dump_{stem(shape.header.group)}(&beacon.bp);")
    lines.append("    while (dcp_next_payload(&beacon.payloads, &payload, &problem)) {")
    lines.append("        dump_payload(&payload);")
    if shape.fill is not None:
        lines.append("        dump_octets(payload.area.data, payload.area.size);")
    lines.append(f"        if (payload.protocol_id == {shape.protocols[shape.vardis.name]}u) {{")
    lines += ["            dcp_list_t list = dcp_containers(payload.content.data, payload.content.size);"]
    lines += ["            while (dcp_next_container(&list, &container, &problem)) {"]
    lines += ["                dump_container(&container);", "                switch (container.ic_type) {"]
    for number, record in shape.records.items():
        name = stem(record.group)
        lines += [f"                case {number}u: {{", f"                    dcp_{name}_t record;"]
        lines += [f"                    while (dcp_next_{name}(&container.records, &record))"]
        lines += [f"                        dump_{name}(&record);", "                    break;", "                }"]
    lines += ["                }", "                need(container.records.taken == container.ic_num_records);"]
    lines += ["            }", "            need(problem.reason == DCP_OK);"]
    if shape.srp is not None:
        name = stem(shape.srp.group)
        lines += ["        } else if (payload.protocol_id == DCP_PROTOCOL_SRP) {", f"            dcp_{name}_t report;"]
        lines += [f"            need(dcp_read_{name}(payload.content.data, payload.content.size, &report, &problem));"]
        lines += [f"            dump_{name}(&report);"]
    lines += ["        } else {", "            dump_octets(payload.content.data, payload.content.size);", "        }"]
    lines += ["    }", "    need(problem.reason == DCP_OK);", "}", ""]
    return "\n".join(lines)


def _rewrite(shape: Shape) -> str:
    """Return the function that decodes a valid beacon and encodes it again."""
    lines = [
        "static bool rewrite(const uint8_t *octets, size_t size, dcp_writer_t *w)",
        "{",
        "    dcp_beacon_t beacon;",
    ]
    lines += ["    dcp_payload_t payload;", "    dcp_container_t container;", "    dcp_problem_t problem;"]
    lines += ["    (void)dcp_read_beacon(octets, size, &beacon, &problem);"]
    header = ", &beacon.bp" if shape.header is not None else ""
    lines += [f"    if (!dcp_begin_beacon(w{header}))", "        return false;"]
    lines += ["    while (dcp_next_payload(&beacon.payloads, &payload, &problem)) {"]
    lines += ["        if (!dcp_begin_payload(w, &payload))", "            return false;"]
    lines.append(f"        if (payload.protocol_id == {shape.protocols[shape.vardis.name]}u) {{")
    lines += ["            dcp_list_t list = dcp_containers(payload.content.data, payload.content.size);"]
    lines += ["            while (dcp_next_container(&list, &container, &problem)) {"]
    lines += ["                if (!dcp_begin_container(w, &container))", "                    return false;"]
    lines += ["                switch (container.ic_type) {"]
    for number, record in shape.records.items():
        name = stem(record.group)
        lines += [f"                case {number}u: {{", f"                    dcp_{name}_t record;"]
        lines += [f"                    while (dcp_next_{name}(&container.records, &record))"]
        lines += [
            f"                        if (!dcp_add_{name}(w, &record))",
            "                            return false;",
        ]
        lines += ["                    break;", "                }"]
    lines += ["                }", "                if (!dcp_end_container(w))", "                    return false;"]
    lines += ["            }"]
    if shape.srp is not None:
        name = stem(shape.srp.group)
        lines += ["        } else if (payload.protocol_id == DCP_PROTOCOL_SRP) {", f"            dcp_{name}_t report;"]
        lines += [f"            if (!dcp_read_{name}(payload.content.data, payload.content.size, &report, &problem)"]
        lines += [f"                || !dcp_add_{name}(w, &report))", "                return false;"]
    lines += ["        } else if (!dcp_add_octets(w, payload.content.data, payload.content.size)) {"]
    lines += ["            return false;", "        }"]
    lines += ["        if (!dcp_end_payload(w, &payload))", "            return false;", "    }"]
    lines += ["    return dcp_end_beacon(w);", "}", ""]
    return "\n".join(lines)


_START = """#include "dcp_codec.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint32_t table[256];
static uint32_t crc;

static void need(bool condition)
{
    if (!condition)
        abort();
}

static void dump(const uint8_t *data, size_t size)
{
    size_t i;
    for (i = 0; i < size; i++)
        crc = table[(crc ^ data[i]) & 255u] ^ crc >> 8;
}

static void dump_number(uint64_t number)
{
    uint8_t octets[8];
    unsigned i;
    for (i = 0; i < 8u; i++)
        octets[i] = (uint8_t)(number >> 8u * i);
    dump(octets, sizeof octets);
}

static void dump_octets(const uint8_t *data, size_t size)
{
    dump_number(size);
    dump(data, size);
}

/* All NaNs are one: Python need not keep their octets. */
static void dump_real(double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    dump_number(number != number ? UINT64_MAX : bits);
}
"""
_END = """static void number(uint8_t *to, uint64_t value, unsigned size)
{
    unsigned i;
    for (i = 0; i < size; i++)
        to[i] = (uint8_t)(value >> 8u * i);
}

static unsigned encode(const uint8_t *octets, size_t size, size_t used)
{
    unsigned faults = 0;
    size_t lacks;
    for (lacks = 0; lacks < 2; lacks++) {
        dcp_writer_t w;
        uint8_t *buffer = malloc(used - lacks + 1u);
        uint8_t *exact = realloc(buffer, used - lacks != 0 ? used - lacks : 1u);
        bool good;
        need(exact != NULL);
        dcp_write_to(&w, exact, used - lacks);
        good = rewrite(octets, size, &w);
        if (lacks == 0 && (!good || w.at != used || memcmp(exact, octets, used) != 0))
            faults |= 1u;
        if (lacks == 1 && (good || w.fault != DCP_FAULT_NO_ROOM))
            faults |= 2u;
        free(exact);
    }
    return faults;
}

int main(void)
{
    uint8_t head[4];
    uint32_t i, k;
    for (i = 0; i < 256u; i++) {
        table[i] = i;
        for (k = 0; k < 8u; k++)
            table[i] = table[i] & 1u ? 0xEDB88320u ^ table[i] >> 1 : table[i] >> 1;
    }
    while (fread(head, 1, sizeof head, stdin) == sizeof head) {
        const size_t size = (size_t)head[0] | (size_t)head[1] << 8 | (size_t)head[2] << 16 | (size_t)head[3] << 24;
        uint8_t *octets = malloc(size != 0 ? size : 1u);
        uint8_t out[96];
        dcp_problem_t problem;
        unsigned faults = 0;
        need(octets != NULL && fread(octets, 1, size, stdin) == size);
        crc = 0xFFFFFFFFu;
        if (dcp_check_beacon(octets, size, &problem)) {
            walk(octets, size);
            faults = encode(octets, size, problem.offset);
        }
        memset(out, 0, sizeof out);
        out[0] = (uint8_t)problem.reason;
        out[1] = (uint8_t)faults;
        number(out + 4, crc ^ 0xFFFFFFFFu, 4);
        number(out + 8, problem.offset, 8);
        if (problem.reason != DCP_OK) {
            number(out + 16, problem.needed, 8);
            number(out + 24, problem.available, 8);
            strncpy((char *)out + 32, dcp_requirement_name(problem.requirement), 16);
            strncpy((char *)out + 48, problem.field, 48);
        }
        need(fwrite(out, 1, sizeof out, stdout) == sizeof out);
        free(octets);
    }
    return 0;
}
"""
