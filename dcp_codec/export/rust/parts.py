"""Payloads and containers of the generated module."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from dcp_codec.export.wording import snake_name
from dcp_codec.plan.tree import Region

if TYPE_CHECKING:
    from .module import Module


def returned(wrong: str, error: str, indent: int = 8) -> Iterator[str]:
    """Yield the return of an error if a condition holds."""
    yield from (f"{' ' * indent}if {wrong} {{", f"{' ' * indent}    return Err({error});", f"{' ' * indent}}}")


def payloads(module: Module) -> Iterator[str]:
    """Yield beacons and the iterator over their payloads."""
    shape = module.shape
    header = shape.header
    yield from ("/// A bearer payload.", "#[derive(Debug, Clone, Copy)]", "pub struct Beacon<'a> {")
    if header is not None:
        yield f"    pub bp: {module.name(header)},"
    yield from ("    pub payloads: Payloads<'a>,", "}", "", "impl<'a> Beacon<'a> {")
    yield "    /// Read the header of a bearer payload. Octets after the beacon are padding of the bearer."
    yield "    pub fn read(octets: &'a [u8]) -> Result<Self, Problem> {"
    yield f"        let {'mut ' if header is not None else ''}r = Reader::new(octets);"
    if header is not None:
        places = "bp, count_at, length_at" if shape.region is not None else "bp, count_at"
        yield f"        let ({places}) = {module.bare(header)}::read(&mut r)?;"
        if shape.region is not None:
            yield from _fits(module, shape.region, "u64::from(bp.length)", "bp.length as u64")
            yield "        r.end = r.at + bp.length as usize;"
        yield "        let (count, bp_count_at) = (bp.num_payloads as u64, count_at);"
        yield "        let payloads = Payloads { r, count, count_at: bp_count_at, taken: 0, failed: false };"
        yield "        Ok(Beacon { bp, payloads })"
    else:
        yield "        let payloads = Payloads { r, count: 0, count_at: 0, taken: 0, failed: false };"
        yield "        Ok(Beacon { payloads })"
    yield from ("    }", "", "    /// A beacon to be written: its payloads are added by a `Writer`.")
    arguments = f"bp: {module.name(header)}" if header is not None else ""
    yield f"    pub fn new({arguments}) -> Self {{"
    yield "        let payloads = Payloads { r: Reader::new(&[]), count: 0, count_at: 0, taken: 0, failed: false };"
    yield f"        Beacon {{ {'bp, ' if header is not None else ''}payloads }}"
    yield from (
        "    }",
        "",
        "    /// Call a function for each value of the header, without lengths, counts and constants.",
    )
    yield "    pub fn show(&self, show: &mut impl FnMut(Value)) {"
    yield f"        {'self.bp.show(show)' if header is not None else 'let _ = show'};"
    yield from ("    }", "}", "")
    yield _PAYLOADS
    yield from _begin_payload(module)
    yield from _content(module)
    yield from _check(module)


def _begin_payload(module: Module) -> Iterator[str]:
    shape, problem = module.shape, module.problem
    many, content = shape.payloads, shape.content
    yield "    /// Begin the next payload; the reader is then at its content."
    yield "    fn begin(&mut self) -> Result<Option<(Payload<'a>, usize)>, Problem> {"
    yield "        let r = &mut self.r;"
    if many.count is not None:
        yield from ("        if self.taken == self.count {", "            return Ok(None);", "        }")
    elif many.nonempty:
        yield from ("        if r.at == r.end && self.taken != 0 {", "            return Ok(None);", "        }")
    else:
        yield "        if r.at == r.end {"
        if many.agrees is not None:
            wrong = problem(many.reason, many.requirement, many.agrees, "self.count_at", "self.count", "self.taken")
            yield from returned("self.taken != self.count", wrong, 12)
        yield from ("            return Ok(None);", "        }")
    yield f"        let (mut payload, length_at) = {module.bare(shape.payload)}::read(r)?;"
    length = f"payload.{snake_name(content.length)}"
    yield from _fits(module, content, f"{length} as u64", f"{length} as u64")
    yield f"        payload.octets = &r.octets[r.at..r.at + {length} as usize];"
    yield from ("        payload.octets_at = r.at;", "        Ok(Some((payload, length_at)))", "    }", "")
    yield "    /// Continue after the content of a payload."
    yield "    fn end(&mut self, payload: &mut Payload<'a>, length_at: usize) -> Result<(), Problem> {"
    yield "        let r = &mut self.r;"
    yield "        r.at = payload.octets_at + payload.octets.len();"
    if shape.fill is not None:
        fill = shape.fill
        size = "payload.octets.len()"
        wrong = problem(fill.reason, fill.requirement, fill.used, "length_at", f"{size} as u64", str(fill.total))
        yield from returned(f"{size} > {fill.total}", wrong)
        yield f"        let rest = ({fill.total} - payload.octets.len()) as u64;"
        yield f'        payload.area = r.take(rest, "{fill.requirement}", "{fill.name}")?;'
    else:
        yield "        let _ = length_at;"
    yield from ("        self.taken += 1;", "        Ok(())", "    }", "}", "")


def _content(module: Module) -> Iterator[str]:
    shape, problem = module.shape, module.problem
    report = "Report<'a>" if shape.srp is not None and "'a" in module.name(shape.srp) else "Report"
    if shape.srp is None:
        yield from ("/// A state report: there is none in this profile.", "#[derive(Debug, Clone, Copy)]")
        yield from ("pub enum Report {}", "", "impl Report {", "    pub fn show(&self, _: &mut impl FnMut(Value)) {")
        yield from ("        match *self {}", "    }", "}", "")
    else:
        yield f"pub type {report} = {module.name(shape.srp)};"
        yield from ("", f"fn read_report<'a>(r: &mut Reader<'a>) -> Result<{report}, Problem> {{")
        exact, label = shape.srp_exact, ".".join(shape.srp.path)
        if exact is not None:
            wrong = problem(exact.reason, exact.requirement, label, "r.at", str(exact.size), "r.left() as u64")
            yield from returned(f"r.left() != {exact.size}", wrong, 4)
        yield "    let report = Report::read(r)?;"
        if exact is None:
            wrong = problem("leftover", shape.content.requirement, label, "r.at", "0", "r.left() as u64")
            yield from returned("r.left() != 0", wrong, 4)
        yield from ("    Ok(report)", "}", "")
    yield from ("/// What a payload contains.", "#[derive(Debug, Clone, Copy)]", "pub enum Content<'a> {")
    yield from (f"    Srp({report}),", "    Vardis(Containers<'a>),", "    Other(&'a [u8]),", "}", "")
    yield "impl<'a> Payload<'a> {"
    yield "    /// Its content, by its protocol. Offsets of problems count from the first octet of the content."
    yield "    pub fn content(&self) -> Result<Content<'a>, Problem> {"
    yield "        match self.protocol_id as u64 {"
    yield "            PROTOCOL_VARDIS => Ok(Content::Vardis(Containers::new(self.octets))),"
    if shape.srp is not None:
        yield "            PROTOCOL_SRP => Ok(Content::Srp(read_report(&mut Reader::new(self.octets))?)),"
    yield from ("            _ => Ok(Content::Other(self.octets)),", "        }", "    }", "")
    yield "    /// Call a function for the unused rest of an area, if the profile has areas."
    yield "    pub fn show_area(&self, show: &mut impl FnMut(Value)) {"
    yield f"        {'show(Value::Octets(self.area))' if shape.fill is not None else 'let _ = show'};"
    yield from ("    }", "}", "")


def _check(module: Module) -> Iterator[str]:
    yield "/// Check a bearer payload with the contents of all its payloads. Return the number of octets of the beacon."
    yield "pub fn check_beacon(octets: &[u8]) -> Result<usize, Problem> {"
    yield "    let mut payloads = Beacon::read(octets)?.payloads;"
    yield "    while let Some((mut payload, length_at)) = payloads.begin()? {"
    yield "        let mut r = payloads.r;"
    yield "        r.end = r.at + payload.octets.len();"
    yield "        match payload.protocol_id as u64 {"
    yield "            PROTOCOL_VARDIS => {"
    yield from (
        "                while r.at != r.end {",
        "                    read_container(&mut r)?;",
        "                }",
    )
    yield "            }"
    if module.shape.srp is not None:
        yield from ("            PROTOCOL_SRP => {", "                read_report(&mut r)?;", "            }")
    yield from ("            _ => {}", "        }", "        payloads.end(&mut payload, length_at)?;", "    }")
    yield from ("    Ok(payloads.r.at)", "}", "")


def containers(module: Module) -> Iterator[str]:
    """Yield the iterators over containers and their records."""
    shape, problem = module.shape, module.problem
    yield from ("/// A record of a container.", "#[derive(Debug, Clone, Copy, PartialEq)]", "pub enum Record<'a> {")
    for record in shape.all_records():
        yield f"    {module.bare(record)}({module.name(record)}),"
    yield from ("}", "", "impl<'a> Record<'a> {", "    /// The type of containers that it belongs to.")
    yield "    pub fn ic_type(&self) -> u64 {"
    yield from _match(module, lambda number, _: str(number))
    yield from ("    }", "", "    fn read(ic_type: u64, r: &mut Reader<'a>) -> Result<Option<Self>, Problem> {")
    yield "        Ok(Some(match ic_type {"
    for number, record in shape.records.items():
        yield f"            {number} => Record::{module.bare(record)}({module.bare(record)}::read(r)?),"
    yield from ("            _ => return Ok(None),", "        }))", "    }", "")
    yield "    fn write(&self, w: &mut Writer) -> Result<(), Fault> {"
    yield from _match(module, lambda _, name: f"{name}.write(w)", "each")
    yield from (
        "    }",
        "",
        "    /// Call a function for each value in wire order, without lengths, counts and constants.",
    )
    yield "    pub fn show(&self, show: &mut impl FnMut(Value)) {"
    yield from _match(module, lambda _, name: f"{name}.show(show)", "each")
    yield from ("    }", "}", "")
    yield _CONTAINERS
    region, select = shape.list_region, shape.select
    yield "/// Read a container and check all its records."
    yield "fn read_container<'a>(r: &mut Reader<'a>) -> Result<Container<'a>, Problem> {"
    places = "container, type_at, length_at" if region is not None else "container, type_at"
    yield f"    let (mut container, {places.partition(', ')[2]}) = {module.bare(shape.container)}::read(r)?;"
    if region is not None:
        length = f"container.{snake_name(region.length)}"
        yield from _fits(module, region, f"{length} as u64", f"{length} as u64", 4)
        yield from ("    let end = r.end;", f"    r.end = r.at + {length} as usize;")
    yield "    let (ic_type, left) = (container.ic_type as u64, container.ic_num_records as u64);"
    yield "    let begin = *r;"
    known = " | ".join(str(number) for number in shape.records)
    wrong = problem(select.reason, select.requirement, select.key, "type_at", "0", "ic_type")
    yield from returned(f"!matches!(ic_type, {known})", wrong, 4)
    yield from ("    for _ in 0..left {", "        Record::read(ic_type, r)?;", "    }")
    if region is not None:
        wrong = problem("leftover", region.requirement, region.content.name, "r.at", "0", "r.left() as u64")
        yield from (*returned("r.left() != 0", wrong, 4), "    r.end = end;")
    yield "    container.records = Records { r: Reader { end: r.at, ..begin }, ic_type, left };"
    yield from ("    Ok(container)", "}", "")


def _fits(module: Module, region: Region, length: str, needed: str, indent: int = 8) -> Iterator[str]:
    """Yield the check that the octets of a region are there."""
    left = "r.left() as u64"
    wrong = module.problem(region.reason, region.requirement, region.length, "length_at", needed, left)
    yield from returned(f"({left}) < {length}", wrong, indent)


def _match(module: Module, made: Callable[[int, str], str], name: str = "_") -> Iterator[str]:
    yield "        match self {"
    for number, record in module.shape.records.items():
        yield f"            Record::{module.bare(record)}({name}) => {made(number, name)},"
    yield "        }"


_PAYLOADS = """/// The payloads of a beacon that are still to be read. A payload before a wrong one is good.
#[allow(dead_code)]
#[derive(Debug, Clone, Copy)]
pub struct Payloads<'a> {
    r: Reader<'a>,
    count: u64,
    count_at: usize,
    taken: u64,
    failed: bool,
}

impl<'a> Iterator for Payloads<'a> {
    type Item = Result<Payload<'a>, Problem>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let (mut payload, length_at) = match self.begin() {
            Ok(found) => found?,
            Err(problem) => {
                self.failed = true;
                return Some(Err(problem));
            }
        };
        let ended = self.end(&mut payload, length_at);
        self.failed = ended.is_err();
        Some(ended.map(|()| payload))
    }
}

impl<'a> Payloads<'a> {"""
_CONTAINERS = """/// The records of a container.
#[derive(Debug, Clone, Copy)]
pub struct Records<'a> {
    r: Reader<'a>,
    ic_type: u64,
    left: u64,
}

impl PartialEq for Records<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.left == other.left && self.r.octets[self.r.at..self.r.end] == other.r.octets[other.r.at..other.r.end]
    }
}

impl<'a> Iterator for Records<'a> {
    type Item = Record<'a>;

    fn next(&mut self) -> Option<Self::Item> {
        self.left = self.left.checked_sub(1)?;
        Record::read(self.ic_type, &mut self.r).ok().flatten()
    }
}

/// The containers in the content of a payload of VarDis. Offsets of problems count from the first octet of the content.
#[derive(Debug, Clone, Copy)]
pub struct Containers<'a> {
    r: Reader<'a>,
}

impl<'a> Containers<'a> {
    pub fn new(octets: &'a [u8]) -> Self {
        Containers { r: Reader::new(octets) }
    }
}

impl<'a> Iterator for Containers<'a> {
    type Item = Result<Container<'a>, Problem>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.r.left() == 0 {
            return None;
        }
        let found = read_container(&mut self.r);
        if found.is_err() {
            self.r.at = self.r.end;
        }
        Some(found)
    }
}
"""
