"""Known faults and permitted variants in networks: each fault must turn a cell red, and no variant may.

A fault is in the network once as implementation A (producer, ends of lines) and once as B (consumer, relays), with
our node as the other one. The first red cell decides; cells that run before it are those that missed the fault.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_lab.interop.cell import Cell, obstacle, run_cell
from dcp_lab.interop.definition import all_tests, select_tests
from dcp_lab.interop.implementations import built_in, meeting_profile
from dcp_lab.interop.matrix import default_jobs
from dcp_lab.interop.workers.pool import run_in_workers
from dcp_spec.markdown import table

from dcp_codec.common.atomic_write import write_whole
from dcp_codec.common.signals import Stop
from dcp_selftest.variants.variant import all_variants

#: Faults that show between nodes: what spreads, what is asked for and answered, what is kept, what harms others.
FAULTS: Final = (
    "M-VD-PC-09-own-only",
    "M-VD-PC-09-not-summarised",
    "M-VD-PC-10-producer",
    "M-VD-PC-10-creation-time",
    "M-VD-PC-07-seqno-zero",
    "M-VD-PC-07-nul-value",
    "M-VD-TYP-06-repcnt-down",
    "M-VD-PU-07-not-sent-on",
    "M-VD-PU-07-ignored",
    "M-VD-PU-07-number-kept",
    "M-VD-PU-07-value-kept",
    "M-VD-PU-07-no-wrap",
    "M-VD-PU-07-next-only",
    "M-VD-PU-06-stored",
    "M-VD-PD-04-ignored",
    "M-VD-PD-04-not-sent-on",
    "M-VD-DEL-05-silent",
    "M-VD-DB-02-forgets",
    "M-VD-PS-01-ignored",
    "M-VD-PS-04-not-requested",
    "M-VD-PS-04-number-taken",
    "M-VD-RC-03-consumer-silent",
    "M-VD-RC-03-producer-silent",
    "M-VD-RU-04-producer-silent",
    "M-VD-RU-03-no-wrap",
    "M-VD-SCP-01-summary-copied",
    "M-VD-SCR-06-not-refreshed",
    "M-VD-SCR-05-foreign-only",
    "M-VD-INI-06-never",
    "M-VD-TYP-03-shared",
    "M-VD-UPD-07-constant",
    "M-SRP-RX-06-forwarded",
    "M-BP-RX-15-dies",
    "M-BP-RX-16-mute",
    "M-BP-RX-16-dies-of-short",
    "M-UWB-01-gives-up",
)
#: Variants with the same node as another one: they differ in the declarations to the tester of a single node.
_TOLD: Final = ("V-UT-*", "V-PAR-*-get", "V-PAR-*-pixit", "*-denied", "*-silent", "*-claimed")


class Trial(msgspec.Struct, frozen=True):
    """The outcome of one fault or variant."""

    name: str
    what: str
    red: str = ""
    """The first red cell as ``A:B:TEST``; empty: none."""
    reason: str = ""
    cells: int = 0
    """Cells that applied and were run."""


class SelftestResult(NamedTuple):
    """All trials."""

    faults: tuple[Trial, ...]
    variants: tuple[Trial, ...]

    @property
    def good(self) -> bool:
        """Whether every fault turned a cell red, and no variant did."""
        return all(each.red for each in self.faults) and not any(each.red for each in self.variants)

    def lines(self) -> Iterator[str]:
        """Yield the outcome in words."""
        seen = sum(bool(each.red) for each in self.faults)
        yield f"{seen} of {len(self.faults)} faults turn a cell red"
        yield from (
            f"  not noticed: {each.name} ({each.what}) in {each.cells} cells" for each in self.faults if not each.red
        )
        wrong = [each for each in self.variants if each.red]
        yield f"{len(wrong)} of {len(self.variants)} permitted variants turn a cell red"
        yield from (f"  {each.name} ({each.what}): {each.red}: {each.reason}" for each in wrong)


def variants_to_try() -> list[str]:
    """The permitted variants that are nodes of their own, sorted by identifier."""
    return [name for name in sorted(all_variants()) if not any(fnmatchcase(name, each) for each in _TOLD)]


def run_selftest(
    *,
    tests: Sequence[str] = (),
    names: Sequence[str] = (),
    seeds: int = 1,
    jobs: int | None = None,
    on_line: Callable[[str], None] | None = None,
) -> SelftestResult:
    """Run the self-test; ``names``: only these (``mutant:ID``, ``variant:ID``, globs).

    ``tests``: only these network tests; by default all for faults, and the short selection for variants. Raises
    ``UsageError`` for a name that means nothing.
    """
    every = [*(f"mutant:{each}" for each in FAULTS), *(f"variant:{each}" for each in variants_to_try())]
    chosen: list[str] = []
    for name in names:
        found = [each for each in every if fnmatchcase(each, name)]
        if not found:
            # Also those outside of the selection.
            built_in(name)
            found = [name]
        chosen += found
    chosen = list(dict.fromkeys(chosen)) or every
    for pattern in tests:
        select_tests((pattern,))
    made: dict[int, Trial] = {}
    job = partial(_job, patterns=tuple(tests), seeds=seeds)
    with contextlib.closing(run_in_workers(job, chosen, jobs or default_jobs("virtual"))) as results:
        for number, trial in results:
            made[number] = trial
            if on_line is not None:
                on_line(f"{trial.name:<44} {trial.red or 'no red cell'} ({trial.cells} cells)")
    trials = [made[number] for number in range(len(chosen))]
    faults = tuple(each for each in trials if each.name.startswith("mutant:"))
    return SelftestResult(faults, tuple(each for each in trials if not each.name.startswith("mutant:")))


def _job(name: str, stop: Stop, *, patterns: tuple[str, ...], seeds: int) -> Trial:
    with stop.interruptible_by_signals():
        return _try(name, patterns, seeds)


def _try(name: str, patterns: tuple[str, ...], seeds: int) -> Trial:
    try:
        other = built_in(name)
    except UsageError as error:
        return Trial(name, str(error))
    faulty = name.startswith("mutant:")
    node_name = f"node:{other.profile}"
    node = built_in(node_name)
    if meeting_profile(other, node) is None:
        # Another network, or another layout: it can meet only itself.
        node_name, node = name, other
    tests = select_tests(patterns, short=not faulty and not patterns)
    # The longest tests come last: most faults show before.
    tests.sort(key=lambda test: ("MANY" in test.id, len(test.shape.roles)))
    cells = 0
    for test in tests:
        for a, b in dict.fromkeys(((name, node_name), (node_name, name))):
            pair = (other, node) if a == name else (node, other)
            if test.wire != "same" or meeting_profile(*pair) is None or obstacle(test, *pair, "virtual"):
                continue
            for seed in range(1, seeds + 1):
                cell = Cell(a=a, b=b, test=test.id, implementations=pair, seed=seed)
                result = run_cell(cell, all_tests()[test.id])
                cells += result.verdict is not Verdict.NOT_APPLICABLE
                if result.verdict in (Verdict.FAIL, Verdict.ERROR):
                    return Trial(name, other.what, cell.name, result.reason, cells)
    return Trial(name, other.what, "", "", cells)


_BEGIN, _END = "<!-- begin: interop selftest -->", "<!-- end: interop selftest -->"


def write_document(result: SelftestResult, path: Path) -> None:
    """Write the tables between the two marks of a Markdown file.

    Raises ``UsageError`` if the file or its marks are missing.
    """
    try:
        text = path.read_text()
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    before, begin, rest = text.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not (begin and end):
        raise UsageError(f"{path}: there is no section between the lines '{_BEGIN}' and '{_END}'")
    rows = []
    for each in result.faults:
        test = each.red.rpartition(":")[2]
        role = "" if not each.red else "A" if each.red.startswith(each.name) else "B"
        rows.append((each.name.partition(":")[2], each.what, test or "**none**", role, each.reason[:160]))
    columns = ("fault", "the node ...", "first red cell", "role", "reason")
    seen, wrong = sum(bool(each.red) for each in result.faults), sum(bool(each.red) for each in result.variants)
    lines = [
        "",
        table(columns, rows),
        "",
        f"{seen} of {len(result.faults)} faults turn a cell red. Of {len(result.variants)} permitted variants",
    ]
    lines += [f"(short selection, both roles) {wrong or 'none'} does.", ""]
    write_whole(path, (before + begin + "\n".join(lines) + end + after).encode())
