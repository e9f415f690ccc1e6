"""Create the chapter of a report on one recording: its summary and sections, from the numbers of the other modules."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dcp_codec.analysis.vantage_point import NO_LOSSES
from dcp_codec.common.printable import plain
from dcp_codec.texts import utc

from . import analysis, holding, reactions, sections, variables
from .analysis import Sender, Steps, Time
from .findings import Judged
from .page import Chapter
from .plots import DRAWN, PlotContext
from .recorded import Recorded
from .series import seconds_text, short


def chapter(recorded: Recorded, number: int = 0, judged: Judged | None = None) -> Chapter:
    """Return the chapter on one recording. ``number`` makes the names of plots and sections unique on the page.

    ``judged``: findings of ``check``; they are shown if they are about this recording.
    """
    outcome = recorded.outcome
    if judged is not None and judged.recording != Path(outcome.path).name:
        judged = None
    time, steps = analysis.time_of(recorded), analysis.steps_of(recorded)
    senders = analysis.senders_of(recorded, time, steps)
    transmissions = variables.transmissions(recorded)
    values, passed = variables.dissemination(recorded, time, transmissions)
    lines = variables.lines(recorded, values, passed, DRAWN)
    most = sorted(senders, key=lambda sender: -sender.beacons)[:DRAWN]
    # Nodes that sent no beacon, but are in reports of others, come last.
    known = {sender.node for sender in senders}
    silent = [node for node in np.unique(recorded.column("srp", "node")).tolist() if node not in known]
    nodes = ([sender.node for sender in senders if sender in most] + silent)[:DRAWN]
    context = PlotContext(recorded, time, nodes, [line.number for line in lines], prefix=f"{number:02}-")
    held = holding.holding(recorded, time)
    found = reactions.reactions(recorded, transmissions, nodes)
    found_sections = []
    if outcome.frames > outcome.other:
        found_sections = [
            *([sections.findings_section(context, judged)] if judged is not None else []),
            sections.holding_section(context, held),
            sections.reactions_section(context, found),
            sections.anomalies_section(context, steps),
            sections.senders_section(context, senders, steps),
            sections.ages_section(context, found),
            sections.positions_section(context),
            sections.variables_section(context, lines, values, passed),
            sections.overhead_section(context),
        ]
    for section in found_sections:
        section.id = f"{section.id}-{number}"
    return Chapter(
        name=plain(Path(outcome.path).name),
        facts=_facts(recorded, time),
        tiles=[*_tiles(recorded, time, senders, steps, held), *_failures(judged)],
        problems=_problems(recorded, steps),
        sections=found_sections,
        figures=_figures(context, senders, steps, held, values, passed) if found_sections else [],
        duration=time.duration,
    )


# -- the head of a chapter ----------------------------------------------------------------------------------------


def _facts(recorded: Recorded, time: Time) -> list[tuple[str, str]]:
    outcome = recorded.outcome
    facts = [
        ("recording", plain(outcome.path)),
        ("profile", plain(", ".join(outcome.notes).removeprefix("profile ") or outcome.profile)),
    ]
    if outcome.frames > outcome.other:
        facts.append(("from", f"{utc(time.first_ns)} UTC"))
        facts.append(("to", f"{utc(time.last_ns)} UTC"))
    if recorded.transmissions_only:
        facts.append(("note", f"Losses are unknown: {NO_LOSSES}."))
    return facts


def _lost(recorded: Recorded, steps: Steps) -> tuple[int, float]:
    """Return the number of lost beacons, and their share in percent."""
    beacons, lost = recorded.column("beacons", "node").size, int(steps.lost.sum())
    return lost, 100 * lost / (beacons + lost) if beacons else 0.0


def _tiles(
    recorded: Recorded, time: Time, senders: Sequence[Sender], steps: Steps, held: holding.Holding
) -> list[tuple[str, str, str]]:
    malformed = recorded.outcome.malformed
    stale = sum(pair.stale_at_end for pair in held.pairs)
    behind = sum(bool(pair.stale) for pair in held.pairs)
    lost, share = _lost(recorded, steps)
    tiles = [(f"{recorded.column('beacons', 'node').size:,}", "beacons", ""), (f"{len(senders):,}", "senders", "")]
    if recorded.tells_losses:
        tiles.append((f"{short(share, 2)} %", "lost", "fail" if lost else ""))
    tiles.append((str(len(recorded.variables)), "variables", ""))
    if held.pairs:
        many, label = (stale, "stale at the end") if stale else (behind, "were stale")
        tiles.append((f"{'≠ ' if many else ''}{many:,}", label, "fail" if many else ""))
    tiles.append((f"{malformed:,}", "malformed", "fail" if malformed else ""))
    tiles.append((seconds_text(time.duration), "duration", ""))
    return tiles


def _failures(judged: Judged | None) -> list[tuple[str, str, str]]:
    """Return the tile with the number of findings with the verdict fail."""
    if judged is None:
        return []
    many = sum(each.verdict == "fail" for each in judged.findings)
    return [(f"{many:,}", "finding" if many == 1 else "findings", "fail" if many else "")]


def _problems(recorded: Recorded, steps: Steps) -> list[str]:
    outcome = recorded.outcome
    found = [plain(problem) for problem in outcome.problems]
    if outcome.other == outcome.frames:
        listed = ", ".join(f"{kind} ({many})" for kind, many in list(outcome.others.items())[:6])
        nothing = f"All {outcome.frames:,} frames are other traffic." if outcome.frames else "It has no frames at all."
        there = f"It has: {listed}." if listed else nothing
        found.append(f"There are no DCP frames of profile {outcome.profile} in this recording. {there}")
    elif outcome.other:
        found.append(f"{outcome.other:,} of {outcome.frames:,} frames are not DCP.")
    if steps.back.any():
        found.append(
            "Time goes back in this recording: the clock of the recorder was set. Rates, ages, delays and the order of "
            "events are wrong at these times."
        )
    return found


def _figures(
    context: PlotContext,
    senders: Sequence[Sender],
    steps: Steps,
    held: holding.Holding,
    values: variables.Values,
    passed: variables.Passings,
) -> list[tuple[str, str]]:
    """Return the figures of the comparison of recordings, as (name, text)."""
    recorded = context.recorded
    lost, share = _lost(recorded, steps)
    octets = sum(part.octets for part in analysis.overhead(recorded, context.time))
    delays = passed.delay[passed.counted]
    could, sent = sum(pair.values for pair in held.pairs), sum(pair.sent for pair in held.pairs)
    behind = sum(b - a for pair in held.pairs for a, b in pair.stale)
    known = sum(b - a for pair in held.pairs for a, b in pair.known) or 1.0

    def quantile(at: float) -> str:
        return seconds_text(float(np.quantile(delays, at))) if delays.size else "-"

    return [
        ("duration", seconds_text(context.time.duration)),
        ("profile", plain(recorded.outcome.profile)),
        ("senders", f"{len(senders):,}"),
        ("beacons", f"{recorded.column('beacons', 'node').size:,}"),
        ("beacons lost", f"{lost:,} ({short(share, 2)} %)" if recorded.tells_losses else "unknown"),
        ("malformed frames", f"{recorded.outcome.malformed:,}"),
        ("values of variables", f"{values.variable.size:,}"),
        ("values that a node never sent", f"{could - sent:,} of {could:,}"),
        ("time with a stale value", f"{short(100 * behind / known)} %"),
        ("longest lag", seconds_text(max((pair.age for pair in held.pairs), default=0.0))),
        ("stale at the end (node and variable)", f"{sum(pair.stale_at_end for pair in held.pairs):,}"),
        ("dissemination delay, median", quantile(0.5)),
        ("dissemination delay, 95th percentile", quantile(0.95)),
        ("transmitted octets", f"{octets:,}"),
    ]
