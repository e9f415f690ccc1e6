"""YAML in the style of ``.ksy`` files: in the given order, with hexadecimal numbers and block texts."""

from __future__ import annotations

from typing import Any

import yaml


class Hex(int):
    """An integer that is written in hexadecimal."""


class _Dumper(yaml.SafeDumper):
    """Dumper with the representations below; it repeats equal values instead of using aliases."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - the signature is PyYAML's
        return True

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:  # noqa: ARG002
        # Lists are indented under their key, as in Kaitai's own format gallery.
        super().increase_indent(flow, indentless=False)


def _hex(dumper: _Dumper, number: Hex) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:int", f"{number:#x}")


def _text(dumper: _Dumper, text: str) -> yaml.Node:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(Hex, _hex)
_Dumper.add_representer(str, _text)


def dump(document: dict[str, Any], remark: str) -> str:
    """Return the text of a document, after a comment of one line."""
    text: str = yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    return f"# {' '.join(remark.split())}\n{text}"
