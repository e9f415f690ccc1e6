"""What is said to a relay, a line of JSON each, and what it answers."""

from __future__ import annotations

from typing import Any

import msgspec


class Setup(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The first line: what the relay forwards between. Answered by ``{"ok": true}`` once all ports are open."""

    ports: tuple[str, ...]
    """Interfaces, one for each station."""
    impairment: str = ""
    """Of all links that have none of their own, as ``dcp_codec.impairment.parse_impairment`` reads it."""
    seed: int = 1
    hears: tuple[tuple[int, int], ...] | None = None
    """Pairs (sender, receiver); None: everybody hears everybody."""
    record: str = ""
    """Folder for one MCAP file for each port; empty: nothing is recorded."""
    profile: str = ""
    """Wire profile that the recordings name; empty: none."""


class SetQuality(msgspec.Struct, tag="set", tag_field="do", forbid_unknown_fields=True, kw_only=True):
    """Change the impairment of one direction, or of all that have none of their own."""

    impairment: str
    sender: int | None = None
    receiver: int | None = None


class Partition(msgspec.Struct, tag="partition", tag_field="do", forbid_unknown_fields=True):
    """Let frames stay within groups of stations; no groups: end that."""

    groups: tuple[tuple[int, ...], ...]


class SwitchPort(msgspec.Struct, tag="port", tag_field="do", forbid_unknown_fields=True):
    """Connect or disconnect a station."""

    number: int
    up: bool


class Count(msgspec.Struct, tag="counters", tag_field="do", forbid_unknown_fields=True):
    """Answered by the counters."""


Command = SetQuality | Partition | SwitchPort | Count


class Answer(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """What the relay says to a command."""

    ok: bool
    why: str = ""
    """The reason of a refusal."""
    counters: dict[str, Any] = {}
