"""Draw the layers of each package from its imports: the figure in ARCHITECTURE.md.

``python tests/meta/layers.py`` writes the figure; ``test_imports.py`` checks that it is up to date. A package or module
is one layer above the highest one that it imports, so that all imports point downwards.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "ARCHITECTURE.md"
PACKAGES = {
    "dcp_spec": "spec",
    "dcp_codec": ".",
    "dcp_stack": ".",
    "dcp_conformance": "conformance",
    "dcp_tables": "tables",
    "dcp_lab": "lab",
    "dcp_selftest": "selftest",
}
_BEGIN, _END = "<!-- layers: made by tests/meta/layers.py -->", "<!-- end of layers -->"
_WIDTH = 110


@cache
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


def layers_of(package: str) -> list[list[str]]:
    """Return the parts of a package by layer, the lowest first. Raises ``RecursionError`` for import circles."""
    imports = by_package(imports_of(package))
    level: dict[str, int] = {}

    def height(name: str) -> int:
        if name not in level:
            level[name] = 1 + max((height(other) for other in imports.get(name, ())), default=-1)
        return level[name]

    layers: dict[int, list[str]] = {}
    for name in sorted(imports):
        layers.setdefault(height(name), []).append(name.partition(".")[2])
    return [layers[number] for number in sorted(layers)]


def figure() -> str:
    """Return the figure: for each package its layers, the highest first."""
    lines = ["```"]
    for package in reversed(PACKAGES):
        lines += [package, "=" * len(package)]
        for layer in reversed(layers_of(package)):
            lines.append("  " + "   ".join(_shown(package, name) for name in layer))
        lines.append("")
    return "\n".join([*lines[:-1], "```"])


def _shown(package: str, name: str) -> str:
    return f"{name}/" if (ROOT / PACKAGES[package] / package / name).is_dir() else name


def first_line(package: str, name: str) -> str:
    """Return the first line of the docstring of a package or module."""
    path = ROOT / PACKAGES[package] / package / name
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def updated(page: str) -> str:
    """Return the page with the present figure."""
    before, _, rest = page.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return f"{before}{_BEGIN}\n{figure()}\n{_END}{after}"


if __name__ == "__main__":
    sys.setrecursionlimit(1000)
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
