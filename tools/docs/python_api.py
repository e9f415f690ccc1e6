"""Generate the reference of the public Python interface: the names in ``__all__`` of the packages."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import griffe

from .markdown import code, page

PACKAGES = ("dcp_codec", "dcp_stack", "dcp_conformance", "dcp_tables", "dcp_spec")


def python_page(root: Path) -> str:
    """Return the page. ``root``: the repository; nothing is imported."""
    loader = griffe.GriffeLoader(search_paths=[root, root / "spec", root / "conformance", root / "tables"])
    parts = ["Stable names, and for how long: [Stability](../stability.md). Times are integers in ns unless stated."]
    for name in PACKAGES:
        package = loader.load(name)
        assert isinstance(package, griffe.Module)
        parts += [f"## {name}", _doc(package)]
        for member in sorted(str(each) for each in package.exports or ()):
            found = package[member]
            target = found.final_target if isinstance(found, griffe.Alias) else found
            parts += _described(target, f"{name}.{member}")
    return page("Python", *parts)


def _described(it: griffe.Object, path: str) -> Iterator[str]:
    yield f"### {path}"
    if isinstance(it, griffe.Class):
        bases = ", ".join(str(each) for each in it.bases)
        yield _source(f"class {it.name}({bases})" if bases else f"class {it.name}")
        yield _doc(it)
        fields = [each for each in it.members.values() if isinstance(each, griffe.Attribute) and _public(each.name)]
        yield "\n".join(_field(each) for each in fields)
        for each in it.members.values():
            if isinstance(each, griffe.Function) and (_public(each.name) or each.name == "__init__"):
                yield f"#### {path}.{each.name}" if each.name != "__init__" else ""
                yield _source(_signature(each))
                yield _doc(each)
    elif isinstance(it, griffe.Function):
        yield _source(_signature(it))
        yield _doc(it)
    elif isinstance(it, griffe.Attribute):
        yield _source(f"{it.name} = {it.value}")
        yield _doc(it)


def _public(name: str) -> bool:
    return not name.startswith("_")


def _field(it: griffe.Attribute) -> str:
    about = " ".join(_doc(it).split())
    kind = f": {it.annotation}" if it.annotation else ""
    default = f" = {it.value}" if it.value is not None and len(str(it.value)) < 60 else ""
    return f"* `{it.name}{kind}{default}`" + (f" {about}" if about else "")


def _signature(it: griffe.Function) -> str:
    text = it.signature()
    if len(text) > 90:
        inner, _, tail = text.removeprefix(f"{it.name}(").rpartition(")")
        text = f"{it.name}(\n    " + ",\n    ".join(_split(inner)) + f",\n){tail}"
    decorated = "".join(f"@{each.value}\n" for each in it.decorators if "property" in str(each.value))
    return f"{decorated}def {text}"


def _split(arguments: str) -> Iterator[str]:
    """The arguments at commas that are in no brackets and no text."""
    depth, start = 0, 0
    for index, letter in enumerate(arguments):
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            yield arguments[start:index].strip()
            start = index + 1
    yield arguments[start:].strip()


def _source(text: str) -> str:
    return f"```python\n{text}\n```"


def _doc(it: griffe.Object) -> str:
    """A docstring as Markdown: blocks after ``::`` become code."""
    if it.docstring is None:
        return ""
    out: list[str] = []
    block = False
    for paragraph in inspect.cleandoc(it.docstring.value).split("\n\n"):
        if block and paragraph.startswith(" "):
            out.append("```python\n" + inspect.cleandoc("\n" + paragraph) + "\n```")
            continue
        block = paragraph.endswith("::")
        out.append(code(paragraph.removesuffix(":") if block else paragraph))
    return "\n\n".join(out)
