"""Markdown as text: tables and headings of generated pages."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from dcp_spec import markdown


def cell(text: str) -> str:
    """Return text on one line that does not end a table cell and holds no HTML."""
    return re.sub(r"\s+", " ", text).strip().replace("|", "\\|").replace("<", "&lt;")


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; the cells may hold Markdown, and are put on one line."""
    return markdown.table(columns, ([cell(each) for each in row] for row in rows))


def code(text: str) -> str:
    """Return text in reStructuredText's double backquotes as Markdown, references as plain code."""
    text = re.sub(r":[a-z:]+:`~?\.?([^`]+)`", r"`\1`", text)
    return text.replace("``", "`")


def page(title: str, *parts: str) -> str:
    """Return a page with a title."""
    return "\n\n".join([f"# {title}", *(part.strip("\n") for part in parts if part.strip())]) + "\n"
