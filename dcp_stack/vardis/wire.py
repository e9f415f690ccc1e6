"""The receive path of VarDis, first phase: a payload is taken apart (dcp-vardis.md, "Extraction Step")."""

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

#: A type of the specification, or the name of one of the profile's own.
ContainerType = ICType | str
#: Records by container type, each with its offset in the payload.
Records = dict[ContainerType, list[tuple[int, Any]]]


class Extracted(msgspec.Struct, frozen=True):
    """A payload taken apart: records of each type in the order of the payload, each with its offset there."""

    records: Records
    problems: tuple[Problem, ...] = ()


class Extractor:
    """The extraction step of the receive path: octets to records, before anything is looked up or changed."""

    def __init__(self, config: NodeConfig, sizes: RecordSizes) -> None:
        self._codec: Codec = config.codec
        self._sizes = sizes
        self._policy = _receive_error_policy(config)
        self._kinds: dict[int, ContainerType] = {number: kind for kind, number in config.container_numbers.items()}
        self._kinds |= {each.number: each.name for each in config.profile.vardis.own_containers}

    def extract(self, payload: bytes) -> Extracted:
        """The records to process. Never raises; what is not a record is in ``problems``."""
        records: Records = {kind: [] for kind in self._kinds.values()}
        try:
            containers = self._codec.decode_containers(payload)
        except DecodeError as error:
            return self._salvage(payload, error, records)
        ##= VD-RX-04
        self._collect(containers, 0, records)
        return Extracted(records)

    def _salvage(self, payload: bytes, error: DecodeError, records: Records) -> Extracted:
        """What the policy keeps of a payload with an error in it."""
        problems: list[Problem] = []
        start = 0
        while True:
            problems.append(error.problem.moved(start))
            ##= VD-RX-05
            ##= VD-RX-07
            if self._policy == "drop-payload":
                break
            partial: tuple[Container, ...] = error.partial or ()
            bad = self._collect(partial, start, records)
            ##= VD-RX-11
            if self._policy == "keep-prefix":
                # What is wrong in the header of a container leaves none of its records.
                if len(error.indices) > 1:
                    container = self._codec.decode_leading_records(payload, bad, error.indices[1])
                    self._collect((container,) if container else (), bad, records)
                break
            ##= VD-RX-06
            # Behind the header of a container without records the next one starts. Of any other bad container the
            # end is not known: types tell sizes, and a record that is cut off is the last.
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
        """Sort the records of ``containers`` that start at ``offset``; returns the offset behind them."""
        sizes = self._sizes
        for container in containers:
            ##= VD-RX-02
            ##= VD-RX-03
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


def _receive_error_policy(config: NodeConfig) -> str:
    """Reading X34 if it was chosen, otherwise what the profile says of its implementation."""
    if "X34" in config.readings:
        return config.reading("X34")
    policy = config.profile.behaviour.vardis_receive_error
    return "skip-container" if policy == "skip-element" else policy
