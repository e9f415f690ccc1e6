"""The variables of a recording: whether all that is said of an identifier is said of one and the same variable.

Updates and summaries carry an identifier and a number, and not which creation of the variable they are about. Where an
identifier has been used twice (created again, by two nodes, after a restart), nodes may rightly have different things
under one number, and pass them on (hazards H3 to H6). Only of a variable with a single life in the recording it is
certain that all nodes must say the same.
"""

from __future__ import annotations

from dataclasses import dataclass

from dcp_spec.constants import ICType

from dcp_codec.values import VarSpec

from .senders import Senders
from .statements import Statement


@dataclass(slots=True)
class Lifetime:
    """What is known of one identifier."""

    producer: bytes | None = None
    spec: VarSpec | None = None
    first: Statement | None = None
    """Its producer's first create, if nobody had spoken of it before."""
    producer_life: int = 0
    mixed: bool = False
    """There was another life, or may have been."""


class Lifetimes:
    """All variables of a recording."""

    def __init__(self, senders: Senders, most: int, *, creation_time: bool) -> None:
        self._senders = senders
        self._most = most
        self._creation_time = creation_time
        self._known: dict[int, Lifetime] = {}

    def feed(self, said: Statement) -> None:
        """Something is said of a variable."""
        life = self._known.get(said.var_id)
        create = said.record if said.kind is ICType.CREATE_VARIABLES else None
        if life is None:
            if len(self._known) >= self._most:
                return
            life = self._known[said.var_id] = Lifetime()
            if create is not None and create.spec.prod_id == said.sender and create.upd.seqno == 0:
                life.first = said
        if create is not None:
            if life.spec is None:
                life.spec, life.producer = create.spec, create.spec.prod_id
                life.producer_life = self._senders.life(create.spec.prod_id)
            elif self._another(life.spec, create.spec, said.sender):
                life.mixed = True
        elif said.kind is ICType.DELETE_VARIABLES:
            # It may come back, and not all nodes need have heard that it had gone.
            life.mixed = True

    def _another(self, known: VarSpec, spec: VarSpec, sender: bytes) -> bool:
        if spec.prod_id != known.prod_id:
            return True
        if self._creation_time:
            return spec.creation_time != known.creation_time
        return spec != known and sender == spec.prod_id

    def producer(self, var_id: int) -> bytes | None:
        """Who produces a variable, as it was first said."""
        life = self._known.get(var_id)
        return None if life is None else life.producer

    def first(self, var_id: int) -> tuple[int, Statement] | None:
        """When its producer created a variable of which nobody had spoken before, in ns since 1970, and the record."""
        life = self._known.get(var_id)
        return None if life is None or life.first is None else (life.first.time, life.first)

    def born(self, var_id: int) -> int | None:
        """When a variable was created of which the recording shows the only life so far, from its beginning.

        None for all others: its producer has been restarted, or beacons of it are missing, or it was deleted; then
        there may be another life.
        """
        life = self._known.get(var_id)
        if life is None or life.first is None or life.mixed or life.producer is None:
            return None
        begin = life.first.time
        if life.producer_life != self._senders.life(life.producer) or not self._senders.unbroken(life.producer, begin):
            return None
        return begin
