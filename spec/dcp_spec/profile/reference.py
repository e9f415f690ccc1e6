"""Write the reference of the profile format from the types in :mod:`dcp_spec.profile.definition`.

``python -m dcp_spec.profile.reference FILE`` writes ``docs/profile-reference.md``; a test fails if the page is not what
the types say.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from msgspec import inspect as ms

from dcp_spec.markdown import table

from .definition import Profile
from .loading import load_profile, profile_names

#: Heading of a section of the page, and a complete profile that shows its keys; each example is loaded by a test.
EXAMPLES: dict[str, tuple[str, str]] = {
    "": (
        "A profile of your own that differs from a built-in one in one thing",
        """
extends = "cpp-2.0"
name = "mine"
title = "Our fork of the C++ implementation"
[types]
var_id = { width = 2, byte_order = "little" }
""",
    ),
    "link": ("Another EtherType", "[link]\nether_type = 0x88B5\n"),
    "types": (
        "Sixteen-bit variable identifiers, and time stamps in microseconds since start-up",
        '[types]\nvar_id = { width = 2 }\ntimestamp = { width = 8, unit = "us", epoch = "boot" }\n',
    ),
    "bp": (
        "A hop count in the beacon header, and two octets of padding in each payload header",
        """
[bp]
header = ["version", "magicNo", "senderId", "networkId", "length", "numPayloads", "seqno",
          { name = "hops", extra = { width = 1 }, note = "times the beacon was repeated" }]
payload_header = ["protocolId", { name = "gap", opaque = 2 }, "length"]
""",
    ),
    "srp": (
        "A battery voltage in the safety data. To describe 40 octets without known fields, write "
        '`record = [{ name = "pattern", opaque = 40 }]`; for octets of any number, `record = []`',
        """
[srp]
safety_data = [
    { name = "x", type = "f64", unit = "m", role = "position.x" },
    { name = "y", type = "f64", unit = "m", role = "position.y" },
    { name = "z", type = "f64", unit = "m", role = "position.z" },
    { name = "battery", type = "u16", unit = "mV" },
]
""",
    ),
    "vardis": (
        "A container type of your own",
        """
[[vardis.own_containers]]
name = "GEO-FENCE"
number = 9
record = [
    "varId",
    { name = "lat", extra = { width = 4, signed = true }, unit = "1e-7 deg" },
    { name = "lon", extra = { width = 4, signed = true }, unit = "1e-7 deg" },
    { name = "radius", real = { width = 4 }, unit = "m" },
    { name = "label", block = { lengths = [{ width = 1 }] }, text = true },
]
""",
    ),
    "vardis.container_types": ("Numbers from another draft", "[vardis.container_types]\nSUMMARIES = 16\n"),
    "vardis.records": (
        "The age of each summarised value",
        '[vardis.records]\nVarSumm = ["varId", "seqno", { name = "age", extra = { width = 2 }, unit = "ms" }]\n',
    ),
    "limits": ("A node with little memory", "[limits]\nmax_variables = 16\nmax_value_length = 8\n"),
    "behaviour": ("A receiver that drops damaged payloads", '[behaviour]\nvardis_receive_error = "drop-payload"\n'),
}

_HEAD = """# Reference of wire profiles

<!-- Written by `python -m dcp_spec.profile.reference docs/profile-reference.md` from dcp_spec/profile/definition.py.
-->

A wire profile is a TOML file that describes the octets of one implementation. All tools take one with `--profile FILE`.
`extends = "NAME"` (a built-in profile, or another file relative to this one) takes over every key that the file does
not state; tables are merged key by key, lists are replaced. An unknown key, a value out of bounds and keys that
contradict each other are errors that name the file and the key.

* `dcp-codec profiles` lists the built-in profiles; `dcp-codec profiles NAME --format toml` shows one with all keys.
* `dcp-codec profiles FILE` checks a file and shows its layout.
* `dcp-codec profiles new NAME --from RECORDING` writes a draft from a recording and checks it against the recording.

Fields and containers of your own are decoded by all tools of `dcp-codec`. Nodes store and forward the fields of
records; in records of their own they send what the application gives, or zeros. A node and the test suite refuse a
profile with fields in the headers of beacons and payloads and blocks of octets in records, and name the key; they send
octets without a meaning (`opaque`) as zeros.

Built-in profiles:
"""


def reference() -> str:
    """The page as Markdown."""
    out = [_HEAD + "\n".join(f"`{name}`: {load_profile(name).title}.  " for name in profile_names()).rstrip()]
    shared: dict[str, ms.StructType] = {}
    top = ms.type_info(Profile)
    assert isinstance(top, ms.StructType)
    out += _section("", top, shared)
    out.append("## Values that several keys share")
    done: set[str] = set()
    while waiting := [name for name in shared if name not in done]:
        for name in waiting:
            done.add(name)
            out.append(f"### {name}\n\n{_about(shared[name])}")
            out.append(_table(shared[name], shared))
    return "\n\n".join(out) + "\n"


def _section(path: str, struct: ms.StructType, shared: dict[str, ms.StructType]) -> list[str]:
    out = [f"## [{path}]" if path else "## Top level", _about(struct), _table(struct, shared, path)]
    if path in EXAMPLES:
        what, text = EXAMPLES[path]
        out.append(f"{what}:\n\n```toml\n{text.strip()}\n```")
    for field in struct.fields:
        inner = _plain(field.type)
        if isinstance(inner, ms.StructType) and _is_section(path, field):
            out += _section(f"{path}.{field.encode_name}".lstrip("."), inner, shared)
    return out


def _is_section(path: str, field: ms.Field) -> bool:
    """Tables of the file have sections of their own; small inline tables are listed once, at the end."""
    return path == "" or (path == "vardis" and field.encode_name in ("container_types", "records"))


def _about(struct: ms.StructType) -> str:
    text = inspect.cleandoc(struct.cls.__doc__ or "").partition("See the module docstring")[0].strip()
    return text.replace("``", "`")


def _table(struct: ms.StructType, shared: dict[str, ms.StructType], path: str = "-") -> str:
    rows: list[tuple[str, ...]] = []
    if path == "":
        rows.append(("`extends`", "text", "", "Profile or file (relative to this one) that this one is based on."))
    for field in struct.fields:
        section = isinstance(_plain(field.type), ms.StructType) and _is_section(path, field)
        anchor = f"{path}.{field.encode_name}".lstrip(".")
        kind = f"table [`[{anchor}]`](#{anchor.replace('.', '')})" if section else _kind(field.type, shared)
        default = "see there" if section and not field.required else _default(field)
        rows.append((f"`{field.encode_name}`", kind, default, _meaning(field.type)))
    return table(("key", "type", "default", "meaning"), rows)


def _plain(kind: ms.Type) -> ms.Type:
    return _plain(kind.type) if isinstance(kind, ms.Metadata) else kind


def _meaning(kind: ms.Type) -> str:
    if isinstance(kind, ms.Metadata):
        return str((kind.extra_json_schema or {}).get("description", "")) or _meaning(kind.type)
    return ""


def _default(field: ms.Field) -> str:
    if field.required:
        return "required"
    value = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()
    if value is None:
        return "none"
    return f"`{_toml(msgspec.to_builtins(value))}`"


def _toml(value: Any) -> str:
    """Return a value in TOML on one line; keys without a value are left out."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case dict():
            return "{ " + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items() if each is not None) + " }"
        case list() | tuple():
            return "[" + ", ".join(map(_toml, value)) + "]"
        case _:
            return str(value)


def _kind(kind: ms.Type, shared: dict[str, ms.StructType]) -> str:
    match kind:
        case ms.Metadata():
            return _kind(kind.type, shared)
        case ms.IntType():
            return " ".join(["integer", *_bounds(kind)])
        case ms.BoolType():
            return "true or false"
        case ms.StrType():
            return "text"
        case ms.LiteralType():
            return ", ".join(f"`{_toml(value)}`" for value in kind.values)
        case ms.EnumType():
            return ", ".join(f'`"{each.value}"`' for each in kind.cls)
        case ms.StructType():
            shared.setdefault(kind.cls.__name__, kind)
            return f"[{kind.cls.__name__}](#{kind.cls.__name__.lower()})"
        case ms.VarTupleType():
            return f"list of {_kind(kind.item_type, shared)}"
        case ms.UnionType():
            return " or ".join(_kind(each, shared) for each in kind.types if not isinstance(each, ms.NoneType))
        case _:
            raise TypeError(f"the reference cannot describe {kind}")


def _bounds(kind: ms.IntType) -> Iterator[str]:
    if kind.ge is not None and kind.le is not None:
        yield f"{_number(kind.ge)} to {_number(kind.le)}"
    elif kind.ge is not None:
        yield f"from {_number(kind.ge)}"


def _number(number: int) -> str:
    return f"{number:#06x}" if number >= 0x0600 else str(number)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference(), encoding="utf-8")
