"""Unused identifiers of nodes and variables for one case."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn, Protocol

from dcp_conformance.test_system.judgement.verdicts import Verdicts
from dcp_conformance.test_system.steps import Clock
from dcp_conformance.test_system.sut_properties import SutProperties

from .pool import IdentifierPool


class RunIdentifiers(Protocol):
    """The identifiers that a run has used so far."""

    identifier_pool: IdentifierPool
    boundaries: Mapping[str, int]
    sut_id: bytes | None
    sut_address: bytes | None
    renewable: bool
    next_node: int
    creation_time: int


class Identifiers:
    """Supplies one case with identifiers, and knows which variables the case has created."""

    def __init__(
        self, run: RunIdentifiers, clock: Clock, sut: SutProperties, verdicts: Verdicts, created: set[int]
    ) -> None:
        """``created``: the set to which created variables are added."""
        self._run = run
        self._pool = run.identifier_pool
        self._clock = clock
        self._sut = sut
        self._verdicts = verdicts
        self.created = created
        """Identifiers that this case has chosen for variables, or has made a VarCreate for."""
        self.called_unknown: set[int] = set()
        """Identifiers that this case got for variables that remain unknown."""
        self.produced: set[int] = set()
        """Identifiers of the variables that the implementation's application has created."""

    # -- nodes ---------------------------------------------------------------------------------------------------------

    @property
    def sut_id(self) -> bytes:
        """The implementation's node identifier; inconclusive if it is not known yet."""
        if self._run.sut_id is None:
            self._verdicts.inconclusive("the node identifier of the implementation", "no beacon received so far")
        return self._run.sut_id

    def node_id(self) -> bytes:
        """Return the identifier of a node that does not exist: a distant producer, or a neighbour of another node."""
        return self.new_node()[0]

    def new_node(self) -> tuple[bytes, bytes]:
        """Return identifier and link-layer address of a node that this run has not used and that are not the SUT's.

        Raises ``NamesUsedUp`` if identifiers are so short that none is left.
        """
        run, layout = self._run, self._sut.profile.types.node_id
        while True:
            run.next_node += 1
            if layout.representation != "text" and run.next_node >= 1 << (8 * min(layout.width, 3)):
                self.used_up("a node identifier that this run has not used", 0, run.next_node)
            address = _address(run.next_node)
            node_id = layout.of(address)
            if node_id != run.sut_id and address != run.sut_address:
                return node_id, address

    # -- variables -----------------------------------------------------------------------------------------------------

    def var_id(self) -> int:
        """Return an identifier for a variable of a peer: a VarCreate sent now creates it, whatever was there before.

        From 2.0 on it may have been used by peers in earlier cases: a case that needs an unknown variable uses
        :meth:`unknown_id`. Raises ``NamesUsedUp``.
        """
        number = self.spare_var_id()
        if number is None:
            self._no_variables_left("an identifier for a variable of a peer")
        return number

    def spare_var_id(self) -> int | None:
        """Return what :meth:`var_id` does, or None if no identifier is left."""
        run, now = self._run, self._clock.now()
        # Up to 1.3 one range serves both: an identifier used as unknown must not become a variable of the case.
        for without in (self.created | self.called_unknown, self.created):
            number = self._pool.for_peer(now, run.creation_time + 1, without, reuse=not run.renewable)
            if number is not None:
                self.created.add(number)
                return number
        return None

    def var_ids(self, count: int) -> list[int]:
        """Return several identifiers for variables of peers, ascending unless the range ends in between."""
        return [self.var_id() for _ in range(count)]

    def unknown_ids(self, count: int) -> list[int]:
        """Return identifiers that are not in the implementation's database, descending from the top of the range.

        They may have been used before: a variable that is requested but never answered remains unknown. Raises
        ``NamesUsedUp``.
        """
        # Preferably others than this case got before.
        for without in (self.created | self.called_unknown, self.created):
            found = self._pool.unknown(count, self._clock.now(), without)
            if len(found) == count:
                break
        else:
            what = f"{count} identifiers of variables that the implementation does not know"
            self._no_variables_left(what, len(self.created) + count)
        self.called_unknown.update(found)
        return found

    def unknown_id(self) -> int:
        """Return one of :meth:`unknown_ids`."""
        return self.unknown_ids(1)[0]

    def has_unknown_ids(self, count: int = 1) -> bool:
        """Return whether ``count`` identifiers are left that are not in the implementation's database."""
        return self._pool.left(self._clock.now(), self.created) >= count

    def is_applications(self, var_id: int) -> bool:
        """Return whether an identifier is that of an application on the node, by the PIXIT or as observed before."""
        return var_id in self._pool.foreign or not self._pool.first <= var_id < self._pool.first + self._pool.size

    def own_var_id(self) -> int:
        """Return an identifier for one of the node's own variables that was never used before (X20).

        Raises ``NamesUsedUp`` if no more are left than the probes of other cases need.
        """
        for without in (self.created | self.called_unknown, self.created):
            number = self._pool.for_own(self._clock.now(), without)
            if number is not None:
                break
        if number is None:
            expected = "an identifier never used before, for one of the node's own variables"
            self._no_variables_left(expected, len(self.created | self.called_unknown) + 1 + self._pool.reserve)
        self.created.add(number)
        return number

    def boundary_id(self, name: str) -> int:
        """Return a boundary value (``Session.boundaries``) as the identifier of an unknown variable.

        Raises ``NamesUsedUp`` if the implementation may know it.
        """
        number = self._run.boundaries[name]
        taken = number in self.created or number in self._pool.in_use()
        if taken or not self._pool.is_unknown(number, self._clock.now()):
            self._no_variables_left(f"the identifier {number}, never used before")
        self.created.add(number)
        return number

    def offered(self, var_id: int, creation_time: int | None) -> None:
        """Record that a peer may have created a variable of this case with this creationTime."""
        self.created.add(var_id)
        self._pool.offered(var_id, creation_time)

    def created_by_others(self, var_id: int, *, application: bool = False) -> None:
        """Record that the implementation may hold a variable that no peer of the tester has created.

        ``application``: the implementation's application has.
        """
        if application:
            self.produced.add(var_id)
        self._pool.offered(var_id, by_peer=False)

    def departure(self) -> int:
        """Return the time in ns by which, up to 1.3, a variable deleted now is removed from the database."""
        return self._clock.now() + (self._sut.parameter("VARDISPAR_MAX_REPETITIONS") + 4) * self._sut.period

    # -- none left -----------------------------------------------------------------------------------------------------

    def _no_variables_left(self, expected: str, wanted: int = 0) -> NoReturn:
        """``wanted``: the number of variables that the case needs, if there may be more than it has."""
        # One more is needed for signs of life.
        if why := self._sut.lacks("variables", max(wanted, len(self.created | self.called_unknown) + 1) + 1):
            self._verdicts.not_applicable(f"{why}, and this case needs more")
        self.used_up(expected, self._pool.left(self._clock.now(), self.created), self._pool.size)

    def used_up(self, expected: str, left: int, size: int) -> NoReturn:
        """Stop the case as inconclusive: too many identifiers were used since the last reset."""
        observed = (
            f"identifiers used up: {left} of {size} are left that the implementation cannot know from earlier cases. "
            "A reset frees them: provide UT-Reset, or a command to start it (--start, --restart), or set "
            'reset = "restart" in [pixit]'
        )
        self._verdicts.used_up(expected, observed)


def _address(number: int) -> bytes:
    """Return a locally administered address of the tester: 02:dc:9n:..."""
    return bytes((0x02, 0xDC, 0x90)) + number.to_bytes(3, "big")
