"""Generated mutants as Markdown: the scores of draws, the survivors, and the numbers in the ledger."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

from dcp_spec.markdown import table

from .campaign import GeneratedResult, Trial
from .ledger import CLASSES, entries
from .sites import sites


def section(results: Sequence[GeneratedResult]) -> str:
    """Return the section ``generated`` of the document; it depends on the draws, the suite and the node only."""
    count = len(sites())
    excused = sum(len(entry.changes) for entry in entries())
    drawn = max((result.drawn for result in results), default=0)
    seeds = " ".join(f"--seed {result.seed}" for result in results)
    lines = [
        "## Generated mutants",
        "",
        f"Made by `dcp-selftest generated {drawn} {seeds} --document docs/selftest.md`.",
        "",
        "Each of these mutants is one random change in the source of the reference node: another comparison, operator,",
        "constant or return value, a dropped call, assignment or condition, swapped arguments, a branch that is always",
        f"or never taken. There are {count:,} such changes in the modules of BP, SRP and VarDis. The draw does not",
        "depend on the cases. A change is killed if a case or a passive rule fails, or if the node does not work at",
        "all. Changes in the ledger (`selftest/dcp_selftest/data/invisible-changes/`) cannot be observed from",
        "outside, or are permitted; they do not count. The cases of the model (`TC_DCP_MODEL_*`) are executed after",
        "all others, so that the column *by hand* is the score without them.",
        "",
        table(
            ("seed", "drawn", "in the ledger", "judged", "killed", "by the model only", "survived", "by hand", "score"),
            map(_row, results),
            "r" * 9,
        ),
        "",
        *_survivors(results),
        f"The ledger holds {excused:,} of {count:,} changes ({excused / count:.1%}):",
        "",
        table(("kind", "changes", "meaning"), _kinds(), "lrl"),
    ]
    return "\n".join(lines) + "\n"


def _row(result: GeneratedResult) -> tuple[object, ...]:
    judged, lost, more = len(result.judged), len(result.survivors), len(result.by_model)
    by_hand = result.score - more / judged if judged else 1.0
    return (
        result.seed, result.drawn, len(result.trials) - judged, judged, judged - lost, more, lost, f"{by_hand:.1%}",
        f"{result.score:.1%}",
    )  # fmt: skip


def _survivors(results: Sequence[GeneratedResult]) -> list[str]:
    found: dict[str, Trial] = {trial.site.key: trial for result in results for trial in result.survivors}
    rows = []
    for trial in sorted(found.values(), key=lambda each: (each.site.module, each.site.function, each.site.key)):
        site = trial.site
        change = f"{site.operator}: `{site.before}` -> `{site.after}`"
        noticed = trial.outcome.by.partition(":")[0] if trial.outcome.fate == "noticed" else "-"
        rows.append((f"`{site.module}.{site.function}`", change, noticed))
    return [table(("survivor", "change", "noticed by"), rows), ""] if rows else []


def _kinds() -> Iterator[tuple[str, int, str]]:
    counts = Counter[str]()
    for entry in entries():
        counts[entry.kind] += len(entry.changes)
    for kind, number in counts.most_common():
        yield kind, number, CLASSES[kind]
