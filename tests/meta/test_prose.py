"""The English of revised folders stays free of the expressions in ``prose.PATTERNS``."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def _load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("meta_prose", Path(__file__).with_name("prose.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


prose = _load()


@pytest.mark.parametrize("folder", prose.FOLDERS)
def test_a_package_has_no_hits(folder: str):
    found = prose.hits_in(folder)
    assert not found, "\n" + "\n".join(map(str, found))


def test_every_package_is_checked():
    assert all(any((prose.ROOT / each).rglob("*.py")) for each in prose.FOLDERS)


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ('"""Padding behind the end of a beacon."""', "behind"),
        ("# A client is told\n# of its payload.", "is told"),
        ('check(x, f"{n} payloads are sent on")', "sent on"),
        ('check(x, "both payloads", f"they are")', "they are"),
        ('"""What comes from it."""', "What comes from it."),
        ('"""Who lost a container."""', "Who lost"),
    ],
)
def test_an_expression_is_found(tmp_path: Path, source: str, found: str):
    path = tmp_path / "module.py"
    path.write_text(source + "\n", "utf-8")
    assert found in [hit.found for hit in prose.hits(path)]


@pytest.mark.parametrize(
    "source",
    [
        '"""Padding after the end of a beacon."""',
        '"""What happens to seqno while the link is down?"""',
        '"""Padding cannot be told from a further block."""',
        "behind = tells = 1",
        'check(x, "BP-RX-14", f"{behind} octets")',
    ],
)
def test_other_text_is_not_found(tmp_path: Path, source: str):
    path = tmp_path / "module.py"
    path.write_text(source + "\n", "utf-8")
    assert not list(prose.hits(path))


def test_the_output_counts_hits_per_package(capsys: pytest.CaptureFixture[str]):
    assert prose.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines] == [["0", each] for each in prose.FOLDERS]
