"""The writer of the generated module."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from dcp_codec.export.shape import Record
from dcp_codec.plan.measures import largest

from .parts import returned

if TYPE_CHECKING:
    from .module import Module


def writing(module: Module) -> Iterator[str]:
    """Yield the functions of the writer that begin, fill and end parts."""
    shape = module.shape
    yield "impl Writer<'_> {"
    yield "    /// Begin a bearer payload. Every payload is begun and ended in it."
    yield "    pub fn begin_beacon(&mut self, beacon: &Beacon) -> Result<(), Fault> {"
    yield from ("        let at = self.at;", *_fault("self.beacon.is_some()", "Order"))
    if shape.header is not None:
        yield "        beacon.bp.write(self)?;"
    else:
        yield "        let _ = beacon;"
    yield from (
        "        self.beacon = Some(at);",
        "        self.payloads = self.at;",
        "        self.payloads_written = 0;",
    )
    yield from ("        Ok(())", "    }", "", "    /// End it; `size` is then its size.")
    yield "    pub fn end_beacon(&mut self) -> Result<(), Fault> {"
    yield from _fault("self.beacon.is_none() || self.payload.is_some()", "Order")
    if shape.header is not None or shape.payloads.nonempty:
        yield from _fault("self.payloads_written == 0", "Empty")
    if shape.header is not None:
        size = "(self.at - self.payloads) as u64"
        yield from _limit(module, shape.header, "numPayloads", "self.payloads_written", "TooMany")
        yield from _limit(module, shape.header, "length", size, "TooLong")
        yield from _set(module, shape.header, "numPayloads", "NUM_PAYLOADS", "self.payloads_written")
        yield from _set(module, shape.header, "length", "BEACON_LENGTH", size)
    yield from ("        self.beacon = None;", "        Ok(())", "    }", "")
    yield "    pub fn begin_payload(&mut self, payload: &Payload) -> Result<(), Fault> {"
    yield "        let at = self.at;"
    yield from _fault("self.beacon.is_none() || self.payload.is_some()", "Order")
    yield from ("        payload.write(self)?;", "        self.payload = Some(at);", "        self.content = self.at;")
    yield from (
        "        Ok(())",
        "    }",
        "",
        "    pub fn end_payload(&mut self, payload: &Payload) -> Result<(), Fault> {",
    )
    yield "        let size = self.at - self.content;"
    yield from _fault("self.payload.is_none() || self.container.is_some()", "Order")
    yield from _limit(module, shape.payload, shape.content.length, "size as u64", "TooLong")
    if shape.fill is not None:
        total = shape.fill.total
        wrong = f"size > {total} || (!payload.area.is_empty() && payload.area.len() != {total} - size)"
        yield from (*_fault(wrong, "TooLong"), f"        self.room({total} - size)?;")
        yield from ("        if payload.area.is_empty() {", f"            for _ in size..{total} {{")
        yield from ("                self.put(0, 1, false);", "            }", "        } else {")
        yield from ("            self.copy(payload.area);", "        }")
    else:
        yield "        let _ = payload;"
    yield from _set(module, shape.payload, shape.content.length, "PAYLOAD_LENGTH", "size as u64")
    yield from ("        self.payload = None;", "        self.payloads_written += 1;", "        Ok(())", "    }", "")
    yield "    /// Add a state report to the content of a payload."
    yield "    pub fn add_report(&mut self, report: &Report) -> Result<(), Fault> {"
    yield "        report.write(self)" if shape.srp is not None else "        match *report {}"
    yield from ("    }", "", "    /// Begin a container, whose type is `ic_type`.")
    yield "    pub fn begin_container(&mut self, container: &Container) -> Result<(), Fault> {"
    yield from ("        let at = self.at;", *_fault("self.container.is_some()", "Order"))
    known = " | ".join(str(number) for number in shape.records)
    yield from _fault(f"!matches!(container.ic_type as u64, {known})", "UnknownType")
    yield from ("        container.write(self)?;", "        self.container = Some(at);")
    yield from ("        self.records = self.at;", "        self.records_written = 0;")
    yield from ("        self.ic_type = container.ic_type as u64;", "        Ok(())", "    }", "")
    yield "    /// Add a record to the container. If it does not fit, the container can be ended without it."
    yield "    pub fn add_record(&mut self, record: &Record) -> Result<(), Fault> {"
    yield from _fault("self.container.is_none() || self.ic_type != record.ic_type()", "Order")
    yield from _fault(f"self.records_written == {shape.most_records}", "TooMany")
    yield "        record.write(self)?;"
    yield from ("        self.records_written += 1;", "        Ok(())", "    }", "")
    yield "    /// End the container; one without records is removed."
    yield "    pub fn end_container(&mut self) -> Result<(), Fault> {"
    yield from (
        "        let at = self.container.take().ok_or(Fault::Order)?;",
        "        if self.records_written == 0 {",
    )
    yield from ("            self.at = at;", "            return Err(Fault::Empty);", "        }")
    if shape.list_region is not None:
        size = "(self.at - self.records) as u64"
        yield from _limit(module, shape.container, shape.list_region.length, size, "TooLong")
        yield from _set(module, shape.container, shape.list_region.length, "LIST_LENGTH", size)
    yield from _set(module, shape.container, "icNumRecords", "NUM_RECORDS", "self.records_written")
    yield from ("        Ok(())", "    }", "}")


def _fault(wrong: str, name: str) -> Iterator[str]:
    return returned(wrong, f"Fault::{name}")


def _set(module: Module, record: Record, name: str, place: str, number: str) -> Iterator[str]:
    """Yield the setting of a derived field, unless the layout has none."""
    if (node := module.shape.derived(record, name)) is not None:
        little = "true" if node.order == "little" else "false"
        yield f"        self.set(self.places[{place}], {number}, {node.size}, {little});"


def _limit(module: Module, record: Record, name: str, number: str, fault: str) -> Iterator[str]:
    """Yield the check that a derived field can express a number."""
    if (node := module.shape.derived(record, name)) is None:
        return
    if node.rule is not None and name not in ("numPayloads", "icNumRecords"):
        yield from _fault(f"{number} == 0", "Empty")
    if (most := largest(node)) < (1 << 64) - 1:
        yield from _fault(f"{number} > {most}", fault)
