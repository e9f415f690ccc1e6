"""JSON Schemas of the records of one plan, the parts of the documents of :mod:`dcp_codec.export.jsonschema`."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

from dcp_spec.profile.definition import Profile

from dcp_codec.plan.measures import largest, longest
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from dcp_codec.views.encode_diagnosis import bounds

from .wording import description, meaning

JSONSchema = dict[str, Any]

_Style = Literal["strict", "partial", "viewer"]

_HEX = "^(?:[0-9a-f]{2})*$"
_NOT_FINITE = "^(?:NaN|-?Infinity)$"
_FLOAT32_MAX = 3.4028234663852886e38
#: The greatest string length that is stated as a bound: no frame is longer.
_MAX_BOUND = 0xFFFF


class ViewerRecord(NamedTuple):
    """A record for a viewer: its columns, the required columns of frames without errors, and further conditions for
    such frames (``alternatives`` exclude each other; empty for none).
    """

    properties: dict[str, JSONSchema]
    required: list[str]
    alternatives: list[JSONSchema]


class RecordSchemas:
    """Schemas of the nodes of one plan in one style.

    strict: for well-formed messages. partial: for any message, with null for unreadable parts. viewer: as partial,
    without null.
    """

    def __init__(self, profile: Profile, style: _Style) -> None:
        self.profile = profile
        self.style = style
        self.defs: dict[str, JSONSchema] = {}

    # Everything that may be a member of a record.

    def member(self, node: Node, scope: Group) -> JSONSchema:
        schema = self.node(node, scope)
        return {**schema, "description": description(node, self.profile)}

    def node(self, node: Node, scope: Group) -> JSONSchema:
        match node:
            case Scalar():
                return self.scalar(node)
            case Text():
                return self.text(node)
            case Rest():
                return self.string(pattern=_HEX)
            case Fill():
                return self.string(pattern=_hex_up_to(node.total))
            case Group():
                return self.record(node)
            case Many():
                return {"type": "array", "items": self.record(node.element), **self.bounds(node, scope)}
            case Region() | Exact():
                return self.node(node.content, scope)
            case Select():
                raise TypeError("a choice has no schema of its own; the record that it is in has one")

    def types(self, name: str) -> str | list[str]:
        return [name, "null"] if self.style == "partial" else name

    def string(self, **keywords: Any) -> JSONSchema:
        return {"type": self.types("string"), **keywords}

    def scalar(self, scalar: Scalar) -> JSONSchema:
        if scalar.kind == "bytes":
            if scalar.role == "node-id" and self.profile.types.node_id.representation == "mac":
                return self.string(pattern=f"^[0-9a-f]{{2}}(?::[0-9a-f]{{2}}){{{scalar.size - 1}}}$")
            return self.string(pattern=f"^[0-9a-f]{{{2 * scalar.size}}}$")
        if scalar.kind == "float":
            return self.real(scalar)
        if self.style == "strict" and scalar.rule is not None and scalar.rule.value is not None:
            return {"type": "integer", "const": scalar.rule.value}
        low, high = bounds(scalar)
        if self.style == "strict" and scalar.rule is not None:
            low = 1
        schema: JSONSchema = {"type": self.types("integer"), "minimum": low, "maximum": high}
        if self.style == "strict" and scalar.names is not None:
            schema["enum"] = sorted(scalar.names)
        return schema

    def real(self, scalar: Scalar) -> JSONSchema:
        schema: JSONSchema = {"type": self.types("number")}
        if self.style != "viewer":
            # A pattern only applies to strings, bounds only to numbers.
            null = ["null"] if self.style == "partial" else []
            schema = {"type": ["number", "string", *null], "pattern": _NOT_FINITE}
        if scalar.size == 4:
            schema |= {"minimum": -_FLOAT32_MAX, "maximum": _FLOAT32_MAX}
        return schema

    def text(self, text: Text) -> JSONSchema:
        bound = _longest(text)
        if not text.human:
            return self.string(pattern=_hex_up_to(bound))
        if bound is None or text.role == "node-id":
            # Octets of an identifier that are not UTF-8 are printed as escapes, which take more characters.
            return self.string()
        return self.string(maxLength=bound)

    def bounds(self, node: Many, scope: Group) -> JSONSchema:
        """Return the bounds on the number of elements of a well-formed list, from its counting field."""
        counter = _find(scope, node.count or node.agrees)
        if self.style != "strict" or counter is None:
            return {"minItems": 1} if self.style == "strict" and node.nonempty else {}
        least = 1 if counter.rule is not None and counter.rule.value is None else 0
        return {"minItems": least, "maxItems": largest(counter)}

    # Records.

    def record(self, group: Group) -> JSONSchema:
        """Return the schema of a record inside another one."""
        if self.style == "viewer":
            return self.group(group)
        name = group.type_name if self.style == "strict" else f"Partial{group.type_name}"
        if name not in self.defs:
            self.defs[name] = {}  # reserves its position: outer records precede inner ones
            self.defs[name] = self.group(group)
        return {"$ref": f"#/$defs/{name}"}

    def group(self, group: Group) -> JSONSchema:
        """Return the object schema of a record."""
        properties: dict[str, JSONSchema] = {}
        required: list[str] = []
        choices: list[list[JSONSchema]] = []
        for member in group.members:
            content = member.content if isinstance(member, Region) else member
            if isinstance(content, Select):
                choices.append(self.select(content, group, properties, member.doc))
                continue
            properties[member.name] = self.member(member, group)
            if isinstance(member, Text) and member.human and member.role != "node-id":
                choices.append(self.described_in_hex(member, properties))
                continue
            required.append(member.name)
            if isinstance(member, Scalar) and member.names is not None and member.name_field is not None:
                properties[member.name_field] = self.label(member)
                required.append(member.name_field)
        requirement = f" [{group.requirement}]" if group.requirement else ""
        schema: JSONSchema = {
            "title": group.type_name,
            "description": f"{meaning(group)}{requirement}",
            "type": "object",
            "properties": properties,
        }
        if self.style == "strict":
            schema["required"] = required
            if len(choices) == 1:
                schema["oneOf"] = choices[0]
            elif choices:
                schema["allOf"] = [{"oneOf": alternatives} for alternatives in choices]
        return {**schema, "additionalProperties": False}

    def label(self, scalar: Scalar) -> JSONSchema:
        names = scalar.names or {}
        return {
            "type": "string",
            "enum": [names[number] for number in sorted(names)],
            "description": f"name of {scalar.name}",
        }

    def described_in_hex(self, text: Text, properties: dict[str, JSONSchema]) -> list[JSONSchema]:
        """Add the member for octets of a text that are not UTF-8; return that exactly one of the two is present."""
        other = f"{text.name}Hex"
        properties[other] = self.string(
            pattern=_hex_up_to(_longest(text)), description=f"{meaning(text)}: octets that are not UTF-8"
        )
        return [{"required": [text.name]}, {"required": [other]}]

    def select(self, select: Select, group: Group, properties: dict[str, JSONSchema], about: str) -> list[JSONSchema]:
        """Add the members of all contents of a choice; return the alternatives that exclude each other."""
        cases = list(select.cases.items())
        contents: dict[str, list[Node]] = {}
        for case in [*(case for _, case in cases), *([select.default] if select.default else [])]:
            contents.setdefault(case.name, []).append(case)
        for label, found in contents.items():
            properties[label] = self.union(found, group, about)
        if select.default is None and self.style != "strict":
            properties["data"] = self.string(pattern=_HEX, description="octets of a type that is not known")
        key = _find(group, select.key)
        assert key is not None
        alternatives = [
            self.alternative(key, {"const": number}, case, contents, group, number) for number, case in cases
        ]
        if select.default is not None:
            other = {"not": {"enum": sorted(select.cases)}}
            alternatives.append(self.alternative(key, other, select.default, contents, group, None))
        return alternatives

    def union(self, cases: list[Node], group: Group, about: str) -> JSONSchema:
        """Return the property that all ``cases`` share."""
        first = cases[0]
        if len(cases) == 1:
            return {**self.node(first, group), "description": description(first, self.profile)}
        elements = [case.element for case in cases if isinstance(case, Many)]
        if len(elements) != len(cases):
            raise TypeError(f"the contents called {first.name} are not all lists")
        schema: JSONSchema = {"type": "array", "description": about or "list of records"}
        if self.style == "partial":
            schema["items"] = {"anyOf": [self.record(element) for element in elements]}
        elif self.style == "viewer":
            schema["items"] = self.merged(elements)
        return schema

    def merged(self, elements: list[Group]) -> JSONSchema:
        """Return one object with the members of all ``elements``."""
        properties: dict[str, JSONSchema] = {}
        for element in elements:
            for name, schema in self.group(element)["properties"].items():
                known = properties.setdefault(name, dict(schema))
                if schema["description"] not in known["description"]:
                    known["description"] += f"; {element.type_name}: {schema['description']}"
        return {"type": "object", "title": "record", "description": "one instruction", "properties": properties}

    def alternative(
        self,
        key: Scalar,
        condition: JSONSchema,
        case: Node,
        contents: dict[str, list[Node]],
        group: Group,
        number: int | None,
    ) -> JSONSchema:
        """Return the condition for messages in which the field ``key`` chooses ``case``."""
        properties: dict[str, Any] = {key.name: condition}
        title = case.name
        if key.names is not None and key.name_field is not None and number is not None:
            title = key.names[number]
            properties[key.name_field] = {"const": title}
        if len(contents[case.name]) > 1:
            properties[case.name] = self.element_rules(case, contents[case.name], group)
        for label in contents:
            if label != case.name:
                properties[label] = False
        return {"title": title, "properties": properties, "required": [case.name]}

    def element_rules(self, case: Node, cases: list[Node], group: Group) -> JSONSchema:
        """Return the rules for the elements of the list ``case`` if one property is used for several lists."""
        assert isinstance(case, Many)
        if self.style != "viewer":
            return self.node(case, group)
        required = self.viewer_record(case.element).required
        known = {member.name for each in cases if isinstance(each, Many) for member in each.element.members}
        foreign = sorted(known - {member.name for member in case.element.members})
        rules: JSONSchema = {"required": required}
        if foreign:
            rules["properties"] = dict.fromkeys(foreign, False)
        return {"items": rules}

    def viewer_record(self, group: Group) -> ViewerRecord:
        properties = self.group(group)["properties"]
        required: list[str] = []
        alternatives: list[JSONSchema] = []
        for member in group.members:
            content = member.content if isinstance(member, Region) else member
            if isinstance(content, Select):
                alternatives = self.select(content, group, {}, member.doc)
            elif isinstance(content, Text):
                required += [] if content.human and content.role != "node-id" else [member.name]
            elif not (isinstance(content, Scalar) and content.kind == "float"):
                required.append(member.name)
                if isinstance(content, Scalar) and content.names is not None and content.name_field is not None:
                    required.append(content.name_field)
        return ViewerRecord(properties, required, alternatives)


def _longest(text: Text) -> int | None:
    """Return the maximum number of octets of a text without its NUL; None if it is unbounded."""
    most = longest(text)
    return None if most is None or most - text.terminated > _MAX_BOUND else most - text.terminated


def _hex_up_to(octets: int | None) -> str:
    return _HEX if octets is None else f"^(?:[0-9a-f]{{2}}){{0,{octets}}}$"


def _find(scope: Group, reference: str | None) -> Scalar | None:
    """Return the scalar to which a reference from a member of ``scope`` refers."""
    found: Node = scope
    for part in reference.split(".") if reference else ():
        members = found.members if isinstance(found, Group) else ()
        found = next((member for member in members if member.name == part), found)
    return found if isinstance(found, Scalar) else None
