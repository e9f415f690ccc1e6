"""Imports inside each package run one way: no circles, of modules or of packages."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path

import pytest

_PATH = Path(__file__).with_name("layers.py")
_SPEC = importlib.util.spec_from_file_location("meta_layers", _PATH)
assert _SPEC is not None
assert _SPEC.loader is not None
layers = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(layers)


def circles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Return the strongly connected parts of a graph with more than one node (Tarjan)."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        number[node] = low[node] = len(number)
        stack.append(node)
        for other in sorted(graph.get(node, ())):
            if other not in number:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == number[node]:
            part = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(part) > 1:
                found.append(sorted(part))

    for node in sorted(graph):
        if node not in number:
            visit(node)
    return found


@pytest.mark.parametrize("package", layers.PACKAGES)
def test_there_are_no_import_circles(package: str):
    imports = layers.imports_of(package)
    assert circles(imports) == []
    assert circles(layers.by_package(imports)) == []


def test_a_circle_is_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


def test_the_figure_of_layers_is_up_to_date():
    page = layers.PAGE.read_text(encoding="utf-8")
    assert page == layers.updated(page), "python tests/meta/layers.py writes it"


@pytest.mark.parametrize("package", layers.PACKAGES)
def test_each_part_has_a_docstring(package: str):
    parts = [name for layer in layers.layers_of(package) for name in layer]
    assert [name for name in parts if not layers.first_line(package, name)] == []
