"""No case sets by hand whether a failure is proved: that follows from the form of the statement (the matchers)."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Folders of the cases and of the test system, except the matchers themselves.
FOLDERS = ("suite", "test_steps", "test_system", "passive", "interconnection", "execution", "fuzz")
MATCHERS = "judgement"


def by_hand(tree: ast.AST) -> list[int]:
    """Return the lines of calls with the flag ``shown``, or of the check that takes it."""
    return [
        call.lineno
        for call in ast.walk(tree)
        if isinstance(call, ast.Call)
        and ast.unparse(call.func) != "msgspec.structs.replace"
        and (
            any(each.arg == "shown" for each in call.keywords)
            or (isinstance(call.func, ast.Attribute) and ast.unparse(call.func).endswith("verdicts.check"))
        )
    ]


def test_no_flag_is_set_by_hand():
    base = ROOT / "conformance/dcp_conformance"
    paths = [path for folder in FOLDERS for path in (base / folder).rglob("*.py") if path.parent.name != MATCHERS]
    assert len(paths) > 150
    found = {
        f"{path.relative_to(ROOT)}:{line}"
        for path in paths
        for line in by_hand(ast.parse(path.read_text(encoding="utf-8")))
    }
    assert found == set()


def test_flags_would_be_found():
    code = "bench.none(found, 'none', shown=True)\nself._verdicts.check(found, 'none')\nbench.none(found, 'none')"
    assert by_hand(ast.parse(code)) == [1, 2]
