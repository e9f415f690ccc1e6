"""The document ``docs/check-selftest.md``: how many faulty nodes ``check`` finds in simulated recordings."""

from __future__ import annotations

from collections import Counter
from typing import Final

from dcp_spec.markdown import table

from dcp_selftest.mutants import all_mutants

from .clean import CleanResult
from .faulty import SHAPES, FaultyResult, Outcome

COMMAND: Final = "dcp-selftest recordings --clean 500 --document docs/check-selftest.md"
#: Text of the last column for mutants without a failed rule, by outcome.
REASONS: Final = {
    "same": "not visible: the beacons are those of the reference node",
    "missed": "visible in the beacons",
    "observed": "observed, and not judged",
    "doubted": "inconclusive",
}
_ORDER: Final = ("found", "otherwise", "doubted", "observed", "missed", "same")
TITLES: Final = {
    "found": "found, with the requirement",
    "otherwise": "found, with other requirements",
    "doubted": "inconclusive",
    "observed": "observed",
    "missed": "not found",
    "same": "same octets",
}


def document(result: FaultyResult, clean: CleanResult | None) -> str:
    """Return the document in Markdown: numbers, networks without a fault, and a row for each visible mutant."""
    by_mutant = result.by_mutant()
    lines = [
        "# Tests of check with simulated recordings",
        "",
        f"Made by `{COMMAND}`; do not edit.",
        "",
        "Each mutant (the reference node with one small fault) is put into the middle of a simulated network of five",
        "nodes, on a bus and in a line, with restarts, a node that joins late, and applications that create, update",
        "and delete. `check` judges the recording. A mutant cannot be found if it sends the same octets as the",
        "reference node in this traffic.",
        f"{len(by_mutant)} of {len(all_mutants())} mutants were tried for this page.",
        "",
    ]
    counts = {shape: Counter(each.fate for each in result.outcomes if each.shape == shape) for shape in SHAPES}
    either = Counter(min((each.fate for each in row.values()), key=_ORDER.index) for row in by_mutant.values())
    numbers = [(name, *(each[fate] for fate in _ORDER)) for name, each in (*counts.items(), ("either", either))]
    lines.append(table(("network", *(TITLES[each] for each in _ORDER)), numbers, "l" + "r" * len(_ORDER)))
    if clean is not None:
        lines += [
            "",
            "## Networks without a fault",
            "",
            f"{clean.networks} networks with {clean.beacons} beacons (all versions; bus, line, grid, moving nodes;",
            "losses of 0 to 50 %; restarts, late joins, set clocks; a permitted variant in every third network):",
            f"{len(clean.false)} findings, inconclusive verdicts in {clean.doubts}.",
        ]
        lines += [f"* {each.situation}: {each.rule}: {each.text}" for each in clean.false]
    visible = [
        (mutant, *(TITLES[row[shape].fate] if shape in row else "" for shape in SHAPES), _reason(row))
        for mutant, row in sorted(by_mutant.items())
        if any(each.fate != "same" for each in row.values())
    ]
    columns = ("mutant", *SHAPES, "rules, or the reason")
    lines += ["", "## Mutants that are visible in the beacons", "", table(columns, visible)]
    return "\n".join(lines) + "\n"


def _reason(row: dict[str, Outcome]) -> str:
    rules = dict.fromkeys(rule for each in row.values() for rule in each.rules)
    best = min(row.values(), key=lambda each: _ORDER.index(each.fate))
    if best.fate in ("found", "otherwise"):
        return ", ".join(rules)
    # For mutants without a failed rule, show the reason from the network with the best outcome.
    return ": ".join(filter(None, (", ".join(rules), REASONS[best.fate], best.text)))
