"""The default scenario, if the user gives none: all nodes move and send beacons, and some variables are updated."""

from __future__ import annotations

import math

from dcp_codec.codec import get_codec
from dcp_lab.sim.measuring.reach import longest_distance
from dcp_stack.positions.fields import SafetyFields

from .definition import (
    PERFECT,
    Action,
    Converged,
    Create,
    Expected,
    LinkQuality,
    Scenario,
    Topology,
    Tracks,
    Update,
)

#: Seconds between two updates of a variable.
EVERY_S = 5.0
#: Seconds that the databases may take to agree in a small network without losses.
AGREE_S = 5.0
#: Seconds for each hop without losses: two beacon periods. On average a value needs one and a half at most.
HOP_S = 0.2


def default_scenario(
    nodes: int,
    *,
    topology: Topology,
    profile: str = "dcp-2.0",
    duration_s: float = 60.0,
    variables: int = 2,
    seed: int = 1,
    link: LinkQuality = PERFECT,
) -> Scenario:
    """Return a scenario in which nodes spread over the network create and update variables.

    ``variables``: number of variables, created after 1 s and updated every :data:`EVERY_S` s. The databases are
    expected to agree within :func:`time_to_agree` after the last event, if the duration is long enough. Raises
    ProfileError for an unknown profile.
    """
    producers = [number * nodes // max(variables, 1) for number in range(variables)]
    within = time_to_agree(topology, nodes, producers, link.loss)
    events: list[Action] = []
    updates = max(int((duration_s - 1.0 - within) / EVERY_S), 0) if math.isfinite(within) else int(duration_s / EVERY_S)
    for number, node in enumerate(producers):
        # All variables are created at the same moment, so they are one event for convergence.
        events.append(Create(at_s=min(1.0, duration_s), node=node, variable=number, text="0"))
        if updates > 0:
            again = Update(
                at_s=1.0 + EVERY_S, every_s=EVERY_S, times=updates, node=node, variable=number, text="update {n}"
            )
            events.append(again)
    fields = SafetyFields(get_codec(profile).profile)
    tracks = (Tracks(source="track:walk,extent=200"),) if fields.has_position else ()
    expect: tuple[Expected, ...] = (Converged(within_s=within),) if duration_s > 1.0 + within and variables else ()
    return Scenario(
        nodes=nodes,
        duration_s=duration_s,
        profile=profile,
        topology=topology,
        seed=seed,
        link=link,
        tracks=tracks,
        events=tuple(events),
        expect=expect,
    )


def time_to_agree(topology: Topology, nodes: int, producers: list[int], loss: float) -> float:
    """Return the time in s after which all nodes should have the values of these producers.

    It is infinite if a producer cannot reach all nodes. ``loss``: share of frames lost on each connection, 0..1.
    """
    heard = topology.heard_by(nodes)
    longest = longest_distance(
        nodes,
        lambda node: [other for other in heard.neighbours(node, nodes) if 0 <= other < nodes],
        set(producers),
    )
    if longest is None or loss >= 1:
        return math.inf
    return max(AGREE_S, 1.0 + longest * HOP_S / (1 - loss))
