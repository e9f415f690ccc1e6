"""The space of an exploration: the network, and how often each kind of event may occur."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from dcp_stack.config import VardisConfig

#: Kinds of events that distinguish causes, in the order of :attr:`Space.limits`. ``again``: a creation by a node that
#: has created the variable before; ``other``: a creation by a second node.
KINDS = ("create", "again", "other", "update", "delete", "restart", "clock", "silence", "partition", "loss")


class SpaceError(ValueError):
    """A space is invalid; the message has the key and the problem."""


class Space(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A network of 2 to 4 nodes with one variable, and the maximum number of events of each kind.

    Nodes 0 to ``producers`` - 1 may create the variable; the others are exchangeable. Beacons are not limited.
    """

    title: str = ""
    nodes: int = 3
    profile: str = "dcp-2.0"
    producers: int = 1
    repetitions: int = 1
    """``repCnt`` of the variable."""
    creations: int = 1
    """Creations by all nodes together, first ones included."""
    updates: int = 0
    deletions: int = 0
    restarts: int = 0
    clock_steps: int = 0
    """Changes of a producer's clock between the correct time and an hour ahead."""
    silences: int = 0
    """Periods of 0.6 timeouts of the variable without beacons; without any the variable has no timeout."""
    partitions: int = 0
    """Partitions into two groups; healing is not limited."""
    losses: int | None = None
    """Receptions that may be lost; None: each beacon may be heard by any subset of the nodes."""
    rounds: int = 10
    """Lossless rounds (each node sends one beacon) after which requests have to have ended."""
    max_states: int = 2_000_000
    """Number of states after which the exploration ends although it is not complete."""
    vardis: VardisConfig = VardisConfig()
    readings: dict[str, str] = {}
    proposal: str = ""
    """A changed text of the specification (``dcp_lab.explore.proposals``); empty: the unchanged text."""

    @property
    def timeout_ms(self) -> int:
        """The timeout of the variable in ms, 0 for none."""
        return 60_000 if self.silences else 0

    @property
    def bounds(self) -> str:
        """The bounds as text: "3 nodes, 2 creations, 1 update"."""
        counts = {
            "node": self.nodes,
            "producer": self.producers if self.producers > 1 else 0,
            "creation": self.creations,
            "update": self.updates,
            "deletion": self.deletions,
            "restart": self.restarts,
            "clock step": self.clock_steps,
            "silence": self.silences,
            "partition": self.partitions,
        }
        found = [f"{count} {noun}{'s' * (count != 1)}" for noun, count in counts.items() if count]
        found.append("any loss" if self.losses is None else f"{self.losses} loss{'es' * (self.losses != 1)}")
        if self.repetitions > 1:
            found.append(f"repCnt {self.repetitions}")
        if self.vardis.seqno_modulus:
            found.append(f"{self.vardis.seqno_modulus} sequence numbers")
        return ", ".join(found)


def load_space(path: Path) -> Space:
    """Return the space in a TOML file with the keys of :class:`Space`. Raises :class:`SpaceError`."""
    try:
        raw: dict[str, Any] = tomllib.loads(path.read_bytes().decode())
        return check(msgspec.convert(raw, Space))
    except OSError as error:
        raise SpaceError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise SpaceError(f"{path}: {error}") from None


def check(space: Space) -> Space:
    """Return ``space`` if it is consistent. Raises :class:`SpaceError` for the first problem."""
    for key, problem in _problems(space):
        raise SpaceError(f"{key}: {problem}")
    return space


def _problems(space: Space) -> Iterator[tuple[str, str]]:
    if not 2 <= space.nodes <= 4:
        yield "nodes", f"a network has 2 to 4 nodes, not {space.nodes}"
    if not 1 <= space.producers <= space.nodes:
        yield "producers", f"1 to {space.nodes} nodes may create the variable, not {space.producers}"
    for name in ("creations", "repetitions", "rounds", "max_states"):
        if getattr(space, name) < 1:
            yield name, f"must be at least 1, not {getattr(space, name)}"
    for name in ("updates", "deletions", "restarts", "clock_steps", "silences", "partitions"):
        if getattr(space, name) < 0:
            yield name, f"must be at least 0, not {getattr(space, name)}"
    if space.losses is not None and space.losses < 0:
        yield "losses", f"must be at least 0, not {space.losses}"
