"""The bench connects its parts and has no behaviour of its own."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path

from dcp_conformance import test_system
from dcp_conformance.definitions.case import Case, all_cases, cases_of
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Bench, Session

from dcp_codec import get_codec

FOLDER = Path(test_system.__file__).parent
PAGE = Path(__file__).parents[3] / "docs" / "extending.md"


def session() -> tuple[Session, InProcess]:
    codec = get_codec("dcp-2.0")
    sut = InProcess(reference_config(codec))
    return Session(codec, sut.lower_tester(), sut.upper_tester(), Pics()), sut


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


def test_the_parts_of_the_documents_exist():
    bench = Bench(session()[0], next(iter(all_cases().values())))
    page = PAGE.read_text(encoding="utf-8")
    names = re.findall(r"`bench\.(\w+)`", page)
    assert len(names) >= 10
    assert [name for name in names if not hasattr(bench, name)] == []


def test_the_case_of_the_documents_passes(tmp_path: Path):
    [text] = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    [found] = cases_in(text, tmp_path)
    run, sut = session()
    runner = Runner(run, sut)
    runner.prepare()
    assert runner.run(found).verdict is Verdict.PASS


def cases_in(text: str, folder: Path) -> list[Case]:
    """Return the cases of a module with this source text."""
    path = folder / "documented.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("documented", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return list(cases_of(module))
