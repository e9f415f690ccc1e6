"""The sections of a report on one recording: tables, text and plots, from the numbers of the other modules."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence

import numpy as np

from dcp_codec.common.printable import plain

from . import analysis, holding, plots, reactions, variables
from .analysis import Sender, Steps
from .findings import Judged
from .page import Cell, Section, Table, table
from .plots import DRAWN, PlotContext, number_text
from .recorded import Recorded
from .series import seconds_text, short

#: Maximum number of listed anomalies of each kind, and of shown octets of a value.
_LISTED, _OCTETS = 10, 16


def command(recorded: Recorded, frame: int, variable: int | None = None) -> Cell:
    """Return a cell with the command that shows a frame; empty for standard input, which cannot be read again."""
    path = recorded.outcome.path
    if path == "-":
        return Cell("")
    only = f" -w 'varId == {variable}'" if variable is not None else ""
    return Cell(plain(f"dcp-codec decode --frames {frame}{only} {recorded.options} {shlex.quote(path)}"), code=True)


def findings_section(context: PlotContext, judged: Judged) -> Section:
    """Return the section on the findings of ``dcp-conformance check``."""
    section = Section("findings", "Findings of dcp-conformance check")
    if judged.links:
        section.words.append(judged.links[0].upper() + judged.links[1:] + ".")
    rows = [
        [
            Cell(each.verdict, bad=each.verdict == "fail"),
            Cell(each.rule, mono=True),
            _number("" if each.seconds is None else f"{each.seconds:.3f}"),
            Cell(plain(each.text)),
            command(context.recorded, each.frames[-1]) if each.frames else Cell(""),
        ]
        for each in judged.findings
        if each.verdict != "info" or each.frames
    ]
    if rows:
        caption = "Findings by verdict. The command shows the last frame of the finding."
        section.tables.append(table(caption, ["verdict", "rule", "at (s)", "observed", "command"], rows))
    if not any(each.verdict == "fail" for each in judged.findings):
        section.words.append("No rule fails.")
    return section


def holding_section(context: PlotContext, found: holding.Holding) -> Section:
    """Return the section on the values that nodes hold."""
    section = Section("holding", "Values held by each node")
    if not found.pairs:
        section.words.append("No node has sent a sequence number of another node's variable, so none can be compared.")
        return section
    section.words += _stale_values(context, found)
    section.tables.append(_at_the_end(context, found))
    plot, hidden = plots.holdings(context, found)
    if plot is not None:
        section.plots.append(plot)
    if hidden:
        section.words.append(f"The {plots.ROWS} rows that differ longest are drawn; {hidden:,} more are not.")
    if found.left_out:
        section.words.append(f"{found.left_out:,} more pairs of a node and a variable were not compared.")
    if found.stale:
        section.tables.append(_stale_states(context, found.stale))
        if len(found.stale) > 2 * _LISTED:
            section.words.append(f"The list has {2 * _LISTED} of {len(found.stale):,} stale values, the longest.")
    section.tables += _never_sent(context, found)
    if found.without_producer:
        listed = ", ".join(map(str, found.without_producer[:12]))
        section.words.append(f"Not compared, because not one producer is known: variable {listed}.")
    return section


def _stale_values(context: PlotContext, found: holding.Holding) -> list[str]:
    """Describe the stale values of nodes, those at the end, and variables without a record."""
    behind = [pair for pair in found.pairs if pair.stale]
    stale = [pair for pair in behind if pair.stale_at_end]
    words = []
    if not behind:
        words.append("No node had a stale value: no number was kept for more than 3 s after the producer had left it.")
    if stale:
        about = sorted({pair.variable for pair in stale})
        listed = ", ".join(map(str, about[:8])) + (" ..." if len(about) > 8 else "")
        words.append(
            f"≠ At the end {len({pair.node for pair in stale})} of {len({pair.node for pair in found.pairs})} nodes "
            f"have stale values of {len(about)} of {len({pair.variable for pair in found.pairs})} variables ({listed})."
        )
    if behind:
        worst = max(behind, key=lambda pair: (pair.age, pair.numbers))
        by = f", {worst.numbers:,} value{'' if worst.numbers == 1 else 's'}" if worst.numbers else ""
        nodes, variables = len({pair.node for pair in behind}), len({pair.variable for pair in behind})
        words.append(
            f"≠ Nodes with stale values: {nodes}, of variables: {variables}. The longest lag: "
            f"{context.name(worst.node)} with variable {worst.variable}, {seconds_text(worst.age)}{by}."
            f"{'' if stale else ' At the end no node has one.'}"
        )
    absent = [f"{pair.variable} at {context.name(pair.node)}" for pair in found.pairs if pair.absent]
    if absent:
        more = f" and {len(absent) - 8} more" if len(absent) > 8 else ""
        words.append(f"No record about a variable that its producer has: {', '.join(absent[:8])}{more}.")
    return words


def _at_the_end(context: PlotContext, found: holding.Holding) -> Table:
    pairs = {(pair.variable, pair.node): pair for pair in found.pairs}
    shown = list(dict.fromkeys(pair.variable for pair in sorted(found.pairs, key=lambda each: not each.stale_at_end)))
    rows = []
    for variable in sorted(shown[:DRAWN]):
        first = next(pair for pair in found.pairs if pair.variable == variable)
        row = [Cell(f"{variable}"), Cell(context.name(first.producer), mono=True), _number(number_text(first.produced))]
        for node in context.nodes:
            pair = pairs.get((variable, node))
            if pair is None:
                row.append(_number("producer" if node == first.producer else "-"))
            else:
                bad = pair.stale_at_end
                row.append(Cell(f"{'≠ ' if bad else ''}{number_text(pair.held)}", number=True, bad=bad))
        rows.append(row)
    heads = ["variable", "producer", "its number", *(context.name(node) for node in context.nodes)]
    caption = "The last sequence number of each variable that each node sent. ≠ in red: it is stale."
    return table(caption, heads, rows, matrix=True)


def _stale_states(context: PlotContext, found: Sequence[holding.Stale]) -> Table:
    rows = [
        [
            Cell(f"{each.variable}"),
            Cell(context.name(each.node), mono=True),
            _number(number_text(each.held)),
            _number(f"{each.start:.3f}"),
            Cell("to the end" if each.to_the_end else f"for {seconds_text(each.age)}", bad=each.to_the_end),
            _number(number_text(each.produced)),
            _number(f"{each.missed:,}"),
            command(context.recorded, each.frame, each.variable),
        ]
        for each in found[: 2 * _LISTED]
    ]
    caption = "Stale values. The command shows the frame in which the producer left the node's number."
    heads = ["variable", "node", "it keeps", "since (s)", "how long", "the producer", "lag in values", "command"]
    return table(caption, heads, rows)


def _never_sent(context: PlotContext, found: holding.Holding) -> list[Table]:
    producers = [node for node in context.nodes if any(pair.producer == node for pair in found.pairs)]
    if not producers:
        return []

    def cell(node: int, producer: int) -> str:
        own = [pair for pair in found.pairs if pair.node == node and pair.producer == producer]
        could, sent = sum(pair.values for pair in own), sum(pair.sent for pair in own)
        return f"{short(100 * (could - sent) / could, 2)} % ({could - sent:,} of {could:,})" if could else "-"

    caption = (
        "End-to-end loss per pair: values of the column's node that the row's node never sent. A value that was "
        "replaced before the node's next beacon counts, too."
    )
    return [_by_node(context, caption, producers, cell)]


def reactions_section(context: PlotContext, found: reactions.Reactions) -> Section:
    """Return the section on the reactions of nodes to each other."""
    section = Section("reactions", "Reactions between nodes")
    if context.recorded.column("beacons", "node").size:
        section.plots.append(plots.presence(context))
    if not found.trials.any():
        section.words.append("No node forwarded a value of another node, so that reception cannot be inferred.")
        return section

    def cell(node: int, other: int) -> str:
        place = context.nodes.index(node), context.nodes.index(other)
        share, many, done = found.share(*place), int(found.trials[place]), int(found.reacted[place])
        if node == other:
            return ""
        if share is None:
            return f"? ({done} of {many})" if many else "?"
        sign = "●" if share >= reactions.REACTS else "○" if share <= reactions.DEAF else "◐"
        return f"{sign} {100 * share:.0f} % ({done:,} of {many:,})"

    reacts = [
        f"{context.name(node)} to {', '.join(context.name(context.nodes[other]) for other in close)}"
        for place, node in enumerate(context.nodes)
        if (close := found.reacts(place))
    ]
    caption = (
        "Row: the node that reacts; column: the node that it reacts to. Counted are intervals between two beacons of "
        "the row's node in which only the column's node sent a value that was new to it, and how often the next beacon "
        "of the row's node has the value. ● reacts, ◐ sometimes, ○ does not react, ? too few intervals. The difference "
        "to 100 % is the loss between the two, based on the frames that the recorder received."
    )
    section.words.append(f"Reacts: {'; '.join(reacts)}." if reacts else "No node reacted often enough to be sure.")
    section.tables.append(_by_node(context, caption, context.nodes, cell))
    return section


def senders_section(context: PlotContext, senders: Sequence[Sender], steps: Steps) -> Section:
    """Return the section on the beacons of each sender."""
    section = Section("senders", "Beacons")
    if not senders:
        section.words.append("There is no well-formed beacon.")
        return section
    names = context.recorded.nodes
    heads = ["sender", "beacons", "per second", "lost", "restarts", "state reports", "first (s)", "last (s)"]
    rows = [
        [
            Cell(names[sender.node], series=_series(context, sender.node), mono=True),
            _number(f"{sender.beacons:,}"),
            _number("-" if sender.rate is None else short(sender.rate)),
            _number("unknown" if sender.loss is None else f"{sender.lost:,} ({short(100 * sender.loss, 2)} %)"),
            _number(f"{sender.restarts:,}"),
            _number(f"{sender.reports:,}"),
            _number(f"{sender.first:.3f}"),
            _number(f"{sender.last:.3f}"),
        ]
        for sender in senders
        if sender.node in context.nodes
    ]
    section.tables.append(table("Received beacons by sender", heads, rows))
    rest = [sender for sender in senders if sender.node not in context.nodes]
    if rest:
        beacons, lost = sum(each.beacons for each in rest), sum(each.lost for each in rest)
        section.words.append(
            f"The {len(rows)} senders with most beacons are drawn; {len(rest):,} more sent {beacons:,} received "
            f"beacons and {lost:,} that are missing."
        )
    if not context.recorded.modulus:
        section.words.append("Beacons of this profile have no sequence numbers, so that losses are unknown.")
    elif context.recorded.tells_losses and not steps.lost.any():
        section.words.append("No sequence number of a beacon is missing.")
    section.plots += plots.beacon_rate(context, steps)
    return section


def ages_section(context: PlotContext, found: reactions.Reactions) -> Section:
    """Return the section on the age of state reports."""
    section = Section("age", "Age of information")
    recorded = context.recorded
    if not recorded.column("srp", "node").size:
        section.words.append("There are no state reports (SRP) in this recording.")
        return section
    section.plots.append(plots.ages(context))
    _, high = analysis.pair_ages(recorded, context.time, context.nodes)
    inferred = found.trials.any()

    def cell(node: int, other: int) -> str:
        row, column = context.nodes.index(node), context.nodes.index(other)
        unknown = not np.isfinite(high[row, column]) or (inferred and column not in found.hears(row))
        return "-" if unknown else short(high[row, column])

    if np.isfinite(high).any():
        caption = (
            "95th percentile age (s) of what the row's node could know about the column's node. Lower bound: it "
            "assumes that the node received everything that the recorder received"
            f"{'; pairs that do not react to each other are left out' if inferred else ''}."
        )
        section.tables.append(_by_node(context, caption, context.nodes, cell))
    return section


def positions_section(context: PlotContext) -> Section:
    """Return the section on the positions of nodes."""
    section = Section("positions", "Positions")
    recorded = context.recorded
    many = recorded.column("srp", "node").size
    if not {"position.x", "position.y"} <= recorded.units.keys():
        section.words.append(f"State reports of profile {recorded.outcome.profile} have no fields with positions.")
    elif not many:
        section.words.append("There are no state reports (SRP), so there are no positions.")
    else:
        section.plots += plots.positions(context)
        wrong = many - int(plots.usable(recorded.tables["srp"]).sum())
        if wrong:
            section.words.append(
                f"{wrong:,} of {many:,} state reports have coordinates that are not numbers or out of range; they are "
                "not drawn."
            )
    return section


def variables_section(
    context: PlotContext, lines: Sequence[variables.VariableLine], values: variables.Values, passed: variables.Passings
) -> Section:
    """Return the section on the values of variables and their dissemination."""
    section = Section("variables", "Variables")
    if not lines:
        section.words.append("No node sent a record about a variable (VarDis).")
        return section
    heads = ["variable", "producer", "description", "values", "octets", "last value", "median delay", "95th percentile"]
    names = context.recorded.nodes
    rows = [
        [
            Cell(str(line.number), series=place),
            Cell(names[line.producer] if line.producer >= 0 else "not heard", mono=True),
            Cell(plain(line.description)),
            _number(f"{line.values:,}"),
            _number(line.sizes),
            Cell(line.value[:_OCTETS].hex() + ("..." if len(line.value) > _OCTETS else ""), mono=True),
            _number("-" if line.median is None else seconds_text(line.median)),
            _number("-" if line.p95 is None else seconds_text(line.p95)),
        ]
        for place, line in enumerate(lines)
    ]
    section.tables.append(table("Variables, their last values, and the delays of their dissemination", heads, rows))
    rest = len(context.recorded.variables) - len(lines)
    if rest:
        more = values.variable.size - sum(line.values for line in lines)
        section.words.append(f"The {DRAWN} variables with most values are drawn; {rest:,} more have {more:,} values.")
    section.plots += plots.values(context, values)
    if passed.counted.any():
        section.plots += plots.delays(context, passed)
    else:
        section.words.append("No value was received from its producer and then from another node: there are no delays.")
    late = int((~values.from_producer).sum())
    if late:
        section.words.append(
            f"{late:,} of {values.variable.size:,} values were first received from another node than the producer "
            "(repeated, or lost at the recorder); they are left out of the delays."
        )
    return section


def overhead_section(context: PlotContext) -> Section:
    """Return the section on the octets of each kind."""
    section = Section("overhead", "Overhead")
    parts = analysis.overhead(context.recorded, context.time)
    if not parts:
        section.words.append("There is no well-formed beacon whose octets could be counted.")
        return section
    total = sum(part.octets for part in parts)
    rows = [
        [
            Cell(part.name, series=place),
            _number(f"{part.octets:,}"),
            Cell(f"{short(share, 2)} %", number=True, bar=share / 100),
        ]
        for place, part in enumerate(parts)
        for share in [100 * part.octets / total]
    ]
    caption = f"{total:,} octets in frames with valid beacons; each kind of container with its header"
    section.tables.append(table(caption, ["kind", "octets", "share"], rows))
    section.plots.append(plots.load(context, parts))
    size = int(context.recorded.column("values", "size").sum())
    if size:
        section.words.append(f"{short(total / size)} transmitted octets for each octet of a variable's value.")
    return section


def anomalies_section(context: PlotContext, steps: Steps) -> Section:
    """Return the section on anomalies: malformed frames, gaps, restarts, repetitions, and set clocks."""
    section = Section("anomalies", "Anomalies")
    recorded = context.recorded
    times = analysis.anomaly_times(recorded, context.time, steps)
    if not any(each.size for each in times.values()):
        numbers = ", no gap, restart or repetition in sequence numbers," if recorded.modulus else ""
        section.words.append(f"None: there is no malformed frame{numbers} and time does not go back.")
        return section
    section.plots.append(plots.anomalies(context, times))
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
        section.tables.append(table("Malformed frames by reason", ["reason", "requirement", "frames"], rows))
    worst = analysis.worst(recorded, context.time, steps, _LISTED)
    rows = [
        [
            _number(f"{each.frame:,}"),
            _number(f"{each.time:.6f}"),
            Cell(recorded.nodes[each.node], mono=True),
            Cell(each.kind, bad=each.kind == "malformed"),
            Cell(each.words),
            command(recorded, each.frame),
        ]
        for each in worst
    ]
    heads = ["frame", "time (s)", "sender", "kind", "detail", "command"]
    section.tables.append(table("Anomalies, each with the command that shows its frame", heads, rows))
    if sum(each.size for each in times.values()) > len(worst):
        section.words.append(f"The list has the first {_LISTED} of each kind, and the largest gaps.")
    return section


def _by_node(context: PlotContext, caption: str, columns: Sequence[int], cell: Callable[[int, int], str]) -> Table:
    """Return a table with a row for each drawn node and a column for each of ``columns``; ``cell`` has the texts."""
    rows = [
        [Cell(context.name(node), mono=True, series=place), *(_number(cell(node, other)) for other in columns)]
        for place, node in enumerate(context.nodes)
    ]
    return table(caption, ["node", *(context.name(node) for node in columns)], rows, matrix=True)


def _number(text: str) -> Cell:
    return Cell(text, number=True)


def _series(context: PlotContext, node: int) -> int | None:
    return context.nodes.index(node) if node in context.nodes else None
