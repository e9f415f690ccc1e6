"""Scapy packets that are made from a plan: the layout is read from it, not written down again.

:class:`Shape` lists the scapy fields of one record, :class:`PlanPacket` fills them from a dissection of
:mod:`dcp_codec.dissect` and builds octets from them. Both know the node types of :mod:`dcp_codec.plan` and nothing of
DCP. Octets that belong to no field become ``Raw`` behind the record, or at the end of the list, where they were found.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from scapy.fields import ConditionalField, RawVal
from scapy.packet import Packet, Raw
from scapy.volatile import VolatileValue

from .dissect import Field as Found
from .dissect import dissect
from .jsonform import node_id_text
from .layout import read_scalar
from .plan import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from .scapy_fields import (
    ChosenField,
    NodeIdField,
    NodeIdTextField,
    Octets,
    OctetsField,
    RecordField,
    RecordListField,
    ScalarField,
)


@dataclass(frozen=True, slots=True)
class Member:
    """The scapy fields of one member of a record: its own, those of its lengths, those of each choice by its label."""

    node: Node
    name: str = ""
    lengths: tuple[str, ...] = ()
    choices: Mapping[str, str] | None = None
    opened: tuple[Member, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The fields that hold the content."""
        return tuple(self.choices.values()) if self.choices else (self.name,)

    def flat(self) -> Iterator[Member]:
        """The members of an opened record, or else this one."""
        if not self.opened:
            yield self
        for member in self.opened:
            yield from member.flat()


@dataclass(frozen=True, slots=True)
class Following:
    """How a field follows from others while it is None: the octets that they take (``size``), the number of their
    elements (``count``), what they are a choice of (``choice``), the room they leave of ``total`` octets (``room``)."""

    kind: Literal["size", "count", "choice", "room"]
    of: Member
    total: int = 0


class Shape:
    """The scapy fields of a record: ``desc`` in wire order, ``members`` of the record, ``following`` by field."""

    def __init__(
        self,
        group: Group,
        *,
        packets: Mapping[str, type[PlanPacket]],
        representation: str,
        defaults: Mapping[str, Any],
        opened: str = "",
    ) -> None:
        """``packets``: the class of each record type; ``representation`` of node identifiers; ``defaults`` by role.

        Fields of a record of the type ``opened`` stand among those of the record around it.
        """
        self.packets = packets
        self.representation = representation
        self.defaults = defaults
        self.opened = opened
        self.desc: list[Any] = []
        self.following: dict[str, Following] = {}
        self.chosen: dict[str, Member] = {}
        self.members = self._members(group)
        by_name = {each.node.name: each for member in self.members for each in member.flat()}
        for member in by_name.values():
            node = member.node
            if isinstance(node, Scalar) and node.derived is not None:
                self.following[member.name] = Following(node.derived.kind, by_name[_last(node.derived.of)])
            elif isinstance(node, Fill):
                measured = by_name[node.used].node
                assert isinstance(measured, Scalar)
                assert measured.derived is not None
                self.following[member.name] = Following("room", by_name[_last(measured.derived.of)], node.total)
            elif isinstance(select := _content(node), Select):
                self.following[by_name[select.key].name] = Following("choice", member)
                self.chosen[by_name[select.key].name] = member

    def _members(self, group: Group) -> tuple[Member, ...]:
        choices = {select.key: select for select in map(_content, group.members) if isinstance(select, Select)}
        return tuple(self._member(node, node, choices) for node in group.members)

    def _member(self, node: Node, content: Node, choices: Mapping[str, Select]) -> Member:
        match content:
            case Scalar():
                return Member(node, self._scalar(content, choices.get(content.name)))
            case Text():
                return self._text(content)
            case Group() if content.type_name == self.opened:
                return Member(node, opened=self._members(content))
            case Rest():
                return Member(node, self._put(OctetsField(_free(content.name), b"", content)))
            case Fill():
                return Member(node, self._put(OctetsField(_free(content.name), None, content)))
            case Group() | Exact() | Many():
                return Member(node, self._put(self._record(content, standing=True)))
            case Region():
                return self._member(node, content.content, choices)
            case Select():
                return self._select(node, content)

    def _scalar(self, node: Scalar, select: Select | None) -> str:
        name, names = _free(node.name), node.names
        if select is not None and names is None:
            names = {number: case.name for number, case in select.cases.items()}
        if select is not None or node.derived is not None:
            return self._put(ScalarField(name, None, node, names))
        if node.role == "node-id":
            zero = node_id_text(bytes(node.size), self.representation)
            return self._put(NodeIdField(name, zero, node, self.representation))
        zero = self.defaults.get(node.role or "", read_scalar(node, bytes(node.size)))
        return self._put(ScalarField(name, zero if node.rule is None else node.rule.value, node, names))

    def _text(self, node: Text) -> Member:
        stem = node.name
        lengths = tuple(self._put(ScalarField(f"{stem}L{prefix.name[1:]}", None, prefix)) for prefix in node.prefixes)
        is_node_id = node.role == "node-id"
        made = NodeIdTextField(_free(stem), "", node) if is_node_id else OctetsField(_free(stem), b"", node)
        member = Member(node, self._put(made), lengths)
        self.following.update((length, Following("size", member)) for length in lengths)
        return member

    def _select(self, node: Node, select: Select) -> Member:
        cases = [*select.cases.values(), *([select.default] if select.default is not None else [])]
        by_label = {case.name: case for case in reversed(cases)}
        if len(by_label) == 1:
            return Member(node, self._put(self._record(cases[0], standing=False)))
        names: dict[str, str] = {}
        for label in dict.fromkeys(case.name for case in cases):
            case = by_label[label]
            if isinstance(case, Rest):
                made: Any = OctetsField(_free(label), b"", case)
            else:
                made = self._record(case, standing=False)
            names[label] = self._put(ChosenField(made, _condition(select.key, made.name)))
        return Member(node, choices=names)

    def _record(self, node: Node, *, standing: bool) -> Any:
        """A field of one record or a list of them; one that is always there (``standing``) has a default."""
        if isinstance(node, Many):
            return RecordListField(_free(node.name), [], self.packets[node.element.type_name])
        group = node.content if isinstance(node, Exact) else node
        assert isinstance(group, Group)
        packet = self.packets[group.type_name]
        return RecordField(_free(node.name), packet() if standing else None, packet)

    def _put(self, made: Any) -> str:
        self.desc.append(made)
        return str(made.name)


def _content(node: Node) -> Node:
    return node.content if isinstance(node, Region) else node


def _last(reference: str) -> str:
    return reference.rsplit(".", 1)[-1]


def _free(name: str) -> str:
    """``name``, or ``name_`` where scapy's packets have an attribute of that name already."""
    return f"{name}_" if hasattr(PlanPacket, name) else name


def _condition(key: str, name: str) -> Any:
    return lambda packet: packet.chosen(_free(key)) == name


class PlanPacket(Packet):
    """A record of the profile in use as a scapy packet.

    Fields that follow from others are None until they are given; what is given is put on the wire, right or wrong.
    Dissecting takes any octets. Building raises ``ValueError`` for a value that its field cannot hold, and
    ``RuntimeError`` for a packet that was made under another profile.
    """

    #: The record in the plan, and its scapy fields; both are set when a profile is put to use.
    layout: ClassVar[Node]
    shape: ClassVar[Shape]
    __signature__: ClassVar[inspect.Signature]

    @classmethod
    def lay_out(cls, layout: Node, shape: Shape) -> None:
        """Give the class other fields. Packets of the class that exist cannot be built any more."""
        cls.layout, cls.shape, cls.fields_desc = layout, shape, shape.desc
        for cache in (
            Packet.class_default_fields,
            Packet.class_default_fields_ref,
            Packet.class_fieldtype,
            Packet.class_packetfields,
            Packet.class_dont_cache,
        ):
            cache.pop(cls, None)
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters = [inspect.Parameter("_pkt", inspect.Parameter.POSITIONAL_ONLY)]
        for each in shape.desc:
            each.register_owner(cls)
            parameters.append(inspect.Parameter(each.name, keyword, default=each.default))
        cls.__signature__ = inspect.Signature(parameters)

    def __init__(self, *args: Any, **fields: Any) -> None:
        for member in self.shape.chosen.values():
            given = [name for name in member.choices or () if fields.get(name)]
            if len(given) > 1:
                raise ValueError(f"{' and '.join(given)} exclude each other")
        super().__init__(*args, **fields)

    def _field(self, name: str) -> Any:
        return self.fieldtype[name]

    # -- choices --------------------------------------------------------------------------------------------------

    def chosen(self, key: str) -> str:
        """The field of the content there is: the one that was given, else the one that the field ``key`` says."""
        member = self.shape.chosen[key]
        choices, select = member.choices or {}, _content(member.node)
        for name in choices.values():
            value = self.getfieldval(name)
            if isinstance(value, VolatileValue) or value:
                return name
        number, case = self.getfieldval(key), None
        if isinstance(select, Select):
            case = select.cases.get(number, select.default) if isinstance(number, int) else select.default
        return choices[case.name] if case is not None else next(iter(choices.values()))

    def _choice(self, member: Member) -> int:
        """The number that stands for the content there is, 0 if none does."""
        select = _content(member.node)
        assert isinstance(select, Select)
        for number, case in select.cases.items():
            if member.choices:
                if self.getfieldval(member.choices[case.name]):
                    return number
                continue
            elements = self.getfieldval(member.name)
            if isinstance(case, Many) and elements and type(elements[0]) is self.shape.packets[case.element.type_name]:
                return number
        return 0

    def setfieldval(self, attr: str, val: Any) -> None:
        super().setfieldval(attr, val)
        for member in self.shape.chosen.values():
            if attr in member.names and val:
                for other in member.names:
                    if other != attr:
                        self.fields[other] = self._field(other).any2i(self, None)

    # -- building -------------------------------------------------------------------------------------------------

    def self_build(self) -> bytes:
        # Every field is built once, so that random values do not change between a content and its length.
        built: dict[str, bytes] = {}
        missing: list[str] = []
        for each in self.shape.desc:
            if self.fieldtype.get(each.name) is not each:
                raise RuntimeError(f"this {type(self).__name__} was made under another profile: make it anew")
            if isinstance(each, ConditionalField) and not each._evalcond(self):
                continue
            value = self.getfieldval(each.name)
            if value is None and each.name in self.shape.following:
                missing.append(each.name)
                built[each.name] = b""
            else:
                built[each.name] = bytes(value) if isinstance(value, RawVal) else each.octets(value)
        for name in missing:
            built[name] = self._field(name).octets(self._follow(self.shape.following[name], built))
        return b"".join(built.values())

    def follow(self, name: str) -> Any:
        """The value of a field that follows from others."""
        rule = self.shape.following[name]
        built = {each: self._field(each).octets(self.getfieldval(each)) for each in rule.of.names}
        return self._follow(rule, built)

    def _follow(self, rule: Following, built: Mapping[str, bytes]) -> Any:
        if rule.kind == "count":
            return len(self.getfieldval(rule.of.name))
        if rule.kind == "choice":
            return self._choice(rule.of)
        size = sum(len(built.get(name, b"")) for name in rule.of.names)
        return size if rule.kind == "size" else bytes(max(rule.total - size, 0))

    def clear_derived(self) -> None:
        """Set all lengths and counts to None, here and in all records inside: building works them out again."""
        for name, rule in self.shape.following.items():
            if rule.kind in ("size", "count"):
                self.delfieldval(name)
        for value in list(self.fields.values()):
            for element in value if isinstance(value, list) else [value]:
                if isinstance(element, PlanPacket):
                    element.clear_derived()

    # -- dissecting -----------------------------------------------------------------------------------------------

    def do_dissect(self, s: bytes) -> bytes:
        found = dissect(self.layout, s)
        self._fill(found.root, found.end, s)
        return s[found.end :]

    def extract_padding(self, s: bytes) -> tuple[bytes, bytes | None]:
        return b"", s

    def _fill(self, record: Found, end: int, octets: bytes) -> None:
        """Take over a dissected record, and the octets behind it up to ``end``."""
        self.explicit = 1
        self.original = octets[record.offset : end]
        last = self._fill_members(self.shape.members, record, end, octets)
        if last < end:
            self.add_payload(Raw(octets[last:end]))

    def _fill_members(self, members: tuple[Member, ...], record: Found, end: int, octets: bytes) -> int:
        parts, last = record.children, record.offset
        for index, member in enumerate(members):
            if index >= len(parts):
                self._leave_out(member)
                continue
            part = parts[index]
            # The dissector steps over what it cannot make sense of; the next part says where it went on.
            stop = parts[index + 1].offset if index + 1 < len(parts) else end
            if member.opened:
                last = self._fill_members(member.opened, part, stop, octets)
            else:
                last = self._take(member, part, stop, octets)
        return last

    def _take(self, member: Member, part: Found, stop: int, octets: bytes) -> int:
        """Set the fields of a member; returns the offset behind what they hold."""
        name = (member.choices or {}).get(part.name, member.name)
        match part.layout:
            case Group():
                self.fields[name] = self._inside(part, stop, octets)
                return stop
            case Many():
                self.fields[name] = self._elements(part, stop, octets)
                return stop
            case Text() if member.lengths:
                data = part.children[-1] if part.children[-1].name == "data" else None
                lengths = part.children[: len(member.lengths)]
                for index, length in enumerate(member.lengths):
                    known = index < len(lengths)
                    self.fields[length] = self._field(length).held(lengths[index]) if known else Octets()
                self.fields[name] = Octets() if data is None else self._field(name).held(data)
            case Rest() if self._field(name).islist:
                self.fields[name] = [Raw(part.raw)] if part.length else []
            case _:
                self.fields[name] = self._field(name).held(part)
        return part.offset + part.length

    def _inside(self, part: Found, stop: int, octets: bytes) -> PlanPacket:
        assert isinstance(part.layout, Group)
        packet = self.shape.packets[part.layout.type_name]()
        packet.add_parent(self)
        packet._fill(part, stop, octets)
        return packet

    def _elements(self, part: Found, stop: int, octets: bytes) -> list[Any]:
        elements: list[Any] = []
        last = part.offset
        for child in part.children:
            last = child.offset + child.length
            elements.append(self._inside(child, last, octets))
        if last < stop:
            elements.append(Raw(octets[last:stop]))
        return elements

    def _leave_out(self, member: Member) -> None:
        """Say of a member that nothing of it is there."""
        for each in member.flat():
            if each.choices:
                continue
            for name in (*each.lengths, each.name):
                self.fields[name] = [] if self._field(name).islist else Octets()


# The class itself is laid out empty, so that it can be asked for its attributes before there is a profile.
PlanPacket.layout = Group("", "", (), 0)
PlanPacket.shape = Shape(Group("", "", (), 0), packets={}, representation="mac", defaults={})
