"""The functions of the generated C that read."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dcp_codec.export.shape import Part, Record, Run
from dcp_codec.export.wording import constant
from dcp_codec.plan.tree import Region, Scalar, Text

from .names import access, cite, comment, stem
from .scalars import Functions


def reason(name: str) -> str:
    """Return the enumerator of a reason."""
    return f"DCP_{constant(name)}"


def needs(identifier: str | None) -> str:
    """Return the enumerator of a requirement."""
    return f"DCP_{constant(identifier)}" if identifier else "DCP_REQUIREMENT_NONE"


class Reading(Functions):
    """Makes the reading functions of a shape."""

    # -- records ----------------------------------------------------------------------------------------------

    def record(self, record: Record, marks: Mapping[str, str] = MappingProxyType({})) -> None:
        """Emit the function that reads a record. ``marks``: fields whose place is kept -> the variable for it."""
        name = stem(record.group)
        runs = list(record.runs())
        for number, run in enumerate(runs, start=1):
            self._table(f"{name}_{number}", record, run)
        self.add(*comment(f"{record.group.type_name}: {cite(record.group.requirement)}"))
        places = "".join(f", size_t *{variable}" for variable in marks.values())
        self.add(f"static inline bool read_{name}(reader_t *r, dcp_{name}_t *v{places})", "{")
        if any(run.scalars for run in runs):
            self.add("    const uint8_t *p;")
        lengths = {
            f"n{number}_{index}": prefix
            for number, run in enumerate(runs, start=1)
            if run.text is not None
            for index, prefix in enumerate(run.text.node.prefixes, start=1)
        }
        for variable, prefix in lengths.items():
            self.add(f"    {'uint64_t' if prefix.size > 4 else 'uint32_t'} {variable};")
        if any(run.text is not None and run.text.node.terminated for run in runs):
            self.add("    size_t stop;")
        for number, run in enumerate(runs, start=1):
            self._run(record, run, number, marks)
        self.add("    return true;", "}", "")

    def quick(self, record: Record) -> None:
        """Emit the function that reads a record of a container without a report of what is wrong."""
        name = stem(record.group)
        self.add(
            f"static inline const uint8_t *dcp_get_{name}(const uint8_t *p, const uint8_t *end, dcp_{name}_t *v)",
            "{",
        )
        for number, run in enumerate(record.runs(), start=1):
            if run.text is not None:
                for index, prefix in enumerate(run.text.node.prefixes, start=1):
                    self.add(f"    {'uint64_t' if prefix.size > 4 else 'uint32_t'} n{number}_{index};")
                if run.text.node.terminated:
                    self.add(f"    size_t stop{number};")
        for number, run in enumerate(record.runs(), start=1):
            self._quick_run(run, number)
        self.add("    return p;", "}", "")

    def _quick_run(self, run: Run, number: int) -> None:
        lengths: list[str] = []
        if run.size:
            self.add(f"    if ((size_t)(end - p) < {run.size}u)", "        return NULL;")
        place = 0
        for part in run.scalars:
            node = part.node
            assert node.rule is None
            target = access(part.path)
            if run.text is not None and part.path[:-1] == run.text.path:
                lengths.append(target := f"n{number}_{len(lengths) + 1}")
            self.add(f"    {target} = {self.shared.read(node, place)};")
            place += node.size
        if place:
            self.add(f"    p += {place};")
        if run.text is None:
            return
        text, stop = access(run.text.path), f"stop{number}"
        self.add(f"    {text}.data = p;")
        if not lengths:
            self.add(
                f"    for ({stop} = 0; {stop} < (size_t)(end - p) && p[{stop}] != 0u; {stop}++)",
                "        ;",
                f"    if ({stop} == (size_t)(end - p))",
                "        return NULL;",
                f"    {text}.size = {stop};",
                f"    p += {stop} + 1u;",
            )
            return
        wrong = [f"{other} != {lengths[0]}" for other in lengths[1:]] + [f"(size_t)(end - p) < {lengths[0]}"]
        self.add(f"    if ({' || '.join(wrong)})", "        return NULL;", f"    {text}.size = (size_t){lengths[0]};")
        if run.text.node.terminated:
            self.add(
                f"    for ({stop} = 0; {stop} < {text}.size && p[{stop}] != 0u; {stop}++)",
                "        ;",
                f"    if ({text}.size == 0u || {stop} != {text}.size - 1u)",
                "        return NULL;",
            )
        self.add(f"    p += {text}.size;")
        if run.text.node.terminated:
            self.add(f"    {text}.size -= 1u;")

    def _table(self, table: str, record: Record, run: Run) -> None:
        if not run.scalars:
            return
        self.add(f"static const field_t {table}[] = {{")
        for part in run.scalars:
            node = part.node
            rule, little = node.rule, "true" if node.order == "little" and node.size > 1 else "false"
            expected = "0" if rule is None or rule.value is None else f"0x{rule.value:x}"
            self.add(
                f'    {{"{self.path(record, part)}", {node.size}, {little}, {needs(node.requirement)}, '
                f"{reason(rule.reason) if rule else 'DCP_OK'}, {needs(rule.requirement if rule else None)}, "
                f"{expected}}},"
            )
        self.add("};")

    def fail_if(
        self, wrong: str, code: str, requirement: str | None, field: str, at: str, values: str, *, wrapped: bool = True
    ) -> None:
        """Emit a condition and the return of its problem. ``values``: what is needed, and what is available."""
        reader, space = "&r" if "r.at" in wrong else "r", f",\n{' ' * 20}" if wrapped else ", "
        self.add(f"    if ({wrong})")
        self.add(f'        return fail({reader}, {code}, {needs(requirement)}, "{field}", {at}{space}{values});')

    def fits(self, left: str, length: str, region: Region, at: str) -> None:
        """Emit the problem of a length at ``at`` that is greater than the number of octets that are left."""
        values = f"{length}, {left}"
        self.fail_if(f"{left} < {length}", reason(region.reason), region.requirement, region.length, at, values)

    @staticmethod
    def path(record: Record, part: Part[Scalar | Text]) -> str:
        return ".".join((*record.path, *part.path))

    def _run(self, record: Record, run: Run, number: int, marks: Mapping[str, str]) -> None:
        size, place, rules, offset = run.size, 0, [], ""
        lengths: list[tuple[str, int, Part[Scalar]]] = []
        if run.scalars:
            table = f"{stem(record.group)}_{number}"
            self.add(f"    if (r->end - r->at < {size}u)")
            self.add(f"        return cut_off(r, {table}, {len(run.scalars)}u);")
            self.add("    p = r->octets + r->at;")
        for part in run.scalars:
            node = part.node
            offset = f" + {place}u" if place else ""
            if part.path[-1] in marks and len(part.path) == 1:
                self.add(f"    *{marks[part.path[-1]]} = r->at{offset};")
            value = self.scalars.read(node, place)
            if run.text is not None and part.path[:-1] == run.text.path:
                variable = f"n{number}_{len(lengths) + 1}"
                lengths.append((variable, place, part))
                self.add(f"    {variable} = {value};")
                value = variable
            elif node.rule is None or node.rule.value is None:
                self.add(f"    {access(part.path)} = {value};")
                value = access(part.path)
            if node.rule is not None:
                wanted = node.rule.value
                wrong = f"{value} == 0u" if wanted is None else f"{value} != 0x{wanted:x}u"
                rules.append((wrong, node, part, offset, value))
            place += node.size
        for wrong, node, part, offset, value in rules:
            assert node.rule is not None
            expected = "1u" if node.rule.value is None else f"0x{node.rule.value:x}u"
            code, place_of = reason(node.rule.reason), self.path(record, part)
            self.fail_if(wrong, code, node.rule.requirement, place_of, f"r->at{offset}", f"{expected}, {value}")
        if run.text is None:
            if size:
                self.add(f"    r->at += {size}u;")
            return
        for variable, position, part in lengths[1:]:
            wrong, values = f"{variable} != {lengths[0][0]}", f"{lengths[0][0]}, {variable}"
            at = f"r->at + {position}u"
            self.fail_if(wrong, "DCP_LENGTH_MISMATCH", "DATA-06", self.path(record, part), at, values)
        if size:
            self.add(f"    r->at += {size}u;")
        self._text(record, run.text, [variable for variable, *_ in lengths])

    def _text(self, record: Record, part: Part[Text], lengths: list[str]) -> None:
        text, target = part.node, access(part.path)
        name = self.path(record, part)
        if not lengths:
            self.add("    for (stop = r->at; stop < r->end && r->octets[stop] != 0u; stop++)", "        ;")
            self.fail_if("stop == r->end", "DCP_TRUNCATED", text.requirement, name, "r->end", "1u, 0", wrapped=False)
            self.add(f"    {target}.data = r->octets + r->at;", f"    {target}.size = stop - r->at;")
            self.add("    r->at = stop + 1u;")
            return
        size, data, at = lengths[0], f"{name}.data", "r->at"
        wrong, values = f"r->end - r->at < {size}", f"{size}, r->end - r->at"
        self.fail_if(wrong, "DCP_TRUNCATED", text.requirement, data, at, values, wrapped=False)
        self.add(f"    {target}.data = r->octets + r->at;", f"    {target}.size = (size_t){size};")
        if text.terminated:
            self.add(f"    for (stop = 0; stop < {target}.size && {target}.data[stop] != 0u; stop++)", "        ;")
            wrong = f"{size} == 0u || stop != {target}.size - 1u"
            self.fail_if(wrong, "DCP_BAD_TERMINATOR", "DATA-07", data, at, "0, 0", wrapped=False)
        self.add(f"    r->at += {target}.size;")
        if text.terminated:
            self.add(f"    {target}.size -= 1u;")

    # -- lists ------------------------------------------------------------------------------------------------

    def all(self) -> str:
        """Return all reading functions."""
        shape = self.shape
        if shape.header is not None:
            self.record(shape.header, shape.header_marks)
        self.record(shape.payload, {shape.content.length: "length_at"})
        if shape.srp is not None:
            self.record(shape.srp)
        self.record(shape.container, shape.container_marks)
        for record in shape.all_records():
            self.record(record)
        self._beacon()
        self._payloads()
        self._report()
        self._containers()
        self._check()
        return "\n".join(self.lines)

    def _beacon(self) -> None:
        shape = self.shape
        listed = ["beacon->payloads.octets = octets;", "beacon->payloads.at = r.at;", "beacon->payloads.end = r.end;"]
        self.add(
            "bool dcp_read_beacon(const uint8_t *octets, size_t size, dcp_beacon_t *beacon, dcp_problem_t *problem)",
            "{",
        )
        self.add("    reader_t r;")
        if shape.header is not None:
            self.add(f"    size_t {', '.join(f'{place} = 0' for place in shape.header_marks.values())};")
        self.add("    begin(&r, octets, size, problem);")
        if shape.header is not None:
            places = ", ".join(f"&{place}" for place in shape.header_marks.values())
            self.add(f"    if (!read_{stem(shape.header.group)}(&r, &beacon->bp, {places}))", "        return false;")
        if shape.region is not None:
            self.fits("r.end - r.at", "beacon->bp.length", shape.region, "length_at")
            self.add("    r.end = r.at + (size_t)beacon->bp.length;")
        self.add(*(f"    {line}" for line in listed))
        self.add("    beacon->payloads.taken = 0;")
        if shape.header is not None:
            self.add(
                "    beacon->payloads.count = beacon->bp.num_payloads;", "    beacon->payloads.count_at = count_at;"
            )
        else:
            self.add("    beacon->payloads.count = 0;", "    beacon->payloads.count_at = 0;")
        self.add("    return true;", "}", "")

    def _payloads(self) -> None:
        """Emit the reading of a payload: its header and the place of its content, and what follows the content."""
        shape = self.shape
        many, content = shape.payloads, shape.content
        self.add("/* Begin the next payload; the reader is then at its content. False: there is none, or a problem. */")
        self.add(
            "static inline bool begin_payload(reader_t *r, const dcp_list_t *list, dcp_payload_t *payload,",
            "                                 size_t *length_at)",
            "{",
        )
        if many.count is not None:
            self.add("    if (list->taken == list->count)", "        return false;")
        elif many.nonempty:
            self.add("    if (r->at == r->end && list->taken != 0u)", "        return false;")
        else:
            self.add("    if (r->at == r->end) {")
            if many.agrees is not None:
                self.add(
                    "        if (list->taken != list->count)",
                    f'            return fail(r, {reason(many.reason)}, {needs(many.requirement)}, "{many.agrees}", '
                    "list->count_at,",
                    "                        list->count, list->taken);",
                )
            self.add("        return false;", "    }")
        self.add("    if (!read_payload(r, payload, length_at))", "        return false;")
        self.fits("r->end - r->at", "payload->length", content, "*length_at")
        self.add(
            "    payload->content.data = r->octets + r->at;",
            "    payload->content.size = (size_t)payload->length;",
            "    payload->content_at = r->at;",
            "    return true;",
            "}",
            "",
        )
        if shape.fill:
            fill, total = shape.fill, shape.fill.total
            self.add(
                "/* Read the unused rest of the area after a content. */",
                "static inline bool read_area(reader_t *r, dcp_payload_t *payload, size_t length_at)",
                "{",
            )
            wrong, values = f"payload->length > {total}u", f"payload->length, {total}u"
            self.fail_if(wrong, reason(fill.reason), fill.requirement, fill.used, "length_at", values)
            self.add("    payload->area.data = r->octets + r->at;")
            self.add(f"    payload->area.size = {total}u - payload->content.size;")
            wrong, values = "r->end - r->at < payload->area.size", "payload->area.size, r->end - r->at"
            self.fail_if(wrong, "DCP_TRUNCATED", fill.requirement, fill.name, "r->at", values)
            self.add("    r->at += payload->area.size;", "    return true;", "}", "")
        self.add(
            "bool dcp_next_payload(dcp_list_t *payloads, dcp_payload_t *payload, dcp_problem_t *problem)",
            "{",
            "    reader_t r;",
            "    size_t length_at = 0;",
            "    resume(&r, payloads, problem);",
            "    if (!begin_payload(&r, payloads, payload, &length_at))",
            "        return false;",
            "    r.at += payload->content.size;",
        )
        if shape.fill:
            self.add("    if (!read_area(&r, payload, length_at))", "        return false;")
        self.add("    payloads->at = r.at;", "    payloads->taken += 1u;", "    return true;", "}", "")

    def _report(self) -> None:
        shape = self.shape
        if shape.srp is None:
            return
        name = stem(shape.srp.group)
        exact, label = shape.srp_exact, ".".join(shape.srp.path)
        self.add(f"static inline bool read_report(reader_t *r, dcp_{name}_t *report)", "{")
        if exact is not None:
            wrong, values = f"r->end - r->at != {exact.size}u", f"{exact.size}u, r->end - r->at"
            self.fail_if(wrong, reason(exact.reason), exact.requirement, label, "r->at", values, wrapped=False)
        self.add(f"    return read_{name}(r, report);", "}", "")
        self.add(
            f"bool dcp_read_{name}(const uint8_t *octets, size_t size, dcp_{name}_t *report,",
            f"{' ' * (len(name) + 15)}dcp_problem_t *problem)",
            "{",
            "    reader_t r;",
            "    begin(&r, octets, size, problem);",
            "    if (!read_report(&r, report))",
            "        return false;",
        )
        if exact is None:
            self.add(
                "    if (r.at != r.end)",
                f'        return fail(&r, DCP_LEFTOVER, DCP_SRP_RX_01, "{label}", r.at, 0, r.end - r.at);',
            )
        self.add("    return true;", "}", "")

    def _containers(self) -> None:
        shape = self.shape
        for record in shape.all_records():
            name = stem(record.group)
            self.add(
                f"static inline bool walk_{name}(reader_t *r, uint32_t count)",
                "{",
                f"    dcp_{name}_t record;",
                "    uint32_t i;",
            )
            if record.group.size is not None:
                self.add(
                    f"    if (r->end - r->at >= (uint64_t)count * {record.group.size}u) {{",
                    f"        r->at += (size_t)count * {record.group.size}u;",
                    "        return true;",
                    "    }",
                )
            self.add(
                "    for (i = 0; i < count; i++) {",
                "        const uint8_t *const p = r->octets + r->at;",
                f"        const uint8_t *const next = dcp_get_{name}(p, r->octets + r->end, &record);",
                "        if (next == NULL)",
                f"            return read_{name}(r, &record); /* reports what is wrong */",
                "        r->at += (size_t)(next - p);",
                "    }",
                "    return true;",
                "}",
                "",
            )
        region, select = shape.list_region, shape.select
        marks = shape.container_marks
        self.add("/* Read a container and check all its records. */")
        self.add("static inline bool read_whole_container(reader_t *r, dcp_container_t *container)", "{")
        self.add("    bool good;")
        self.add(f"    size_t {', '.join(f'{variable} = 0' for variable in marks.values())};")
        if region is not None:
            self.add("    const size_t end = r->end;")
        arguments = ", ".join(f"&{variable}" for variable in marks.values())
        self.add(f"    if (!read_container(r, container, {arguments}))", "        return false;")
        if region is not None:
            length = access((region.length,)).replace("v->", "container->")
            self.fits("r->end - r->at", length, region, "length_at")
            self.add(f"    r->end = r->at + (size_t){length};")
        self.add(
            "    container->records.octets = r->octets;",
            "    container->records.at = r->at;",
            "    container->records.count = container->ic_num_records;",
            "    container->records.count_at = 0;",
            "    container->records.taken = 0;",
            "    switch (container->ic_type) {",
        )
        for number, record in shape.records.items():
            self.add(f"    case {number}u:", f"        good = walk_{stem(record.group)}(r, container->ic_num_records);")
            self.add("        break;")
        self.add(
            "    default:",
            f"        good = fail(r, {reason(select.reason)}, {needs(select.requirement)}, "
            f'"{select.key}", type_at, 0, container->ic_type);',
            "        break;",
            "    }",
            "    if (!good)",
            "        return false;",
        )
        if region is not None:
            field, values = region.content.name, "0, r->end - r->at"
            self.fail_if("r->at != r->end", "DCP_LEFTOVER", region.requirement, field, "r->at", values, wrapped=False)
            self.add("    r->end = end;")
        self.add("    container->records.end = r->at;", "    return true;", "}", "")
        self.add(
            "dcp_list_t dcp_containers(const uint8_t *octets, size_t size)",
            "{",
            "    dcp_list_t list;",
            "    list.octets = octets;",
            "    list.at = 0;",
            "    list.end = size;",
            "    list.count_at = 0;",
            "    list.count = 0;",
            "    list.taken = 0;",
            "    return list;",
            "}",
            "",
            "bool dcp_next_container(dcp_list_t *containers, dcp_container_t *container, dcp_problem_t *problem)",
            "{",
            "    reader_t r;",
            "    resume(&r, containers, problem);",
            "    if (r.at == r.end || !read_whole_container(&r, container))",
            "        return false;",
            "    containers->at = r.at;",
            "    containers->taken += 1u;",
            "    return true;",
            "}",
            "",
        )

    def inline(self) -> str:
        """Return the functions that read the records of containers, which are in the header."""
        self.lines = []
        for record in self.shape.all_records():
            name = stem(record.group)
            self.quick(record)
            self.add(
                f"/* Read the next {record.group.type_name} of a container. False: there is none. */",
                f"static inline bool dcp_next_{name}(dcp_list_t *records, dcp_{name}_t *record)",
                "{",
                "    const uint8_t *p, *next;",
                "    if (records->taken == records->count)",
                "        return false;",
                "    p = records->octets + records->at;",
                f"    next = dcp_get_{name}(p, records->octets + records->end, record);",
                "    if (next == NULL)",
                "        return false;",
                "    records->at += (size_t)(next - p);",
                "    records->taken += 1u;",
                "    return true;",
                "}",
                "",
            )
        return "\n".join(self.lines)

    def _check(self) -> None:
        shape = self.shape
        self.add(
            "bool dcp_check_beacon(const uint8_t *octets, size_t size, dcp_problem_t *problem)",
            "{",
            "    dcp_beacon_t beacon;",
            "    dcp_payload_t payload;",
            "    dcp_container_t container;",
        )
        if shape.srp is not None:
            self.add(f"    dcp_{stem(shape.srp.group)}_t report;")
        self.add(
            "    reader_t r;",
            "    size_t length_at = 0;",
            "    if (!dcp_read_beacon(octets, size, &beacon, problem))",
            "        return false;",
            "    resume(&r, &beacon.payloads, problem);",
            "    while (begin_payload(&r, &beacon.payloads, &payload, &length_at)) {",
            "        const size_t end = r.end, stop = r.at + payload.content.size;",
            "        r.end = stop;",
            "        switch (payload.protocol_id) {",
        )
        for label, number in shape.protocols.items():
            self.add(f"        case {number}u:")
            if label == shape.vardis.name:
                self.add(
                    "            while (r.at != r.end)",
                    "                if (!read_whole_container(&r, &container))",
                    "                    return false;",
                )
            else:
                self.add("            if (!read_report(&r, &report))", "                return false;")
                if shape.srp_exact is None:
                    self.add(
                        "            if (r.at != r.end)",
                        f"                return fail(&r, DCP_LEFTOVER, {needs(shape.content.requirement)}, "
                        f'"{label}", r.at, 0, r.end - r.at);',
                    )
            self.add("            break;")
        self.add("        default:", "            break;")
        self.add("        }", "        r.end = end;", "        r.at = stop;")
        if shape.fill:
            self.add("        if (!read_area(&r, &payload, length_at))", "            return false;")
        self.add(
            "        beacon.payloads.taken += 1u;",
            "    }",
            "    if (problem->reason != DCP_OK)",
            "        return false;",
            "    problem->offset = r.at;",
            "    return true;",
            "}",
            "",
        )
