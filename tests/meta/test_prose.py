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


def test_names_are_split_into_words(tmp_path: Path):
    path = tmp_path / "module.py"
    path.write_text("def test_nobody_waits():\n    class SentOn: ...\n", "utf-8")
    assert [hit.found for hit in prose.hits(path)] == ["nobody", "Sent On"]


def test_a_marked_text_is_exempt(tmp_path: Path):
    path = tmp_path / "module.py"
    path.write_text('check("a client is told")  # prose: data\n"""Padding behind it."""\n', "utf-8")
    assert [hit.line for hit in prose.hits(path)] == [2]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("f'{x} is' f\" {y['a b']!r}\"", [(1, "a b"), (1, "... is ...")]),
        ("# one\n#: two\n\n# three\n", [(1, "one two "), (4, "three ")]),
        (r"rb'a \' b' + 'a \'# b'", [(1, r"a \'# b")]),
        ('"""A a\nb"""\nx = "1"', [(1, "A a\nb")]),
        ("(\n    'a '\n    'b', 'c d'\n)", [(2, "a b"), (3, "c d")]),
        ("class ThisOne(That): ...", [(1, "This One")]),
    ],
)
def test_texts(source: str, expected: list[tuple[int, str]]):
    assert [(each.line, each.text) for each in prose.texts(source)] == expected


def test_the_output_counts_hits_per_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "module.py").write_text('"""Padding behind it, in vain."""\n', "utf-8")
    assert prose.main([], (str(tmp_path),)) == 1
    assert capsys.readouterr().out.split() == ["2", str(tmp_path)]
