"""The bench connects its parts and has no behaviour of its own."""

from __future__ import annotations

import ast
from pathlib import Path

from dcp_conformance import test_system

FOLDER = Path(test_system.__file__).parent


def test_no_part_imports_the_bench_or_the_session():
    found = []
    for path in FOLDER.rglob("*.py"):
        if path.name in ("bench.py", "session.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").endswith(("bench", "session")):
                found.append(f"{path.name}: {node.module}")
    assert found == []


def test_no_part_has_many_members():
    """The bench had more than a hundred before it was divided."""
    most = {}
    for path in FOLDER.rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef):
                methods = [each.name for each in node.body if isinstance(each, ast.FunctionDef)]
                most[node.name] = sum(not name.startswith("_") for name in methods)
    assert most["Bench"] <= 3
    assert {name: count for name, count in most.items() if count > 16} == {}
