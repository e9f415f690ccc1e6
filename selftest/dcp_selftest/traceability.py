"""The traceability matrix: requirement x code x unit test x conformance case.

It is generated from the repository: citations ``##= ID`` in the code, the marker ``req`` of the tests, the requirements
of the cases, and ``data/undecided.toml`` with the reasons why a requirement has no case.
``dcp-selftest matrix`` (``make matrix``) writes ``docs/traceability.md`` and adds new cases to
``data/case-ids.txt``. That file keeps the identifiers of all cases that ever existed, so that none is used again.

The matrix has no line numbers: it changes when a relation changes, not when code moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path
from typing import Final

import msgspec
from dcp_conformance.definitions.case import Case, all_cases
from dcp_conformance.errors import UsageError
from dcp_spec.catalogue.origins import origins
from dcp_spec.catalogue.requirements import Requirement, requirements
from dcp_spec.constants import SpecVersion
from dcp_spec.markdown import table

CODE: Final = ("spec/dcp_spec", "dcp_codec", "dcp_stack")
"""Folders with code that fulfils requirements."""
TESTS: Final = "tests"
DOCUMENT: Final = "docs/traceability.md"
UNDECIDED: Final = "selftest/dcp_selftest/data/undecided.toml"
LEDGER: Final = "conformance/dcp_conformance/data/case-ids.txt"
RETIRED: Final = "retired"

_ID = r"(?:[A-Z]+-){1,2}\d+"
CITATION: Final = re.compile(rf"##= *({_ID}(?: +{_ID})*)(?: *\| *(.*))?")
"""A comment that cites requirements, ``##= ID ID``, or one with a remark, ``##= ID | exception: reason``."""
_QUOTED = re.compile(r'"((?:DATA|UWB)-\d\d|(?:BP|SRP|VD)-[A-Z]+-\d\d)"')
_MARKED = re.compile(r"mark\.req\(([^)]*)\)")
_STRING = re.compile(r'"([^"]+)"')
#: Tests with requirement ids that intentionally do not exist.
_NOT_SCANNED = frozenset({"test_requirements.py", "test_citations.py", "test_traceability.py"})


# -- reading the repository --------------------------------------------------------------------------------------------


def cited_in_comments(text: str) -> list[str]:
    """Return the requirement ids that the comments of Python source cite."""
    return [each for match in CITATION.finditer(text) for each in match[1].split()]


def cited(text: str) -> set[str]:
    """Return the requirement ids that Python source cites or has in a string: those that it fulfils."""
    return {*cited_in_comments(text), *_QUOTED.findall(text)}


def marked(text: str) -> set[str]:
    """Return the requirement ids that tests are marked with: those that they decide."""
    return {each for group in _MARKED.findall(text) for each in _STRING.findall(group)}


def sources(root: Path, *folders: str) -> list[Path]:
    """Return the sorted Python files below ``folders`` of the repository, without those in ``_NOT_SCANNED``."""
    return sorted(path for folder in folders for path in (root / folder).rglob("*.py") if path.name not in _NOT_SCANNED)


class Undecided(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A requirement that no case decides, with the reason."""

    id: str
    why: str


class _UndecidedFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    undecided: tuple[Undecided, ...] = ()


def read_undecided(path: Path) -> tuple[Undecided, ...]:
    """Return the entries of ``undecided.toml``; empty without the file. Raise :class:`UsageError` if it is invalid."""
    try:
        return msgspec.toml.decode(path.read_bytes(), type=_UndecidedFile).undecided
    except FileNotFoundError:
        return ()
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: {error}") from None


def read_ledger(path: Path) -> dict[str, bool]:
    """Return all identifiers that cases ever had, and whether each is retired.

    Raise :class:`UsageError` for an invalid line or a duplicate.
    """
    found: dict[str, bool] = {}
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    for number, line in enumerate(lines, 1):
        identifier, _, rest = line.partition(" ")
        if rest not in ("", RETIRED) or not identifier:
            raise UsageError(
                f"{path}, line {number}: {line!r}; a line is an identifier, or one followed by {RETIRED!r}"
            )
        if identifier in found:
            raise UsageError(f"{path}, line {number}: {identifier} is a duplicate")
        found[identifier] = bool(rest)
    return found


def ledger_text(ledger: Mapping[str, bool], used: Iterable[str]) -> str:
    """Return the text of the ledger with the identifiers ``used`` added, one per line, sorted. It never shrinks."""
    merged = {**dict.fromkeys(used, False), **ledger}
    return "".join(f"{name} {RETIRED}\n" if retired else f"{name}\n" for name, retired in sorted(merged.items()))


# -- the matrix --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Row:
    """One requirement with its code, tests, cases and rules."""

    requirement: Requirement
    code: tuple[str, ...]
    """The files that cite it, relative to the repository, without ``.py``."""
    tests: tuple[str, ...]
    """The test files with tests that decide it, relative to ``tests``, without ``.py``."""
    cases: tuple[str, ...]
    """The cases that decide it, without their variants."""
    why: str = ""
    """The reason why no case decides it."""
    rules: tuple[str, ...] = ()
    """The rules of ``check``, and of passive testing, that judge it in recordings."""


@dataclass(frozen=True, slots=True)
class Matrix:
    """All requirements in the order of the catalogue, and the data for consistency checks."""

    rows: tuple[Row, ...]
    undecided: tuple[Undecided, ...]
    ledger: Mapping[str, bool]
    case_ids: tuple[str, ...]
    unknown: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Ids that the catalogue does not have, with the files that have them."""
    rule_ids: tuple[str, ...] = ()
    """The identifiers of the rules that judge recordings."""

    def problems(self) -> list[str]:
        """Return the gaps and contradictions of the matrix, each with its remedy; empty if it is complete."""
        return [*self._citations(), *self._coverage(), *self._reasons(), *self._identifiers()]

    def _citations(self) -> Iterable[str]:
        for name, places in self.unknown.items():
            yield f"{name} is not a requirement, but is named in {', '.join(places)}"

    def _coverage(self) -> Iterable[str]:
        for row in self.rows:
            needed = row.requirement
            if needed.level == "mandatory" and not row.code and not row.tests:
                yield f"{needed.id} is mandatory, but no code cites it and no test is marked with it"
            if not row.cases and not row.why:
                places = " and ".join(needed.observable)
                yield f"{needed.id} ({places}): no case decides it; write one, or the reason why not in {UNDECIDED}"

    def _reasons(self) -> Iterable[str]:
        for before, after in pairwise(each.id for each in self.undecided):
            if after <= before:
                yield f"{UNDECIDED}: {after} comes after {before}; sort the entries by id, with one for each id"
        for row in self.rows:
            if row.why and row.cases:
                yield f"{UNDECIDED} has {row.requirement.id}, but {', '.join(row.cases)} decide it; remove the entry"
        for each in self.undecided:
            if not each.why.strip():
                yield f"{UNDECIDED}: {each.id} has no reason"

    def _identifiers(self) -> Iterable[str]:
        all_ids = (*self.case_ids, *self.rule_ids)
        used = set(all_ids)
        if new := [name for name in all_ids if name not in self.ledger]:
            more = f" and {len(new) - 3} more" if len(new) > 3 else ""
            yield f"not in {LEDGER}: {', '.join(new[:3])}{more}; make matrix adds them"
        for name in all_ids:
            if self.ledger.get(name):
                yield f"{name} is retired in {LEDGER}: identifiers are never used again, take the next number"
        for name, retired in self.ledger.items():
            if name not in used and not retired:
                yield f"{name} is in {LEDGER}, but the case does not exist: mark it {RETIRED!r}, or restore the case"


def matrix(repo_root: Path, cases: Mapping[str, Case] | None = None) -> Matrix:
    """Generate the matrix of a repository, with ``cases`` (default: all cases and rules).

    Raise :class:`UsageError` if ``repo_root`` is not a checkout, or for an invalid data file.
    """
    if not all((repo_root / folder).is_dir() for folder in (*CODE, TESTS)):
        raise UsageError(
            f"{repo_root} is not a checkout of this repository: it must contain {', '.join((*CODE, TESTS))}"
        )
    catalogue = requirements()
    chosen = all_cases() if cases is None else cases
    unknown: dict[str, list[str]] = {}

    def collect(paths: Iterable[Path], find: str, base: Path) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for path in paths:
            text = path.read_text(encoding="utf-8")
            name = path.relative_to(base).with_suffix("").as_posix()
            for each in sorted(cited(text) if find == "cited" else marked(text)):
                (found if each in catalogue else unknown).setdefault(each, []).append(name)
        return found

    code = collect(sources(repo_root, *CODE), "cited", repo_root)
    tests = collect(sources(repo_root, TESTS), "marked", repo_root / TESTS)
    undecided = read_undecided(repo_root / UNDECIDED)
    reasons = {each.id: each.why for each in undecided}
    for name in reasons.keys() - catalogue.keys():
        unknown.setdefault(name, []).append(UNDECIDED)
    deciding: dict[str, dict[str, None]] = {}
    for each in chosen.values():
        for name in each.requirements:
            deciding.setdefault(name, {})[each.base] = None
    judging: dict[str, dict[str, None]] = {}
    rules = _rules() if cases is None else ()
    for rule in rules:
        for name in rule.requirements:
            judging.setdefault(name, {})[rule.id] = None
    rows = tuple(
        Row(
            requirement,
            tuple(code.get(name, ())),
            tuple(tests.get(name, ())),
            tuple(sorted(deciding.get(name, ()))),
            reasons.get(name, ""),
            tuple(sorted(judging.get(name, ()))),
        )
        for name, requirement in catalogue.items()
    )
    ledger = read_ledger(repo_root / LEDGER)
    found = {name: tuple(places) for name, places in sorted(unknown.items())}
    rule_ids = tuple(sorted({rule.id for rule in rules}))
    return Matrix(rows, undecided, ledger, tuple(sorted(chosen)), found, rule_ids)


def _rules() -> tuple[Case, ...]:
    """Return the rules of ``check`` and of passive testing, as cases."""
    from dcp_conformance.check.judge import cases as checked
    from dcp_conformance.passive.tester import cases as passive

    return (*checked(), *passive())


# -- the document ------------------------------------------------------------------------------------------------------

_INTRODUCTION = """\
# Traceability

Generated by `make matrix`; do not edit. Each requirement of the catalogue (`spec/dcp_spec/data/requirements.toml`), the
code that cites it (`##= ID`), the tests that are marked with it (below `tests/`), and the conformance cases that decide
it (without `TC_`, and without their variants), or the reason why none does, and the rules that judge it in recordings
(without `CK_`: `dcp-conformance check`, and passive testing during a run). *Seen* is where a violation shows: on the
wire, at the upper interface, or only inside. *Specification* is where the newest version states it: files without
`dcp-` and `.md`, and lines ([provenance.md](provenance.md) has the commits; older versions and links:
`dcp-selftest provenance --requirement ID`). *Derived* means that no sentence of its own states it.
"""

_COLUMNS: Final = ("requirement", "level", "seen", "specification", "code", "tests", "cases", "recordings")


def render(matrix: Matrix) -> str:
    """Return the matrix as Markdown; it depends on the repository only."""
    parts = [_INTRODUCTION, _summary(matrix)]
    for protocol, group in groupby(matrix.rows, lambda row: row.requirement.protocol):
        parts.append(f"## {protocol}\n")
        parts.append(table(_COLUMNS, map(_cells, group)) + "\n")
    return "\n".join(parts)


def _summary(matrix: Matrix) -> str:
    columns = ("", "requirements", "cited in code", "with a test", "with a case", "with a reason")
    numbers = []
    groups: list[tuple[str, list[Row]]] = [
        (protocol, list(group)) for protocol, group in groupby(matrix.rows, lambda row: row.requirement.protocol)
    ]
    for name, rows in [*groups, ("all", list(matrix.rows))]:
        counts = (
            name,
            len(rows),
            sum(bool(row.code) for row in rows),
            sum(bool(row.tests) for row in rows),
            sum(bool(row.cases) for row in rows),
            sum(bool(row.why) for row in rows),
        )
        numbers.append(counts)
    bases = {name.partition("-")[0] for name in matrix.case_ids}
    judged = sum(bool(row.rules) for row in matrix.rows)
    return (
        f"{table(columns, numbers, 'lrrrrr')}\n\n{len(bases)} cases, {len(matrix.case_ids)} with their variants. "
        f"{len(matrix.rule_ids)} rules judge {judged} requirements in recordings.\n"
    )


def _cells(row: Row) -> tuple[str, ...]:
    needed = row.requirement
    cases = ", ".join(each.removeprefix("TC_") for each in row.cases) or f"*{' '.join(row.why.split())}*"
    return (
        needed.id,
        needed.level[0].upper(),
        ", ".join(each[0].upper() for each in needed.observable),
        _stated(needed.id),
        ", ".join(_short(row.code)),
        ", ".join(row.tests),
        cases if cases != "**" else "",
        ", ".join(each.removeprefix("CK_") for each in row.rules),
    )


def _stated(requirement: str) -> str:
    """Return file and lines where the newest version that has the requirement states it."""
    entry = origins()[requirement]
    version = max(entry.origins)
    lines: dict[str, dict[int, None]] = {}
    for each in entry.origins[version]:
        lines.setdefault(each.section.file.removeprefix("dcp-").removesuffix(".md"), {})[each.line] = None
    places = "; ".join(f"{file} {', '.join(map(str, numbers))}" for file, numbers in lines.items())
    older = f"{version}: " if version != max(SpecVersion) else ""
    return f"derived; {places}".removesuffix("; ") if entry.why else f"{older}{places}"


def _short(paths: Sequence[str]) -> list[str]:
    """Return the paths without their package, without duplicates."""
    return list(dict.fromkeys(path.removeprefix("spec/").partition("/")[2] or path for path in paths))


def write(repo_root: Path) -> Matrix:
    """Update ledger and document; return the matrix. Raise :class:`UsageError` as :func:`matrix` does."""
    found = matrix(repo_root)
    used = (*found.case_ids, *found.rule_ids)
    (repo_root / LEDGER).write_text(ledger_text(found.ledger, used), encoding="utf-8")
    (repo_root / DOCUMENT).write_text(render(found), encoding="utf-8")
    return matrix(repo_root)


def outdated(repo_root: Path, found: Matrix) -> bool:
    """Return whether the document in the repository differs from the matrix."""
    path = repo_root / DOCUMENT
    return not path.exists() or path.read_text(encoding="utf-8") != render(found)
