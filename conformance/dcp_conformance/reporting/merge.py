"""Compare several runs: requirements of different implementations, or cases of one implementation before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dcp_spec.catalogue.requirements import requirements

from dcp_conformance.definitions.results import CaseResult, RunResult
from dcp_conformance.definitions.verdict import Verdict, worst
from dcp_conformance.execution.selection import retired

#: Verdicts that count as better and as worse in comparisons. The other verdicts are neither.
_GOOD = (Verdict.PASS, Verdict.INFO)
_BAD = (Verdict.FAIL, Verdict.ERROR)


#: Kinds of change for the worse. A case without a result in the new run may hide a fail.
WORSE = ("regression", "gone")


@dataclass(frozen=True, slots=True)
class Change:
    """A case whose verdict differs between two runs; None for a run that does not contain the case."""

    id: str
    old: Verdict | None
    new: Verdict | None
    reason: str

    @property
    def kind(self) -> str:
        """``regression``, ``gone``, ``changed``, ``fixed``, ``new`` or ``retired``."""
        if self.old is None:
            return "new"
        if self.new is None:
            return "retired" if self.id in retired() else "gone"
        if self.new in _BAD and self.old not in _BAD:
            return "regression"
        if self.old in _BAD and self.new in _GOOD:
            return "fixed"
        return "changed"


def compare(old: RunResult, new: RunResult) -> list[Change]:
    """Return the cases whose verdicts differ, regressions first. Of several attempts the worst verdict counts."""
    before, after = _by_case(old), _by_case(new)
    changes = []
    for identifier in dict.fromkeys((*before, *after)):
        was, is_now = before.get(identifier), after.get(identifier)
        if was is None or is_now is None or was.verdict is not is_now.verdict:
            reason = is_now.reason if is_now is not None else ""
            verdicts = (was.verdict if was is not None else None, is_now.verdict if is_now is not None else None)
            changes.append(Change(identifier, *verdicts, reason))
    order = ("regression", "gone", "changed", "fixed", "new", "retired")
    return sorted(changes, key=lambda change: order.index(change.kind))


def side_by_side(old: RunResult, new: RunResult) -> list[tuple[str, Verdict | None, Verdict | None]]:
    """Return the requirements whose verdicts differ between two runs, in the order of the catalogue.

    None is the verdict of a requirement that a run did not decide. For results of different commands (``run`` and
    ``check``), which have no cases in common.
    """
    return [
        (identifier, verdicts[0], verdicts[1])
        for identifier, verdicts in matrix((old, new))
        if verdicts[0] is not verdicts[1]
    ]


def contradict(old: RunResult, new: RunResult) -> bool:
    """Return whether a requirement passes in one of two runs and fails in the other."""
    return any({was, is_now} == {Verdict.PASS, Verdict.FAIL} for _, was, is_now in side_by_side(old, new))


def _by_case(run: RunResult) -> dict[str, CaseResult]:
    found: dict[str, CaseResult] = {}
    for case in (*run.cases, *run.invariants):
        if case.id not in found or case.verdict.rank > found[case.id].verdict.rank:
            found[case.id] = case
    return found


def labels(runs: Sequence[RunResult]) -> list[str]:
    """Return a distinct label for each run: name and version, and the profile or a number if labels would be equal."""
    names = [" ".join(filter(None, (run.sut.name or "unnamed", run.sut.version))) for run in runs]
    if len(set(names)) < len(names):
        names = [f"{name} ({run.profile})" for name, run in zip(names, runs, strict=True)]
    if len(set(names)) < len(names):
        names = [f"{number}: {name}" for number, name in enumerate(names, 1)]
    return names


def matrix(runs: Sequence[RunResult]) -> list[tuple[str, list[Verdict | None]]]:
    """Return the verdict in each run, for each requirement that a run decided, in the order of the catalogue."""
    return [
        (identifier, [run.requirements.get(identifier) for run in runs])
        for identifier in requirements()
        if any(identifier in run.requirements for run in runs)
    ]


def render_matrix(runs: Sequence[RunResult]) -> str:
    """Return the HTML page that compares several runs by requirement."""
    from .page import page

    known = requirements()
    rows = [
        {
            "id": identifier,
            "statement": known[identifier].statement,
            "verdicts": [str(verdict) if verdict is not None else "" for verdict in verdicts],
            "worst": str(worst(verdict for verdict in verdicts if verdict is not None)),
            "differs": len({verdict for verdict in verdicts if verdict is not None}) > 1,
        }
        for identifier, verdicts in matrix(runs)
    ]
    return page("matrix.html", runs=list(zip(labels(runs), runs, strict=True)), rows=rows)
