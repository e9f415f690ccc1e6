"""Variable identifiers of a run: the state of each in the implementation's database since its last reset.

Without a reset between cases, a variable of an earlier case may still be in the database: since 2.0 deleted variables
remain there for good, up to 1.3 they are removed with their last VarDelete. A case that needs an unknown variable must
not get the identifier of such a variable: it would fail because of an earlier case.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

#: Number of beacons without a record of a deleted variable after which, up to 1.3, it counts as removed.
_QUIET = 8
#: Number of beacons after a reset that may still have been composed before it.
_STALE = 3
#: Number of resets after which an identifier must turn up by itself to count as an application's, although the tester
#: has handed it out before.
_SHOWN = 2
#: One of this many identifiers is reserved for variables that remain unknown: probes, requests, summaries.
_KEPT = 4


@dataclass(slots=True)
class _Use:
    """An identifier that the database may hold."""

    peers_only: bool = True
    """Whether only peers of the tester have created it: then a later creationTime of a peer certainly replaces it."""
    newest: int | None = None
    """The latest creationTime in a VarCreate of the tester; None if the tester has sent none."""
    leaves: int | None = None
    """The time in ns by which the last VarDelete was sent and, up to 1.3, the variable was removed; None if it was not
    deleted."""
    confirmed: bool = False
    """Whether the implementation has sent a VarDelete for it since the last creation."""
    beacons: int = 0
    """Number of beacons received since the deletion."""


class IdentifierPool:
    """The identifiers from ``first`` to ``last``. Times are ns of any one clock.

    ``leave``: deleted variables are removed from the database (up to 1.3). ``timed``: variables have a creationTime,
    with which a peer can create a deleted one again (since 2.0). ``kept``: identifiers that are not handed out, for
    cases that test these values. ``capacity``: the number of variables that the database can hold; None: unlimited. A
    full database requests no unknown variable (X43), so that then none is handed out.
    """

    def __init__(
        self,
        first: int,
        last: int,
        *,
        leave: bool,
        timed: bool,
        kept: Collection[int] = frozenset(),
        capacity: int | None = None,
    ) -> None:
        self.first = first
        self.size = last - first + 1
        self._leave = leave
        self._timed = timed
        self._uses: dict[int, _Use] = {}
        self._kept = frozenset(kept)
        self._capacity = capacity
        self.in_use: Callable[[], Iterable[int]] = frozenset
        """The identifiers used by the other cases that are being executed at this moment."""
        self.foreign: set[int] = set()
        """Variables that the implementation has without a request or frame of the tester: of an application."""
        self._beacons = 0
        """Number of beacons since the last reset."""
        self._unasked: Counter[int] = Counter()
        """By identifier that was handed out: the number of resets after which the implementation created the variable
        although the tester had not asked for it."""
        self._handed: set[int] = set()
        """The identifiers that were handed out."""
        self._next_unknown = 0
        self._next_for_peers = 0

    def forget(self) -> None:
        """Record a reset of the implementation: its database is empty. The order of identifiers continues."""
        self._uses.clear()
        self._beacons = 0

    # -- events --------------------------------------------------------------------------------------------------------

    def offered(self, var_id: int, creation_time: int | None = None, *, by_peer: bool = True) -> None:
        """Record that a variable may have been created, by a VarCreate with this creationTime or by RTDB-Create.

        ``by_peer``: by a peer of the tester, and by no other node.
        """
        use = self._uses.setdefault(var_id, _Use())
        use.peers_only = use.peers_only and by_peer
        if creation_time is not None:
            use.newest = creation_time if use.newest is None else max(use.newest, creation_time)
        use.leaves, use.confirmed = None, False

    def deleted(self, var_id: int, leaves: int) -> None:
        """Record that the tester has deleted a variable; ``leaves``: the time by which the last VarDelete was sent."""
        use = self._uses.get(var_id)
        if use is not None and not use.confirmed:
            use.leaves, use.beacons = leaves, 0

    def heard(self, alive: Iterable[int], deleted: Iterable[int], leaves: int, produced: Collection[int] = ()) -> None:
        """Take a beacon of the implementation into account.

        ``alive``: variables that its database must hold to send the beacon. ``deleted``: variables with a VarDelete.
        ``leaves``: the time by which the last repetition was sent. ``produced``: variables with a VarCreate that names
        the implementation as their producer.
        """
        self._beacons += 1
        if self._leave:
            for use in self._uses.values():
                use.beacons += 1
        for var_id in alive:
            if var_id not in self._uses and var_id not in self._kept:
                self._unasked[var_id] += var_id in produced and self._beacons > _STALE
                if var_id not in self._handed or self._unasked[var_id] >= _SHOWN:
                    self.foreign.add(var_id)
            self.offered(var_id, by_peer=var_id in self._uses)
        for var_id in deleted:
            use = self._uses.setdefault(var_id, _Use(peers_only=False))
            use.leaves, use.confirmed, use.beacons = leaves, True, 0

    # -- free identifiers ----------------------------------------------------------------------------------------------

    def is_unknown(self, var_id: int, now: int) -> bool:
        """Return whether the database cannot hold the variable."""
        use = self._uses.get(var_id)
        if use is None:
            return True
        if not self._leave or use.leaves is None or now < use.leaves:
            return False
        # Without a VarDelete, it did not exist, or the request was lost: then its summaries continue.
        if not use.confirmed and use.beacons < _QUIET:
            return False
        del self._uses[var_id]
        return True

    def unknown(self, count: int, now: int, without: Collection[int] = ()) -> list[int]:
        """Return ``count`` identifiers that the database cannot hold, the least recently returned first; fewer if there
        are not enough.

        They remain unknown until a variable is created with them.
        """
        found: list[int] = []
        without = {*without, *self.in_use()}
        count = min(count, self._room(now, without))
        for _ in range(self.size):
            if len(found) == count:
                break
            var_id = self.first + self.size - 1 - self._next_unknown % self.size
            self._next_unknown += 1
            if var_id not in without and not self._reserved(var_id) and self.is_unknown(var_id, now):
                found.append(var_id)
        self._handed.update(found)
        return found

    def _reserved(self, var_id: int) -> bool:
        return var_id in self._kept or var_id in self.foreign

    def left(self, now: int, without: Collection[int] = ()) -> int:
        """Return the number of identifiers that the database cannot hold, without the kept ones."""
        # Only used identifiers are checked one by one: there are hundreds of others, and this is called often.
        taken = {*self._kept, *self.foreign, *without, *self.in_use()}
        taken.update([each for each in tuple(self._uses) if each not in taken and not self.is_unknown(each, now)])
        every = range(self.first, self.first + self.size)
        left = self.size - sum(each in every for each in taken)
        return left if self._capacity is None else min(left, self._room(now, without))

    def _room(self, now: int, without: Collection[int] = ()) -> int:
        """Return the number of variables for which the database has room, in addition to those ``without``."""
        if self._capacity is None:
            return self.size
        known = {each for each in tuple(self._uses) if not self.is_unknown(each, now)}
        return max(0, self._capacity - len(known.union(without, self.in_use())))

    @property
    def reserve(self) -> int:
        """The number of identifiers that are left for the probes of other cases."""
        return min(self.size, self._capacity or self.size) // _KEPT

    def for_own(self, now: int, without: Collection[int] = ()) -> int | None:
        """Return an unknown identifier for a new variable; None if the remaining ones are reserved."""
        if self.left(now, without) <= self.reserve:
            return None
        return next(iter(self.unknown(1, now, without)), None)

    def for_peer(
        self, now: int, creation_time: int, without: Collection[int] = (), *, reuse: bool = True
    ) -> int | None:
        """Return an identifier that a peer can create with this creationTime; None if there is none.

        Since 2.0, identifiers of earlier variables of peers are used again, to save unknown ones. ``reuse`` False:
        only identifiers that the database cannot hold, as for the node's own variables. An implementation that
        compares creation times wrongly may mistake a variable that is created again for the old one.
        """
        if not reuse:
            return self.for_own(now, without)
        without = {*without, *self.in_use()}
        full = not self._room(now, without)
        shared = self.size // 2 if self._timed and self.size >= 2 * _KEPT else self.size
        # Beacons may still have records of the last case's variables: their identifiers are used only if no others are
        # left.
        for settled in (True, False):
            for step in range(shared):
                var_id = self.first + (self._next_for_peers + step) % shared
                if var_id in without or self._reserved(var_id):
                    continue
                if full and self.is_unknown(var_id, now):
                    continue
                if self._can_be_created(var_id, now, creation_time, settled=settled):
                    self._next_for_peers += step + 1
                    self._handed.add(var_id)
                    return var_id
        return None

    def _can_be_created(self, var_id: int, now: int, creation_time: int, *, settled: bool) -> bool:
        if self.is_unknown(var_id, now):
            return True
        use = self._uses[var_id]
        if settled and (use.leaves is None or use.leaves > now):
            return False
        return self._timed and use.peers_only and (use.newest is None or use.newest < creation_time)
