"""Run the unit tests that are marked with a requirement against changed code.

:func:`main` runs as a separate program, in an interpreter that has not imported any module of the project.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Final

#: Timeout in seconds for the tests of one requirement: a change can cause an endless loop.
_PATIENCE: Final = 240.0
#: The parts of the tests that run in virtual time (``tests/conftest.py``).
_PARTS: Final = tuple(f"--part={each}" for each in ("core", "suite", "tools", "tables"))


def checkout() -> Path | None:
    """Return the root of the checkout that contains the imported ``dcp_stack``; None without its tests."""
    spec = find_spec("dcp_stack")
    root = Path(spec.origin).parents[1] if spec is not None and spec.origin is not None else None
    return root if root is not None and (root / "tests" / "stack").is_dir() else None


def marked_files(root: Path, name: str) -> list[Path]:
    """Return the test files below ``root/tests`` with tests that are marked with the requirement ``name``.

    Folders with tests in real time are left out.
    """
    from dcp_selftest.traceability import marked

    return [
        path
        for path in sorted((root / "tests").rglob("test_*.py"))
        if path.parent.name not in ("link", "foreign", "meta") and name in marked(path.read_text(encoding="utf-8"))
    ]


def failing_test(root: Path, name: str, module: str, source: str) -> str:
    """Run the tests marked with the requirement ``name`` with ``source`` as the source of ``module``.

    Return the line of pytest about the first failed test, a note if the tests time out, or an empty text if all pass.
    """
    files = marked_files(root, name)
    if not files:
        return ""
    with tempfile.NamedTemporaryFile("w", suffix=".py", encoding="utf-8") as changed:
        changed.write(source)
        changed.flush()
        command = [sys.executable, str(Path(__file__).resolve()), module, changed.name, name, *map(str, files)]
        try:
            done = subprocess.run(  # noqa: S603 - ourselves
                command, cwd=root, capture_output=True, text=True, timeout=_PATIENCE, check=False
            )
        except subprocess.TimeoutExpired:
            return "(the tests did not end in time)"
    return next((line for line in done.stdout.splitlines() if line.startswith("FAILED ")), "")[:200]


def main(module: str, path: str, name: str, files: list[str]) -> int:
    """Run the tests in ``files`` that are marked with ``name``, with ``module`` imported from ``path``.

    Return the exit status of pytest.
    """
    import importlib.abc
    import importlib.util

    import pytest

    class Importer(importlib.abc.MetaPathFinder):
        def find_spec(
            self, fullname: str, where: Sequence[str] | None = None, target: ModuleType | None = None, /
        ) -> ModuleSpec | None:
            del where, target
            return importlib.util.spec_from_file_location(fullname, path) if fullname == module else None

    class Only:
        def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
            items[:] = [each for each in items if any(name in mark.args for mark in each.iter_markers("req"))]

    sys.meta_path.insert(0, Importer())
    options = ["-x", "-q", "--no-header", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist"]
    return int(pytest.main([*options, *_PARTS, *files], plugins=[Only()]))


if __name__ == "__main__":
    # Python puts the folder of this file first in sys.path, where its modules would hide others of the same name.
    sys.path.pop(0)
    sys.exit(main(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:]))
