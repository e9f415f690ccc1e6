"""What VarDis has to know about octets: sizes of records, limits of fields, and extracting a received payload.

Layouts are the codec's business; the sizes here are sums over the widths that the profile states (DATA-02).
"""

from __future__ import annotations

import re
from typing import Any, Final

import msgspec
from dcp_spec.constants import ICType, seqno_modulus
from dcp_spec.profile import IntType, Profile, TextType

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, Problem
from dcp_codec.values import Container, VarCreate, VarSpec, VarUpdate

from .config import NodeConfig


def _largest(layout: IntType) -> int:
    bits = 8 * layout.width - layout.signed
    return (1 << bits) - 1


def _overhead(layout: TextType) -> int:
    return sum(length.width for length in layout.lengths) + layout.terminated


def _longest(layout: TextType) -> int | None:
    return min((_largest(length) for length in layout.lengths), default=None)


class RecordSizes:
    """Sizes on the wire in octets, and the ranges of fields that applications fill."""

    def __init__(self, profile: Profile) -> None:
        types, layout = profile.types, profile.vardis
        self.ic_header = 2 + sum(extra.extra.width for extra in layout.container_extra)
        self.ic_header += layout.list_length.width if layout.list_length is not None else 0
        self.var_id = types.var_id.width
        self.var_summ = self.var_id + types.var_seqno.width
        self._update = self.var_summ + _overhead(types.value)
        node_id = types.node_id
        self._id_varies = node_id.length is not None
        widths = {
            "varId": self.var_id,
            "prodId": node_id.length.width if node_id.length is not None else node_id.width,
            "repCnt": types.var_rep_cnt.width,
            "creationTime": types.timestamp.width,
            "timeout": types.var_timeout.width,
            "descr": _overhead(types.string),
        }
        self._spec = sum(widths[name] for name in layout.var_spec)
        self.node_id_width = None if self._id_varies else node_id.width
        self.highest_var_id = _largest(types.var_id)
        self.highest_rep_cnt = _largest(types.var_rep_cnt)
        self.highest_timeout = _largest(types.var_timeout)
        self.longest_value = _longest(types.value)
        self.longest_description = _longest(types.string)
        self.nul_terminated = types.string.terminated
        self.highest_stamp = _largest(types.timestamp.as_int())
        ##= VD-TYP-03
        self.seqno_modulus = seqno_modulus(types.var_seqno.width)

    def update(self, value: bytes) -> int:
        """A VarUpdate with this value."""
        return self._update + len(value)

    def create(self, spec: VarSpec, value: bytes) -> int:
        """A VarCreate of a variable with this value."""
        producer = len(spec.prod_id) if self._id_varies else 0
        return self._spec + producer + len(spec.descr) + self._update + len(value)

    def record(self, kind: ICType, record: Any) -> int:
        """Any decoded record."""
        if kind is ICType.CREATE_VARIABLES:
            create: VarCreate = record
            return self.create(create.spec, create.upd.value)
        if kind is ICType.UPDATES:
            update: VarUpdate = record
            return self.update(update.value)
        return self.var_id if kind in _BARE else self.var_summ


#: Going through an enumeration takes longer than through a tuple.
_KINDS: Final = tuple(ICType)
_BARE: Final = frozenset({ICType.DELETE_VARIABLES, ICType.REQUEST_VARCREATES})


class Extracted(msgspec.Struct, frozen=True):
    """A payload taken apart: records of each type in the order of the payload, each with its offset there."""

    records: dict[ICType, list[tuple[int, Any]]]
    problems: tuple[Problem, ...] = ()


#: Which record of which container a problem lies in.
_PLACE: Final = re.compile(r"\[(\d+)\]\.records\[(\d+)\]")


class Extractor:
    """The extraction step of the receive path: octets to records, before anything is looked up or changed."""

    def __init__(self, config: NodeConfig, sizes: RecordSizes) -> None:
        self._codec: Codec = config.codec
        self._sizes = sizes
        self._policy = _receive_error_policy(config)
        numbers = config.profile.vardis.container_types.by_name()
        self._kinds = {numbers[kind.label]: kind for kind in ICType}
        self._list_length = config.profile.vardis.list_length is not None

    def extract(self, payload: bytes) -> Extracted:
        """The records to process. Never raises; what is not a record is in ``problems``."""
        ##= VD-RX-01
        ##= VD-RX-02
        ##= VD-RX-03
        ##= VD-RX-04
        records: dict[ICType, list[tuple[int, Any]]] = {kind: [] for kind in _KINDS}
        try:
            containers = self._codec.decode_containers(payload)
        except DecodeError as error:
            return self._salvage(payload, error, records)
        self._collect(containers, 0, records)
        return Extracted(records)

    def _salvage(self, payload: bytes, error: DecodeError, records: dict[ICType, list[tuple[int, Any]]]) -> Extracted:
        """What the policy keeps of a payload with an error in it."""
        ##= VD-RX-05
        ##= VD-RX-06
        ##= VD-RX-07
        problems: list[Problem] = []
        start = 0
        while True:
            problems.append(error.problem.moved(start))
            if self._policy == "drop-payload":
                break
            partial: tuple[Container, ...] = error.partial or ()
            bad = self._collect(partial, start, records)
            if self._policy == "keep-prefix":
                self._collect(self._complete_records(payload[start:], error, bad - start), bad, records)
                break
            # Behind the header of a container without records the next one starts. Of any other bad container the
            # end is not known: types tell sizes, and a record that is cut off is the last.
            if error.problem.reason != "zero-count":
                break
            start = bad + self._sizes.ic_header
            try:
                self._collect(self._codec.decode_containers(payload[start:]), start, records)
                break
            except DecodeError as further:
                error = further
        return Extracted(records, tuple(problems))

    def _complete_records(self, payload: bytes, error: DecodeError, bad: int) -> tuple[Container, ...]:
        """The containers up to the error, the last of them with only the records in front of it.

        The strict decoder reports whole containers. Told that the bad one has only as many records as are complete,
        it reports those, too, and stumbles over the rest, which is dropped anyway.
        """
        place = _PLACE.match(error.problem.path)
        if place is None or place[2] == "0" or self._list_length:
            return ()
        shortened = payload[: bad + 1] + bytes([int(place[2])]) + payload[bad + 2 :]
        try:
            found = self._codec.decode_containers(shortened)
        except DecodeError as rest:
            found = rest.partial or ()
        return found[int(place[1]) : int(place[1]) + 1]

    def _collect(
        self,
        containers: tuple[Container, ...],
        offset: int,
        records: dict[ICType, list[tuple[int, Any]]],
    ) -> int:
        """Sort the records of ``containers`` that start at ``offset``; returns the offset behind them."""
        size_of = self._sizes.record
        for container in containers:
            kind = self._kinds[container.ic_type]
            offset += self._sizes.ic_header
            found = records[kind]
            ##= VD-RX-09
            for record in container.records:
                found.append((offset, record))
                offset += size_of(kind, record)
        return offset


def _receive_error_policy(config: NodeConfig) -> str:
    """Reading X34 if it was chosen, otherwise what the profile says of its implementation."""
    if "X34" in config.readings:
        return config.reading("X34")
    policy = config.profile.behaviour.vardis_receive_error
    return "skip-container" if policy == "skip-element" else policy
