"""Results of a matrix as data: ``interop.json``, from which every report is made."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final, Literal

import msgspec
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict

SCHEMA: Final = "dcp-conformance-interop/1"
INTERRUPTED: Final = "interrupted"
"""Why a matrix ended early: Ctrl-C, SIGTERM or SIGHUP."""


class TimelineEntry(msgspec.Struct, frozen=True, omit_defaults=True):
    """A line of a timeline: ``time`` in s since the start, ``place`` None for the network, ``frame`` 0 for none."""

    time: float
    place: int | None
    text: str
    frame: int = 0


class Spread(msgspec.Struct, frozen=True):
    """The time in seconds that a change took to reach all stations; ``took`` is None if it exceeded ``limit``."""

    what: str
    time: float
    took: float | None
    limit: float


class StationResult(msgspec.Struct, frozen=True, kw_only=True):
    """One place of a cell."""

    place: int
    implementation: str
    profile: str
    node_id: str
    neighbours: tuple[int, ...]
    beacons: int = 0
    death: str = ""
    recording: str = ""
    """The recording of the station's frames, relative to the report's folder."""
    log: str = ""


class CellResult(msgspec.Struct, frozen=True, kw_only=True):
    """One test with one pair of implementations."""

    a: str
    b: str
    test: str
    purpose: str
    requirements: tuple[str, ...]
    network: str
    profile: str
    world: str
    """``virtual`` or ``real``."""
    seed: int
    verdict: Verdict
    reason: str = ""
    duration_s: float = 0.0
    """Seconds of the world's time."""
    elapsed_s: float = 0.0
    """Seconds that the tester took."""
    checks: tuple[Check, ...] = ()
    spreads: tuple[Spread, ...] = ()
    moments: tuple[TimelineEntry, ...] = ()
    left_out: int = 0
    stations: tuple[StationResult, ...] = ()
    links: dict[str, Any] = {}
    """Counters of each direction, by ``"SENDER>RECEIVER"``."""
    recording: str = ""
    """Everything that was transmitted, relative to the report's folder."""
    seeds: int = 1
    """Number of seeds that were played; the result is that of the first failed one."""
    failed_seeds: tuple[int, ...] = ()
    rerun: str = ""
    """The command that runs this cell again."""
    error_detail: str = ""


class ImplementationResult(msgspec.Struct, frozen=True):
    """One row and column of the matrix."""

    name: str
    profile: str
    what: str = ""
    declared: dict[str, str] = {}
    """Requirement -> how its profiles deviate from the specification: no cell fails because of it."""


class MatrixResult(msgspec.Struct, frozen=True, kw_only=True):
    """A whole matrix."""

    schema: str = SCHEMA
    tool: str = ""
    started: str = ""
    elapsed_s: float = 0.0
    command: str = ""
    implementations: tuple[ImplementationResult, ...] = ()
    cells: tuple[CellResult, ...] = ()
    ended_early: str = ""
    """Why cells are missing: ``interrupted``, or what went wrong; empty if all were run."""
    unfinished: int = 0
    """Number of cells that are missing."""

    @property
    def incomplete(self) -> str:
        """Say why cells are missing, and how many; empty if all were run."""
        if not self.ended_early:
            return ""
        return f"{self.ended_early}: {self.unfinished} of {len(self.cells) + self.unfinished} cells were not run"

    def counts(self) -> Counter[str]:
        """The number of cells by verdict."""
        return Counter(str(cell.verdict) for cell in self.cells)

    def implementations_of(self, role: Literal["a", "b"]) -> list[str]:
        """The names of the implementations in a role, in the order of their cells."""
        return list(dict.fromkeys(getattr(cell, role) for cell in self.cells))

    def declared(self) -> list[tuple[str, str, str]]:
        """Implementation, requirement and deviation, for each deviation that a profile declares."""
        return [(each.name, *item) for each in self.implementations for item in each.declared.items()]
