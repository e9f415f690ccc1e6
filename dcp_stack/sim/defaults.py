"""The scenario of those who have none: everybody moves and beacons, and some variables change now and then."""

from __future__ import annotations

from dcp_codec.codec import get_codec
from dcp_stack.positions import SafetyFields

from .scenario import Action, Converged, Create, Expected, Scenario, Topology, Tracks, Update

#: Seconds between two updates of a variable, and how long the last one may take.
EVERY_S = 5.0


def default_scenario(
    nodes: int,
    *,
    topology: Topology,
    profile: str = "dcp-2.0",
    duration_s: float = 60.0,
    variables: int = 2,
    seed: int = 1,
) -> Scenario:
    """``variables`` are created after a second by nodes spread over the network, and updated every five seconds.

    Raises ProfileError for an unknown profile.
    """
    events: list[Action] = []
    updates = int((duration_s - 1.0 - EVERY_S) / EVERY_S)
    for number in range(variables):
        # A variable later than a second would be one event each; those of one moment are one for convergence.
        node = number * nodes // max(variables, 1)
        events.append(Create(at_s=min(1.0, duration_s), node=node, variable=number, text="0"))
        if updates > 0:
            again = Update(
                at_s=1.0 + EVERY_S, every_s=EVERY_S, times=updates, node=node, variable=number, text="update {n}"
            )
            events.append(again)
    fields = SafetyFields(get_codec(profile).profile)
    tracks = (Tracks(source="track:walk,extent=200"),) if fields.has_position else ()
    expect: tuple[Expected, ...] = (Converged(within_s=EVERY_S),) if duration_s > 1.0 + EVERY_S and variables else ()
    return Scenario(
        nodes=nodes,
        duration_s=duration_s,
        profile=profile,
        topology=topology,
        seed=seed,
        tracks=tracks,
        events=tuple(events),
        expect=expect,
    )
