"""What a scenario file says, as values; ``docs/scenarios.md`` describes the file, ``loading.py`` reads it.

Nodes are numbers from 0, times are seconds since the start, octets are text or hexadecimal digits.
"""

from __future__ import annotations

from typing import ClassVar, Literal, TypeVar

import msgspec

from dcp_codec.impairment import Impairment
from dcp_stack.config import BPConfig, SRPConfig, VardisConfig
from dcp_stack.links.quality import Quality
from dcp_stack.links.topology import Full, Grid, Line, Neighbours, Positions
from dcp_stack.links.topology import Topology as HeardBy

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000

Config = TypeVar("Config", SRPConfig, VardisConfig)


class ScenarioError(ValueError):
    """A scenario cannot be used. The message names the file, the key and what is wrong with it."""


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file: unknown keys are errors."""


# -- the network ------------------------------------------------------------------------------------------------------


class LinkQuality(Strict, kw_only=True, frozen=True):
    """What a connection does to frames, in each direction. Probabilities 0..1, times in ms."""

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    reorder_delay_ms: float = 50.0
    burst: float = 0.0
    """Mean number of frames in a burst of losses, at least 1; 0: losses are independent."""
    corrupt: float = 0.0
    """Probability, for each octet, that one of its bits is inverted."""
    corrupt_frames: float = 0.0
    """Share of frames in which ``flips`` bits are inverted."""
    flips: int = 1

    def quality(self) -> Quality:
        """The same for the simulated medium. Raises ValueError for what is no probability or no time."""
        return Quality(
            loss=self.loss,
            duplicate=self.duplicate,
            reorder=self.reorder,
            delay=round(self.delay_ms * NS_PER_MS),
            jitter=round(self.jitter_ms * NS_PER_MS),
            reorder_delay=round(self.reorder_delay_ms * NS_PER_MS),
            burst=self.burst,
            corrupt=self.corrupt,
            corrupt_frames=self.corrupt_frames,
            flips=self.flips,
        )

    def impairment(self) -> Impairment:
        """The same for a relay. Raises ValueError for what is no probability or no time."""
        return Impairment(
            loss=self.loss,
            burst=self.burst,
            duplicate=self.duplicate,
            reorder=self.reorder,
            delay=round(self.delay_ms * NS_PER_MS),
            jitter=round(self.jitter_ms * NS_PER_MS),
            reorder_delay=round(self.reorder_delay_ms * NS_PER_MS),
            corrupt=self.corrupt,
            corrupt_frames=self.corrupt_frames,
            flips=self.flips,
        )

    @property
    def only_loses(self) -> bool:
        """Whether all it does is to lose frames, each independently."""
        return self == LinkQuality(loss=self.loss, reorder_delay_ms=self.reorder_delay_ms, flips=self.flips)


PERFECT = LinkQuality()


class LinkBetween(Strict, kw_only=True, frozen=True):
    """Quality of its own for frames that go from one node to another."""

    sender: int = msgspec.field(name="from")
    receiver: int = msgspec.field(name="to")
    both_ways: bool = True
    quality: LinkQuality = PERFECT

    @property
    def directions(self) -> tuple[tuple[int, int], ...]:
        """The (sender, receiver) pairs meant."""
        there = (self.sender, self.receiver)
        return (there, there[::-1]) if self.both_ways else (there,)


class Topology(Strict, kw_only=True, frozen=True):
    """Who is a neighbour of whom. Connections go both ways; ``links`` with a loss of 1 make them one-way."""

    kind: Literal["full", "line", "grid", "neighbours", "positions"] = "full"
    columns: int | None = None
    """Of a grid; by default the smallest number that makes it at least as wide as high."""
    diagonal: bool = False
    """Of a grid: neighbours touch at corners, too."""
    neighbours: tuple[tuple[int, ...], ...] = ()
    """For each node in order the nodes next to it; naming a connection at one of its ends is enough."""
    positions: tuple[tuple[float, float, float], ...] = ()
    """For each node in order its place in m. In simulations ``tracks`` move their nodes; if all nodes have one,
    there need not be any positions."""
    range_m: float = 0.0
    """Nodes at most this far apart hear each other."""

    def heard_by(self, count: int) -> HeardBy:
        """The same for the simulated medium."""
        match self.kind:
            case "full":
                return Full()
            case "line":
                return Line()
            case "grid":
                return Grid(self.columns or grid_columns(count), diagonal=self.diagonal)
            case "positions":
                return Positions(self.positions or [None] * count, self.range_m)
            case _:
                heard: dict[int, set[int]] = {node: set() for node in range(count)}
                for node, row in enumerate(self.neighbours):
                    for other in row:
                        heard[node].add(other)
                        heard[other].add(node)
                return Neighbours(heard)

    def pairs(self, count: int) -> list[tuple[int, int]]:
        """All connections as (lower, higher) node numbers, ascending."""
        heard = self.heard_by(count)
        found = {
            (min(node, other), max(node, other))
            for node in range(count)
            for other in heard.neighbours(node, count)
            if 0 <= other < count and other != node
        }
        return sorted(found)


def grid_columns(count: int) -> int:
    """The columns of a grid that nobody gave a shape."""
    columns = 1
    while columns * columns < count:
        columns += 1
    return columns


# -- what happens -----------------------------------------------------------------------------------------------------


class Event(Strict, tag_field="do", kw_only=True, frozen=True):
    """Something that happens ``at_s``; ``every_s`` repeats it, ``times`` in all (until the end without)."""

    #: Whether it changes what the databases have to agree on, or how they can: convergence is measured from here.
    disturbs: ClassVar[bool] = False

    at_s: float
    every_s: float | None = None
    times: int | None = None


class Content(Event, kw_only=True, frozen=True):
    """An event with a value: ``text``, or ``value`` in hexadecimal digits. {n} in a text counts repetitions from 0."""

    text: str | None = None
    value: str | None = None

    def octets(self, n: int = 0) -> bytes:
        """The value of the ``n``-th repetition."""
        return octets(self.text, self.value, n)


class Create(Content, tag="create", kw_only=True, frozen=True):
    """``RTDB-Create`` at a node. Creating a variable of one's own again is a re-creation (2.0)."""

    disturbs = True

    node: int
    variable: int
    descr: str | None = None
    repetitions: int = 1
    timeout_ms: int = 0
    own_fields: dict[str, int | float | str] = {}
    """Fields that the profile adds to VarSpec, by name; octets in hexadecimal digits. Others are zero."""

    @property
    def description(self) -> str:
        """The description, which must not be empty."""
        return f"variable {self.variable}" if self.descr is None else self.descr


class Update(Content, tag="update", kw_only=True, frozen=True):
    """``RTDB-Update`` at the node that created the variable."""

    disturbs = True

    node: int
    variable: int


class Delete(Event, tag="delete", kw_only=True, frozen=True):
    """``RTDB-Delete`` at the node that created the variable."""

    disturbs = True

    node: int
    variable: int


class Activate(Event, tag="activate", kw_only=True, frozen=True):
    """``VD-MGMT-Activate`` or ``BP-MGMT-Activate``."""

    disturbs = True

    node: int
    layer: Literal["vardis", "bp"] = "vardis"


class Deactivate(Event, tag="deactivate", kw_only=True, frozen=True):
    """``VD-MGMT-Deactivate`` or ``BP-MGMT-Deactivate``."""

    disturbs = True

    node: int
    layer: Literal["vardis", "bp"] = "vardis"


class Down(Event, tag="down", kw_only=True, frozen=True):
    """The node loses power: it says nothing more, and all that it knew is gone."""

    disturbs = True

    node: int


class Up(Event, tag="up", kw_only=True, frozen=True):
    """The node is switched on, with nothing in its memory."""

    disturbs = True

    node: int


class Restart(Event, tag="restart", kw_only=True, frozen=True):
    """Down and up again at once."""

    disturbs = True

    node: int


class Partition(Event, tag="partition", kw_only=True, frozen=True):
    """From now on frames stay inside their group; nodes in none of the groups form one more together."""

    disturbs = True

    groups: tuple[tuple[int, ...], ...]


class Heal(Event, tag="heal", kw_only=True, frozen=True):
    """The partition ends."""

    disturbs = True


class SetLink(Event, tag="link", kw_only=True, frozen=True):
    """Connections change their quality: those of ``from``/``to``, or all that have none of their own."""

    quality: LinkQuality
    sender: int | None = msgspec.field(default=None, name="from")
    receiver: int | None = msgspec.field(default=None, name="to")
    both_ways: bool = True


class HandDown(Event, tag="safety-data", kw_only=True, frozen=True):
    """``SRP-UpdateSafetyData`` with these fields of the profile."""

    node: int
    data: dict[str, float | int | str]


Action = Create | Update | Delete | Activate | Deactivate | Down | Up | Restart | Partition | Heal | SetLink | HandDown


class Tracks(Strict, kw_only=True, frozen=True):
    """Where nodes (all, unless listed) get their safety data from; ``source`` as for ``dcp-node run --position``."""

    source: str
    nodes: tuple[int, ...] | None = None


# -- what is expected -------------------------------------------------------------------------------------------------


class Expectation(Strict, tag_field="that", kw_only=True, frozen=True):
    """Something that has to be so."""


class Converged(Expectation, tag="converged", kw_only=True, frozen=True):
    """All databases agree at the latest ``within_s`` after each event that disturbs, or the last one only."""

    within_s: float
    after: Literal["last", "each"] = "last"


class VariableIs(Expectation, tag="variable", kw_only=True, frozen=True):
    """What a node knows about a variable ``at_s`` (at the end without)."""

    node: int
    variable: int
    state: Literal["alive", "deleted", "unknown", "off"] = "alive"
    """``off``: the node is switched off, or its VarDis does not answer."""
    text: str | None = None
    value: str | None = None
    at_s: float | None = None

    def octets(self) -> bytes | None:
        """The value asked for, None for any."""
        return None if self.text is None and self.value is None else octets(self.text, self.value)


class NeighboursAre(Expectation, tag="neighbours", kw_only=True, frozen=True):
    """The nodes in the neighbour table of a node ``at_s`` (at the end without)."""

    node: int
    are: tuple[int, ...]
    at_s: float | None = None


class BeaconRate(Expectation, tag="beacon-rate", kw_only=True, frozen=True):
    """Nodes (all, unless listed) that are up all the time send so many beacons per s, within a share of it."""

    per_s: float
    tolerance: float = 0.02
    nodes: tuple[int, ...] | None = None


Expected = Converged | VariableIs | NeighboursAre | BeaconRate


class Scenario(Strict, kw_only=True, frozen=True):
    """A whole file."""

    nodes: int
    duration_s: float
    title: str = ""
    profile: str = "dcp-2.0"
    seed: int = 1
    warm_up_s: float = 0.0
    """Simulations count values, consistency and traffic from here on; events and expectations are not affected."""
    topology: Topology = Topology()
    link: LinkQuality = PERFECT
    """Of all connections that ``links`` does not name."""
    links: tuple[LinkBetween, ...] = ()
    bp: BPConfig = BPConfig()
    srp: SRPConfig | bool = True
    vardis: VardisConfig | bool = True
    """False: the protocol is not on the nodes."""
    readings: dict[str, str] = {}
    """Choices where the specification is disputed, by id."""
    down_at_start: tuple[int, ...] = ()
    tracks: tuple[Tracks, ...] = ()
    events: tuple[Action, ...] = ()
    expect: tuple[Expected, ...] = ()

    @property
    def duration(self) -> int:
        """Length in ns."""
        return round(self.duration_s * NS_PER_S)

    @property
    def warm_up(self) -> int:
        """Length of the warm-up in ns."""
        return round(self.warm_up_s * NS_PER_S)

    @property
    def srp_config(self) -> SRPConfig | None:
        """How SRP is set up, None for not at all."""
        return _config(self.srp, SRPConfig())

    @property
    def vardis_config(self) -> VardisConfig | None:
        """How VarDis is set up, None for not at all."""
        return _config(self.vardis, VardisConfig())

    def timeline(self) -> list[tuple[int, int, Action]]:
        """Everything that happens: time in ns, which repetition, event; by time, then as in the file."""
        found: list[tuple[int, int, Action]] = []
        for event in self.events:
            time, n = round(event.at_s * NS_PER_S), 0
            while time <= self.duration and (n == 0 or (event.every_s and (event.times is None or n < event.times))):
                found.append((time, n, event))
                n += 1
                time = round((event.at_s + n * (event.every_s or 0)) * NS_PER_S)
        return sorted(found, key=lambda each: each[0])


def _config(given: Config | bool, default: Config) -> Config | None:
    if isinstance(given, bool):
        return default if given else None
    return given


def octets(text: str | None, value: str | None, n: int = 0) -> bytes:
    """What ``text`` or ``value`` stands for; raises ValueError unless exactly one of them is there and hexadecimal."""
    if (text is None) == (value is None):
        raise ValueError("there has to be either text or value (in hexadecimal digits)")
    if text is not None:
        return text.replace("{n}", str(n)).encode()
    return bytes.fromhex(value or "")
