"""Progress output and final summary of ``dcp-conformance run``."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from dcp_codec.common.printable import plain
from dcp_conformance.check.wording import moment
from dcp_conformance.definitions.case import Case
from dcp_conformance.definitions.outcome import nothing_decided
from dcp_conformance.definitions.results import CaseResult, Check, RunResult
from dcp_conformance.definitions.survival import bad_checks
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.remarks import listed
from dcp_conformance.reporting.overview import (
    certainty,
    deaths,
    diagnosed,
    observed_readings,
    sentence,
    stated,
    undecided_deaths,
)

STYLES = {
    Verdict.PASS: "green",
    Verdict.INFO: "cyan",
    Verdict.NOT_APPLICABLE: "dim",
    Verdict.TOO_LITTLE: "dim",
    Verdict.INCONCLUSIVE: "yellow",
    Verdict.FAIL: "bold red",
    Verdict.ERROR: "bold magenta",
}
#: Verdicts in the order of columns.
_COLUMNS = (
    Verdict.PASS,
    Verdict.INFO,
    Verdict.FAIL,
    Verdict.INCONCLUSIVE,
    Verdict.ERROR,
    Verdict.NOT_APPLICABLE,
)
#: Seconds between two lines about the progress of a run without a progress bar.
_MINUTE = 60.0
#: Number of earlier lines since which the pace is measured for the estimate of the remaining time.
_LOOKED_AT = 2
#: Maximum number of frames that are named for one check.
_FRAMES = 8
#: Maximum number of failed checks that are shown for one case.
_CHECKS = 4
#: Maximum number of notes that are shown. An implementation that crashes often can have many.
_NOTES = 6
#: Maximum number of probable faults that are shown.
_FAULTS = 8
#: Maximum number of observations in a recording that are shown.
_OBSERVATIONS = 12
_HEADINGS = {Verdict.NOT_APPLICABLE: "n/a", Verdict.INCONCLUSIVE: "inconcl.", Verdict.TOO_LITTLE: "too little"}


class SafeConsole(Console):
    """A console that accepts colours only as markup and escapes control characters in strings."""

    def render_str(self, text: str, **more: Any) -> Text:
        """Render a string with markup, as print and cells of tables do."""
        return super().render_str(plain(text, keep="\n\t"), **more)


def console() -> Console:
    """Return a console on standard output; it writes colours only to a terminal."""
    return SafeConsole(highlight=False, emoji=False, soft_wrap=True)


def data(text: object) -> str:
    """Escape foreign text for a string with markup: its markup and control characters have no effect."""
    return escape(plain(str(text)))


def progress_bar(*, quiet: bool) -> Progress:
    """Return a transient progress bar on standard error; disabled with ``quiet`` or without a terminal."""
    bar = SafeConsole(stderr=True, emoji=False)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
        console=bar,
        transient=True,
        disable=quiet or not bar.is_terminal,
    )


class Minutes:
    """Prints once a minute how far a run is, also while nothing is completed."""

    def __init__(self, unit: str, out: Callable[[str], None], *, clock: Callable[[], float] = time.monotonic) -> None:
        """``unit``: what is counted, in the plural. ``out`` prints a line. ``clock``: seconds."""
        self._unit, self._out, self._clock = unit, out, clock
        self.state: Callable[[], str] = lambda: ""
        """Returns a clause on the state of the run for the next line; empty without one."""
        self._total = self._done = 0
        self._last = ""
        self._began = clock()
        self._before = deque([(self._began, 0)], maxlen=_LOOKED_AT)
        """Times of the last lines, and how many units were completed then."""
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._print, daemon=True)

    def start(self, total: int) -> None:
        """Begin a run of so many units."""
        self._total, self._began = total, self._clock()
        self._before = deque([(self._began, 0)], maxlen=_LOOKED_AT)

    def done(self, name: str) -> None:
        """Count a unit."""
        self._done += 1
        self._last = name

    def line(self) -> str:
        """Return how far the run is, the estimated seconds that are left, and the last completed unit."""
        now, done = self._clock(), self._done
        text = f"{done} of {self._total} {self._unit} after {now - self._began:.0f} s"
        # A run becomes slower: at first many cases are executed side by side.
        begun, before = self._before[0]
        self._before.append((now, done))
        if done == before > 0:
            text += f", none completed for {now - begun:.0f} s; last completed: {self._last}"
        elif done:
            left = (now - begun) * max(0, self._total - done) / (done - before)
            text += f", about {left:.0f} s left; last completed: {self._last}"
        state = self.state()
        return f"{text}; {state}" if state else text

    def _print(self) -> None:
        while not self._ended.wait(_MINUTE):
            if self._total:
                self._out(self.line())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()


class Display:
    """Progress bar on a terminal, and a line for each case that did not pass, or with ``verbose`` for each case."""

    def __init__(self, *, verbose: bool = False, quiet: bool = False) -> None:
        self._verbose = verbose
        self._quiet = quiet
        self._console = console()
        self._progress = progress_bar(quiet=quiet)
        self._task: TaskID | None = None
        self.minutes = Minutes("cases", self.waiting)

    def __enter__(self) -> Self:
        self._progress.start()
        # The progress bar shows the same.
        if self._progress.disable and not self._quiet:
            self.minutes.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self.minutes.__exit__(*exception)
        self._progress.stop()

    def start(self, total: int) -> None:
        """Set the number of test cases of the run."""
        self._task = self._progress.add_task("cases", total=total)
        self.minutes.start(total)

    def waiting(self, what: str) -> None:
        """Print a message on standard error: what the run waits for, or a fault of the adapter."""
        if not self._quiet:
            self._progress.console.print(data(what), soft_wrap=True, highlight=False)

    def result(self, case: Case, result: CaseResult, surprise: str) -> None:
        """Show the result of a completed test case."""
        if self._task is not None:
            self._progress.update(self._task, advance=1, description=data(case.id))
        self.minutes.done(case.id)
        notable = result.verdict in (Verdict.FAIL, Verdict.ERROR, Verdict.INCONCLUSIVE) or bool(surprise)
        if self._quiet or not (notable or self._verbose):
            return
        # On a terminal, print through the progress bar's console, so that the bar stays below the text.
        out = self._progress.console if sys.stdout.isatty() and not self._progress.disable else self._console
        out.print(self._line(result, surprise), soft_wrap=True, highlight=False)
        # A program may be reading the output from a pipe.
        out.file.flush()

    def _line(self, result: CaseResult, surprise: str) -> str:
        style = STYLES[result.verdict]
        word = _HEADINGS.get(result.verdict, str(result.verdict)).rstrip(".")
        text = f"[{style}]{word:<8}[/] {data(result.id)}"
        detail = result.reason if result.verdict is not Verdict.PASS else result.purpose
        if result.verdict is Verdict.PASS and result.executions > 1:
            detail = f"{detail} (execution {result.executions})"
        if surprise and surprise not in detail and not surprise.startswith("unexpected fail"):
            detail = f"{surprise}; {detail}"
        return f"{text}  {data(detail)}"


def print_summary(run: RunResult, *, report: str = "") -> None:
    """Print the summary of a run: a table by section, failures with commands to repeat them, and the report path."""
    out = console()
    if run.cases:
        out.print(_sections(run))
    print_findings(run)
    if run.kind == "check":
        _print_observations(out, run)
    counts = {verdict: sum(each is verdict for each in run.requirements.values()) for verdict in Verdict}
    shown = [
        f"{counts[each]} {_HEADINGS.get(each, each) if each is Verdict.TOO_LITTLE else each}"
        for each in _columns(run)
        if counts[each] and each is not Verdict.NOT_APPLICABLE
    ]
    decided = f"requirements: {', '.join(shown)}" if shown else "no requirement was decided"
    sut = " ".join(filter(None, (run.sut.name, run.sut.version))) or "the implementation"
    where = f" over {data(run.sut.link)}" if run.kind != "check" and run.sut.link else ""
    out.print(f"\n{data(sut)} as {data(run.profile)}{where}: {decided}")
    if run.kind != "check" and (failing := _failing(run)):
        out.print(f"[{STYLES[Verdict.FAIL]}]failing[/]: {data(failing)}")
    _print_diagnosis(out, run)
    if lost := undecided_deaths(run):
        out.print(f"[{STYLES[Verdict.FAIL]}]died[/]: {data(lost)}")
    for identifier, instead in run.declared.items():
        out.print(f"{data(identifier)} is not met, as the profile declares: {data(instead)}")
    for identifier, denial in run.denied.items():
        out.print(f"{data(identifier)} is not met, {data(denial)}")
    if nothing_decided(run.cases):
        out.print("nothing was decided: no case applies")
    for line in _readings(run):
        out.print(line)
    for note in run.notes[:_NOTES]:
        out.print(f"note: {data(note)}")
    if len(run.notes) > _NOTES:
        out.print(f"      ... and {len(run.notes) - _NOTES} more, which the report shows")
    count = sum(case.counted for case in run.cases)
    number = f"{count} case" + ("" if count == 1 else "s")
    out.print(f"{number} in {run.duration:.1f} s" + (f"; report: {data(report)}" if report else ""))


def print_findings(run: RunResult) -> None:
    """Print the failures of a run, those with the same cause together, with commands to repeat them."""
    out = console()
    alike = deaths(run)
    for group in alike:
        _print_alike(out, Verdict.FAIL, f"the implementation {group.how}", group.cases)
    printed = {id(case) for group in alike for case in group.cases}
    for cases in _errors_alike(run):
        _print_alike(out, Verdict.ERROR, cases[0].reason, cases)
        printed.update(map(id, cases))
    for case in run.cases:
        if case.verdict in (Verdict.FAIL, Verdict.ERROR) and case.counted and id(case) not in printed:
            _print_finding(out, case)


def _print_diagnosis(out: Console, run: RunResult) -> None:
    """Print the probable faults, starting with the one that explains the most failures."""
    if run.diagnosis is None or not (heading := diagnosed(run)):
        return
    out.print(f"\n[bold]{data(heading)}[/]")
    if (said := stated(run)) and run.diagnosis.stated is not None:
        out.print(f"  {data(said)}  \\[{data(', '.join(run.diagnosis.stated.requirements))}]")
    for number, fault in enumerate(run.diagnosis.faults[:_FAULTS], 1):
        out.print(f"  {number}. {data(sentence(fault))}  \\[{data(', '.join(fault.requirements))}]")
        for other in fault.alternatives:
            out.print(f"     or {'it' if fault.likely else 'that'} {data(other)}")
        if not fault.likely and fault.check is not None and fault.check.observed:
            out.print(f"     expected {data(fault.check.expected)}; observed {data(fault.check.observed)}")
        out.print(f"     {data(certainty(fault))}")
        frame = f", frame {fault.mark.frame}" if fault.mark is not None else ""
        if fault.case:
            out.print(f"     best seen in {data(fault.case)}{frame}; again: {data(fault.rerun)}")
    if len(run.diagnosis.faults) > _FAULTS:
        out.print(f"  ... and {len(run.diagnosis.faults) - _FAULTS} more, which the report shows")


def _failing(run: RunResult) -> str:
    """Return the failed requirements with their numbers of failed cases, the most frequent first."""
    cases: Counter[str] = Counter()
    for case in run.cases:
        failed = (check.requirements for check in case.checks if check.verdict is Verdict.FAIL)
        cases.update([*dict.fromkeys(identifier for names in failed for identifier in names)])
    return ", ".join(f"{name} in {count} case{'' if count == 1 else 's'}" for name, count in cases.most_common())


def _readings(run: RunResult) -> Iterator[str]:
    """Yield the observed interpretations of ambiguous text, with their names if any, and the observed hazards."""
    named: list[str] = []
    differing: list[str] = []
    others: list[str] = []
    for each in observed_readings(run):
        text = f"{each.id} {'/'.join(each.observed)}"
        if not each.named:
            others.append(each.id)
        else:
            (differing if each.differs else named).append(text)
    if named:
        yield f"readings: {data(', '.join(named))}"
    if differing:
        yield f"readings that differ from the reference reading: {data(', '.join(differing))}"
    if others:
        yield f"observed, see the report: {data(' '.join(others))}"


def _print_observations(out: Console, run: RunResult) -> None:
    """Print the observations from a recording that are not verdicts."""
    seen = [check for case in run.cases for check in case.checks if check.verdict is Verdict.INFO]
    if seen:
        out.print("\n[cyan]observed[/]")
    # A question that has an answer for every sender must not displace the others.
    asked: Counter[str] = Counter()
    turns: list[tuple[int, int]] = []
    for place, check in enumerate(seen):
        turns.append((asked[check.expected], place))
        asked[check.expected] += 1
    for place in sorted(place for _, place in sorted(turns)[:_OBSERVATIONS]):
        check = seen[place]
        out.print(f"  {data(check.expected)}: {data(check.observed)}{_frames(check)}")
    if len(seen) > _OBSERVATIONS:
        out.print(f"  ... and {len(seen) - _OBSERVATIONS} more, which the report shows")


def _frames(check: Check) -> str:
    """Return the frames of a check and the time of the first one, in brackets; empty if it has neither."""
    frames = list(dict.fromkeys(str(mark.frame) for mark in check.frames if mark.frame))
    named = f"frame{'' if len(frames) == 1 else 's'} {listed(frames, _FRAMES)}" if frames else ""
    parts = [named, moment(check.seconds) if check.seconds is not None else ""]
    return f" ({', '.join(filter(None, parts))})" if any(parts) else ""


def _columns(run: RunResult) -> tuple[Verdict, ...]:
    """Return the verdicts with a column. ``TOO_LITTLE`` has one only if it occurs."""
    few = Verdict.TOO_LITTLE in run.requirements.values() or any(c.verdict is Verdict.TOO_LITTLE for c in run.cases)
    return (*_COLUMNS[:-1], Verdict.TOO_LITTLE, _COLUMNS[-1]) if few else _COLUMNS


def _sections(run: RunResult) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("", no_wrap=True, overflow="ellipsis", min_width=20)
    columns = _columns(run)
    for verdict in columns:
        heading = _HEADINGS.get(verdict, str(verdict))
        table.add_column(heading, justify="right", no_wrap=True, min_width=len(heading))
    # Group by document: a row for every heading would fill pages.
    sections: dict[tuple[str, str], Counter[Verdict]] = {}
    for case in run.cases:
        if case.counted:
            sections.setdefault((case.table, case.section.partition(":")[0]), Counter())[case.verdict] += 1
    for kind in ("conformance", "robustness"):
        rows = [(section, row) for (each, section), row in sorted(sections.items()) if each == kind]
        if not rows:
            continue
        table.add_row(f"[bold]{kind}[/]")
        for section, row in rows:
            table.add_row(f"  {data(section)}", *_cells(row, columns))
        table.add_row("  [bold]all[/]", *_cells(sum((row for _, row in rows), Counter()), columns))
    return table


def _cells(row: Counter[Verdict], columns: Iterable[Verdict]) -> list[str]:
    return [f"[{STYLES[each]}]{row[each]}[/]" if row[each] else "[dim].[/]" for each in columns]


def _errors_alike(run: RunResult) -> list[list[CaseResult]]:
    """Return the cases that ended with the same error of the tester, where these are several."""
    groups: dict[str, list[CaseResult]] = {}
    for case in run.cases:
        if case.verdict is Verdict.ERROR:
            groups.setdefault(case.reason, []).append(case)
    return [cases for cases in groups.values() if len(cases) > 1]


def _print_alike(out: Console, verdict: Verdict, text: str, cases: Sequence[CaseResult]) -> None:
    """Print one finding for cases in which the SUT crashed in the same way, or that ended with the same error."""
    out.print(f"\n[{STYLES[verdict]}]{verdict}[/] [bold]{len(cases)} cases[/]: {data(text)}")
    out.print(f"  cases     {data(listed([case.id for case in cases], _CHECKS))}")
    if verdict is Verdict.FAIL:
        decided = dict.fromkeys(each for case in cases for check in bad_checks(case) for each in check.requirements)
        out.print(f"  decides   {data(', '.join(decided))}")
    if cases[0].rerun:
        out.print(f"  again     {data(cases[0].rerun)}")


def _print_finding(out: Console, case: CaseResult) -> None:
    out.print(f"\n[{STYLES[case.verdict]}]{case.verdict}[/] [bold]{data(case.id)}[/]: {data(case.purpose)}")
    bad = bad_checks(case)
    previous = ""
    for check in bad[:_CHECKS]:
        if check.expected != previous:
            out.print(f"  expected  {data(check.expected)}")
        out.print(f"  observed  {data(check.observed)}{_frames(check)}")
        previous = check.expected
    if len(bad) > _CHECKS:
        out.print(f"            ... and {len(bad) - _CHECKS} more, which the report shows")
    decided = dict.fromkeys(each for check in bad for each in check.requirements)
    if decided:
        out.print(f"  decides   {data(', '.join(decided))}")
    if case.consequence:
        out.print(f"  means     {data(case.consequence)}")
    if case.show:
        out.print(f"  show      {data(case.show)}")
    if case.rerun:
        out.print(f"  again     {data(case.rerun)}")
