"""Loading of scenario and topology files. Each error message has the file, the key and the problem."""

from __future__ import annotations

import copy
import difflib
import math
import random
import re
import tomllib
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

import msgspec
from dcp_spec.catalogue.readings import UnknownReadingError
from dcp_spec.profile.loading import ProfileError

from dcp_codec.codec import Codec, get_codec
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig
from dcp_stack.node import Node
from dcp_stack.virtual.radio import RadioError
from dcp_stack.virtual.world import node_id

from .definition import (
    BeaconRate,
    Clock,
    Content,
    Converged,
    Create,
    Event,
    Expectation,
    LinkBetween,
    LinkQuality,
    NeighboursAre,
    Partition,
    Scenario,
    ScenarioError,
    SetLink,
    Topology,
    Tracks,
    VariableIs,
)
from .radio import RadioTable, located

MAX_NODES = 10_000
MAX_DURATION_S = 30 * 86_400.0
#: Maximum number of events with repetitions, so that a very short period does not exhaust memory.
MAX_EVENTS = 1_000_000
_SHORTEST_S = 1e-9

T = TypeVar("T", bound=msgspec.Struct)
NO_SETTINGS: Final[Mapping[str, object]] = MappingProxyType({})


def load_scenario(path: str | Path, settings: Mapping[str, object] = NO_SETTINGS) -> Scenario:
    """Return the scenario in a TOML file with ``settings`` (see :func:`change`). Raises :class:`ScenarioError`."""
    raw = read_toml(Path(path))
    # Lists of values for dcp-node sweep; a single run has the values of the scenario itself.
    raw.pop("sweep", None)
    return scenario_from(change(raw, settings, str(path)), str(path), Path(path).parent)


def scenario_from(raw: dict[str, Any], where: str, folder: Path | None = None) -> Scenario:
    """Return the scenario with the content of a file. Raises :class:`ScenarioError`.

    Paths of profiles, topologies and models of a radio are relative to ``folder``, that of the scenario.
    """
    topology, profile, radio = raw.get("topology"), raw.get("profile"), raw.get("radio")
    if isinstance(topology, str):
        raw["topology"] = msgspec.to_builtins(parse_topology(topology, folder))
    if folder is not None and isinstance(profile, str) and profile.endswith(".toml") and (folder / profile).exists():
        raw["profile"] = str(folder / profile)
    if folder is not None and isinstance(radio, dict):
        raw["radio"] = located(radio, folder)
    return check(_convert(raw, Scenario, where), where)


def change(raw: dict[str, Any], settings: Mapping[str, object], where: str) -> dict[str, Any]:
    """Return the content of a scenario file with other values, by dotted keys such as ``link.loss``.

    Parts of keys may be numbers of list entries, from 0, or ``*`` for all entries: ``events.*.repetitions`` sets the
    key in all events that can have it. Raises :class:`ScenarioError` for a key that leads nowhere.
    """
    raw = copy.deepcopy(raw)
    for key, value in settings.items():
        *path, last = key.split(".")
        found: list[Any] = [raw]
        for number, part in enumerate(path):
            found = [below for each in found for below in _below(each, part, [*path, last][number + 1])]
        found = [each for each in found if isinstance(each, dict) and _can_have(each, path, last)]
        if not found:
            raise ScenarioError(f"{where}: {key}: there is no such key in this scenario")
        for each in found:
            each[last] = value
    return raw


def _below(table: Any, part: str, following: str) -> list[Any]:
    """Return the entries of a table or list; a missing table is added unless it would be a list."""
    if isinstance(table, list):
        return table if part == "*" else table[int(part) : int(part) + 1] if part.isdecimal() else []
    if not isinstance(table, dict) or (part not in table and (following == "*" or following.isdecimal())):
        return []
    return [table.setdefault(part, {})]


def _can_have(table: dict[str, Any], path: list[str], key: str) -> bool:
    """Return whether an event or expectation has a key; other tables are checked when they are converted."""
    if len(path) != 2 or path[0] not in ("events", "expect"):
        return True
    kind = _variant(*((Event, table.get("do")) if path[0] == "events" else (Expectation, table.get("that"))))
    return kind is None or key in {field.encode_name for field in msgspec.structs.fields(kind)}


def parse_topology(text: str, folder: Path | None = None) -> Topology:
    """Return the topology for ``full``, ``bus`` (the same), ``line``, ``grid``, ``grid:COLUMNS`` or a TOML file.

    The file has the keys of ``[topology]``; its path is relative to ``folder``. Raises :class:`ScenarioError`.
    """
    kind, _, columns = text.partition(":")
    if kind in ("full", "bus", "line", "grid") and not (columns and kind != "grid"):
        if not columns:
            return _convert({"kind": "full" if kind == "bus" else kind}, Topology, text)
        if columns.isdecimal() and int(columns):
            return Topology(kind="grid", columns=int(columns))
        raise ScenarioError(f"topology {text!r}: a grid has at least one column, as in grid:10")
    path = Path(text) if folder is None else folder / text
    if not path.is_file():
        known = "full, bus, line, grid, grid:COLUMNS"
        raise ScenarioError(f"unknown topology {text!r}; expected one of {known}, or a file")
    return _convert(read_toml(path), Topology, str(path))


def scenario_codec(scenario: Scenario, where: str = "scenario") -> Codec:
    """Return the codec of a scenario's profile. Raises :class:`ScenarioError` for an unknown or invalid profile."""
    try:
        return get_codec(scenario.profile)
    except ProfileError as error:
        raise ScenarioError(f"{where}: profile: {error}") from None


def check(scenario: Scenario, where: str = "scenario") -> Scenario:
    """Return ``scenario`` if it is consistent; raises :class:`ScenarioError` for the first problem."""
    for key, problem in _problems(scenario):
        raise ScenarioError(f"{where}: {key}: {problem}")
    scenario_codec(scenario, where)
    return scenario


def trial_node(scenario: Scenario, codec: Codec) -> Node:
    """Return a node that never runs. Raises :class:`ScenarioError` if it refuses the parameters or readings."""
    try:
        config = NodeConfig(
            node_id=node_id(codec.profile, 0),
            codec=codec,
            bp=scenario.bp,
            srp=scenario.srp_config,
            vardis=scenario.vardis_config,
            readings=scenario.readings,
        )
        return Node(config, rng=random.Random(0), now=0, wall=0)  # noqa: S311 - it never runs
    except (UnknownReadingError, ValueError) as error:
        raise ScenarioError(f"the nodes refuse this configuration: {error}") from None


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file. Raises :class:`ScenarioError`."""
    try:
        return tomllib.loads(path.read_bytes().decode())
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path}: not a valid TOML file: {error}") from None


def _convert(raw: dict[str, Any], kind: type[T], where: str) -> T:
    """Return a table as a value of ``kind``. Raises :class:`ScenarioError` with the key of the first problem."""
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        sentence, _, place = str(error).partition(" - at `$")
        key = place.rstrip("`").lstrip(".")
        sentence = sentence.replace("Object contains unknown field", "unknown key") + _hint(sentence, key, raw)
        sentence = sentence.replace("Object missing required field", "missing key")
        raise ScenarioError(f"{where}: {key}: {sentence}" if key else f"{where}: {sentence}") from None
    except ValueError as error:
        raise ScenarioError(f"{where}: {error}") from None


#: Tables by their place in the file, for hints. The tables of events and expectations depend on their tag.
_TABLES: dict[str, type[msgspec.Struct]] = {
    "": Scenario,
    "topology": Topology,
    "link": LinkQuality,
    "links[...]": LinkBetween,
    "radio": RadioTable,
    "bp": BPConfig,
    "srp": SRPConfig,
    "vardis": VardisConfig,
    "tracks[...]": Tracks,
}


def _hint(sentence: str, key: str, raw: dict[str, Any]) -> str:
    """Return a hint about the key that was probably meant by an unknown one, about all keys or all values."""
    if "Invalid enum value" in sentence:
        place, _, name = key.rpartition(".")
        table = _table(place, raw)
        values = typing.get_args(typing.get_type_hints(table).get(name)) if table is not None else ()
        return f"; the values are {', '.join(map(str, values))}" if values else ""
    match = re.search(r"unknown field `(.*)`", sentence)
    if match is None or (table := _table(key, raw)) is None:
        return ""
    known = [field.encode_name for field in msgspec.structs.fields(table)]
    near = difflib.get_close_matches(match[1], known, n=1)
    return f"; did you mean {near[0]}?" if near else f"; the keys are {', '.join(known)}"


def _table(key: str, raw: dict[str, Any]) -> type[msgspec.Struct] | None:
    """Return the type of the table at a key, None if it is not known."""
    if place := re.fullmatch(r"(events|expect)\[(\d+)\]", key):
        row = raw[place[1]][int(place[2])]
        return _variant(Event if place[1] == "events" else Expectation, row.get("do") or row.get("that"))
    return _TABLES.get(re.sub(r"\[\d+\]", "[...]", key))


def _variant(base: type[msgspec.Struct], tag: object) -> type[msgspec.Struct] | None:
    """Return the subclass of ``base`` with this tag, None if there is none."""
    for below in base.__subclasses__():
        found = below if below.__struct_config__.tag == tag else _variant(below, tag)
        if found is not None:
            return found
    return None


#: A key of the scenario, and what is wrong with its value.
Problem = tuple[str, str]


def _problems(scenario: Scenario) -> Iterator[Problem]:
    """Yield the inconsistencies of a scenario, in the order of its keys."""
    if not 1 <= scenario.nodes <= MAX_NODES:
        yield "nodes", f"a network has 1 to {MAX_NODES} nodes, not {scenario.nodes}"
    if not 0 < scenario.duration_s <= MAX_DURATION_S:
        yield "duration_s", f"{scenario.duration_s:g} is not within 0..{MAX_DURATION_S:g} s"
    if not 0 <= scenario.warm_up_s < scenario.duration_s:
        yield "warm_up_s", f"{scenario.warm_up_s:g} is not less than the {scenario.duration_s:g} s of the scenario"
    yield from _node_problems(scenario, "down_at_start", scenario.down_at_start)
    yield from _topology_problems(scenario)
    yield from _quality_problems("link", scenario.link)
    for index, link in enumerate(scenario.links):
        yield from _node_problems(scenario, f"links[{index}].from", (link.sender,))
        yield from _node_problems(scenario, f"links[{index}].to", (link.receiver,))
        yield from _quality_problems(f"links[{index}].quality", link.quality)
    yield from _radio_problems(scenario)
    for index, track in enumerate(scenario.tracks):
        yield from _node_problems(scenario, f"tracks[{index}].nodes", track.nodes or ())
        if track.source.partition(":")[0] in ("stdin", "mavlink"):
            yield f"tracks[{index}].source", f"{track.source} cannot be a source of a scenario; use a track or a file"
    planned = 0
    for index, event in enumerate(scenario.events):
        yield from _event_problems(scenario, f"events[{index}]", event)
        planned += 1 if not event.every_s else event.times or int(scenario.duration_s / event.every_s) + 1
        if planned > MAX_EVENTS:
            yield f"events[{index}].every_s", f"the scenario has more than {MAX_EVENTS} events with this period"
    yield from _expectation_problems(scenario)


def _node_problems(scenario: Scenario, key: str, nodes: tuple[int, ...]) -> Iterator[Problem]:
    """Yield the numbers that are not nodes of the scenario."""
    for node in nodes:
        if not 0 <= node < scenario.nodes:
            yield key, f"there is no node {node}; the nodes are 0..{scenario.nodes - 1}"


def _topology_problems(scenario: Scenario) -> Iterator[Problem]:
    """Yield the inconsistencies of the topology."""
    topology, count = scenario.topology, scenario.nodes
    for name, kind in (("neighbours", "neighbours"), ("positions", "positions")):
        rows = getattr(topology, name)
        if topology.kind != kind and rows:
            yield f"topology.{name}", f"a topology of kind {topology.kind} does not have this key"
        if kind == "positions" and not rows and _all_tracked(scenario):
            continue
        if topology.kind == kind and len(rows) != count:
            yield f"topology.{name}", f"it must have as many entries as nodes: {count}, not {len(rows)}"
    for node, row in enumerate(topology.neighbours):
        yield from _node_problems(scenario, f"topology.neighbours[{node}]", row)
    if topology.kind == "positions" and not topology.range_m > 0:
        yield "topology.range_m", "it is required, and must be greater than 0"
    if topology.columns is not None and topology.columns < 1:
        yield "topology.columns", f"a grid has at least one column, not {topology.columns}"


def _all_tracked(scenario: Scenario) -> bool:
    """Return whether each node has a track, which determines its position."""
    tracked: set[int] = set()
    for track in scenario.tracks:
        tracked.update(range(scenario.nodes) if track.nodes is None else track.nodes)
    return len(tracked) == scenario.nodes


def _quality_problems(key: str, quality: LinkQuality) -> Iterator[Problem]:
    """Yield the first value of a quality that is out of range."""
    try:
        quality.quality()
    except (ValueError, OverflowError) as error:
        yield key, str(error)


def _radio_problems(scenario: Scenario) -> Iterator[Problem]:
    """Yield the first value of the radio that is out of range. The model is loaded when the scenario is run."""
    radio = scenario.radio
    if radio is None:
        return
    if not 0 <= radio.preamble_us < math.inf:
        yield "radio.preamble_us", f"must be finite and at least 0, not {radio.preamble_us:g}"
    try:
        radio.radio(with_model=False)
    except RadioError as error:
        yield "radio", str(error)
    if radio.loss and scenario.topology.kind != "positions":
        yield "radio.loss", 'distances need positions: a [topology] with kind = "positions" and its range_m'


def _event_problems(scenario: Scenario, key: str, event: Event) -> Iterator[Problem]:
    """Yield the inconsistencies of one event."""
    if not 0 <= event.at_s <= scenario.duration_s:
        yield f"{key}.at_s", f"{event.at_s:g} is not within the {scenario.duration_s:g} s of the scenario"
    # TOML allows inf, nan, and periods below the resolution of any clock.
    if event.every_s is not None and not _SHORTEST_S <= event.every_s < math.inf:
        yield f"{key}.every_s", f"must be finite and at least {_SHORTEST_S:g} s, not {event.every_s:g}"
    if event.times is not None and (event.times < 1 or event.every_s is None):
        yield f"{key}.times", "must be at least 1, and requires every_s"
    if event.intervals != "fixed" and event.every_s is None:
        yield f"{key}.intervals", "requires every_s, the mean interval"
    node = getattr(event, "node", None)
    if isinstance(node, int):
        yield from _node_problems(scenario, f"{key}.node", (node,))
    if isinstance(event, Clock) and not abs(event.step_s) <= MAX_DURATION_S:
        yield f"{key}.step_s", f"{event.step_s:g} is not within {-MAX_DURATION_S:g}..{MAX_DURATION_S:g} s"
    if isinstance(event, Content):
        yield from _content_problems(key, event)
    if isinstance(event, Create) and event.repetitions < 1:
        yield f"{key}.repetitions", "must be at least 1"
    if isinstance(event, Partition):
        seen: set[int] = set()
        for group in event.groups:
            yield from _node_problems(scenario, f"{key}.groups", group)
            for each in group:
                if each in seen:
                    yield f"{key}.groups", f"node {each} is in two groups"
                seen.add(each)
    if isinstance(event, SetLink):
        yield from _quality_problems(f"{key}.quality", event.quality)
        if (event.sender is None) != (event.receiver is None):
            yield key, "from and to must be given together"
        ends = tuple(end for end in (event.sender, event.receiver) if end is not None)
        yield from _node_problems(scenario, key, ends)


def _content_problems(key: str, content: Content | VariableIs) -> Iterator[Problem]:
    """Yield the problem of a text or value."""
    try:
        content.octets()
    except ValueError as error:
        yield f"{key}.value", str(error)


def _expectation_problems(scenario: Scenario) -> Iterator[Problem]:
    """Yield the inconsistencies of the expectations."""
    for index, expectation in enumerate(scenario.expect):
        key = f"expect[{index}]"
        at = getattr(expectation, "at_s", None)
        if at is not None and not 0 <= at <= scenario.duration_s:
            yield f"{key}.at_s", f"{at:g} is not within the {scenario.duration_s:g} s of the scenario"
        if isinstance(expectation, VariableIs):
            yield from _node_problems(scenario, f"{key}.node", (expectation.node,))
            yield from _content_problems(key, expectation)
        elif isinstance(expectation, NeighboursAre):
            yield from _node_problems(scenario, key, (expectation.node, *expectation.are))
        elif isinstance(expectation, Converged):
            if not 0 <= expectation.within_s < math.inf:
                yield f"{key}.within_s", f"must be finite and at least 0 s, not {expectation.within_s:g}"
        elif isinstance(expectation, BeaconRate):
            for name, number in (("per_s", expectation.per_s), ("tolerance", expectation.tolerance)):
                if not 0 <= number < math.inf:
                    yield f"{key}.{name}", f"must be finite and at least 0, not {number:g}"
            yield from _node_problems(scenario, f"{key}.nodes", expectation.nodes or ())
