"""``dcp-node status``: the state of a node on one page."""

from __future__ import annotations

import json
from typing import Any

import click

from dcp_stack.drops import split

from .common import EXIT_STATUS, counted, node_options, simple, span


@click.command("status", epilog=EXIT_STATUS)
@node_options
def command(control: str, as_json: bool) -> int:
    """Show the node's identity, neighbours and variables, and what it sent, received and ignored."""
    return simple(control, as_json, "UT-Status", lambda result: "\n".join(_lines(result)))


def _lines(status: dict[str, Any]) -> list[str]:
    node, runtime = status["node"], status["runtime"]
    bp, link = node["bp"], runtime.get("link", {})
    counters = bp["counters"]
    rows = [
        ("node", status["nodeId"]),
        ("profile", f"{status['profile']} (specification {status['specVersion']})"),
        ("up for", span(runtime.get("uptime_ms", 0))),
        ("link", _link(link)),
        ("BP", f"{_active(bp)}, next beacon number {bp['next_seqno']}, {counted(len(bp['clients']), 'protocol')}"),
        ("beacons", f"{_sent(counters, link)}, {counters.get('beacons-received', 0)} received"),
    ]
    if "srp" in node:
        srp = node["srp"]
        state = "registered" if srp["registered"] else "not registered"
        most = f" of at most {srp['max_neighbours']}" if "max_neighbours" in srp else ""
        rows.append(("SRP", f"{state}, {counted(len(srp['neighbours']), 'neighbour')}{most}"))
    if "vardis" in node:
        variables = node["vardis"]["variables"].values()
        deleted = sum(each["isDeleted"] for each in variables)
        rows.append(
            ("VarDis", f"{_active(node['vardis'])}, {counted(len(variables) - deleted, 'variable')}, {deleted} deleted")
        )
    if "recording" in runtime:
        recording = runtime["recording"]
        problem = f"; stopped: {recording['problem']}" if recording["problem"] else ""
        if recording.get("frames_lost"):
            problem += f"; {recording['frames_lost']} frames not recorded"
        rows.append(("recording", f"{recording['path']}, {recording['frames']} frames{problem}"))
    if "positions" in runtime:
        rows.append(("position", runtime["positions"]["source"]))
    rows += [("undelivered", each["text"]) for each in status.get("obstacles", ())]
    for title, counts in zip(("ignored", "redundant"), split(status["drops"]), strict=True):
        rows.append((title, ", ".join(f"{name} {count}" for name, count in counts.items()) or "nothing"))
    return [f"{name:<10} {text}" for name, text in rows]


def _sent(counters: dict[str, int], link: dict[str, Any]) -> str:
    """Format the numbers of beacons that were sent and that could not be sent."""
    made, failed = counters.get("beacons-sent", 0), link.get("send_errors", 0)
    return f"{max(made - failed, 0)} sent" + (f" ({failed} could not be sent)" if failed else "")


def _active(entity: dict[str, Any]) -> str:
    return "active" if entity["active"] else "not active"


def _link(link: dict[str, Any]) -> str:
    shown = [counted(count, name.removesuffix("s").replace("_", " ")) for name, count in troubles(link).items()]
    state = [] if link.get("up", True) else ["DOWN"]
    if same := own_address(link):
        shown.append(same)
    return ", ".join([str(link.get("name", "?")), *state, *shown])


def troubles(link: dict[str, Any]) -> dict[str, int]:
    """Return the counters of a link that show a problem, without those that are 0."""
    return {name: link[name] for name in ("send_errors", "kernel_drops", "outages") if link.get(name)}


def own_address(link: dict[str, Any]) -> str:
    """Describe frames received from the node's own address; empty on loopback, where they are its own."""
    count = link.get("own_address", 0)
    if not count or link.get("name") == "eth:lo":
        return ""
    return f"{counted(count, 'frame')} from its own address (another node with this MAC address?)"


def as_line(status: dict[str, Any]) -> str:
    """Return a status as one JSON line."""
    return json.dumps(status)
