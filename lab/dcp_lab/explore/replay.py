"""The sequence of a violation as a scenario for ``dcp-node simulate``, which runs complete nodes in virtual time.

All connections lose everything and VarDis is inactive, except around the beacons and services of the sequence. Each
step has a beacon period of its own. At the end the network is lossless for the rounds of the trace.
"""

from __future__ import annotations

from typing import Any, Final

from dcp_spec.constants import features

from dcp_codec.export.tomltext import toml_text
from dcp_stack.config import VardisConfig

from .cores import AHEAD, SILENCE, VARIABLE, Held
from .properties import PROPERTIES
from .search import Search, Step, Violation
from .trace import Row, Trace, trace

#: Beacon period, the distance of the beacons of two nodes, and half of the time in which VarDis is active, in s.
_PERIOD: Final = 0.1
_APART: Final = 0.01
_HALF: Final = 0.004
#: Time of a service in its period in s, after the beacons of all nodes.
_SERVICE: Final = 0.07
_START: Final = 0.2


def refusal(search: Search) -> str | None:
    """Return why sequences of a search cannot be scenarios, None if they can."""
    if search.space.proposal:
        return "scenarios cannot be written: simulate has the nodes of the specification only"
    if features(search.cores.codec.profile.spec_version).vardis_activation != "service":
        return "scenarios cannot be written: nodes before 1.2 cannot deactivate VarDis"
    return None


def scenario_text(search: Search, violation: Violation) -> str:
    """Return the scenario as TOML. See :func:`refusal` for searches without scenarios."""
    return toml_text(_Script(search, violation).scenario())


class _Script:
    """The events and expectations of a scenario, in the order of time."""

    def __init__(self, search: Search, violation: Violation) -> None:
        self._search, self._space, self._violation = search, search.space, violation
        self._events: list[dict[str, Any]] = []
        self._expect: list[dict[str, Any]] = []
        self._at = _START

    def scenario(self) -> dict[str, Any]:
        """Return the content of the scenario file."""
        space, found = self._space, trace(self._search, self._violation)
        for node in range(space.nodes):
            up = _APART * (node + 1)
            self._event(up, "up", node)
            self._event(up + _HALF, "deactivate", node)
        for row in found.rows:
            if not row.in_rounds:
                self._step(row)
                self._at += _PERIOD
        end = self._end(found)
        vardis = VardisConfig()
        settings = {
            name: value
            for name in vardis.__struct_fields__
            if (value := getattr(space.vardis, name)) != getattr(vardis, name)
        }
        kinds = ", ".join(sorted(self._violation.kinds))
        return {
            "title": f"{PROPERTIES[self._violation.name]} ({kinds})",
            "nodes": space.nodes,
            "duration_s": round(end, 6),
            "profile": space.profile,
            "srp": False,
            "down_at_start": list(range(space.nodes)),
            "link": {"loss": 1.0},
            "bp": {"beacon_period_ms": round(_PERIOD * 1000), "jitter": 0.0},
            "vardis": settings or None,
            "readings": space.readings or None,
            "events": sorted(self._events, key=lambda each: each["at_s"]),
            "expect": self._expect,
        }

    def _end(self, found: Trace) -> float:
        """Add the lossless rounds; returns the end of the scenario."""
        nodes = range(self._space.nodes)
        self._events.append({"at_s": round(self._at, 6), "do": "heal"})
        for node in nodes:
            self._event(self._at, "activate", node)
            for other in nodes if found.rounds else ():
                if other != node:
                    self._link(self._at, node, other, 0.0)
        end = self._at + found.rounds * _PERIOD + _HALF
        held = [self._search.cores.held[each] for each in found.contents]
        if found.rounds and self._space.silences and held != list(found.rows[-1].held):
            end += 2 * SILENCE * self._space.timeout_ms / 1000
        for node in nodes:
            self._expected(None, node, held[node])
        return end

    def _step(self, row: Row) -> None:
        """Add a step at the current time."""
        step = row.step
        node, phase = step.node, self._at + _APART * (step.node + 1)
        match step.kind:
            case "beacon":
                self._beacon(step, row, phase)
            case "create" | "update" | "delete":
                details: dict[str, Any] = {"variable": VARIABLE}
                if step.kind != "delete":
                    details["text"] = row.held[node].text
                if step.kind == "create":
                    details |= {"descr": "v", "repetitions": self._space.repetitions}
                    if self._space.timeout_ms:
                        details["timeout_ms"] = self._space.timeout_ms
                at = self._at + _SERVICE
                self._event(at - _HALF, "activate", node)
                self._event(at, step.kind, node, **details)
                self._event(at + _HALF, "deactivate", node)
            case "restart":
                # At the time of its beacon, so that the next ones come at the same place in their periods.
                self._event(phase, "restart", node)
                self._event(phase + _HALF, "deactivate", node)
            case "clock":
                ahead = row.text != "clock correct"
                self._event(self._at + _SERVICE, "clock", node, step_s=(AHEAD if ahead else -AHEAD) / 1e9)
            case "silence":
                self._at += SILENCE * self._space.timeout_ms / 1000
            case _:
                rest = [each for each in range(self._space.nodes) if each not in step.hearers]
                groups = {"groups": [rest, list(step.hearers)]} if step.kind == "partition" else {}
                self._events.append({"at_s": round(self._at + _SERVICE, 6), "do": step.kind, **groups})

    def _beacon(self, step: Step, row: Row, phase: float) -> None:
        """Add a beacon, and the expected content of those that receive it."""
        for node in (step.node, *step.hearers):
            self._event(phase - _HALF, "activate", node)
            self._event(phase + _HALF, "deactivate", node)
        for hearer in step.hearers:
            self._link(phase - _HALF, step.node, hearer, 0.0)
            self._link(phase + _HALF, step.node, hearer, 1.0)
            self._expected(phase + _HALF / 2, hearer, row.held[hearer])

    def _event(self, at: float, do: str, node: int, **details: Any) -> None:
        self._events.append({"at_s": round(at, 6), "do": do, "node": node, **details})

    def _link(self, at: float, sender: int, receiver: int, loss: float) -> None:
        ends = {"from": sender, "to": receiver, "both_ways": False}
        self._events.append({"at_s": round(at, 6), "do": "link", **ends, "quality": {"loss": loss}})

    def _expected(self, at: float | None, node: int, held: Held) -> None:
        """Add what a node has at a time, None: at the end."""
        value = {"text": held.text} if held.state == "alive" else {}
        when = {} if at is None else {"at_s": round(at, 6)}
        self._expect.append(
            {"that": "variable", "node": node, "variable": VARIABLE, "state": held.state, **value, **when}
        )
