"""Names, types and comments of the generated C."""

from __future__ import annotations

import re
import textwrap

from dcp_spec.catalogue.requirements import requirement

from dcp_codec.export.wording import bits_of, snake_name
from dcp_codec.plan.tree import Group, Scalar

#: Words that no member of a structure may have, in C99 and C++17, beside those that Python reserves, too.
_WORDS = frozenset(
    re.findall(
        r"\w+",
        """alignas alignof and_eq asm auto bitand bitor bool case catch char char16_t char32_t compl const const_cast
        constexpr decltype default delete do double dynamic_cast enum explicit export extern false float friend goto
        inline int long mutable namespace new noexcept not_eq nullptr operator or_eq private protected public register
        reinterpret_cast restrict short signed sizeof static static_assert static_cast struct switch template this
        thread_local throw true typedef typeid typename union unsigned using virtual void volatile wchar_t xor xor_eq
        """,
    )
)
_LINE = 100


def member_name(name: str) -> str:
    """Return the name of a structure's member: ``"numPayloads"`` -> ``"num_payloads"``."""
    plain = snake_name(name)
    return f"{plain}_" if plain in _WORDS else plain


def access(path: tuple[str, ...]) -> str:
    """Return the access to a member of the structure ``v``."""
    return "v->" + ".".join(member_name(name) for name in path)


def integer_type(scalar: Scalar) -> str:
    """Return the narrowest type of C that holds an integer of the wire."""
    return f"{'' if scalar.signed else 'u'}int{bits_of(scalar.size)}_t"


def value_type(scalar: Scalar) -> str:
    """Return the type of a member that holds a scalar."""
    if scalar.kind == "float":
        return "float" if scalar.size == 4 else "double"
    return integer_type(scalar)


def stem(group: Group) -> str:
    """Return the name of a record without prefix: ``"VarUpdate"`` -> ``"var_update"``."""
    return snake_name(group.type_name)


def cite(identifier: str | None) -> str:
    """Return a requirement with its section; empty without one."""
    return f"{requirement(identifier).section} [{identifier}]" if identifier else ""


def plain(text: str) -> str:
    """Return a text of a profile in the form that a comment can have."""
    ascii_only = " ".join(text.split()).encode("ascii", "replace").decode()
    return (
        ascii_only.replace("``", "").replace("*/", "* /").replace("/*", "/ *").replace("\\", "/").replace("??", "? ?")
    )


def comment(text: str, indent: str = "") -> list[str]:
    """Return a comment as lines."""
    lines = textwrap.wrap(plain(text), _LINE - 6 - len(indent), break_on_hyphens=False)
    if len(lines) == 1:
        return [f"{indent}/* {lines[0]} */"]
    return [f"{indent}/* {lines[0]}", *(f"{indent} * {line}" for line in lines[1:-1]), f"{indent} * {lines[-1]} */"]
