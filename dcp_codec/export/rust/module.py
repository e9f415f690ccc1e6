"""The generated module: structures of all records, reading, writing."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from types import MappingProxyType
from typing import Final

from dcp_spec.profile.definition import Profile
from dcp_spec.reasons import REASONS
from dcp_spec.version import __version__

from dcp_codec.codec import Codec
from dcp_codec.export.shape import Part, Record, Shape, shape_of
from dcp_codec.export.wording import bits_of, constant, description, snake_name
from dcp_codec.plan.measures import largest, longest
from dcp_codec.plan.tree import Group, Node, Scalar, Text

from .parts import containers, payloads, returned
from .writer import writing

#: Words that no field of a structure may have, beside those that Python reserves, too.
_WORDS: Final = frozenset(
    re.findall(
        r"\w+",
        """abstract become box const crate do dyn enum extern false final fn impl let loop macro match mod move mut
        override priv pub ref self static struct super trait true try type typeof unsafe unsized use virtual where""",
    )
)
#: Fields that are set when a part is ended: the constant for the place in ``Writer.places``.


def rust_module(codec: Codec) -> str:
    """Return the text of the module. Raise ``ValueError`` if two fields of a record would get the same name."""
    return "\n".join(Module(shape_of(codec), codec.profile).lines()) + "\n"


def field_name(name: str) -> str:
    """Return the name of a field of a structure: ``"numPayloads"`` -> ``"num_payloads"``."""
    plain = snake_name(name)
    return f"{plain}_" if plain in _WORDS else plain


def type_name(group: Group) -> str:
    """Return the name of a structure: ``"BPHeader"`` -> ``"BpHeader"``."""
    return "".join(word.capitalize() for word in snake_name(group.type_name).split("_"))


def _reason(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("-"))


def _number_type(node: Scalar) -> str:
    if node.kind == "bytes":
        return f"[u8; {node.size}]"
    if node.kind == "float":
        return "f32" if node.size == 4 else "f64"
    return f"{'i' if node.signed else 'u'}{bits_of(node.size)}"


def _doc(text: str, indent: str = "    ") -> list[str]:
    plain = " ".join(text.split()).encode("ascii", "replace").decode().replace("``", "`").replace("[", "(")
    return [f"{indent}/// {line}" for line in textwrap.wrap(plain.replace("]", ")"), 100, break_on_hyphens=False)]


def _borrows(members: tuple[Node, ...]) -> bool:
    """Return whether a structure has octets of the input."""
    return any(isinstance(each, Text) or (isinstance(each, Group) and _borrows(each.members)) for each in members)


def _is_constant(node: Scalar) -> bool:
    return node.rule is not None and node.rule.value is not None


class Module:
    """Makes the module of a shape."""

    def __init__(self, shape: Shape, profile: Profile) -> None:
        self.shape = shape
        self.profile = profile
        self._done: set[str] = set()

    # -- types --------------------------------------------------------------------------------------------------

    def name(self, record: Record) -> str:
        """Return the type of a record with its lifetime."""
        outer = record is self.shape.payload or record is self.shape.container
        return type_name(record.group) + ("<'a>" if outer or _borrows(record.members) else "")

    @staticmethod
    def bare(record: Record) -> str:
        """Return the type of a record without its lifetime."""
        return type_name(record.group)

    def _structure(self, group: Group, members: tuple[Node, ...], further: Sequence[str] = ()) -> Iterator[str]:
        name = type_name(group)
        if name in self._done:
            return
        self._done.add(name)
        for member in members:
            if isinstance(member, Group):
                yield from self._structure(member, member.members)
        fields = [*(line for member in members for line in self._field(member)), *further]
        names = [line.split()[1] for line in fields if line.startswith("    pub ")]
        for each in names:
            if names.count(each) > 1:
                raise ValueError(
                    f"{group.type_name}: two fields would be called {each[:-1]}; rename one in the profile"
                )
        lifetime = "<'a>" if further or _borrows(members) else ""
        yield from _doc(f"{group.type_name} {f'({group.requirement})' if group.requirement else 'of this profile'}", "")
        yield from ("#[derive(Debug, Clone, Copy, PartialEq)]", f"pub struct {name}{lifetime} {{", *fields, "}", "")

    def _field(self, member: Node) -> list[str]:
        text = description(member, self.profile)
        if isinstance(member, Scalar):
            if _is_constant(member):
                return []
            text += "; set by reading, ignored by writing" if member.derived is not None else ""
            kind = _number_type(member)
        elif isinstance(member, Group):
            kind = type_name(member) + ("<'a>" if _borrows(member.members) else "")
        else:
            kind = "&'a [u8]"
        return [*_doc(text), f"    pub {field_name(member.name)}: {kind},"]

    # -- records ------------------------------------------------------------------------------------------------

    def _record(
        self,
        record: Record,
        marks: Mapping[str, str] = MappingProxyType({}),
        places: Mapping[str, str] = MappingProxyType({}),
        fields: Sequence[str] = (),
        further: str = "",
    ) -> Iterator[str]:
        """Yield the structure of a record, and how it is read, written and shown.

        ``marks``: fields whose place is returned. ``places``: derived fields, by the constant for their place.
        ``fields``: those that are not in ``record``, and ``further`` their values.
        """
        yield from self._structure(record.group, record.members, fields)
        lifetime = "<'a>" if self.name(record).endswith("<'a>") else ""
        yield f"impl{lifetime} {self.name(record)} {{"
        result = f"(Self, {', '.join('usize' for _ in marks)})" if marks else "Self"
        reader = "Reader<'a>" if lifetime else "Reader<'_>"
        yield f"    fn read(r: &mut {reader}) -> Result<{result}, Problem> {{"
        for part in record.parts():
            if isinstance(part.node, Text):
                yield from self._read_text(record, part.path, part.node)
            else:
                yield from self._read_scalar(record, part.path, part.node, marks)
        made = f"Self {{ {self._values(record.members, ())}{further} }}"
        found = ", ".join((made, *marks.values()))
        yield f"        Ok({f'({found})' if marks else made})"
        yield from ("    }", "")
        yield from self._write(record, places)
        yield ""
        yield "    /// Call a function for each value in wire order, without lengths, counts and constants."
        yield "    pub fn show(&self, show: &mut impl FnMut(Value)) {"
        shown = 0
        for part in record.parts():
            if isinstance(part.node, Text) or part.node.stored:
                shown += 1
                yield f"        show({self._shown(part)});"
        if not shown:
            yield "        let _ = show;"
        yield from ("    }", "}", "")

    @staticmethod
    def _access(part: Part[Scalar | Text]) -> str:
        return "self." + ".".join(map(field_name, part.path))

    def _shown(self, part: Part[Scalar | Text]) -> str:
        value = self._access(part)
        if isinstance(part.node, Text):
            return f"Value::Octets({value})"
        if part.node.kind == "bytes":
            return f"Value::Octets(&{value})"
        if part.node.kind == "float":
            return f"Value::Real({value if part.node.size == 8 else f'f64::from({value})'})"
        return f"Value::{'Signed' if part.node.signed else 'Unsigned'}({value} as {'i' if part.node.signed else 'u'}64)"

    @staticmethod
    def _local(path: tuple[str, ...]) -> str:
        return "v_" + "_".join(map(snake_name, path))

    def _values(self, members: tuple[Node, ...], path: tuple[str, ...]) -> str:
        parts = []
        for each in members:
            if isinstance(each, Group):
                inner = self._values(each.members, (*path, each.name))
                parts.append(f"{field_name(each.name)}: {type_name(each)} {{ {inner} }}")
            elif not (isinstance(each, Scalar) and _is_constant(each)):
                parts.append(f"{field_name(each.name)}: {self._local((*path, each.name))}")
        return ", ".join(parts)

    @staticmethod
    def _path(record: Record, path: tuple[str, ...]) -> str:
        return ".".join((*record.path, *path))

    def _load(self, record: Record, path: tuple[str, ...], node: Scalar) -> Iterator[str]:
        """Yield the reading of a number as u64 into ``raw``, with the check of its rule; ``at`` is its place."""
        order = "little" if node.order == "little" else "big"
        named = f'"{node.requirement or ""}", "{self._path(record, path)}"'
        if node.rule is not None:
            yield "        let at = r.at;"
        yield f"        let raw = r.{order}({node.size}, {named})?;"
        if node.rule is not None:
            wrong = "raw == 0" if node.rule.value is None else f"raw != 0x{node.rule.value:x}"
            expected = "1" if node.rule.value is None else f"0x{node.rule.value:x}"
            rule, field = node.rule, self._path(record, path)
            yield from returned(wrong, self.problem(rule.reason, rule.requirement, field, "at", expected, "raw"))

    @staticmethod
    def problem(reason: str, requirement: str | None, field: str, offset: str, needed: str, available: str) -> str:
        return (
            f'Problem {{ reason: Reason::{_reason(reason)}, requirement: "{requirement or ""}", field: "{field}", '
            f"offset: {offset}, needed: {needed}, available: {available} }}"
        )

    def _read_scalar(
        self, record: Record, path: tuple[str, ...], node: Scalar, marks: Mapping[str, str]
    ) -> Iterator[str]:
        if len(path) == 1 and path[0] in marks:
            yield f"        let {marks[path[0]]} = r.at;"
        local = self._local(path)
        if node.kind == "bytes":
            named = f'"{node.requirement or ""}", "{self._path(record, path)}"'
            yield f"        let {local} = r.array::<{node.size}>({named})?;"
            return
        yield from self._load(record, path, node)
        if _is_constant(node):
            return
        if node.kind == "float":
            value = "f32::from_bits(raw as u32)" if node.size == 4 else "f64::from_bits(raw)"
        elif node.signed:
            value = f"signed(raw, {8 * node.size}) as {_number_type(node)}"
        else:
            value = f"raw as {_number_type(node)}"
        yield f"        let {local} = {value};"

    def _read_text(self, record: Record, names: tuple[str, ...], text: Text) -> Iterator[str]:
        local, path = self._local(names), self._path(record, names)
        if not text.prefixes:
            yield f'        let {local} = r.until_nul("{text.requirement or ""}", "{path}")?;'
            return
        # All lengths are there before they are compared.
        for number, prefix in enumerate(text.prefixes):
            if number:
                yield f"        let place{number} = r.at;"
            yield from self._load(record, (*names, prefix.name), prefix)
            yield f"        let size{number} = raw;"
        for number, prefix in enumerate(text.prefixes[1:], start=1):
            at, size = f"place{number}", f"size{number}"
            problem = self.problem("length-mismatch", "DATA-06", f"{path}.{prefix.name}", at, "size0", size)
            yield from returned(f"size{number} != size0", problem)
        if text.terminated:
            yield "        let place = r.at;"
        yield f'        let {local} = r.take(size0, "{text.requirement or ""}", "{path}.data")?;'
        if text.terminated:
            problem = self.problem("bad-terminator", "DATA-07", f"{path}.data", "place", "0", "0")
            stop = f"{local}.iter().position(|&octet| octet == 0)"
            yield from returned(f"{local}.is_empty() || {stop} != Some({local}.len() - 1)", problem)
            yield f"        let {local} = &{local}[..{local}.len() - 1];"

    def _write(self, record: Record, places: Mapping[str, str]) -> Iterator[str]:
        yield "    fn write(&self, w: &mut Writer) -> Result<(), Fault> {"
        fixed, texts = 0, []
        for part in record.parts():
            node, value = part.node, self._access(part)
            if isinstance(node, Text):
                texts.append(value)
                fixed += sum(prefix.size for prefix in node.prefixes) + node.terminated
                if (most := longest(node)) is not None and most - node.terminated < (1 << 64) - 1:
                    yield from returned(f"{value}.len() as u64 > {most - node.terminated}", "Fault::TooLong")
                if node.terminated:
                    yield from returned(f"{value}.contains(&0)", "Fault::Nul")
                continue
            fixed += node.size
            if node.stored and node.kind == "int" and node.size not in (1, 2, 4, 8):
                top = largest(node)
                below = f"{value} < -{top} - 1 || " if node.signed else ""
                yield from returned(f"{below}{value} > {top}", "Fault::OutOfRange")
        yield f"        w.room({' + '.join([str(fixed), *(f'{each}.len()' for each in texts)])})?;"
        for part in record.parts():
            node, value = part.node, self._access(part)
            if isinstance(node, Text):
                size = f"{value}.len() as u64{' + 1' if node.terminated else ''}"
                for prefix in node.prefixes:
                    yield f"        w.put({size}, {prefix.size}, {_little(prefix)});"
                yield f"        w.copy({value});"
                if node.terminated or not node.prefixes:
                    yield "        w.put(0, 1, false);"
            elif node.kind == "bytes":
                yield f"        w.copy(&{value});"
            elif node.derived is not None:
                yield f"        w.places[{places[part.path[-1]]}] = w.at;"
                yield f"        w.put(0, {node.size}, {_little(node)});"
            else:
                yield f"        w.put({self._bits(node, value)}, {node.size}, {_little(node)});"
        yield from ("        Ok(())", "    }")

    @staticmethod
    def _bits(node: Scalar, value: str) -> str:
        if node.rule is not None and node.rule.value is not None:
            return f"0x{node.rule.value:x}"
        if node.kind == "float":
            return f"u64::from({value}.to_bits())" if node.size == 4 else f"{value}.to_bits()"
        return f"{value} as i64 as u64" if node.signed else f"{value} as u64"

    # -- all ----------------------------------------------------------------------------------------------------

    def lines(self) -> Iterator[str]:
        """Yield the lines of the module."""
        shape, profile = self.shape, self.profile
        heading = (
            f"Codec of the Drone Coordination Protocol, {profile.title} (profile {profile.name}). "
            f"Generated by dcp-codec {__version__}: dcp-codec export rust --profile {profile.name}"
        )
        # No comments or attributes of a crate: the text becomes a module of another crate.
        yield from (line.replace("///", "//", 1) for line in _doc(heading, ""))
        yield ""
        names = {name: _reason(name) for name in REASONS}
        common = resources.files("dcp_codec.export.rust").joinpath("common.rs").read_text(encoding="utf-8")
        reasons = [line for name, each in names.items() for line in (*_doc(REASONS[name]), f"    {each},")]
        common = common.replace("@REASONS@", "\n".join(reasons))
        common = common.replace(
            "@NAMES@", "\n".join(f'            Reason::{each} => "{name}",' for name, each in names.items())
        )
        yield common
        for label, number in shape.protocols.items():
            yield f"pub const PROTOCOL_{constant(label)}: u64 = {number};"
        yield ""
        if shape.header is not None:
            places = {"length": "BEACON_LENGTH", "numPayloads": "NUM_PAYLOADS"}
            yield from self._record(shape.header, shape.header_marks, places)
        area = ["    /// Unused rest of the area.", "    pub area: &'a [u8],"] if shape.fill is not None else []
        content = [
            *("    /// The client payload.", "    pub octets: &'a [u8],"),
            *(
                "    /// Where it begins, counted from the first octet of the beacon.",
                "    pub octets_at: usize,",
                *area,
            ),
        ]
        further = ", octets: &[], octets_at: 0" + (", area: &[]" if area else "")
        length = shape.content.length
        yield from self._record(shape.payload, {length: "length_at"}, {length: "PAYLOAD_LENGTH"}, content, further)
        if shape.srp is not None:
            yield from self._record(shape.srp)
        listed = {shape.list_region.length: "LIST_LENGTH"} if shape.list_region is not None else {}
        records = ["    /// The records, which were checked.", "    pub records: Records<'a>,"]
        places = {"icNumRecords": "NUM_RECORDS", **listed}
        further = ", records: Records { r: *r, ic_type: 0, left: 0 }"
        yield from self._record(shape.container, shape.container_marks, places, records, further)
        for record in shape.all_records():
            yield from self._record(record)
        for make in (payloads, containers, writing):
            yield from make(self)


def _little(node: Scalar) -> str:
    return "true" if node.order == "little" else "false"
