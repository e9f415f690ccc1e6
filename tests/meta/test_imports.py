"""Imports inside each package run one way: no circles, of modules or of packages."""

from __future__ import annotations

from collections.abc import Mapping

import grimp
import pytest


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


def imports_of(package: str) -> dict[str, set[str]]:
    """Return what each module imports when it runs; imports for annotations only are left out."""
    graph = grimp.build_graph(package, exclude_type_checking_imports=True, cache_dir=None)
    return {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}


def by_package(imports: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the same for packages and modules directly below the root."""

    def top(module: str) -> str:
        return ".".join(module.split(".")[:2])

    found: dict[str, set[str]] = {}
    for module, others in imports.items():
        found.setdefault(top(module), set()).update(top(other) for other in others if "." in other)
    return {name: others - {name} for name, others in found.items() if "." in name}


@pytest.mark.parametrize("package", ["dcp_spec", "dcp_codec", "dcp_stack", "dcp_conformance"])
def test_there_are_no_import_circles(package: str):
    imports = imports_of(package)
    assert circles(imports) == []
    assert circles(by_package(imports)) == []


def test_a_circle_is_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]
