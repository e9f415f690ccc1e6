"""Messages to a relay and its answers, each a line of JSON."""

from __future__ import annotations

from typing import Any

import msgspec


class Setup(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The first line: the configuration of the relay. The answer is ``{"ok": true}`` when all ports are open."""

    ports: tuple[str, ...]
    """Interfaces, one for each station."""
    impairment: str = ""
    """Impairment of all links without their own, in the syntax of ``dcp_codec.impairment.parse_impairment``."""
    seed: int = 1
    hears: tuple[tuple[int, int], ...] | None = None
    """Connections as pairs (sender, receiver); None: all stations are connected."""
    record: str = ""
    """Directory for one MCAP file per port; empty: no recordings."""
    profile: str = ""
    """Wire profile in the metadata of the recordings; empty: none."""


class SetQuality(msgspec.Struct, tag="set", tag_field="do", forbid_unknown_fields=True, kw_only=True):
    """Set the impairment of one direction, or (without ``sender`` and ``receiver``) that of all others.

    "All others" are the directions whose impairment was not set separately.
    """

    impairment: str
    sender: int | None = None
    receiver: int | None = None


class Partition(msgspec.Struct, tag="partition", tag_field="do", forbid_unknown_fields=True):
    """Restrict frames to groups of stations; without groups the partition ends."""

    groups: tuple[tuple[int, ...], ...]


class SwitchPort(msgspec.Struct, tag="port", tag_field="do", forbid_unknown_fields=True):
    """Connect or disconnect a station."""

    number: int
    up: bool


class Count(msgspec.Struct, tag="counters", tag_field="do", forbid_unknown_fields=True):
    """Request the counters."""


Command = SetQuality | Partition | SwitchPort | Count


class Answer(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The answer to the setup or to a command."""

    ok: bool
    why: str = ""
    """The reason for a refusal."""
    counters: dict[str, Any] = {}
