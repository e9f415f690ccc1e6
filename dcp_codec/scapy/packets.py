"""Scapy packets that are generated from a plan.

:class:`PlanPacket` fills the scapy fields of a record (:mod:`dcp_codec.scapy.shape`) from a dissection of
:mod:`dcp_codec.views.dissect` and builds octets from them. The module uses the node types of :mod:`dcp_codec.plan.tree`
and does not depend on DCP. Octets that belong to no field become ``Raw`` after the record, or at the end of the list
that contained them.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, ClassVar

from scapy.config import conf
from scapy.fields import ConditionalField, RawVal
from scapy.packet import Packet, Raw
from scapy.volatile import VolatileValue

from dcp_codec.plan.tree import Group, Many, Node, Rest, Select, Text
from dcp_codec.views.dissect import dissect
from dcp_codec.views.fields import Field as Found

from .fields import Octets
from .shape import Following, Member, Shape, content_of


class PlanPacket(Packet):
    """A record of the current profile as a scapy packet.

    Derived fields are None until the user sets them; a set value is sent, right or wrong. Dissection accepts any
    octets. Building raises ``ValueError`` for a value that its field cannot hold, and ``RuntimeError`` for a packet
    that was made under another profile.
    """

    #: The record in the plan, and its scapy fields; both are set when a profile is selected.
    layout: ClassVar[Node]
    shape: ClassVar[Shape]
    __signature__: ClassVar[inspect.Signature]

    @classmethod
    def lay_out(cls, layout: Node, shape: Shape) -> None:
        """Replace the fields of the class. Existing packets of the class cannot be built any more."""
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
        """Return the field of the current content: the one that was set, else the one that the field ``key``
        selects.
        """
        member = self.shape.chosen[key]
        choices, select = member.choices or {}, content_of(member.node)
        for name in choices.values():
            value = self.getfieldval(name)
            if isinstance(value, VolatileValue) or value:
                return name
        number, case = self.getfieldval(key), None
        if isinstance(select, Select):
            case = select.cases.get(number, select.default) if isinstance(number, int) else select.default
        return choices[case.name] if case is not None else next(iter(choices.values()))

    def _choice(self, member: Member) -> int:
        """Return the number for the current content, 0 if it has none."""
        select = content_of(member.node)
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
                    if other != attr and self._field(other).islist:
                        self.fields[other] = []
                    elif other != attr:
                        self.fields.pop(other, None)

    # -- building -------------------------------------------------------------------------------------------------

    def copy(self) -> Any:
        self._check()
        return super().copy()

    def clone_with(self, *args: Any, **fields: Any) -> Any:
        self._check()
        return super().clone_with(*args, **fields)

    def do_build(self) -> bytes:
        self._check()
        return bytes(super().do_build())

    def _check(self) -> None:
        # Scapy would copy the values of one layout into fields of the other.
        if any(self.fieldtype.get(each.name) is not each for each in self.shape.desc):
            raise RuntimeError(f"this {type(self).__name__} was made under another profile: make it again")

    def self_build(self) -> bytes:
        # Every field is built once, so that random values do not change between a content and its length.
        built: dict[str, bytes] = {}
        missing: list[str] = []
        for each in self.shape.desc:
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
        """Return the value of a derived field."""
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
        """Set all lengths and counts to None, here and in all inner records; building then derives them."""
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
        """Set the fields from a dissected record, and keep the octets after it up to ``end``."""
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
            # The dissector skips octets that it cannot interpret; the next part starts where it continued.
            stop = parts[index + 1].offset if index + 1 < len(parts) else end
            if member.opened:
                last = self._fill_members(member.opened, part, stop, octets)
            else:
                last = self._take(member, part, stop, octets)
        return last

    def _take(self, member: Member, part: Found, stop: int, octets: bytes) -> int:
        """Set the fields of a member; return the offset after their octets."""
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
        packet: PlanPacket = self.shape.packets[part.layout.type_name]()
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
        """Mark a member as absent."""
        for each in member.flat():
            if each.choices:
                continue
            for name in (*each.lengths, each.name):
                self.fields[name] = [] if self._field(name).islist else Octets()


# The base class has no layout; scapy must not list it as a layer.
conf.layers.remove(PlanPacket)
conf.layers.ldict.pop(__name__, None)
PlanPacket.layout = Group("", "", (), 0)
PlanPacket.shape = Shape(Group("", "", (), 0), packets={}, representation="mac", defaults={})
