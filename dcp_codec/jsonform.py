"""Messages as JSON objects with the specification's field names, and the conversion back.

Octets are lower-case hex. Node identifiers are ``02:00:00:00:00:01``, hex or text, depending on the profile; octets of
a text that are not UTF-8 are written ``\xff``. Time stamps are integers in the unit of the profile. Descriptions are
text; one that is not UTF-8 is given as hex under ``descrHex``. Floats without a JSON number are the strings ``"NaN"``,
``"Infinity"`` and ``"-Infinity"``.
"""

from __future__ import annotations

import math
import re
from typing import Any

import msgspec

from .codec import Codec
from .errors import EncodeError, Problem
from .plan.layout import ValueTypes
from .plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text
from .values import Beacon
from .views.fields import Field

#: The layouts that can have a role. A tuple, because a union would be built again at each isinstance().
_ROLES = (Scalar, Text)
_FLOATS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


# -- dissection -> JSON -----------------------------------------------------------------------------------------


def field_json(field: Field, representation: str = "mac") -> Any:
    """Return the JSON value of a dissected field; parts that are cut off are null or missing."""
    layout = field.layout
    if isinstance(layout, Group):
        return members_json(field, representation)
    if isinstance(layout, Many):
        return [members_json(child, representation) for child in field.children]
    return scalar_json(layout, field.value, representation)


def members_json(record: Field, representation: str = "mac") -> dict[str, Any]:
    """Return the JSON object of a dissected record."""
    found: dict[str, Any] = {}
    for child in record.children:
        layout, value = child.layout, child.value
        if isinstance(layout, Scalar):
            # Fast path: most fields are plain numbers.
            found[child.name] = value if type(value) is int else scalar_json(layout, value, representation)
            if layout.name_field is not None and child.label is not None:
                found[layout.name_field] = child.label
        elif isinstance(layout, Text) and layout.human and layout.role != "node-id" and not _is_utf8(value):
            found[f"{child.name}Hex"] = value.hex()
        else:
            found[child.name] = field_json(child, representation)
    return found


def _is_utf8(octets: bytes | None) -> bool:
    try:
        return octets is None or bool(octets.decode() is not None)
    except UnicodeDecodeError:
        return False


def scalar_json(layout: Node, value: Any, representation: str) -> Any:
    """Return the JSON value of one number, string or run of octets."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if not isinstance(value, bytes):
        return value
    if isinstance(layout, _ROLES) and layout.role == "node-id":
        return node_id_text(value, representation)
    if isinstance(layout, Text) and layout.human:
        return value.decode(errors="backslashreplace")
    return value.hex()


def node_id_text(node_id: bytes, representation: str) -> str:
    """Format a node identifier; :func:`node_id_octets` is the inverse."""
    if representation == "text":
        # Escape a backslash that would be read as the start of an escape.
        return re.sub(rb"\\(?=x[0-9a-f]{2})", rb"\\x5c", node_id).decode(errors="backslashreplace")
    return node_id.hex(":") if representation == "mac" else node_id.hex()


def node_id_octets(text: str, representation: str) -> bytes:
    """Parse a node identifier. Raises ValueError if it is not hex, unless the representation is text."""
    if representation == "text":
        return re.sub(rb"\\x([0-9a-f]{2})", lambda found: bytes.fromhex(found[1].decode()), text.encode())
    return bytes.fromhex(text.replace(":", ""))


def problem_json(problem: Problem) -> dict[str, Any]:
    """Return the JSON object of a problem: reason, path, offset, needed, available, requirement."""
    found = msgspec.structs.asdict(problem)
    del found["severity"]
    return found


def beacon_json(codec: Codec, root: Field) -> dict[str, Any]:
    """Return the members ``bp`` and ``payloads`` of a dissected beacon."""
    return members_json(root, codec.profile.types.node_id.representation)


def value_json(codec: Codec, beacon: Beacon) -> dict[str, Any]:
    """Return a beacon as the JSON object that ``dcp-codec decode`` prints. Raises EncodeError if it has no encoding."""
    return beacon_json(codec, codec.dissect(codec.encode(beacon)).root)


# -- JSON -> value ----------------------------------------------------------------------------------------------


def beacon_from_json(codec: Codec, data: Any) -> Beacon:
    """Return the beacon that a JSON object describes by ``bp`` and ``payloads``; all other members are ignored.

    Derived members (lengths, counts, version, magicNo, icName) are ignored and may be missing. Raises
    :class:`~dcp_codec.errors.EncodeError` naming the member that is missing or has the wrong form.
    """
    beacon: Beacon = _Reader(codec.types, codec.profile.types.node_id.representation).node(
        codec.beacon_plan, data, "", {}
    )
    return beacon


class _Reader:
    def __init__(self, types: ValueTypes, representation: str) -> None:
        self.types = types
        self.representation = representation

    def node(self, node: Node, data: Any, path: str, siblings: dict[str, Any]) -> Any:
        match node:
            case Scalar():
                return self.scalar(node, data, path)
            case Text():
                return self.text(node, data, path)
            case Rest() | Fill():
                return self.octets(data, path)
            case Group():
                return self.group(node, data, path)
            case Exact():
                return self.group(node.content, data, path)
            case Many():
                if not isinstance(data, list):
                    raise EncodeError(path, f"needs a list, not {_kind(data)}")
                return tuple(self.group(node.element, item, f"{path}[{index}]") for index, item in enumerate(data))
            case Region():
                return self.node(node.content, data, path, siblings)
            case Select():
                case = node.cases.get(siblings[node.key], node.default)
                if case is None:
                    known = ", ".join(str(number) for number in sorted(node.cases))
                    raise EncodeError(path, f"{node.key} {siblings[node.key]} is not one of {known}")
                return self.node(case, data, path, siblings)

    def scalar(self, scalar: Scalar, data: Any, path: str) -> Any:
        if scalar.kind == "bytes":
            return self.octets(data, path)
        if scalar.kind == "float" and isinstance(data, str) and data in _FLOATS:
            return _FLOATS[data]
        wanted = int if scalar.kind == "int" else (int, float)
        if isinstance(data, bool) or not isinstance(data, wanted):
            raise EncodeError(path, f"needs {'an integer' if scalar.kind == 'int' else 'a number'}, not {_kind(data)}")
        return data

    def text(self, text: Text, data: Any, path: str) -> bytes:
        is_node_id = text.role == "node-id"
        if not text.human or (is_node_id and self.representation != "text"):
            return self.octets(data, path)
        if not isinstance(data, str):
            raise EncodeError(path, f"needs a string, not {_kind(data)}")
        try:
            return node_id_octets(data, "text") if is_node_id else data.encode()
        except UnicodeEncodeError:
            raise EncodeError(path, "contains a character that UTF-8 cannot encode") from None

    def octets(self, data: Any, path: str) -> bytes:
        if not isinstance(data, str):
            raise EncodeError(path, f"needs octets as a hex string, not {_kind(data)}")
        try:
            return bytes.fromhex(data.replace(":", ""))
        except ValueError:
            raise EncodeError(path, f"{data!r} is not hex") from None

    def group(self, group: Group, data: Any, path: str) -> Any:
        if not isinstance(data, dict):
            raise EncodeError(path, f"needs an object, not {_kind(data)}")
        names, foreign = self.types.slots(group)
        values: dict[str, Any] = {}
        extra: list[Any] = []
        siblings: dict[str, Any] = {}
        for member in group.members:
            attribute = self.types.attribute(group, member)
            if attribute is None and member not in foreign:
                continue
            value = self.member(member, data, path, siblings)
            siblings[member.name] = value
            if attribute is None:
                extra.append(value)
            else:
                values[attribute] = value
        if foreign and any(value is not None for value in extra):
            missing = [member.name for member, value in zip(foreign, extra, strict=True) if value is None]
            if missing:
                raise EncodeError(f"{path}.{missing[0]}".lstrip("."), "is missing; give all extra fields or none")
            values["extra"] = tuple(extra)
        if "bp" in names:
            values.setdefault("bp", None)
        return self.types[group.type_name](**values)

    def member(self, member: Node, data: dict[str, Any], path: str, siblings: dict[str, Any]) -> Any:
        """Return the value of one member; None for an extra field that is not given."""
        name = self.label(member, siblings)
        here = f"{path}.{name}" if path else name
        if f"{name}Hex" in data and isinstance(member, Text):
            return self.octets(data[f"{name}Hex"], f"{here}Hex")
        if name not in data:
            optional = isinstance(member, Fill) or (
                isinstance(member, Scalar | Text) and member.role in ("opaque", "extra")
            )
            if optional:
                return None
            raise EncodeError(here, "is missing")
        return self.node(member, data[name], here, siblings)

    def label(self, member: Node, siblings: dict[str, Any]) -> str:
        """Return the JSON name of a member; a chosen content has the label of the choice."""
        content = member.content if isinstance(member, Region) else member
        if not isinstance(content, Select):
            return member.name
        case = content.cases.get(siblings[content.key], content.default)
        return case.name if case is not None else member.name


def _kind(data: Any) -> str:
    return {dict: "an object", list: "a list", str: "a string", bool: "a boolean", type(None): "null"}.get(
        type(data), "a number"
    )
