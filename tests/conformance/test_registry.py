"""Registries: order, identifiers that are there twice, patterns, and similar names."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import pytest
from dcp_conformance.definitions.case import case
from dcp_conformance.definitions.registry import Registry, define, defined_in
from dcp_conformance.errors import UsageError


class Entry(NamedTuple):
    id: str


@pytest.fixture
def registry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that makes a registry of a package with these modules, each with these identifiers."""
    monkeypatch.syspath_prepend(tmp_path)

    def made(name: str, **modules: list[str]) -> Registry[Entry]:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
        for module, ids in modules.items():
            lines = ["from dcp_conformance.definitions.registry import define", f"from {__name__} import Entry"]
            for number, each in enumerate(ids):
                lines += [f"def f{number}(): ...", f"define(f{number}, [Entry({each!r})])"]
            (tmp_path / name / f"{module}.py").write_text("\n".join(lines) + "\n")
        return Registry("thing", name, "things --list", names_of=lambda each: (each.id, each.id.partition("-")[0]))

    return made


def test_entries_are_ordered_by_module_and_place(registry):
    found = registry("ordered", b=["T_2", "T_1"], a=["T_3-x", "T_3-y"])
    assert list(found.all()) == ["T_3-x", "T_3-y", "T_2", "T_1"]
    assert [each.id for each in found.select(["T_1", "T_3"])] == ["T_3-x", "T_3-y", "T_1"]
    assert [each.id for each in found.select(["T_?"])] == ["T_3-x", "T_3-y", "T_2", "T_1"] == list(found.all())
    assert len(found.select([])) == 4
    assert found.get("T_2") == Entry("T_2")


def test_a_function_defines_entries_of_all_its_decorators_in_their_order():
    module = ModuleType("stacked")

    def body() -> None: ...

    body.__module__ = module.__name__
    module.body = define(define(body, [Entry("T_2")]), [Entry("T_1")])
    assert list(defined_in(module)) == [Entry("T_1"), Entry("T_2")]


def test_the_body_of_a_case_gets_the_value_of_its_decorator():
    made, module = [], ModuleType(__name__)
    texts = {"requirements": "VD-PS-01", "stimulus": "a summary", "expect": "a request"}

    @case("TC_VD_STACK_BV_03", "A value", value=4, **texts)
    @case("TC_VD_STACK_BV_04", "Another value", value=5, **texts)
    def body(bench, value) -> None:
        made.append((bench, value))

    module.body = body
    found = list(defined_in(module))
    for each in found:
        each.run("bench")
    assert [each.id for each in found] == ["TC_VD_STACK_BV_03", "TC_VD_STACK_BV_04"]
    assert made == [("bench", 4), ("bench", 5)]


def test_an_identifier_twice_names_both_places(registry):
    with pytest.raises(ValueError, match=r"T_1 is defined in twice\.a and in twice\.b"):
        registry("twice", a=["T_1"], b=["T_1"]).all()


def test_an_unknown_name_suggests_similar_ones(registry):
    found = registry("unknown", a=["T_first"])
    with pytest.raises(UsageError, match=r"no thing is called 'T_frist'; did you mean T_first\?"):
        found.get("T_frist")
    with pytest.raises(UsageError, match="no thing is called 'zz'; 'things --list' shows the things"):
        found.select(["zz"])
