"""Numbers on beacons and state reports: rates, losses, age of information, anomalies. NumPy only, no drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .recorded import Column, Recorded

#: Maximum number of intervals of a recording for rates, and for ages.
_BINS = 120
_FINE = 300
#: Mean number of beacons of each sender in one interval, so that rates are meaningful.
_PER_BIN = 10
_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Time:
    """The time of a recording from its first frame, divided into equal intervals by ``edges``, in seconds."""

    first_ns: int
    """ns since 1970."""
    last_ns: int
    """ns since 1970."""
    duration: float
    edges: Column

    def seconds(self, time: Column) -> Column:
        """Convert times of capture (ns since 1970) to seconds since the first."""
        return (time - self.first_ns) / _SECOND

    def bins(self, time: Column) -> Column:
        """Return the index of the interval of each time of capture (ns since 1970)."""
        found = np.searchsorted(self.edges, self.seconds(time), "right") - 1
        return np.clip(found, 0, len(self.edges) - 2)

    @property
    def width(self) -> float:
        """Length of an interval in seconds."""
        return float(self.edges[1] - self.edges[0])

    def finer(self, shortest: float) -> Column:
        """Return the edges of more intervals, none shorter than ``shortest`` seconds, for ages."""
        end = float(self.edges[-1])
        many = min(_FINE, end / shortest) if shortest > 0 else _FINE
        found: Column = np.linspace(0, end, max(1, int(many)) + 1)
        return found


def time_of(recorded: Recorded) -> Time:
    """Return the time from the first to the last beacon or malformed frame; one second without any."""
    stamps = np.concatenate([recorded.column("beacons", "time"), recorded.column("errors", "time")])
    first, last = (int(stamps.min()), int(stamps.max())) if stamps.size else (0, 0)
    duration = (last - first) / _SECOND
    beacons = recorded.column("beacons", "node")
    senders = max(1, len(np.unique(beacons)))
    width = _PER_BIN * max(duration, 1e-9) * senders / max(1, beacons.size)
    many = int(max(1, min(_BINS, duration / width)))
    return Time(first, last, duration, np.linspace(0, duration or 1.0, many + 1))


def times_of(recorded: Recorded, time: Time, table: str, node: int) -> Column:
    """Return the times of the rows of a node in a table: seconds, ascending."""
    columns = recorded.tables[table]
    found: Column = np.sort(time.seconds(columns["time"][columns["node"] == node]))
    return found


@dataclass(frozen=True)
class Steps:
    """The differences of sequence numbers and times between beacons: one row for each beacon, in the order of frames.

    ``lost`` is the number of missing beacons before the beacon. ``restart``: its sequence number is lower than the
    previous one. ``repeated``: the number is the same. ``back`` is the time in ns by which the beacon was recorded
    before the previous one, because the recorder's clock was set.
    """

    lost: Column
    restart: Column
    repeated: Column
    back: Column


def steps_of(recorded: Recorded) -> Steps:
    """Compare each beacon with the previous one of the same sender on the same interface."""
    table = recorded.tables["beacons"]
    many = table["node"].size
    lost, restart, repeated = np.zeros(many, np.int64), np.zeros(many, bool), np.zeros(many, bool)
    back = np.zeros(many, np.int64)
    if many > 1:
        order = np.lexsort((table["frame"], table["interface"], table["node"]))
        node, interface, seqno, at = (table[name][order] for name in ("node", "interface", "seqno", "time"))
        same = (node[1:] == node[:-1]) & (interface[1:] == interface[:-1])
        back[order[1:]] = np.where(same, np.maximum(at[:-1] - at[1:], 0), 0)
        if recorded.modulus:
            step = (seqno[1:] - seqno[:-1]) % recorded.modulus
            # Half of all numbers count as earlier ones.
            ahead = step < recorded.modulus // 2
            lost[order[1:]] = np.where(same & (step >= 2) & ahead, step - 1, 0)
            restart[order[1:]] = same & ~ahead
            repeated[order[1:]] = same & (step == 0)
    return Steps(lost, restart, repeated, back)


@dataclass(frozen=True)
class Sender:
    """One row of the table of senders. ``loss`` is a share, ``rate`` is per second; None if they are unknown."""

    node: int
    beacons: int
    lost: int
    loss: float | None
    rate: float | None
    restarts: int
    first: float
    last: float
    reports: int


def senders_of(recorded: Recorded, time: Time, steps: Steps) -> list[Sender]:
    """Return all senders, sorted by name."""
    table, many = recorded.tables["beacons"], len(recorded.nodes)
    node, seconds = table["node"], time.seconds(table["time"])
    # The number of senders can be huge, because they can be forged: avoid a loop over all beacons for each sender.
    beacons = np.bincount(node, minlength=many)
    lost = np.bincount(node, weights=steps.lost, minlength=many).astype(np.int64)
    restarts = np.bincount(node[steps.restart], minlength=many)
    reports = np.bincount(recorded.column("srp", "node"), minlength=many)
    pairs = np.unique(node.astype(np.int64) << 32 | table["interface"])
    links = np.bincount(pairs >> 32, minlength=many)
    first, last = np.full(many, np.inf), np.full(many, -np.inf)
    np.minimum.at(first, node, seconds)
    np.maximum.at(last, node, seconds)
    found = []
    for each in np.flatnonzero(beacons).tolist():
        received, missing, span = int(beacons[each]), int(lost[each]), float(last[each] - first[each])
        found.append(
            Sender(
                node=each,
                beacons=received,
                lost=missing,
                loss=missing / (received + missing) if recorded.tells_losses else None,
                rate=max(0, received - int(links[each])) / span if span else None,
                restarts=int(restarts[each]),
                first=float(first[each]),
                last=float(last[each]),
                reports=int(reports[each]),
            )
        )
    return sorted(found, key=lambda sender: recorded.nodes[sender.node])


def rates(recorded: Recorded, time: Time, steps: Steps, node: int) -> tuple[Column, Column]:
    """Return beacons per second and the share of lost beacons in each interval; the share is NaN without beacons."""
    table = recorded.tables["beacons"]
    own = table["node"] == node
    bins = time.bins(table["time"][own])
    many = len(time.edges) - 1
    received = np.bincount(bins, minlength=many)
    lost = np.bincount(bins, weights=steps.lost[own], minlength=many)
    there = received + lost
    return received / time.width, np.where(there > 0, lost / np.maximum(there, 1), np.nan)


def age(reports: Column, ends: Column) -> Column:
    """Return the maximum age in seconds of a node's last report in each interval of ``ends``; NaN before the first.

    ``reports`` are the times of the reports in seconds, ascending.
    """
    found = np.full(len(ends) - 1, np.nan)
    if not reports.size:
        return found
    last = np.searchsorted(reports, ends[1:], "right") - 1
    heard = last >= 0
    found[heard] = ends[1:][heard] - reports[last[heard]]
    bins = np.clip(np.searchsorted(ends, reports, "right") - 1, 0, len(found) - 1)
    # The age has a local maximum just before a report is received.
    found[bins] = np.nan_to_num(found[bins])
    np.maximum.at(found, bins[1:], np.diff(reports))
    return found


def pair_ages(recorded: Recorded, time: Time, nodes: list[int]) -> tuple[Column, Column]:
    """Return median and 95th percentile of the age of a neighbour's last report at the beacons of a node, in seconds.

    Both results are indexed by [node, neighbour]. They are NaN for a node itself, and if there is no report.
    """
    heard = {node: times_of(recorded, time, "srp", node) for node in nodes}
    middle, high = np.full((2, len(nodes), len(nodes)), np.nan)
    for row, node in enumerate(nodes):
        sent = times_of(recorded, time, "beacons", node)
        for place, neighbour in enumerate(nodes):
            last = np.searchsorted(heard[neighbour], sent, "right") - 1
            known = last >= 0
            if node == neighbour or not known.any():
                continue
            ages = sent[known] - heard[neighbour][last[known]]
            middle[row, place], high[row, place] = np.quantile(ages, [0.5, 0.95])
    return middle, high


@dataclass(frozen=True)
class Part:
    """The transmitted octets of one kind: their total, and their number in each interval."""

    name: str
    octets: int
    over_time: Column


def overhead(recorded: Recorded, time: Time) -> list[Part]:
    """Return the octets of frames with valid beacons by kind, the largest first, as the query in docs/tables.md."""
    beacons, payloads = recorded.tables["beacons"], recorded.tables["payloads"]
    containers = recorded.tables["containers"]
    many = len(time.edges) - 1

    def binned(times: Column, octets: Column) -> Column:
        found: Column = np.bincount(time.bins(times), weights=octets, minlength=many)
        return found

    found = {"frame header and padding": binned(beacons["time"], beacons["around"])}
    rest = binned(beacons["time"], beacons["octets"]) - binned(payloads["time"], payloads["octets"])
    for table, numbers in (("payloads", payloads), ("containers", containers)):
        for number in np.unique(numbers["content"]).tolist():
            own = numbers["content"] == number
            octets = binned(numbers["time"][own], numbers["octets"][own])
            name = recorded.contents[number]
            if table == "payloads" and name == "vardis" and containers["time"].size:
                # The containers are counted separately; this kind keeps the other octets of the payload.
                octets = octets - binned(containers["time"], containers["octets"])
                name = "around containers"
            found[_NAMES.get(name, name)] = octets
    # Length fields of some profiles have another meaning, so that the difference can be too small or negative.
    found["headers of beacons and payloads"] = np.maximum(rest, 0)
    parts = [Part(name, int(octets.sum()), np.maximum(octets, 0)) for name, octets in found.items()]
    return sorted((part for part in parts if part.octets > 0), key=lambda part: -part.octets)


_NAMES = {"srp": "state reports (SRP)", "data": "other payloads", "vardis": "VarDis"}


@dataclass(frozen=True)
class Anomaly:
    """An anomaly of one frame. ``time`` is in seconds since the first frame; ``weight`` is its severity."""

    kind: str
    time: float
    frame: int
    node: int
    words: str
    weight: int


#: Kinds of anomalies, in the order in which they are shown.
KINDS = ("malformed", "gap", "restart", "repetition", "time goes back")


def anomaly_times(recorded: Recorded, time: Time, steps: Steps) -> dict[str, Column]:
    """Return the times of anomalies by kind, in seconds since the first frame."""
    seconds = time.seconds(recorded.column("beacons", "time"))
    return {
        "malformed": time.seconds(recorded.column("errors", "time")),
        "gap": seconds[steps.lost > 0],
        "restart": seconds[steps.restart],
        "repetition": seconds[steps.repeated],
        "time goes back": seconds[steps.back > 0],
    }


def worst(recorded: Recorded, time: Time, steps: Steps, many: int) -> list[Anomaly]:
    """Return up to ``many`` anomalies of each kind, the most severe ones, in the order of frames."""
    beacons, errors = recorded.tables["beacons"], recorded.tables["errors"]
    found: list[Anomaly] = []
    for row in range(min(many, errors["frame"].size)):
        reason = recorded.reasons[errors["reason"][row]]
        at = float(time.seconds(errors["time"][row : row + 1])[0])
        found.append(Anomaly("malformed", at, int(errors["frame"][row]), int(errors["node"][row]), reason, 0))
    for kind, rows in (
        ("gap", np.argsort(-steps.lost, kind="stable")[: min(many, int((steps.lost > 0).sum()))]),
        ("restart", np.flatnonzero(steps.restart)[:many]),
        ("repetition", np.flatnonzero(steps.repeated)[:many]),
        ("time goes back", np.flatnonzero(steps.back)[:many]),
    ):
        for row in rows.tolist():
            number, lost = int(beacons["seqno"][row]), int(steps.lost[row])
            words = {
                "gap": f"{lost} missing before sequence number {number}",
                "restart": f"continues with sequence number {number}",
                "repetition": f"sequence number {number} again",
                "time goes back": f"recorded {steps.back[row] / _SECOND:.6f} s before the sender's previous beacon",
            }[kind]
            at = float(time.seconds(beacons["time"][row : row + 1])[0])
            found.append(Anomaly(kind, at, int(beacons["frame"][row]), int(beacons["node"][row]), words, lost))
    return sorted(found, key=lambda anomaly: anomaly.frame)
