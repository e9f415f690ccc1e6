"""Command adapter files: typed, and refused with file, key and reason if they make no sense."""

from __future__ import annotations

import datetime
import functools
import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from dcp_codec.common.trust import invoking_user, untrusted_writer
from dcp_conformance.errors import UsageError

from .base import known_status

Kind = Literal["text", "int", "hex", "bool", "octets", "text-octets", "utc"]
_Positive = Annotated[float, msgspec.Meta(gt=0)]


class Reading(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How members of a result are read: a regular expression (``^`` and ``$`` match at lines) with named groups."""

    pattern: str
    member: str = ""
    """The member of the result that holds what is read; empty: the result itself."""
    types: Mapping[str, Kind] = msgspec.field(default_factory=dict)
    """The type of the text of a group; by default text."""
    complete: bool = False
    """Whether all of the output must match, so that output of another form is not taken as an empty list."""


class Method(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The command for one method, and how its outcome is read."""

    command: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    """Program and arguments; ``{name}`` stands for a parameter of the method or a setting."""
    stdin: str = ""
    timeout: _Positive | None = None
    """Seconds that the command may take."""
    defaults: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Values of parameters that a call does not have."""
    fixed: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Parameters that the command has no place for, and the value that they have then."""
    status: str | None = None
    """Finds the status: a regular expression with the group ``status``."""
    success: str | None = None
    """A pattern in the output of a successful command; without it, exit status 0 is a success."""
    ok: str | None = None
    """The status of a success; left out, the one of the protocol."""
    exits: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Statuses that exit statuses stand for."""
    errors: Mapping[str, int] = msgspec.field(default_factory=dict)
    """Regular expressions for what is a JSON-RPC error, with its code."""
    result: Reading | None = None
    rows: Reading | None = None
    """A list of records, one for each place where the expression matches."""


class Adapter(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file."""

    name: str
    methods: Mapping[str, Method]
    version: str = ""
    spec_version: str = ""
    node_id: str = ""
    notes: str = ""
    timeout: _Positive | None = None
    """Seconds that a command may take, unless it says otherwise."""
    status: str | None = None
    """As in a method, for all that have none."""
    statuses: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Statuses of the specification for what the programs say instead."""
    settings: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Values for commands that users may change, with their defaults."""


def load_adapter(name: str) -> Adapter:
    """Read a built-in adapter by its name, or a file: its path, with a ``/`` or a suffix such as ``.toml``.

    The file names programs that are executed. A file that another user can change is refused. Raises ``UsageError``.
    """
    path = Path(name)
    built_in = resources.files("dcp_conformance").joinpath("adapters")
    try:
        if "/" not in name and not path.suffix:
            data = built_in.joinpath(f"{name}.toml").read_bytes()
        else:
            if problem := untrusted_writer(path, owners=invoking_user()):
                raise UsageError(
                    f"commands:{name}: {problem}, and it names programs that the tester executes; "
                    "take away that right, or use a copy in a folder of your own"
                )
            data = path.read_bytes()
    except OSError as error:
        names = ", ".join(sorted(each.name[:-5] for each in built_in.iterdir() if each.name.endswith(".toml")))
        raise UsageError(f"commands:{name}: cannot be read: {error.strerror or error}; built in are: {names}") from None
    try:
        adapter = msgspec.toml.decode(data, type=Adapter)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"commands:{name}: {error}") from None
    for problem in _problems(adapter):
        raise UsageError(f"commands:{name}: {problem}")
    return adapter


def _problems(adapter: Adapter) -> list[str]:
    """Return the faults of a file beyond the types of its keys."""
    found: list[str] = []
    if adapter.status is not None:
        found += _pattern_problems("status", adapter.status, "status")
    found += [
        f"statuses.{key}: the specification has no status {value!r}"
        for key, value in adapter.statuses.items()
        if not known_status(value)
    ]
    known = parameters_of_methods()
    for name, method in adapter.methods.items():
        if name not in known:
            found.append(f"methods.{name}: there is no such method; see conformance/UPPER-TESTER.md")
            continue
        found += [f"methods.{name}.{each}" for each in _method_problems(adapter, method, known[name])]
    return found


def _method_problems(adapter: Adapter, method: Method, parameters: frozenset[str]) -> list[str]:
    found: list[str] = []
    for key in sorted(placeholders(method)):
        if key not in adapter.settings and key not in parameters and key.removesuffix("Text") not in parameters:
            there = ", ".join(sorted({*parameters, *adapter.settings})) or "none"
            found.append(f"command: {{{key}}} is neither a parameter of the method nor a setting; there are: {there}")
    for key in (*method.defaults, *method.fixed):
        if key not in parameters:
            found.append(
                f"{key}: the method has no such parameter; there are: {', '.join(sorted(parameters)) or 'none'}"
            )
    for key, pattern, group in (("status", method.status, "status"), ("success", method.success, "")):
        if pattern is not None:
            found += _pattern_problems(key, pattern, group)
    for pattern in method.errors:
        found += _pattern_problems("errors", pattern, "")
    for status in (*method.exits.values(), *filter(None, (method.ok,))):
        if not known_status(status):
            found.append(f"the specification has no status {status!r}")
    for key, reading in (("result", method.result), ("rows", method.rows)):
        if reading is None:
            continue
        problems = _pattern_problems(f"{key}.pattern", reading.pattern, "")
        found += problems
        if not problems:
            groups = re.compile(reading.pattern).groupindex
            found += [
                f"{key}.types.{each}: the pattern has no such group" for each in reading.types if each not in groups
            ]
        if key == "rows" and not reading.member:
            found.append("rows.member: which member of the result are the rows?")
    return found


def _pattern_problems(key: str, pattern: str, group: str) -> list[str]:
    try:
        compiled = re.compile(pattern, re.MULTILINE)
    except re.error as error:
        return [f"{key}: no regular expression: {error}"]
    return [] if not group or group in compiled.groupindex else [f"{key}: the expression has no group (?P<{group}>...)"]


def placeholders(method: Method) -> frozenset[str]:
    """Return the names in braces in a command."""
    return frozenset(re.findall(r"\{(\w+)\}", " ".join((*method.command, method.stdin))))


@functools.cache
def parameters_of_methods() -> dict[str, frozenset[str]]:
    """The parameters of each method of the contract, out of its schema."""
    text = resources.files("dcp_spec").joinpath("data", "upper-tester.schema.json").read_bytes()
    definitions: dict[str, Any] = msgspec.json.decode(text)["$defs"]
    found: dict[str, frozenset[str]] = {}
    for name, definition in definitions.items():
        if name.endswith(".request"):
            params = definition["properties"].get("params", {})
            if "$ref" in params:
                params = definitions[params["$ref"].rpartition("/")[2]]
            found[name.removesuffix(".request")] = frozenset(params.get("properties", ()))
    return found


def converted(kind: Kind, text: str) -> Any:
    """The text of a group as a value of the contract. Raises ``ValueError``.

    ``octets``: hex digits with anything between them; ``text-octets``: the octets of the text itself; ``utc``: a date
    and time as ``2026-01-31 12:00:00.123456789``, as ns since 1970.
    """
    match kind:
        case "int":
            return int(text)
        case "hex":
            return int(text, 16)
        case "bool":
            if text.lower() not in ("0", "1", "true", "false", "yes", "no"):
                raise ValueError(text)
            return text.lower() in ("1", "true", "yes")
        case "octets":
            return bytes.fromhex(re.sub(r"0x|[^0-9A-Fa-f]", "", text)).hex()
        case "text-octets":
            return text.encode().hex()
        case "utc":
            whole, _, fraction = text.strip().partition(".")
            moment = datetime.datetime.fromisoformat(whole).replace(tzinfo=datetime.UTC)
            return int(moment.timestamp()) * 1_000_000_000 + int(fraction.ljust(9, "0")[:9] or 0)
    return text
