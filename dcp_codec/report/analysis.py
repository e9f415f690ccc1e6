"""Numbers about beacons and state reports: rates, loss, age of information, what is odd. NumPy only, no drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .recorded import Column, Recorded

#: Pieces that a recording is cut into, at most, for rates; and for ages.
_BINS = 120
_FINE = 300
#: Beacons of each sender that one piece should have, so that a rate is one.
_PER_BIN = 10
_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Time:
    """The time of a recording, from its first frame; cut into pieces of one length. Seconds, unless named ns."""

    first_ns: int
    last_ns: int
    duration: float
    edges: Column

    def seconds(self, time: Column) -> Column:
        """Times of capture as seconds since the first."""
        return (time - self.first_ns) / _SECOND

    def bins(self, time: Column) -> Column:
        """The piece that each time of capture is in."""
        found = np.searchsorted(self.edges, self.seconds(time), "right") - 1
        return np.clip(found, 0, len(self.edges) - 2)

    @property
    def width(self) -> float:
        """Seconds of a piece."""
        return float(self.edges[1] - self.edges[0])

    def finer(self, shortest: float) -> Column:
        """The ends of more pieces, none shorter than so many seconds, for ages."""
        end = float(self.edges[-1])
        many = min(_FINE, end / shortest) if shortest > 0 else _FINE
        found: Column = np.linspace(0, end, max(1, int(many)) + 1)
        return found


def time_of(recorded: Recorded) -> Time:
    """The time that beacons and malformed frames cover; a second if there is none."""
    stamps = np.concatenate([recorded.column("beacons", "time"), recorded.column("errors", "time")])
    first, last = (int(stamps.min()), int(stamps.max())) if stamps.size else (0, 0)
    duration = (last - first) / _SECOND
    beacons = recorded.column("beacons", "node")
    senders = max(1, len(np.unique(beacons)))
    width = _PER_BIN * max(duration, 1e-9) * senders / max(1, beacons.size)
    many = int(max(1, min(_BINS, duration / width)))
    return Time(first, last, duration, np.linspace(0, duration or 1.0, many + 1))


def times_of(recorded: Recorded, time: Time, table: str, node: int) -> Column:
    """When a table has something of a node: seconds, ascending."""
    columns = recorded.tables[table]
    found: Column = np.sort(time.seconds(columns["time"][columns["node"] == node]))
    return found


@dataclass(frozen=True)
class Steps:
    """What sequence numbers tell, one row for each beacon, in the order of frames.

    ``lost`` beacons are missing in front of it; ``restart`` and ``repeated`` say how else it does not follow.
    ``back`` is by how many ns the beacon was recorded earlier than the one before: the recorder's clock was set.
    """

    lost: Column
    restart: Column
    repeated: Column
    back: Column


def steps_of(recorded: Recorded) -> Steps:
    """Compare each beacon with the one before, of the same sender on the same interface."""
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
            # Half of the numbers are behind.
            ahead = step < recorded.modulus // 2
            lost[order[1:]] = np.where(same & (step >= 2) & ahead, step - 1, 0)
            restart[order[1:]] = same & ~ahead
            repeated[order[1:]] = same & (step == 0)
    return Steps(lost, restart, repeated, back)


@dataclass(frozen=True)
class Sender:
    """One line of the table of senders. ``loss`` is a share, ``rate`` per second; None where they cannot be known."""

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
    """All senders, by their names."""
    table, many = recorded.tables["beacons"], len(recorded.nodes)
    node, seconds = table["node"], time.seconds(table["time"])
    # Anybody can pretend to be many senders: no loop over beacons for each of them.
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
    """Beacons per second and share lost in each piece of time; NaN where nothing says anything."""
    table = recorded.tables["beacons"]
    own = table["node"] == node
    bins = time.bins(table["time"][own])
    many = len(time.edges) - 1
    received = np.bincount(bins, minlength=many)
    lost = np.bincount(bins, weights=steps.lost[own], minlength=many)
    there = received + lost
    return received / time.width, np.where(there > 0, lost / np.maximum(there, 1), np.nan)


def age(reports: Column, ends: Column) -> Column:
    """The greatest age, in seconds, of a node's last report in each piece that ``ends`` bound; NaN before the first.

    ``reports`` are its times in ascending order, seconds.
    """
    found = np.full(len(ends) - 1, np.nan)
    if not reports.size:
        return found
    last = np.searchsorted(reports, ends[1:], "right") - 1
    heard = last >= 0
    found[heard] = ends[1:][heard] - reports[last[heard]]
    bins = np.clip(np.searchsorted(ends, reports, "right") - 1, 0, len(found) - 1)
    # Just before a report is heard, age is greatest.
    found[bins] = np.nan_to_num(found[bins])
    np.maximum.at(found, bins[1:], np.diff(reports))
    return found


def pair_ages(recorded: Recorded, time: Time, nodes: list[int]) -> tuple[Column, Column]:
    """Median and 95th percentile, in seconds, of the age of [neighbour]'s last report whenever [node] sends a beacon.

    NaN for a node about itself, and where there is nothing to tell.
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
    """Octets on the air of one kind: all of them, and in each piece of time."""

    name: str
    octets: int
    over_time: Column


def overhead(recorded: Recorded, time: Time) -> list[Part]:
    """Where the octets of frames with good beacons go, most first; as the query of docs/tables.md."""
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
                # Its containers say it in detail; what is around them stays here.
                octets = octets - binned(containers["time"], containers["octets"])
                name = "around containers"
            found[_NAMES.get(name, name)] = octets
    # Lengths of some profiles say other things, so that headers may come out a little short.
    found["headers of beacons and payloads"] = np.maximum(rest, 0)
    parts = [Part(name, int(octets.sum()), np.maximum(octets, 0)) for name, octets in found.items()]
    return sorted((part for part in parts if part.octets > 0), key=lambda part: -part.octets)


_NAMES = {"srp": "state reports (SRP)", "data": "other payloads", "vardis": "VarDis"}


@dataclass(frozen=True)
class Anomaly:
    """Something odd in one frame. ``weight`` orders what is shown first; seconds since the first frame."""

    kind: str
    time: float
    frame: int
    node: int
    words: str
    weight: int


#: Kinds of anomalies, in the order in which they are shown.
KINDS = ("malformed", "gap", "restart", "repetition", "time goes back")


def anomaly_times(recorded: Recorded, time: Time, steps: Steps) -> dict[str, Column]:
    """When what happened, by kind; seconds."""
    seconds = time.seconds(recorded.column("beacons", "time"))
    return {
        "malformed": time.seconds(recorded.column("errors", "time")),
        "gap": seconds[steps.lost > 0],
        "restart": seconds[steps.restart],
        "repetition": seconds[steps.repeated],
        "time goes back": seconds[steps.back > 0],
    }


def worst(recorded: Recorded, time: Time, steps: Steps, many: int) -> list[Anomaly]:
    """At most ``many`` of each kind, the gravest, in the order of frames."""
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
                "time goes back": f"recorded {steps.back[row] / _SECOND:.6f} s earlier than the sender's beacon before",
            }[kind]
            at = float(time.seconds(beacons["time"][row : row + 1])[0])
            found.append(Anomaly(kind, at, int(beacons["frame"][row]), int(beacons["node"][row]), words, lost))
    return sorted(found, key=lambda anomaly: anomaly.frame)
