"""The functions of the generated C that write."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dcp_codec.export.shape import Record, Run
from dcp_codec.plan.measures import largest, longest
from dcp_codec.plan.tree import Scalar

from .names import access, stem
from .scalars import Functions, pointer, raw_type


class Writing(Functions):
    """Makes the writing functions of a shape."""

    def all(self) -> str:
        """Return all writing functions."""
        shape = self.shape
        if shape.header is not None:
            self.record(shape.header, {"numPayloads": "num_payloads", "length": "beacon_length"})
        self.record(shape.payload, {shape.content.length: "payload_length"})
        if shape.srp is not None:
            self.record(shape.srp)
        listed = {shape.list_region.length: "list_length"} if shape.list_region is not None else {}
        self.record(shape.container, {"icNumRecords": "num_records", **listed})
        self._beacon()
        self._payload()
        self._contents()
        self._container()
        return "\n".join(self.lines)

    # -- records ----------------------------------------------------------------------------------------------

    def record(self, record: Record, marks: Mapping[str, str] = MappingProxyType({})) -> None:
        """Emit the function that writes a record. ``marks``: derived fields -> the writer's member with the place."""
        name, runs = stem(record.group), list(record.runs())
        texts = [run.text for run in runs if run.text is not None]
        self.add(
            f"static inline bool dcp_write_{name}(dcp_writer_t *w, const dcp_{name}_t *v)",
            "{",
            "    uint8_t *p = w->octets + w->at;",
            "    size_t left = w->size - w->at;",
        )
        if any(text.node.terminated for text in texts):
            self.add("    size_t i;")
        for part in record.parts():
            node = part.node
            if (
                isinstance(node, Scalar)
                and node.stored
                and (wrong := self.scalars.range_check(node, access(part.path)))
            ):
                self.add(f"    if ({wrong})", "        return dcp_refuse(w, DCP_FAULT_OUT_OF_RANGE);")
        for text in texts:
            value, most = access(text.path), longest(text.node)
            if most is not None:
                self.add(*_at_most(f"{value}.size", most - text.node.terminated, "dcp_refuse(w, DCP_FAULT_TOO_LONG)"))
            if text.node.terminated:
                self.add(
                    f"    for (i = 0; i < {value}.size; i++)",
                    f"        if ({value}.data[i] == 0u)",
                    "            return dcp_refuse(w, DCP_FAULT_NUL);",
                )
        needed = f"{sum(run.size for run in runs) + sum(text.node.terminated for text in texts)}u"
        self.add(f"    if (left < {needed})", "        return dcp_refuse(w, DCP_FAULT_NO_ROOM);")
        for text in texts:
            before, needed = needed, f"{access(text.path)}.size"
            self.add(f"    left -= {before};", f"    if (left < {needed})")
            self.add("        return dcp_refuse(w, DCP_FAULT_NO_ROOM);")
        for run in runs:
            self._run(run, marks)
        self.add("    w->at = (size_t)(p - w->octets);", "    return true;", "}", "")

    def _run(self, run: Run, marks: Mapping[str, str]) -> None:
        """Emit the writing of scalars, and of the text after them."""
        place = 0
        for part in run.scalars:
            node = part.node
            if node.kind == "bytes":
                self.add(f"    dcp_copy({pointer(place)}, {access(part.path)}, {node.size}u);")
            elif run.text is not None and part.path[:-1] == run.text.path:
                plus = " + 1u" if run.text.node.terminated else ""
                size = f"({raw_type(node.size)})({access(run.text.path)}.size{plus})"
                self.add(f"    {self.scalars.write(node, size, place)}")
            elif node.derived is not None:
                offset = f" + {place}" if place else ""
                self.add(f"    w->{marks[part.path[-1]]} = (size_t)(p{offset} - w->octets);")
                self.add(f"    {self.scalars.write(node, '0', place)}")
            else:
                value = access(part.path)
                if node.rule is not None and node.rule.value is not None:
                    value = f"0x{node.rule.value:x}u"
                elif node.signed:
                    value = f"({raw_type(node.size)}){value}"
                self.add(f"    {self.scalars.write(node, value, place)}")
            place += node.size
        if place:
            self.add(f"    p += {place};")
        if run.text is not None:
            value = access(run.text.path)
            self.add(f"    dcp_copy(p, {value}.data, {value}.size);", f"    p += {value}.size;")
            if run.text.node.terminated:
                self.add("    *p++ = 0;")

    # -- beacons and payloads -------------------------------------------------------------------------------------

    def _set(self, record: Record, name: str, place: str, number: str) -> None:
        """Emit the setting of a derived field, unless the layout has none."""
        if (node := self.shape.derived(record, name)) is not None:
            self.add(f"    {self.scalars.store(node)}(w->octets + w->{place}, ({raw_type(node.size)})({number}));")

    def _limit(self, record: Record, name: str, number: str, fault: str) -> None:
        """Emit the check that a number can be expressed by a derived field."""
        if (node := self.shape.derived(record, name)) is None:
            return
        if node.rule is not None and name != "numPayloads" and name != "icNumRecords":
            self.add(f"    if ({number} == 0u)", "        return dcp_refuse(w, DCP_FAULT_EMPTY);")
        self.add(*_at_most(number, largest(node), f"dcp_refuse(w, {fault})"))

    def _beacon(self) -> None:
        shape = self.shape
        header = "" if shape.header is None else f", const dcp_{stem(shape.header.group)}_t *bp"
        self.add(
            f"bool dcp_begin_beacon(dcp_writer_t *w{header})",
            "{",
            "    const size_t at = w->at;",
            "    if (w->beacon != DCP_NOWHERE)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
        )
        if shape.header is not None:
            self.add(f"    if (!dcp_write_{stem(shape.header.group)}(w, bp))", "        return false;")
        self.add(
            "    w->beacon = at;",
            "    w->payloads = w->at;",
            "    w->payloads_written = 0;",
            "    return true;",
            "}",
            "",
        )
        self.add(
            "bool dcp_end_beacon(dcp_writer_t *w)",
            "{",
            "    if (w->beacon == DCP_NOWHERE || w->payload != DCP_NOWHERE)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
        )
        if shape.header is not None or shape.payloads.nonempty:
            self.add("    if (w->payloads_written == 0u)", "        return dcp_refuse(w, DCP_FAULT_EMPTY);")
        if shape.header is not None:
            self._limit(shape.header, "numPayloads", "w->payloads_written", "DCP_FAULT_TOO_MANY")
            self._limit(shape.header, "length", "w->at - w->payloads", "DCP_FAULT_TOO_LONG")
            self._set(shape.header, "numPayloads", "num_payloads", "w->payloads_written")
            self._set(shape.header, "length", "beacon_length", "w->at - w->payloads")
        self.add("    w->beacon = DCP_NOWHERE;", "    return true;", "}", "")

    def _payload(self) -> None:
        shape, fill = self.shape, self.shape.fill
        self.add(
            "bool dcp_begin_payload(dcp_writer_t *w, const dcp_payload_t *payload)",
            "{",
            "    const size_t at = w->at;",
            "    if (w->beacon == DCP_NOWHERE || w->payload != DCP_NOWHERE)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
            "    if (!dcp_write_payload(w, payload))",
            "        return false;",
            "    w->payload = at;",
            "    w->content = w->at;",
            "    return true;",
            "}",
            "",
            "bool dcp_end_payload(dcp_writer_t *w, const dcp_payload_t *payload)",
            "{",
            "    const size_t size = w->at - w->content;",
            "    if (w->payload == DCP_NOWHERE || w->container != DCP_NOWHERE)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
        )
        self._limit(shape.payload, shape.content.length, "size", "DCP_FAULT_TOO_LONG")
        if fill is not None:
            self.add(
                f"    if (size > {fill.total}u",
                f"        || (payload->area.size != 0u && payload->area.size != {fill.total}u - size))",
                "        return dcp_refuse(w, DCP_FAULT_TOO_LONG);",
                f"    if (w->size - w->at < {fill.total}u - size)",
                "        return dcp_refuse(w, DCP_FAULT_NO_ROOM);",
                "    dcp_copy(w->octets + w->at, payload->area.size != 0u ? payload->area.data : NULL,",
                f"         {fill.total}u - size);",
                f"    w->at += {fill.total}u - size;",
            )
        else:
            self.add("    (void)payload;")
        self._set(shape.payload, shape.content.length, "payload_length", "size")
        self.add("    w->payload = DCP_NOWHERE;", "    w->payloads_written += 1u;", "    return true;", "}", "")

    def _contents(self) -> None:
        self.add(
            "bool dcp_add_octets(dcp_writer_t *w, const uint8_t *octets, size_t size)",
            "{",
            "    dcp_octets_t all;",
            "    all.data = octets;",
            "    all.size = size;",
            "    return put_octets(w, all);",
            "}",
            "",
        )
        if self.shape.srp is not None:
            name = stem(self.shape.srp.group)
            self.add(
                f"bool dcp_add_{name}(dcp_writer_t *w, const dcp_{name}_t *report)",
                "{",
                f"    return dcp_write_{name}(w, report);",
                "}",
                "",
            )

    def _container(self) -> None:
        shape = self.shape
        self.add(
            "bool dcp_begin_container(dcp_writer_t *w, const dcp_container_t *container)",
            "{",
            "    const size_t at = w->at;",
            "    if (w->container != DCP_NOWHERE)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
            "    switch (container->ic_type) {",
            *(f"    case {number}u:" for number in shape.records),
            "        break;",
            "    default:",
            "        return dcp_refuse(w, DCP_FAULT_UNKNOWN_TYPE);",
            "    }",
            "    if (!dcp_write_container(w, container))",
            "        return false;",
            "    w->container = at;",
            "    w->records = w->at;",
            "    w->records_written = 0;",
            "    w->ic_type = container->ic_type;",
            "    return true;",
            "}",
            "",
            "/* End the container; one without records is removed. */",
            "bool dcp_end_container(dcp_writer_t *w)",
            "{",
            "    const size_t container = w->container;",
            "    if (container == DCP_NOWHERE)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
            "    w->container = DCP_NOWHERE;",
            "    if (w->records_written == 0u) {",
            "        w->at = container;",
            "        return dcp_refuse(w, DCP_FAULT_EMPTY);",
            "    }",
        )
        if shape.list_region is not None:
            self._limit(shape.container, shape.list_region.length, "w->at - w->records", "DCP_FAULT_TOO_LONG")
            self._set(shape.container, shape.list_region.length, "list_length", "w->at - w->records")
        self._set(shape.container, "icNumRecords", "num_records", "w->records_written")
        self.add("    return true;", "}", "")

    def inline(self) -> str:
        """Return the functions that add records to containers, which are in the header."""
        shape, self.lines = self.shape, []
        kept, self.scalars = self.scalars, self.shared
        for record in shape.all_records():
            self.record(record)
        self.add(
            "/* Take note of a record that was put into the open container of its type. */",
            "static inline bool dcp_fits(dcp_writer_t *w, uint64_t ic_type)",
            "{",
            "    if (w->container == DCP_NOWHERE || w->ic_type != ic_type)",
            "        return dcp_refuse(w, DCP_FAULT_ORDER);",
            f"    if (w->records_written == {shape.most_records}u)",
            "        return dcp_refuse(w, DCP_FAULT_TOO_MANY);",
            "    return true;",
            "}",
            "",
        )
        for number, record in sorted(shape.records.items()):
            name = stem(record.group)
            self.add(
                f"/* Add a {record.group.type_name}. False: it does not fit; the container can be ended without it. */",
                f"static inline bool dcp_add_{name}(dcp_writer_t *w, const dcp_{name}_t *record)",
                "{",
                f"    if (!dcp_fits(w, {number}u) || !dcp_write_{name}(w, record))",
                "        return false;",
                "    w->records_written += 1u;",
                "    return true;",
                "}",
                "",
            )
        self.scalars = kept
        return "\n".join(self.lines)


def _at_most(number: str, most: int, otherwise: str) -> list[str]:
    """Return the check that a size or count is at most ``most``, without a warning where it always is."""
    check = [f"    if ({number} > {most}u)", f"        return {otherwise};"]
    if most < 0xFFFF_FFFF:
        return check
    if most >= 1 << 64:
        return []
    check[0] = f"    if ({number} > UINT64_C({most}))"
    return [f"#if SIZE_MAX > {most}u", *check, "#endif"] if most < (1 << 64) - 1 else []
