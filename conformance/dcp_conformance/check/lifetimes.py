"""Lifetimes of variables: whether all records with one identifier in a recording are about one creation of it.

Updates and summaries carry an identifier and a sequence number, but do not name the creation that they belong to. If an
identifier is used several times (created again, created by two nodes, created after a restart), nodes may correctly
hold and forward different values under one number (hazards H3 to H6). Only if a variable has a single lifetime in the
recording, all nodes must agree about it.
"""

from __future__ import annotations

from dataclasses import dataclass

from dcp_spec.constants import ICType

from dcp_codec.values import VarSpec

from .senders import Senders
from .statements import Statement


@dataclass(slots=True)
class Lifetime:
    """The known facts about one variable identifier."""

    producer: bytes | None = None
    spec: VarSpec | None = None
    first: Statement | None = None
    """The producer's first create, if it was the first record about the identifier."""
    producer_life: int = 0
    """Number of the producer's restarts (:meth:`Senders.life`) when its create was first heard."""
    mixed: bool = False
    """Whether the identifier has had, or may have had, another lifetime."""


class Lifetimes:
    """The lifetimes of all variables of a recording."""

    def __init__(self, senders: Senders, most: int, *, creation_time: bool) -> None:
        self._senders = senders
        self._most = most
        self._creation_time = creation_time
        self._known: dict[int, Lifetime] = {}

    def feed(self, statement: Statement) -> None:
        """Process a record about a variable."""
        life = self._known.get(statement.var_id)
        create = statement.record if statement.kind is ICType.CREATE_VARIABLES else None
        if life is None:
            if len(self._known) >= self._most:
                return
            life = self._known[statement.var_id] = Lifetime()
            if create is not None and create.spec.prod_id == statement.sender and create.upd.seqno == 0:
                life.first = statement
        if create is not None:
            if life.spec is None:
                life.spec, life.producer = create.spec, create.spec.prod_id
                life.producer_life = self._senders.life(create.spec.prod_id)
            elif self._another(life.spec, create.spec, statement.sender):
                life.mixed = True
        elif statement.kind is ICType.DELETE_VARIABLES:
            # It may be created again, and some nodes may have missed the delete.
            life.mixed = True

    def _another(self, known: VarSpec, spec: VarSpec, sender: bytes) -> bool:
        """Whether a create (with ``spec``, from ``sender``) is about another creation than the known one."""
        if spec.prod_id != known.prod_id:
            return True
        if self._creation_time:
            return spec.creation_time != known.creation_time
        return spec != known and sender == spec.prod_id

    def first(self, var_id: int) -> tuple[int, Statement] | None:
        """Return time (ns since 1970) and record of the producer's create if it was the variable's first record."""
        life = self._known.get(var_id)
        return None if life is None or life.first is None else (life.first.time, life.first)

    def born(self, var_id: int) -> int | None:
        """Return the creation time (ns since 1970) of a variable whose only lifetime the recording shows completely.

        None if another lifetime is possible: the producer was restarted, beacons of it are missing, the variable was
        deleted, or its creation was not recorded.
        """
        life = self._known.get(var_id)
        if life is None or life.first is None or life.mixed or life.producer is None:
            return None
        begin = life.first.time
        if life.producer_life != self._senders.life(life.producer) or not self._senders.unbroken(life.producer, begin):
            return None
        return begin
