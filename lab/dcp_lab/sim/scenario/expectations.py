"""Comparison of expectations with observations, common to simulations and testbeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from .agreement import Convergence
from .definition import (
    NS_PER_S,
    Activate,
    BeaconRate,
    Clock,
    Converged,
    Create,
    Deactivate,
    Delete,
    Down,
    Event,
    Expected,
    NeighboursAre,
    Partition,
    Restart,
    Scenario,
    SetLink,
    Submission,
    Up,
    Update,
    VariableIs,
)
from .report import Finding, NodeTraffic


class VariableState(NamedTuple):
    """The state of a variable at a node."""

    state: str
    """``alive``, ``deleted``, ``unknown``, or ``off`` if the node or its VarDis is not active."""
    value: bytes = b""


class Observed(Protocol):
    """A network whose nodes can be queried."""

    def variable(self, node: int, var_id: int) -> VariableState:
        """Return the current state of a variable at a node."""

    def neighbours(self, node: int) -> list[int] | None:
        """Return the node numbers in a node's neighbour table, ascending; None while it has no active SRP."""


def describe(event: Event, n: int = 0) -> str:
    """Return a short description of the ``n``-th repetition of an event."""
    match event:
        case Create(node=node, variable=variable):
            return f"node {node} creates variable {variable}"
        case Update(node=node, variable=variable):
            return f"node {node} updates variable {variable}" + (f" ({n + 1})" if event.every_s else "")
        case Delete(node=node, variable=variable):
            return f"node {node} deletes variable {variable}"
        case Activate(node=node, layer=layer):
            return f"node {node} activates {layer}"
        case Deactivate(node=node, layer=layer):
            return f"node {node} deactivates {layer}"
        case Down(node=node):
            return f"node {node} is switched off"
        case Up(node=node):
            return f"node {node} is switched on"
        case Restart(node=node):
            return f"node {node} restarts"
        case Clock(node=node, step_s=step):
            return f"the clock of node {node} is set by {step:+g} s"
        case Partition(groups=groups):
            return "partition " + " | ".join(",".join(map(str, group)) for group in groups)
        case SetLink(sender=None):
            return "links change"
        case SetLink(sender=sender, receiver=receiver):
            return f"link {sender}-{receiver} changes"
        case Submission(node=node):
            return f"node {node} gets safety data"
        case _:
            return "the partition ends"


def checks(scenario: Scenario) -> list[tuple[int, VariableIs | NeighboursAre]]:
    """Return the expectations about one moment, each with its time in ns, sorted by time."""
    found = [
        (scenario.duration if each.at_s is None else round(each.at_s * NS_PER_S), each)
        for each in scenario.expect
        if isinstance(each, VariableIs | NeighboursAre)
    ]
    return sorted(found, key=lambda each: each[0])


def judge_now(expected: VariableIs | NeighboursAre, observed: Observed) -> Finding:
    """Compare an expectation with the current state of the network."""
    when = "at the end" if expected.at_s is None else f"at {expected.at_s:g} s"
    if isinstance(expected, NeighboursAre):
        neighbours = observed.neighbours(expected.node)
        wanted = sorted(expected.are)
        what = f"the neighbours of node {expected.node} are {wanted} {when}"
        return Finding(what, neighbours == wanted, "" if neighbours == wanted else f"found {neighbours}")
    known, value = observed.variable(expected.node, expected.variable), expected.octets()
    what = f"node {expected.node} has variable {expected.variable} {expected.state} {when}"
    if value is not None and expected.state == "alive":
        what += f" with {readable(value)}"
        met = known == (expected.state, value)
    else:
        met = known.state == expected.state
    found = known.state + (f" with {readable(known.value)}" if known.value else "")
    return Finding(what, met, "" if met else f"it is {found}")


def judge_all(
    expect: Sequence[Expected], convergences: Sequence[Convergence], traffic: Sequence[NodeTraffic]
) -> list[Finding]:
    """Compare the expectations about the whole run with its convergences and traffic."""
    found = []
    for expected in expect:
        if isinstance(expected, Converged):
            found.append(_converged(expected, convergences))
        elif isinstance(expected, BeaconRate):
            found.append(_rate(expected, traffic))
    return found


def _converged(expected: Converged, convergences: Sequence[Convergence]) -> Finding:
    """Compare the times until the databases agreed with the expected one."""
    asked = convergences if expected.after == "each" else convergences[-1:]
    what = f"the databases agree {expected.within_s:g} s after {expected.after} event"
    what = what.replace("after last", "after the last")
    limit = round(expected.within_s * NS_PER_S)
    for each in asked:
        if each.took is None:
            return Finding(what, False, f"no agreement after '{each.what}' at {each.time / NS_PER_S:g} s")
        if each.took > limit:
            took = f"{each.took / NS_PER_S:.3f} s"
            return Finding(what, False, f"it took {took} after '{each.what}' at {each.time / NS_PER_S:g} s")
    worst = max((each.took or 0 for each in asked), default=0)
    return Finding(what, True, f"{worst / NS_PER_S:.3f} s")


def _rate(expected: BeaconRate, traffic: Sequence[NodeTraffic]) -> Finding:
    """Compare the beacon rates with the expected one."""
    what = f"nodes send {expected.per_s:g} beacons/s within {expected.tolerance:.1%}"
    asked = [
        (each.beacons_per_s, each)
        for each in traffic
        if each.beacons_per_s is not None and (expected.nodes is None or each.node in expected.nodes)
    ]
    if not asked:
        return Finding(what, False, "no node was switched on during the whole run")
    worst, who = max(asked, key=lambda each: abs(each[0] - expected.per_s))
    met = abs(worst - expected.per_s) <= expected.tolerance * expected.per_s
    found = f"node {who.node} has the largest deviation with {worst:.3f}"
    if who.left_out_per_s:
        found += f"; it left out {who.left_out_per_s:.3f} because the machine was too busy"
    return Finding(what, met, found)


def readable(value: bytes) -> str:
    """Return octets as quoted text if they are printable UTF-8, otherwise as hexadecimal digits."""
    try:
        text = value.decode()
    except UnicodeDecodeError:
        text = ""
    return f"'{text}'" if text.isprintable() and text else value.hex()
