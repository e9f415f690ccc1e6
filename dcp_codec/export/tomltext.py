"""Writer of TOML for plain data. The standard library only reads TOML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from dcp_spec.profile.definition import Profile

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_LINE = 110


def profile_toml(profile: Profile) -> str:
    """Return a profile as a file for ``load_profile``, with all keys and without a base profile."""
    return toml_text(msgspec.to_builtins(profile))


def toml_text(data: Mapping[str, Any]) -> str:
    """Return ``data`` as a TOML document that reads back as the same data; None is left out, since TOML has no null.

    Tables that contain tables get a heading, others are on one line. Raises ``TypeError`` for anything except strings,
    numbers, booleans, lists and dicts with string keys.
    """
    return "".join(line + "\n" for line in _table(data, ())).lstrip("\n")


def _table(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    lines: list[str] = []
    below: list[str] = []
    for key, value in table.items():
        here = (*path, key)
        name = ".".join(map(_key, here))
        if value is None:
            continue
        if isinstance(value, Mapping) and _has_heading(value, path):
            below += ["", f"[{name}]", *_table(value, here)]
        elif not path and isinstance(value, Sequence) and value and all(isinstance(each, Mapping) for each in value):
            for each in value:
                below += ["", f"[[{name}]]", *_table(each, here)]
        else:
            lines.append(f"{_key(key)} = {_value(value, spread=True)}")
    return lines + below


def _has_heading(table: Mapping[str, Any], path: tuple[str, ...]) -> bool:
    return not path or any(isinstance(value, Mapping) for value in table.values())


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _string(key)


def _value(value: Any, *, spread: bool = False) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _paragraphs(value) if spread and "\n" in value else _string(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, Mapping):
        pairs = [f"{_key(key)} = {_value(each)}" for key, each in value.items() if each is not None]
        return "{ " + ", ".join(pairs) + " }" if pairs else "{}"
    if isinstance(value, Sequence):
        items = [_value(each) for each in value]
        line = "[" + ", ".join(items) + "]"
        if spread and len(line) > _LINE:
            return "[\n" + "".join(f"    {item},\n" for item in items) + "]"
        return line
    raise TypeError(f"TOML has no word for a {type(value).__name__}")


def _string(text: str) -> str:
    # JSON has the same escapes except for this character.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _paragraphs(text: str) -> str:
    lines = [_string(line)[1:-1] for line in text.split("\n")]
    return '"""\n' + "\n".join(lines) + '"""'
