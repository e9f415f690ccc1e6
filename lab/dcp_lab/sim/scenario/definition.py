"""The content of a scenario file as values; ``docs/scenarios.md`` describes the file, ``loading.py`` reads it.

Nodes are numbers from 0, times are seconds since the start, octets are text or hexadecimal digits.
"""

from __future__ import annotations

import random
from typing import Any, ClassVar, Literal, TypeVar

import msgspec

from dcp_codec.impairment import Impairment
from dcp_stack.config import BPConfig, SRPConfig, VardisConfig
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.topology import Full, Grid, Line, Neighbours, Positions
from dcp_stack.virtual.topology import Topology as HeardBy

from .radio import RadioTable

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000

Config = TypeVar("Config", SRPConfig, VardisConfig)


class ScenarioError(ValueError):
    """A scenario is invalid. The message has the file, the key and the problem."""


class Strict(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of all tables of the file; unknown keys are errors."""


# -- the network ------------------------------------------------------------------------------------------------------


class LinkQuality(Strict, kw_only=True, frozen=True):
    """The quality of a connection in each direction. Probabilities are 0..1, times are in ms."""

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
        """Return the quality for the simulated medium. Raises ValueError for an invalid probability or time."""
        return Quality(**self._in_ns())

    def impairment(self) -> Impairment:
        """Return the quality for a relay. Raises ValueError for an invalid probability or time."""
        return Impairment(**self._in_ns())

    def _in_ns(self) -> dict[str, Any]:
        """Return the values by name, times in ns."""
        return {
            name.removesuffix("_ms"): round(value * NS_PER_MS) if name.endswith("_ms") else value
            for name, value in msgspec.structs.asdict(self).items()
        }

    @property
    def only_loses(self) -> bool:
        """Whether independent losses are its only effect."""
        return self == LinkQuality(loss=self.loss, reorder_delay_ms=self.reorder_delay_ms, flips=self.flips)


PERFECT = LinkQuality()


class LinkBetween(Strict, kw_only=True, frozen=True):
    """The quality of one connection, in place of that of all connections."""

    sender: int = msgspec.field(name="from")
    receiver: int = msgspec.field(name="to")
    both_ways: bool = True
    quality: LinkQuality = PERFECT

    @property
    def directions(self) -> tuple[tuple[int, int], ...]:
        """The (sender, receiver) pairs of the connection: two if ``both_ways``, otherwise one."""
        there = (self.sender, self.receiver)
        return (there, there[::-1]) if self.both_ways else (there,)


class Topology(Strict, kw_only=True, frozen=True):
    """The neighbours of each node. Connections work in both directions; use ``links`` with a loss of 1 for one-way."""

    kind: Literal["full", "line", "grid", "neighbours", "positions"] = "full"
    columns: int | None = None
    """Columns of a grid; by default the smallest number that makes it at least as wide as high."""
    diagonal: bool = False
    """Whether diagonally adjacent nodes of a grid are neighbours, too."""
    neighbours: tuple[tuple[int, ...], ...] = ()
    """For each node in order its neighbours; a connection may be listed at only one of its ends."""
    positions: tuple[tuple[float, float, float], ...] = ()
    """For each node in order its position in m. In simulations ``tracks`` move their nodes; positions may be omitted
    if all nodes have a track."""
    range_m: float = 0.0
    """Maximum distance in m at which nodes receive each other."""

    def heard_by(self, count: int) -> HeardBy:
        """Return the topology for the simulated medium."""
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
        """Return all connections as (lower, higher) node numbers, ascending."""
        heard = self.heard_by(count)
        found = {
            (min(node, other), max(node, other))
            for node in range(count)
            for other in heard.neighbours(node, count)
            if 0 <= other < count and other != node
        }
        return sorted(found)


def grid_columns(count: int) -> int:
    """Return the default number of columns of a grid: the smallest that makes it at least as wide as high."""
    columns = 1
    while columns * columns < count:
        columns += 1
    return columns


# -- events -----------------------------------------------------------------------------------------------------------


class Event(Strict, tag_field="do", kw_only=True, frozen=True):
    """An event at ``at_s``; ``every_s`` repeats it until it has occurred ``times`` times, by default until the end.

    With ``intervals = "exponential"`` the repetitions are a Poisson process with the mean interval ``every_s``.
    """

    #: Whether it changes variables or the connections between databases; convergence is measured from such events.
    disturbs: ClassVar[bool] = False

    at_s: float
    every_s: float | None = None
    times: int | None = None
    intervals: Literal["fixed", "exponential"] = "fixed"


class Disturbance(Event, kw_only=True, frozen=True):
    """An event that changes variables or the connections between databases; convergence is measured from it."""

    disturbs = True


class Change(Disturbance, kw_only=True, frozen=True):
    """A disturbance at one node."""

    node: int


class Content(Disturbance, kw_only=True, frozen=True):
    """An event with a value: either ``text``, or ``value`` in hexadecimal digits.

    ``{n}`` in a text is replaced by the number of the repetition, from 0.
    """

    text: str | None = None
    value: str | None = None

    def octets(self, n: int = 0) -> bytes:
        """Return the value of the ``n``-th repetition. Raises ValueError as :func:`octets`."""
        return octets(self.text, self.value, n)


class Create(Content, tag="create", kw_only=True, frozen=True):
    """``RTDB-Create`` at a node. For a variable that the node already produces it is a re-creation (2.0)."""

    node: int
    variable: int
    descr: str | None = None
    repetitions: int = 1
    timeout_ms: int = 0
    own_fields: dict[str, int | float | str] = {}
    """Fields that the profile adds to VarCreate, by name; octets in hexadecimal digits."""

    @property
    def description(self) -> str:
        """The description; by default one with the variable identifier, because it must not be empty."""
        return f"variable {self.variable}" if self.descr is None else self.descr


class Update(Content, tag="update", kw_only=True, frozen=True):
    """``RTDB-Update`` at the node that created the variable."""

    node: int
    variable: int
    own_fields: dict[str, int | float | str] = {}
    """Fields that the profile adds to VarUpdate, as for :class:`Create`."""


class Delete(Change, tag="delete", kw_only=True, frozen=True):
    """``RTDB-Delete`` at the node that created the variable."""

    variable: int


class Activate(Change, tag="activate", kw_only=True, frozen=True):
    """``VD-MGMT-Activate`` or ``BP-MGMT-Activate``."""

    layer: Literal["vardis", "bp"] = "vardis"


class Deactivate(Change, tag="deactivate", kw_only=True, frozen=True):
    """``VD-MGMT-Deactivate`` or ``BP-MGMT-Deactivate``."""

    layer: Literal["vardis", "bp"] = "vardis"


class Down(Change, tag="down", kw_only=True, frozen=True):
    """The node loses power: it stops sending without any further message, and its memory is lost."""


class Up(Change, tag="up", kw_only=True, frozen=True):
    """The node is switched on, with empty memory."""


class Restart(Change, tag="restart", kw_only=True, frozen=True):
    """The node is switched off and on again at once."""


class Clock(Event, tag="clock", kw_only=True, frozen=True):
    """The wall clock of the node is set forward (``step_s`` > 0) or back; in simulations only."""

    node: int
    step_s: float


class Partition(Disturbance, tag="partition", kw_only=True, frozen=True):
    """Frames no longer leave the group of their sender. Nodes that are in no group form another group."""

    groups: tuple[tuple[int, ...], ...]


class Heal(Disturbance, tag="heal", kw_only=True, frozen=True):
    """The partition ends."""


class SetLink(Event, tag="link", kw_only=True, frozen=True):
    """The quality of connections changes: of the one ``from``/``to``, or of all without a quality of their own."""

    quality: LinkQuality
    sender: int | None = msgspec.field(default=None, name="from")
    receiver: int | None = msgspec.field(default=None, name="to")
    both_ways: bool = True


class Submission(Event, tag="safety-data", kw_only=True, frozen=True):
    """``SRP-UpdateSafetyData`` at a node; ``data``: fields of the profile by name."""

    node: int
    data: dict[str, float | int | str]


Action = (
    Create
    | Update
    | Delete
    | Activate
    | Deactivate
    | Down
    | Up
    | Restart
    | Clock
    | Partition
    | Heal
    | SetLink
    | Submission
)


class Tracks(Strict, kw_only=True, frozen=True):
    """The source of the safety data of ``nodes`` (default: all); ``source`` as for ``dcp-node run --position``."""

    source: str
    nodes: tuple[int, ...] | None = None


# -- expectations -----------------------------------------------------------------------------------------------------


class Expectation(Strict, tag_field="that", kw_only=True, frozen=True):
    """Base of all expectations."""


class Converged(Expectation, tag="converged", kw_only=True, frozen=True):
    """All databases agree at most ``within_s`` s after the last event that disturbs them, or after each such event."""

    within_s: float
    after: Literal["last", "each"] = "last"


class VariableIs(Expectation, tag="variable", kw_only=True, frozen=True):
    """The state of a variable at a node at ``at_s``, by default at the end."""

    node: int
    variable: int
    state: Literal["alive", "deleted", "unknown", "off"] = "alive"
    """``off``: the node is switched off, or its VarDis is inactive."""
    text: str | None = None
    value: str | None = None
    at_s: float | None = None

    def octets(self) -> bytes | None:
        """Return the expected value, None if any value is accepted. Raises ValueError as :func:`octets`."""
        return None if self.text is None and self.value is None else octets(self.text, self.value)


class NeighboursAre(Expectation, tag="neighbours", kw_only=True, frozen=True):
    """The nodes in the neighbour table of a node at ``at_s``, by default at the end."""

    node: int
    are: tuple[int, ...]
    at_s: float | None = None


class BeaconRate(Expectation, tag="beacon-rate", kw_only=True, frozen=True):
    """The beacon rate of ``nodes`` (default: all) that are switched on during the whole run.

    ``per_s``: beacons per s. ``tolerance``: permitted deviation as a share of ``per_s``.
    """

    per_s: float
    tolerance: float = 0.02
    nodes: tuple[int, ...] | None = None


Expected = Converged | VariableIs | NeighboursAre | BeaconRate


class Scenario(Strict, kw_only=True, frozen=True):
    """The content of a scenario file."""

    nodes: int
    duration_s: float
    title: str = ""
    profile: str = "dcp-2.0"
    seed: int = 1
    warm_up_s: float = 0.0
    """Start of the measurement of values, consistency and traffic in simulations, in s. It does not affect events and
    expectations."""
    topology: Topology = Topology()
    link: LinkQuality = PERFECT
    """The quality of all connections that are not in ``links``."""
    links: tuple[LinkBetween, ...] = ()
    radio: RadioTable | None = None
    """Airtime, overlap, and losses by length and distance, in simulations; None: none of them."""
    bp: BPConfig = BPConfig()
    srp: SRPConfig | bool = True
    vardis: VardisConfig | bool = True
    """False: the nodes do not have the protocol."""
    readings: dict[str, str] = {}
    """Interpretations of disputed text of the specification, by id."""
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
        """The configuration of SRP, None if the nodes do not have it."""
        return _config(self.srp, SRPConfig())

    @property
    def vardis_config(self) -> VardisConfig | None:
        """The configuration of VarDis, None if the nodes do not have it."""
        return _config(self.vardis, VardisConfig())

    def timeline(self) -> list[tuple[int, int, Action]]:
        """Return all events with repetitions as (time in ns, number of the repetition from 0, event).

        They are sorted by time, then in the order of the file.
        """
        found: list[tuple[int, int, Action]] = []
        for index, event in enumerate(self.events):
            # Each event has its own generator: events that are added do not change the times of the others.
            draws = random.Random(f"{self.seed}/event/{index}")  # noqa: S311 - runs have to be repeatable
            period, at_s, n = event.every_s or 0.0, event.at_s, 0
            while (time := round(at_s * NS_PER_S)) <= self.duration:
                found.append((time, n, event))
                n += 1
                if not period or n == event.times:
                    break
                exponential = event.intervals == "exponential"
                at_s = at_s + draws.expovariate(1 / period) if exponential else event.at_s + n * period
        return sorted(found, key=lambda each: each[0])


def _config(given: Config | bool, default: Config) -> Config | None:
    """Return the configuration of a protocol: True means the default, False none."""
    if isinstance(given, bool):
        return default if given else None
    return given


def octets(text: str | None, value: str | None, n: int = 0) -> bytes:
    """Return the octets of ``text`` or of the hexadecimal ``value``.

    Raises ValueError unless exactly one of them is given, and for a ``value`` that is not hexadecimal.
    """
    if (text is None) == (value is None):
        raise ValueError("either text or value (in hexadecimal digits) is required, and not both")
    if text is not None:
        return text.replace("{n}", str(n)).encode()
    return bytes.fromhex(value or "")
