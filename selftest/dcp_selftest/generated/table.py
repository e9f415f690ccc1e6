"""Generated mutants as Markdown: the scores of draws, the survivors, and the numbers in the ledger."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

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
        "outside, or are permitted; they do not count.",
        "",
        "| seed | drawn | in the ledger | judged | killed | survived | score |",
        "|---:|---:|---:|---:|---:|---:|---:|",
        *(_row(result) for result in results),
        "",
        *_survivors(results),
        f"The ledger holds {excused:,} of {count:,} changes ({excused / count:.1%}):",
        "",
        "| kind | changes | meaning |",
        "|---|---:|---|",
        *_kinds(),
    ]
    return "\n".join(lines) + "\n"


def _row(result: GeneratedResult) -> str:
    judged, lost = len(result.judged), len(result.survivors)
    numbers = (result.seed, result.drawn, len(result.trials) - judged, judged, judged - lost, lost)
    return f"| {' | '.join(map(str, numbers))} | {result.score:.1%} |"


def _survivors(results: Sequence[GeneratedResult]) -> Iterator[str]:
    found: dict[str, Trial] = {trial.site.key: trial for result in results for trial in result.survivors}
    if not found:
        return
    yield "| survivor | change | noticed by |"
    yield "|---|---|---|"
    for trial in sorted(found.values(), key=lambda each: (each.site.module, each.site.function, each.site.key)):
        site = trial.site
        change = f"{site.operator}: `{site.before}` -> `{site.after}`".replace("|", "\\|")
        noticed = trial.outcome.by.partition(":")[0] if trial.outcome.fate == "noticed" else "-"
        yield f"| `{site.module}.{site.function}` | {change} | {noticed} |"
    yield ""


def _kinds() -> Iterator[str]:
    counts = Counter[str]()
    for entry in entries():
        counts[entry.kind] += len(entry.changes)
    for kind, number in counts.most_common():
        yield f"| {kind} | {number} | {CLASSES[kind]} |"
