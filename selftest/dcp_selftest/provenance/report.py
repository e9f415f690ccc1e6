"""Report the effect of another version of the specification on the catalogue, the cases and the node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Final, NamedTuple

import msgspec
from dcp_conformance.definitions.case import all_cases
from dcp_spec.catalogue.origins import newest_statements, origins, revisions
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.version import __version__

from dcp_selftest.citations.places import citations_by_requirement

from .checkout import Checkout
from .comparison import Change, Pair, align
from .statements import Kind, Statement

SCHEMA: Final = "dcp-conformance-provenance/1"
StatementKey = tuple[str, int, str]
"""File, line and fingerprint."""

#: From what matters most; a requirement has the first of these that one of its statements has.
ORDER: Final[tuple[Change, ...]] = ("gone", "changed", "new", "moved", "renumbered", "unchanged")


class Place(msgspec.Struct, frozen=True):
    """The place of a statement in one version."""

    file: str
    line: int
    headings: tuple[str, ...]
    step: str = ""
    fingerprint: str = ""

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"

    @property
    def section(self) -> str:
        """The innermost heading, with the step."""
        return f"{self.title}, step {self.step}" if self.step else self.title

    @property
    def title(self) -> str:
        """The innermost heading."""
        return self.headings[-1] if self.headings else "(before the first heading)"


class StatementChange(msgspec.Struct, frozen=True, rename="camel"):
    """A statement and what happened to it."""

    change: Change
    normative: bool
    """Whether it looks like a rule."""
    before: Place | None
    """In the version that the catalogue follows; None if it is new."""
    now: Place | None
    """In the checkout; None if it is gone."""
    requirements: tuple[str, ...]
    """The requirements that stand on it."""
    text: str = ""
    """Its wording in the checkout, if it is new or changed."""

    @property
    def matters(self) -> bool:
        """Whether it must be reviewed."""
        if self.requirements:
            return self.change != "unchanged"
        return self.normative and self.change in ("gone", "changed", "new")


class RequirementChange(msgspec.Struct, frozen=True, rename="camel"):
    """A requirement, and what hangs on it."""

    id: str
    change: Change
    """The gravest change of its statements."""
    statement: str
    """Our paraphrase."""
    cases: tuple[str, ...]
    """The cases that decide it, without their variants."""
    code: tuple[str, ...]
    """Where our node cites it: ``file:line``."""
    readings: tuple[str, ...]


class ProvenanceResult(msgspec.Struct, frozen=True, kw_only=True, rename="camel"):
    """The content of ``dcp-selftest provenance --json``."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    version: str
    """The version that the catalogue follows, and its commit."""
    commit: str
    checkout: str
    counts: dict[str, int]
    """Statements by change."""
    statements: tuple[StatementChange, ...]
    """All changed statements, in the order of the specification."""
    requirements: tuple[RequirementChange, ...]
    """All requirements, in the order of the catalogue."""

    @property
    def touched(self) -> tuple[RequirementChange, ...]:
        """Requirements that must be reviewed."""
        return tuple(each for each in self.requirements if each.change != "unchanged")

    def exit_status(self) -> int:
        """0: the catalogue is valid for the checkout; 1: statements must be reviewed."""
        return 1 if any(each.matters for each in self.statements) else 0


class Baseline(NamedTuple):
    """The version that the catalogue follows."""

    version: str
    commit: str
    statements: tuple[Statement, ...]
    """Without their wording."""
    users: Mapping[StatementKey, tuple[str, ...]]
    """The requirements that stand on each statement."""


@cache
def recorded_baseline() -> Baseline:
    """The baseline that is part of this package."""
    recorded = newest_statements()

    def statement(section: int, line: int, kind: Kind, step: str, mark: str, sketch: str, normative: bool) -> Statement:
        place = recorded.sections[section]
        return Statement(place.file, place.headings, place.anchor, line, kind, step, mark, sketch, normative)

    users: dict[StatementKey, dict[str, None]] = {}
    for name, entry in origins().items():
        for each in entry.origins.get(recorded.version, ()):
            users.setdefault((each.section.file, each.line, each.fingerprint), {})[name] = None
    return Baseline(
        str(recorded.version),
        next(each.commit for each in revisions() if each.version == recorded.version),
        tuple(statement(*msgspec.structs.astuple(each)) for each in recorded.statements),
        {key: tuple(each) for key, each in users.items()},
    )


def compare(checkout: Checkout, baseline: Baseline | None = None) -> ProvenanceResult:
    """Hold the catalogue against a checkout of the specification."""
    base = recorded_baseline() if baseline is None else baseline
    changes = [_statement_change(pair, base.users) for pair in align(base.statements, checkout.statements())]
    counts = Counter(each.change for each in changes)
    return ProvenanceResult(
        version=base.version,
        commit=base.commit,
        checkout=checkout.origin,
        counts={change: counts[change] for change in ORDER},
        statements=tuple(each for each in changes if each.change != "unchanged"),
        requirements=tuple(_requirement_changes(changes)),
    )


def _statement_change(pair: Pair, known: Mapping[StatementKey, tuple[str, ...]]) -> StatementChange:
    old, new = pair.old, pair.new
    users = known.get((old.file, old.line, old.fingerprint), ()) if old is not None else ()
    wording = new.text if new is not None and pair.change in ("changed", "new") else ""
    normative = any(each.normative for each in (old, new) if each is not None)
    return StatementChange(pair.change, normative, _place(old), _place(new), users, wording)


def _place(statement: Statement | None) -> Place | None:
    if statement is None:
        return None
    return Place(statement.file, statement.line, statement.headings, statement.step, statement.fingerprint)


def _requirement_changes(changes: Iterable[StatementChange]) -> Iterable[RequirementChange]:
    gravest: dict[str, Change] = {}
    for each in changes:
        for name in each.requirements:
            gravest[name] = min(gravest.get(name, "unchanged"), each.change, key=ORDER.index)
    deciding: dict[str, dict[str, None]] = {}
    for case in all_cases().values():
        for name in case.requirements:
            deciding.setdefault(name, {})[case.base] = None
    for name, requirement in requirements().items():
        yield RequirementChange(
            name,
            gravest.get(name, "unchanged"),
            requirement.statement,
            tuple(sorted(deciding.get(name, ()))),
            tuple(str(each) for each in citations_by_requirement().get(name, ())),
            requirement.readings,
        )
