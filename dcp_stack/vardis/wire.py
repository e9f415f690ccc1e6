"""The receive path of VarDis, first phase: extraction of records from a payload (dcp-vardis.md, "Extraction Step")."""

from __future__ import annotations

from itertools import count
from typing import Any

import msgspec
from dcp_spec.constants import ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, Problem
from dcp_codec.values import Container
from dcp_stack.config import NodeConfig
from dcp_stack.record_sizes import RecordSizes

#: A container type of the specification, or the name of an additional one of the profile.
ContainerType = ICType | str
#: Records by container type, each with its offset in the payload.
Records = dict[ContainerType, list[tuple[int, Any]]]


class Extracted(msgspec.Struct, frozen=True):
    """The records of a payload by type, in the order of the payload, each with its offset there in octets."""

    records: Records
    problems: tuple[Problem, ...] = ()


class Extractor:
    """The extraction step of the receive path: it decodes records, and does not read or change the database."""

    def __init__(self, config: NodeConfig, sizes: RecordSizes) -> None:
        self._codec: Codec = config.codec
        self._sizes = sizes
        self._policy = config.selected_readings.receive_errors
        self._kinds: dict[int, ContainerType] = {number: kind for kind, number in config.container_numbers.items()}
        self._kinds |= {each.number: each.name for each in config.profile.vardis.own_containers}

    def extract(self, payload: bytes) -> Extracted:
        """Decode a payload. Never raises; decoding errors are in :attr:`Extracted.problems`."""
        records: Records = {kind: [] for kind in self._kinds.values()}
        try:
            containers = self._codec.decode_containers(payload)
        except DecodeError as error:
            return self._salvage(payload, error, records)
        ##= VD-RX-04
        self._collect(containers, 0, records)
        return Extracted(records)

    def _salvage(self, payload: bytes, error: DecodeError, records: Records) -> Extracted:
        """Return the records that the policy for receive errors keeps of a payload with an error (X34)."""
        problems: list[Problem] = []
        start = 0
        while True:
            problems.append(error.problem.moved(start))
            ##= VD-RX-05 VD-RX-07
            if self._policy == "drop-payload":
                break
            partial: tuple[Container, ...] = error.partial or ()
            bad = self._collect(partial, start, records)
            ##= VD-RX-11
            if self._policy == "keep-prefix":
                # After an error in the header of a container none of its records can be decoded.
                if len(error.indices) > 1:
                    container = self._codec.decode_leading_records(payload, bad, error.indices[1])
                    self._collect((container,) if container else (), bad, records)
                break
            ##= VD-RX-06
            # The end of an invalid container is unknown: an unknown type has records of unknown size, and a truncated
            # record is the last of the payload. The exception is a container without records: the next one follows
            # its header.
            if error.problem.reason != "zero-count":
                break
            ##= VD-RX-10
            start = bad + self._sizes.ic_header
            try:
                self._collect(self._codec.decode_containers(payload[start:]), start, records)
                break
            except DecodeError as further:
                error = further
        return Extracted(records, tuple(problems))

    def _collect(
        self,
        containers: tuple[Container, ...],
        offset: int,
        records: Records,
    ) -> int:
        """Add the records of ``containers`` to ``records``; returns the offset of the end of the containers.

        ``offset`` is the start of the first container. Offsets are in octets from the start of the payload.
        """
        sizes = self._sizes
        for container in containers:
            ##= VD-RX-02 VD-RX-03
            kind = self._kinds[container.ic_type]
            offset += sizes.ic_header
            ##= VD-RX-09
            found, listed = records[kind], container.records
            if (size := sizes.fixed[kind]) is not None:
                found.extend(zip(count(offset, size), listed, strict=False))
                offset += size * len(listed)
                continue
            for record in listed:
                found.append((offset, record))
                offset += sizes.record(record)
        return offset
