"""The scapy fields of a record, generated from its members in the plan, with their dependencies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from scapy.packet import Packet

from dcp_codec.jsonform import node_id_text
from dcp_codec.plan.layout import read_scalar
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

from .fields import (
    ChosenField,
    NodeIdField,
    NodeIdTextField,
    OctetsField,
    RecordField,
    RecordListField,
    ScalarField,
)


@dataclass(frozen=True, slots=True)
class Member:
    """The scapy fields of one member of a record: its own field, those of its lengths, those of each choice by its
    label.
    """

    node: Node
    name: str = ""
    lengths: tuple[str, ...] = ()
    choices: Mapping[str, str] | None = None
    opened: tuple[Member, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the fields that hold the content."""
        return tuple(self.choices.values()) if self.choices else (self.name,)

    def flat(self) -> Iterator[Member]:
        """Yield the members of an opened record, or this member if it is not one."""
        if not self.opened:
            yield self
        for member in self.opened:
            yield from member.flat()


@dataclass(frozen=True, slots=True)
class Following:
    """Derivation of a field that is None: from the octets of other fields (``size``), the number of their elements
    (``count``), the chosen content (``choice``), or the room that they leave of ``total`` octets (``room``).
    """

    kind: Literal["size", "count", "choice", "room"]
    of: Member
    total: int = 0


class Shape:
    """The scapy fields of a record: ``desc`` in wire order, ``members`` of the record, ``following`` by field."""

    def __init__(
        self,
        group: Group,
        *,
        packets: Mapping[str, Any],
        representation: str,
        defaults: Mapping[str, Any],
        base: type[Packet] = Packet,
        opened: str = "",
    ) -> None:
        """``packets``: the class of each record type; ``representation`` of node identifiers; ``defaults`` by role.

        A field whose name is an attribute of ``base`` gets the suffix ``_``.

        Fields of a record of the type ``opened`` become fields of the record around it.
        """
        self.packets = packets
        self.representation = representation
        self.defaults = defaults
        self.base = base
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
            elif isinstance(select := content_of(node), Select):
                self.following[by_name[select.key].name] = Following("choice", member)
                self.chosen[by_name[select.key].name] = member

    def _members(self, group: Group) -> tuple[Member, ...]:
        choices = {select.key: select for select in map(content_of, group.members) if isinstance(select, Select)}
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
                return Member(node, self._put(OctetsField(self._free(content.name), b"", content)))
            case Fill():
                return Member(node, self._put(OctetsField(self._free(content.name), None, content)))
            case Group() | Exact() | Many():
                return Member(node, self._put(self._record(content, standing=True)))
            case Region():
                return self._member(node, content.content, choices)
            case Select():
                return self._select(node, content)

    def _scalar(self, node: Scalar, select: Select | None) -> str:
        name, names = self._free(node.name), node.names
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
        made = NodeIdTextField(self._free(stem), "", node) if is_node_id else OctetsField(self._free(stem), b"", node)
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
                made: Any = OctetsField(self._free(label), b"", case)
            else:
                made = self._record(case, standing=False)
            names[label] = self._put(ChosenField(made, _condition(self._free(select.key), made.name)))
        return Member(node, choices=names)

    def _record(self, node: Node, *, standing: bool) -> Any:
        """Return a field of one record or a list of them; one that is always present (``standing``) has a default."""
        if isinstance(node, Many):
            return RecordListField(self._free(node.name), [], self.packets[node.element.type_name])
        group = node.content if isinstance(node, Exact) else node
        assert isinstance(group, Group)
        packet = self.packets[group.type_name]
        return RecordField(self._free(node.name), packet() if standing else None, packet)

    def _free(self, name: str) -> str:
        return f"{name}_" if hasattr(self.base, name) else name

    def _put(self, made: Any) -> str:
        self.desc.append(made)
        return str(made.name)


def content_of(node: Node) -> Node:
    """Return the content of a region, or the node itself."""
    return node.content if isinstance(node, Region) else node


def _last(reference: str) -> str:
    return reference.rsplit(".", 1)[-1]


def _condition(key: str, name: str) -> Any:
    return lambda packet: packet.chosen(key) == name
