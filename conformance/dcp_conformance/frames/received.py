"""Received beacons, decoded as far as possible, with queries for test cases."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import Problem
from dcp_codec.values import (
    Beacon,
    Container,
    ExtendedSafetyData,
)
from dcp_codec.views.salvage import Salvaged

#: The path of a problem inside a client payload.
_CLIENT: Final = re.compile(r"payloads\[\d+\]\.(srp|vardis)\b")


class Instruction(NamedTuple):
    """A record of a VarDis payload, with its position."""

    heard: ReceivedBeacon
    container: int
    """Index of the container in the beacon, from 0."""
    position: int
    """Index of the record in the container, from 0."""
    kind: ICType
    record: Any

    @property
    def var_id(self) -> int:
        """Identifier of the variable of the record."""
        return var_id_of(self.record)


class ReceivedBeacon:
    """One frame of the implementation, decoded once.

    ``beacon`` is the part that can be decoded (see :mod:`dcp_codec.views.salvage`), None without any. ``problems`` has
    the errors of the frame: a frame with problems is not a valid beacon, but parts of it may be valid.
    """

    __slots__ = (
        "_codec", "_made", "beacon", "containers", "number", "octets", "problems", "report", "salvaged", "sender",
        "seqno", "source", "time", "wall",
    )  # fmt: skip

    def __init__(self, codec: Codec, number: int, time: int, wall: int, octets: bytes, source: bytes) -> None:
        self.number = number
        self.time = time
        self.wall = wall
        self.octets = octets
        self.source = source
        self._codec = codec
        self.salvaged: Salvaged = codec.salvage(octets)
        """The decoded and the damaged parts."""
        self.beacon: Beacon | None = self.salvaged.beacon
        self.problems: tuple[Problem, ...] = self.salvaged.problems
        self.sender: bytes | None = self._sender(codec)
        """The node identifier in the beacon; None if the profile has none, or it is truncated."""
        self.containers: tuple[Container, ...] = ()
        """The VarDis containers of all blocks, in order."""
        self.report: ExtendedSafetyData | None = None
        """The first state report; None without any."""
        for payload in () if self.beacon is None else self.beacon.payloads:
            content = payload.content
            if isinstance(content, tuple):
                self.containers = self.containers + content if self.containers else content
            elif self.report is None and isinstance(content, ExtendedSafetyData):
                self.report = content
        self.seqno: int | None = self._seqno()
        """The beacon's sequence number; None if the header is not reliable."""
        self._made: tuple[Instruction, ...] | None = None

    @property
    def _instructions(self) -> tuple[Instruction, ...]:
        """All records, created at the first use."""
        if self._made is None:
            self._made = tuple(self._taken_apart())
        return self._made

    def _taken_apart(self) -> Iterator[Instruction]:
        for number, container in enumerate(self.containers):
            for position, record in enumerate(container.records):
                if (kind := record.IC_TYPE) is not None:
                    yield Instruction(self, number, position, kind, record)

    def _sender(self, codec: Codec) -> bytes | None:
        if self.beacon is not None:
            return None if self.beacon.bp is None else self.beacon.bp.sender_id
        # The error may be after the identifier.
        field = codec.dissect(self.octets).root.find("bp.senderId")
        return None if field is None else field.value

    # -- errors --------------------------------------------------------------------------------------------------------

    @property
    def problem(self) -> Problem | None:
        """The first problem; None for a valid beacon."""
        return self.problems[0] if self.problems else None

    @property
    def header_problems(self) -> list[Problem]:
        """The problems of the headers and the list of blocks, which BP processes."""
        return [each for each in self.problems if _CLIENT.match(each.path) is None]

    @property
    def vardis_problems(self) -> list[Problem]:
        """The problems inside VarDis payloads."""
        return self._problems_of("vardis")

    @property
    def report_problems(self) -> list[Problem]:
        """The problems inside SRP payloads."""
        return self._problems_of("srp")

    def _problems_of(self, client: str) -> list[Problem]:
        return [each for each in self.problems if (found := _CLIENT.match(each.path)) and found[1] == client]

    # -- content -------------------------------------------------------------------------------------------------------

    @property
    def blocks(self) -> list[tuple[int, bytes]]:
        """Protocol identifier and octets of each complete block."""
        envelope = self._codec.salvage_envelope(self.octets).beacon
        if envelope is None:
            return []
        cut_off = {each.payload for each in self.salvaged.damaged if _CLIENT.match(each.problem.path) is None}
        return [
            (each.protocol_id, each.data or b"")
            for number, each in enumerate(envelope.payloads)
            if number not in cut_off
        ]

    def _seqno(self) -> int | None:
        """Return the sequence number; None if the header is unreliable or has numPayloads 0 (shifted fields)."""
        if self.beacon is None or self.beacon.bp is None or not self.salvaged.clear:
            return None
        if self.problems and any(each.reason == "zero-count" for each in self.header_problems):
            return None
        return self.beacon.bp.seqno

    @property
    def known(self) -> set[int]:
        """The variables that must be in the database of the sender, including deleted ones."""
        requests = (ICType.REQUEST_VARCREATES,)
        return {each.var_id for each in self._instructions if each.kind not in requests}

    @property
    def has_vardis(self) -> bool:
        """Whether the beacon has a VarDis block."""
        return self.beacon is not None and any(payload.vardis is not None for payload in self.beacon.payloads)

    def data(self, protocol_id: int) -> list[bytes]:
        """Return the payloads of a protocol as octets."""
        return [octets for number, octets in self.blocks if number == protocol_id]

    def instructions(self, kind: ICType | None = None, var_id: int | None = None) -> list[Instruction]:
        """Return the VarDis records of a type and of a variable; None means any."""
        return [
            each
            for each in self._instructions
            if (kind is None or each.kind is kind) and (var_id is None or each.var_id == var_id)
        ]

    def about(self, kind: ICType, var_id: int) -> Any | None:
        """Return the first record of a type about a variable; None without any."""
        return next((each.record for each in self.instructions(kind, var_id)), None)


def var_id_of(record: Any) -> int:
    """Return the variable identifier of a record; for a VarCreate that of its VarSpec (X14)."""
    spec = getattr(record, "spec", None)
    number: int = record.var_id if spec is None else spec.var_id
    return number
