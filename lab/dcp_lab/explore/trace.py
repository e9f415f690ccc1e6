"""The sequence of a violation: what happens in each step, and a message sequence chart as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from dcp_codec.values import VarCreate, VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate

from .cores import Held
from .search import Search, State, Step, Violation

#: Properties of one step; for the others lossless rounds follow.
OF_STEPS: Final = ("older-value", "taken-over", "repetitions")
_NAMES: Final = (
    (VarCreate, "VC"),
    (VarDelete, "VD"),
    (VarUpdate, "VU"),
    (VarSumm, "VS"),
    (VarReqCreate, "RC"),
    (VarReqUpdate, "RU"),
)


class Row(NamedTuple):
    """One step. ``text``: the service, or the records of a beacon. ``held``: the variable at each node afterwards."""

    step: Step
    text: str
    held: tuple[Held, ...]
    in_rounds: bool = False


class Trace(NamedTuple):
    """All steps of a violation, and after them the lossless rounds that show it. ``contents``: those at the end."""

    rows: tuple[Row, ...]
    rounds: int
    contents: tuple[int, ...]


def trace(search: Search, violation: Violation) -> Trace:
    """Return the trace of a violation that ``search`` has found."""
    cores, state, rows = search.cores, search.states[0], []
    for step in violation.steps:
        state, row = _taken(search, state, step)
        rows.append(row)
    rounds = 0
    if violation.name not in OF_STEPS:
        # With the rounds that repeat: what happens in them happens for ever.
        end = search.judge.end(state.contents)
        rounds = end.rounds + end.period
    for _ in range(rounds):
        for node in range(search.space.nodes):
            others = tuple(each for each in range(search.space.nodes) if each != node)
            state = state._replace(group=0)
            if search.after(state, Step("beacon", node, others)) is not None:
                state, row = _taken(search, state, Step("beacon", node, others))
                rows.append(row._replace(in_rounds=True))
    if rounds and search.space.silences and state.intent.state != "alive":
        contents = state.contents
        for _ in range(2):
            contents = tuple(map(cores.wait, search.roles, contents))
        state = state._replace(contents=contents)
    return Trace(tuple(rows), rounds, state.contents)


def _taken(search: Search, state: State, step: Step) -> tuple[State, Row]:
    """Return the state after a step, and its row."""
    found = search.after(state, step)
    assert found is not None
    after, cores = found[0], search.cores
    text = step.kind
    if step.kind in ("create", "update"):
        text = f"{step.kind} {cores.held[after.contents[step.node]].text}"
    elif step.kind == "clock":
        text = "clock +1 h" if after.ahead >> step.node & 1 else "clock correct"
    elif step.kind == "beacon":
        payload = cores.send(search.roles[step.node], state.contents[step.node]).payload
        text = " ".join(map(_record, cores.records(payload)))
    return after, Row(step, text, tuple(map(cores.held.__getitem__, after.contents)))


def _record(record: Any) -> str:
    """Return a record in short: VC and VU with the value, VS and RU with the sequence number."""
    name = next(name for kind, name in _NAMES if isinstance(record, kind))
    update = record.upd if isinstance(record, VarCreate) else record
    if isinstance(update, VarUpdate):
        return f"{name} {update.value.decode()}"
    if isinstance(record, VarSumm | VarReqUpdate):
        return f"{name} {record.seqno}"
    return name


def described(row: Row, nodes: int) -> str:
    """Return a step as a sentence without a subject: "node 0 sends VC 1.0 to 1, lost at 2"."""
    step = row.step
    match step.kind:
        case "beacon":
            lost = [node for node in range(nodes) if node not in (step.node, *step.hearers)]
            heard = ", ".join(map(str, step.hearers)) or "no node"
            missed = f", not {', '.join(map(str, lost))}" if lost and step.hearers else ""
            return f"{step.node} sends {row.text} to {heard}{missed}"
        case "partition":
            rest = [node for node in range(nodes) if node not in step.hearers]
            return f"partition {','.join(map(str, rest))} | {','.join(map(str, step.hearers))}"
        case "heal" | "silence":
            return {"heal": "the partition ends", "silence": "no beacons for 0.6 timeouts"}[step.kind]
        case _:
            return f"{step.node}: {row.text}"


def table(found: Trace, nodes: int) -> tuple[list[str], list[list[str]]]:
    """Return header and rows: the number of the step, the step, and what each node has after it."""
    rows = [
        [str(number), described(row, nodes), *(held.text if held.state != "unknown" else "-" for held in row.held)]
        for number, row in enumerate(found.rows, 1)
        if not row.in_rounds
    ]
    if found.rounds:
        texts = [held.text if held.state != "unknown" else "-" for held in found.rows[-1].held]
        rows.append(["", f"lossless rounds: {found.rounds}", *texts])
    return ["#", "step", *(f"node {node}" for node in range(nodes))], rows


def chart(found: Trace, nodes: int, width: int = 72) -> list[str]:
    """Return a message sequence chart of at most ``width`` columns (at least 8 for each node)."""
    pitch = max(min(width // nodes, 24), 8)
    places = [pitch * node + pitch // 2 for node in range(nodes)]
    names = [f"node {node}" for node in range(nodes)]
    lines = [_line(pitch, places, dict(enumerate(names)), " ")]
    before: Sequence[Held] = [Held("unknown")] * nodes
    rounds = False
    for row in found.rows:
        if row.in_rounds and not rounds:
            rounds = True
            lines.append("lossless rounds".center(pitch * nodes, ".").rstrip())
        if row.step.kind == "beacon":
            lines += _message(row, pitch, places)
            changed = {
                node: held.text for node, held in enumerate(row.held) if held != before[node] and node != row.step.node
            }
            if changed:
                lines.append(_line(pitch, places, changed))
        elif row.step.kind in ("silence", "partition", "heal"):
            lines.append(f" {described(row, nodes)} ".center(pitch * nodes, ".").rstrip())
        else:
            lines.append(_line(pitch, places, {row.step.node: row.text}))
        before = row.held
    return lines


def _line(pitch: int, places: Sequence[int], texts: dict[int, str], bar: str = "|") -> str:
    """Return a line with lifelines, and texts in place of some of them."""
    cells = [texts.get(node, bar)[: pitch - 1].center(pitch) for node in range(len(places))]
    # str.center() puts an odd space to the left or right; the bar has to be at its place.
    line = list("".join(cells))
    for node, place in enumerate(places):
        if node not in texts:
            line[pitch * node : pitch * (node + 1)] = " " * (place - pitch * node) + bar + " " * (pitch // 2)
    return "".join(line)[: pitch * len(places)].rstrip()


def _message(row: Row, pitch: int, places: Sequence[int]) -> list[str]:
    """Return the lines of a beacon: its records, and an arrow to each node, which ends in x where it is lost."""
    sender = row.step.node
    line = list(_line(pitch, places, {}).ljust(pitch * len(places)))
    for node, place in enumerate(places):
        if node == sender:
            continue
        right = place > places[sender]
        inner = range(places[sender] + 1, place) if right else range(place + 1, places[sender])
        for column in inner:
            if line[column] == " ":
                line[column] = "-"
        end = place - 1 if right else place + 1
        line[end] = "x" if node not in row.step.hearers else ">" if right else "<"
    line[places[sender]] = "o"
    label = list(_line(pitch, places, {}).ljust(pitch * len(places)))
    text = f" {row.text} "
    start = max(min(places[sender] + 1, pitch * len(places) - len(text)), 0)
    label[start : start + len(text)] = text
    return ["".join(label)[: pitch * len(places)].rstrip(), "".join(line).rstrip()]
