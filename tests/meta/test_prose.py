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


@pytest.mark.parametrize("folder", prose.DONE)
def test_a_revised_folder_has_no_hits(folder: str):
    found = prose.hits_in(folder)
    assert not found, "\n" + "\n".join(map(str, found))


def test_every_package_is_listed():
    """Each folder with Python files is in ``DONE`` or ``TO_DO``, or below a folder that is."""
    listed = [prose.ROOT / each for each in (*prose.DONE, *prose.TO_DO)]
    assert [each for each in listed if not each.is_file() and not any(each.rglob("*.py"))] == []
    for package in ("conformance/dcp_conformance", "dcp_codec", "dcp_stack", "spec/dcp_spec"):
        for path in (prose.ROOT / package).rglob("*.py"):
            assert any(each in path.parents for each in listed), path


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


def test_the_output_counts_hits_per_folder(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(prose, "TO_DO", prose.TO_DO[-1:])
    assert prose.main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == [*prose.DONE, *prose.TO_DO]
    assert all(line.endswith("(to do)") == (line.split()[1] in prose.TO_DO) for line in lines)
