"""The page of a report: chapters of recordings, sections of plots and tables; one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from dcp_codec.plain import plain

from . import analysis, figures, variables
from .analysis import Sender, Steps, Time
from .canvas import Plot
from .easel import Easel
from .figures import DRAWN
from .recorded import Recorded
from .series import seconds_text

#: Anomalies of each kind that are listed; octets of a value that are shown.
_LISTED, _OCTETS = 10, 16
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass
class Cell:
    """One cell of a table. ``series`` is the colour of what the row is about; ``number`` aligns it to the right."""

    text: str
    number: bool = False
    series: int | None = None
    mono: bool = False


@dataclass
class Table:
    """A table with its heading."""

    heads: list[Cell]
    rows: list[list[Cell]]


@dataclass
class Section:
    """One section; ``words`` are what there is to say, also where there is nothing to draw."""

    id: str
    title: str
    words: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    plots: list[Plot] = field(default_factory=list)


@dataclass
class Chapter:
    """What is said of one recording."""

    name: str
    facts: list[tuple[str, str]]
    tiles: list[tuple[str, str, str]]
    problems: list[str]
    sections: list[Section]

    @property
    def plots(self) -> list[Plot]:
        """All plots, in the order of the page."""
        return [plot for section in self.sections for plot in section.plots]


def render(chapters: Sequence[Chapter]) -> str:
    """The page; everything that comes from recordings is escaped."""
    environment = Environment(
        loader=PackageLoader("dcp_codec.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html").render(chapters=chapters)


def chapter(recorded: Recorded, number: int = 0, *, png: bool = False) -> Chapter:
    """All that is said of one recording. ``number`` keeps the names of several apart."""
    outcome = recorded.outcome
    time, steps = analysis.time_of(recorded), analysis.steps_of(recorded)
    senders = analysis.senders_of(recorded, time, steps)
    values, hops = variables.dissemination(recorded, time)
    lines = variables.lines(recorded, values, hops, DRAWN)
    most = sorted(senders, key=lambda sender: -sender.beacons)[:DRAWN]
    # Nodes that only others talk about come last.
    known = {sender.node for sender in senders}
    silent = [node for node in np.unique(recorded.column("srp", "node")).tolist() if node not in known]
    nodes = ([sender.node for sender in senders if sender in most] + silent)[:DRAWN]
    easel = Easel(recorded, time, nodes, [line.number for line in lines], png=png, prefix=f"{number:02}-")
    sections = []
    if outcome.frames > outcome.other:
        sections = [
            _senders(easel, senders, steps),
            _ages(easel),
            _neighbours(easel, hops),
            _positions(easel),
            _variables(easel, lines, values, hops),
            _overhead(easel),
            _anomalies(easel, steps),
        ]
    for section in sections:
        section.id = f"{section.id}-{number}"
    return Chapter(
        name=plain(Path(outcome.path).name),
        facts=_facts(recorded, time),
        tiles=_tiles(recorded, time, senders, steps),
        problems=_problems(recorded, steps),
        sections=sections,
    )


# -- the head of a chapter ----------------------------------------------------------------------------------------


def _facts(recorded: Recorded, time: Time) -> list[tuple[str, str]]:
    outcome = recorded.outcome
    facts = [
        ("recording", plain(outcome.path)),
        ("profile", plain(", ".join(outcome.notes).removeprefix("profile ") or outcome.profile)),
    ]
    if outcome.frames > outcome.other:
        facts.append(("from", stamp(time.first_ns)))
        facts.append(("to", stamp(time.last_ns)))
    return facts


def _tiles(recorded: Recorded, time: Time, senders: Sequence[Sender], steps: Steps) -> list[tuple[str, str, str]]:
    beacons, lost = recorded.column("beacons", "node").size, int(steps.lost.sum())
    malformed = recorded.outcome.malformed
    tiles = [(f"{beacons:,}", "beacons", ""), (f"{len(senders):,}", "senders", "")]
    if recorded.modulus:
        share = 100 * lost / (beacons + lost) if beacons else 0
        tiles.append((f"{share:.2g} %", "lost", "fail" if lost else ""))
    tiles.append((str(len(recorded.variables)), "variables", ""))
    tiles.append((f"{malformed:,}", "malformed", "fail" if malformed else ""))
    tiles.append((seconds_text(time.duration), "duration", ""))
    return tiles


def _problems(recorded: Recorded, steps: Steps) -> list[str]:
    outcome = recorded.outcome
    found = [plain(problem) for problem in outcome.problems]
    if outcome.other == outcome.frames:
        listed = ", ".join(f"{kind} ({many})" for kind, many in list(outcome.others.items())[:6])
        nothing = f"All {outcome.frames:,} are other traffic." if outcome.frames else "There are no frames at all."
        there = f"There is: {listed}." if listed else nothing
        found.append(f"There are no DCP frames of profile {outcome.profile} in this recording. {there}")
    elif outcome.other:
        found.append(f"{outcome.other:,} of {outcome.frames:,} frames are other traffic than DCP.")
    if steps.back.any():
        found.append(
            "Time goes back in this recording: the clock of the recorder was set. Rates, ages, delays and the order of "
            "events mislead where it was."
        )
    return found


# -- sections -----------------------------------------------------------------------------------------------------


def _senders(easel: Easel, senders: Sequence[Sender], steps: Steps) -> Section:
    section = Section("senders", "Beacons")
    if not senders:
        section.words.append("There is no well-formed beacon.")
        return section
    names = easel.recorded.nodes
    heads = ["sender", "beacons", "per second", "lost", "restarts", "state reports", "first (s)", "last (s)"]
    rows = [
        [
            Cell(names[sender.node], series=_series(easel, sender.node), mono=True),
            _number(f"{sender.beacons:,}"),
            _number("-" if sender.rate is None else f"{sender.rate:.3g}"),
            _number("unknown" if sender.loss is None else f"{sender.lost:,} ({100 * sender.loss:.2g} %)"),
            _number(f"{sender.restarts:,}"),
            _number(f"{sender.reports:,}"),
            _number(f"{sender.first:.3f}"),
            _number(f"{sender.last:.3f}"),
        ]
        for sender in senders
        if sender.node in easel.nodes
    ]
    section.tables.append(_table(heads, rows))
    rest = [sender for sender in senders if sender.node not in easel.nodes]
    if rest:
        beacons, lost = sum(each.beacons for each in rest), sum(each.lost for each in rest)
        section.words.append(
            f"The {len(rows)} senders with most beacons are drawn; {len(rest):,} more sent {beacons:,} beacons that "
            f"were heard and {lost:,} that are missing."
        )
    if not easel.recorded.modulus:
        section.words.append("Beacons of this profile have no sequence numbers: what is lost cannot be seen.")
    section.plots += figures.beacon_rate(easel, steps)
    return section


def _ages(easel: Easel) -> Section:
    section = Section("age", "Age of information")
    if easel.recorded.column("srp", "node").size:
        section.plots += figures.ages(easel)
    else:
        section.words.append("There are no state reports (SRP) in this recording.")
    return section


def _neighbours(easel: Easel, hops: variables.Hops) -> Section:
    section = Section("neighbours", "Neighbours")
    if easel.recorded.column("beacons", "node").size:
        section.plots.append(figures.presence(easel))
    edges = variables.edges(hops)
    if edges:
        section.plots.append(figures.graph(easel, edges))
    else:
        section.words.append("No node passed on what another had said: there is nothing to draw a graph from.")
    return section


def _positions(easel: Easel) -> Section:
    section = Section("positions", "Positions")
    recorded = easel.recorded
    many = recorded.column("srp", "node").size
    if not {"position.x", "position.y"} <= recorded.units.keys():
        section.words.append(f"Profile {recorded.outcome.profile} names no fields of state reports that are positions.")
    elif not many:
        section.words.append("There are no state reports (SRP), so there are no positions.")
    else:
        section.plots += figures.positions(easel)
        wrong = many - int(figures.usable(recorded.tables["srp"]).sum())
        if wrong:
            section.words.append(
                f"{wrong:,} of {many:,} state reports have coordinates that are no numbers or beyond all bounds; they "
                "are not drawn."
            )
    return section


def _variables(
    easel: Easel, lines: Sequence[variables.VariableLine], values: variables.Values, hops: variables.Hops
) -> Section:
    section = Section("variables", "Variables")
    if not lines:
        section.words.append("Nobody said anything about a variable (VarDis).")
        return section
    heads = ["variable", "producer", "description", "values", "octets", "last value", "median delay", "95 %"]
    names = easel.recorded.nodes
    rows = [
        [
            Cell(str(line.number), series=easel.variables.index(line.number)),
            Cell(names[line.producer] if line.producer >= 0 else "not heard", mono=line.producer >= 0),
            Cell(plain(line.description)),
            _number(f"{line.values:,}"),
            _number(line.sizes),
            Cell(line.value[:_OCTETS].hex(" ", 4) + (" …" if len(line.value) > _OCTETS else ""), mono=True),
            _number("" if line.median is None else seconds_text(line.median)),
            _number("" if line.p95 is None else seconds_text(line.p95)),
        ]
        for line in lines
    ]
    section.tables.append(_table(heads, rows))
    rest = len(easel.recorded.variables) - len(lines)
    if rest:
        more = values.variable.size - sum(line.values for line in lines)
        section.words.append(f"The {DRAWN} variables with most values are drawn; {rest:,} more have {more:,} values.")
    section.plots += figures.values(easel, values)
    if hops.counted.any():
        section.plots += figures.delays(easel, hops)
    else:
        section.words.append("No value was heard from its producer and then from another node: there are no delays.")
    late = int((~values.from_producer).sum())
    if late:
        section.words.append(
            f"{late:,} of {values.variable.size:,} values were first heard from another node than the producer (again, "
            "or the recorder missed it); delays leave them out."
        )
    return section


def _overhead(easel: Easel) -> Section:
    section = Section("overhead", "Overhead")
    parts = analysis.overhead(easel.recorded, easel.time)
    if not parts:
        section.words.append("There is no well-formed beacon to count the octets of.")
        return section
    section.plots += figures.octets(easel, parts)
    size = int(easel.recorded.column("said", "size").sum())
    if size:
        total = sum(part.octets for part in parts)
        section.words.append(f"{total / size:.3g} octets on the air for each octet of a variable's value.")
    return section


def _anomalies(easel: Easel, steps: Steps) -> Section:
    section = Section("anomalies", "Anomalies")
    recorded = easel.recorded
    times = analysis.anomaly_times(recorded, easel.time, steps)
    if not any(each.size for each in times.values()):
        told = ", no gap, restart or repetition in sequence numbers," if recorded.modulus else ""
        section.words.append(f"None: there is no malformed frame{told} and time does not go back.")
        return section
    section.plots.append(figures.anomalies(easel, times))
    reasons = recorded.column("errors", "reason")
    if reasons.size:
        counted = sorted(((int((reasons == n).sum()), n) for n in set(reasons.tolist())), key=lambda each: -each[0])
        rows = [
            [
                Cell(recorded.reasons[reason], mono=True),
                Cell(recorded.requirements.get(recorded.reasons[reason], ""), mono=True),
                _number(f"{many:,}"),
            ]
            for many, reason in counted
        ]
        section.tables.append(_table(["reason", "requirement", "frames"], rows))
    worst = analysis.worst(recorded, easel.time, steps, _LISTED)
    rows = [
        [
            _number(f"{each.frame:,}"),
            _number(f"{each.time:.6f}"),
            Cell(recorded.nodes[each.node], mono=True),
            Cell(each.kind),
            Cell(each.words),
        ]
        for each in worst
    ]
    section.tables.append(_table(["frame", "time (s)", "sender", "what", "in detail"], rows))
    if sum(each.size for each in times.values()) > len(worst):
        section.words.append(f"The list has the first {_LISTED} of each kind, and the largest gaps.")
    return section


# -- words --------------------------------------------------------------------------------------------------------


def _table(heads: Sequence[str], rows: list[list[Cell]]) -> Table:
    # A head is aligned as its column.
    return Table([Cell(head, number=rows[0][place].number) for place, head in enumerate(heads)], rows)


def _number(text: str) -> Cell:
    return Cell(text, number=True)


def _series(easel: Easel, node: int) -> int | None:
    return easel.nodes.index(node) if node in easel.nodes else None


def stamp(time: int) -> str:
    """A time of capture (ns since 1970) in UTC."""
    seconds, rest = divmod(time, 1_000_000_000)
    try:
        return f"{_EPOCH + timedelta(seconds=seconds):%Y-%m-%d %H:%M:%S}.{rest:09d} UTC"
    except OverflowError:
        return f"{time} ns since 1970"
