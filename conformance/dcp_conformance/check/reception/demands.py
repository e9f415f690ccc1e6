"""Records that demand a reaction, and the nodes that owe it if they hear the record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from dcp_conformance.check.base import Context
from dcp_conformance.check.statements import ASK_CREATE, ASK_UPDATE, CREATE, DELETE, SUMMARY, UPDATE
from dcp_conformance.definitions.circular import Circle

from .following import Kind, Population, Station, Variable


class Demands:
    """The reactions that the specification demands (dcp-vardis.md, processing of received records)."""

    def __init__(self, context: Context, circle: Circle, nodes: Population, by_bit: Mapping[int, Station]) -> None:
        """``circle``: compares sequence numbers of variables. ``nodes``, ``by_bit``: the nodes that are followed."""
        self._newer, self._modulus = circle.newer, circle.modulus
        self._nodes = nodes
        self._by_bit = by_bit
        self._times = context.features.creation_time
        self._asks_on = context.profile.spec_version >= "1.1"
        """Whether a node that hears a request for an unknown variable must request it, too (VD-RC-01, VD-RU-01)."""

    def of(self, variable: Variable, kind: int, record: Any, speaker: int) -> list[tuple[Kind, int]]:
        """Return the reactions that a record demands from the nodes that hear it, each with a mask of these nodes.

        ``speaker``: the bit of its sender.
        """
        others = self._nodes.listeners & ~speaker
        known = variable.known & others
        found: list[tuple[Kind, int]] = []
        if kind is SUMMARY or kind is UPDATE or kind is CREATE:
            number = record.upd.seqno if kind is CREATE else record.seqno
            holders = variable.holders
            if len(holders) == 1 and number in holders and variable.known.bit_count() >= self._nodes.count:
                return found
            if speaker & variable.produced:
                self._compare(variable, number)
            may = known & ~(variable.produced | variable.apart)
            if not variable.producers:
                may = known & ~variable.introducers if variable.introducers else 0
            if may and kind is not CREATE:
                behind = ahead = 0
                for has, whom in holders.items():
                    if has != number and (whom := whom & may):
                        # As Circle.newer, without the calls.
                        step = (number - has) % self._modulus
                        if 2 * step < self._modulus:
                            behind |= whom
                        elif 2 * step > self._modulus:
                            ahead |= whom
                if behind:
                    found.append((Kind.TAKE_UPDATE if kind is UPDATE else Kind.ASK_UPDATE, behind))
                if ahead:
                    found.append((Kind.TEACH, ahead))
        elif kind is ASK_CREATE:
            if known:
                found.append((Kind.ANSWER_CREATE, known))
        elif not variable.known:
            return found
        elif kind is DELETE:
            may = known & ~(variable.produced | variable.apart)
            if variable.producers and may:
                found.append((Kind.TAKE_DELETE, may))
        else:
            newer = self._newer
            ahead = sum(whom & others for has, whom in variable.holders.items() if newer(has, record.seqno))
            if ahead:
                found.append((Kind.ANSWER_UPDATE, ahead))
        unknown = others & ~variable.known & ~variable.produced
        if unknown and kind is not DELETE:
            found += self._of_unknown(variable, kind, record, unknown)
        return found

    def _compare(self, variable: Variable, number: int) -> None:
        """Find the nodes with a newer number than ``number``, which a producer states: they have it from another one.

        If a create of such a node has not shown that it is a consumer, it may be the other producer, which must not
        react as a consumer does.
        """
        doubtful = variable.known & ~(variable.produced | variable.consumers | variable.apart)
        if doubtful:
            for has, whom in variable.holders.items():
                if whom & doubtful and has != number and self._newer(has, number):
                    variable.apart |= whom & doubtful

    def _of_unknown(self, variable: Variable, kind: int, record: Any, whom: int) -> Iterator[tuple[Kind, int]]:
        """Yield the reactions due from the nodes in ``whom``, which do not hold the variable."""
        if (kind is ASK_CREATE or kind is ASK_UPDATE) and not self._asks_on:
            return
        had = whom & variable.deleted
        if had and kind is CREATE and self._times:
            # A node that has deleted the variable need not request it, and accepts only a later creation.
            later, created = 0, record.spec.creation_time
            while had:
                bit = had & -had
                had ^= bit
                if created > self._by_bit[bit].had[variable.var_id]:
                    later |= bit
            if later:
                yield Kind.TAKE_CREATE, later
        whom &= ~variable.deleted
        if not variable.born:
            # These nodes may have deleted the variable before the recording began.
            whom &= ~self._nodes.early
        if whom:
            yield Kind.TAKE_CREATE if kind is CREATE else Kind.ASK_CREATE, whom
