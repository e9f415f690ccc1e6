"""Generate tables of the keys of typed files from msgspec structs and the docstrings of their fields."""

from __future__ import annotations

import ast
import inspect
import textwrap

import msgspec
from dcp_conformance.definitions.pics import Access, Capabilities, Target, Testing
from msgspec import inspect as ms

from .markdown import code, page, table

_EXAMPLE = """```toml
[sut]
name = "my-node"
version = "1.4"

[access]
interface = "uwb0"
ut = "unix:/run/my-node.sock"
start = "build/my-node uwb0"

[pics]
multiple_payloads = true
srp = false

[pixit]
profile = "cpp-2.0"
node_id = "02:00:00:00:00:01"
beacon_period_ms = 100.0
```"""


def pics_page() -> str:
    """Return the page of all keys of a PICS and PIXIT file."""
    return page(
        "PICS and PIXIT",
        "One TOML file says what an implementation claims (PICS) and what its tester must know (PIXIT); see the "
        "[glossary](../glossary.md). Pass it to `dcp-conformance run --pics FILE`; `dcp-conformance probe` drafts one. "
        "An unknown key is an error.",
        _EXAMPLE,
        "## `[sut]`: which implementation this is",
        struct_table(Target),
        "## `[access]`: how the tester reaches it",
        "With this table, `run --pics FILE` needs no further options. An option of the same name replaces its value.",
        struct_table(Access),
        "## `[pics]`: what it claims",
        "A capability that is left out is neither claimed nor denied: a case that needs it is reported as not "
        "applicable.",
        struct_table(Capabilities),
        "## `[pixit]`: what the tester must know",
        "A key that is left out has the value of the profile, or the tester asks the implementation.",
        struct_table(Testing),
    )


def struct_table(struct: type[msgspec.Struct]) -> str:
    """Return key, type, default and meaning of each field of a struct."""
    info = ms.type_info(struct)
    assert isinstance(info, ms.StructType)
    about = field_docs(struct)
    rows = [
        (f"`{each.encode_name}`", kind(each.type), _default(each), about.get(each.name, "")) for each in info.fields
    ]
    return table(("Key", "Type", "Default", "Meaning"), rows)


def field_docs(struct: type) -> dict[str, str]:
    """Return the docstring that follows each annotated field in the source of a class."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(struct))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, after in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(after, ast.Expr):
            text = ast.literal_eval(after.value)
            found[field.target.id] = code(inspect.cleandoc(text))
    return found


def kind(of: ms.Type) -> str:
    """Return a type and its bounds as words. Raises ``TypeError`` for a type that no file has."""
    match of:
        case ms.Metadata():
            return kind(of.type)
        case ms.BoolType():
            return "true or false"
        case ms.IntType() | ms.FloatType():
            word = "integer" if isinstance(of, ms.IntType) else "number"
            low = f" from {of.ge:g}" if of.ge is not None else f" above {of.gt:g}" if of.gt is not None else ""
            return word + low + (f" to {of.le:g}" if of.le is not None else "")
        case ms.StrType():
            return "text"
        case ms.LiteralType():
            return ", ".join(f'`"{value}"`' for value in of.values)
        case ms.TupleType():
            return "list of " + ", ".join(kind(each) for each in of.item_types)
        case ms.UnionType():
            return " or ".join(kind(each) for each in of.types if not isinstance(each, ms.NoneType))
        case _:
            raise TypeError(f"the reference cannot describe {of}")


def _default(field: ms.Field) -> str:
    if field.required:
        return "required"
    return "" if field.default in (None, "") else f"`{msgspec.json.encode(field.default).decode()}`"
