"""Requirement ids in code and tests exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from dcp_spec.requirements import requirements

ROOT = Path(__file__).parents[2]
_CODE = [path for folder in ("spec", "dcp_codec", "dcp_stack", "conformance") for path in (ROOT / folder).rglob("*.py")]
_TESTS = list((ROOT / "tests").rglob("*.py"))
_CITED = re.compile(r"##= *([A-Z]+-[A-Z]+-\d+|[A-Z]+-\d+)")
_MARKED = re.compile(r"mark\.req\(([^)]*)\)")
_QUOTED = re.compile(r'"((?:DATA|UWB)-\d\d|(?:BP|SRP|VD)-[A-Z]+-\d\d)"')


def cited(path: Path) -> set[str]:
    text = path.read_text(encoding="utf-8")
    found = set(_CITED.findall(text)) | set(_QUOTED.findall(text))
    for group in _MARKED.findall(text):
        found |= set(re.findall(r'"([^"]+)"', group))
    return found


@pytest.mark.parametrize("path", [*_CODE, *_TESTS], ids=lambda path: str(path.relative_to(ROOT)))
def test_cited_requirements_exist(path):
    # Tests of the catalogue itself name ids that must not exist.
    if path.name in ("test_requirements.py", "test_citations.py"):
        return
    assert cited(path) - set(requirements()) == set()


def test_the_schema_cites_requirements():
    assert sum(len(cited(ROOT / "spec" / "dcp_spec" / name)) for name in ("bp.py", "srp.py", "vardis.py")) > 25
