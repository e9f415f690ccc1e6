"""The links of a scenario, for ``dcp-conformance check --topology``."""

from __future__ import annotations

from pathlib import Path

from dcp_conformance.check.base import name
from dcp_conformance.check.topology import Topology
from dcp_conformance.errors import UsageError

from dcp_codec.codec import Codec
from dcp_stack.virtual.world import node_id

from .definition import ScenarioError
from .loading import load_scenario


def links_of(path: Path) -> Topology:
    """Return the links of a scenario, at any time of it. Raises :class:`UsageError`."""
    try:
        scenario = load_scenario(path)
    except ScenarioError as error:
        raise UsageError(str(error)) from None
    if scenario.topology.kind == "positions" and scenario.tracks:
        raise UsageError(f"{path}: its nodes move, so their links change: omit --topology")
    profile = Codec(scenario.profile).profile
    names = [name(node_id(profile, index)) for index in range(scenario.nodes)]
    hears: dict[str, set[str]] = {each: set() for each in names}
    for one, two in scenario.topology.pairs(scenario.nodes):
        hears[names[one]].add(names[two])
        hears[names[two]].add(names[one])
    return Topology(hears, str(path))
