"""Variable identifiers: what the implementation's database may hold of each since its last reset, and which are free.

Without a reset between cases, a variable of an earlier case may still be in the database: since 2.0 deleted variables
stay there for good, up to 1.3 they leave it with their last VarDelete. A case that needs an unknown variable must not
be given the identifier of such a variable, or it would blame the implementation for what an earlier case has done.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

#: Beacons without any record of a deleted variable after which, up to 1.3, it counts as gone from the database.
_QUIET = 8
#: The share of the identifiers that is kept for what must be unknown and stays so: probes, requests, summaries.
_KEPT = 4


@dataclass(slots=True)
class _Use:
    """An identifier that the database may hold."""

    peers_only: bool = True
    """Whether only peers of the tester have created it: a later creationTime of a peer replaces it for certain."""
    newest: int | None = None
    """The latest creationTime that the tester has sent for it; None if there was none."""
    leaves: int | None = None
    """If it was deleted: the time in ns when the last VarDelete is over, and when, up to 1.3, it has left."""
    confirmed: bool = False
    """Whether the implementation has sent a VarDelete for it since."""
    beacons: int = 0
    """Beacons since the deletion."""


class Identifiers:
    """The identifiers from ``first`` to ``last``. Times are ns of any one clock.

    ``leave``: deleted variables leave the database (up to 1.3). ``timed``: variables have a creationTime, with which a
    peer can create a deleted one again (since 2.0). ``kept``: identifiers that are given to nobody, for cases that try
    just these.
    """

    def __init__(self, first: int, last: int, *, leave: bool, timed: bool, kept: Collection[int] = frozenset()) -> None:
        self.first = first
        self.size = last - first + 1
        self._leave = leave
        self._timed = timed
        self._uses: dict[int, _Use] = {}
        self._kept = frozenset(kept)
        self.in_use: Callable[[], Iterable[int]] = frozenset
        """The identifiers of the cases that are being executed at this moment, beside the one that asks."""
        self._next_unknown = 0
        self._next_for_peers = 0

    def forget(self) -> None:
        """The implementation was reset: its database is empty. The order in which identifiers are given goes on."""
        self._uses.clear()

    # -- what happens --------------------------------------------------------------------------------------------------

    def offered(self, var_id: int, creation_time: int | None = None, *, by_peer: bool = True) -> None:
        """Note that the variable may have been created: by a VarCreate with this creationTime, or by RTDB-Create.

        ``by_peer``: a station of the tester's, and nobody else.
        """
        use = self._uses.setdefault(var_id, _Use())
        use.peers_only = use.peers_only and by_peer
        if creation_time is not None:
            use.newest = creation_time if use.newest is None else max(use.newest, creation_time)
        use.leaves, use.confirmed = None, False

    def deleted(self, var_id: int, leaves: int) -> None:
        """Note that the tester has asked for the deletion; ``leaves``: when the last VarDelete, if heard, is over."""
        use = self._uses.get(var_id)
        if use is not None and not use.confirmed:
            use.leaves, use.beacons = leaves, 0

    def heard(self, alive: Iterable[int], deleted: Iterable[int], leaves: int) -> None:
        """Note a beacon of the implementation; ``alive``: variables that its database must hold to send it.

        ``deleted``: those with a VarDelete; ``leaves``: when the last repetition is over if this was not the last.
        """
        if self._leave:
            for use in self._uses.values():
                use.beacons += 1
        for var_id in alive:
            self.offered(var_id, by_peer=var_id in self._uses)
        for var_id in deleted:
            use = self._uses.setdefault(var_id, _Use(peers_only=False))
            use.leaves, use.confirmed, use.beacons = leaves, True, 0

    # -- what is free --------------------------------------------------------------------------------------------------

    def is_unknown(self, var_id: int, now: int) -> bool:
        """Whether the database cannot hold the variable."""
        use = self._uses.get(var_id)
        if use is None:
            return True
        if not self._leave or use.leaves is None or now < use.leaves:
            return False
        # Without a VarDelete it was not there at all, or the request was lost: then its summaries go on.
        if not use.confirmed and use.beacons < _QUIET:
            return False
        del self._uses[var_id]
        return True

    def unknown(self, count: int, now: int, without: Collection[int] = ()) -> list[int]:
        """Identifiers that the database cannot hold, those given least recently first; fewer if there are not enough.

        They stay unknown unless somebody creates them.
        """
        found: list[int] = []
        without = {*without, *self.in_use()}
        for _ in range(self.size):
            if len(found) == count:
                break
            var_id = self.first + self.size - 1 - self._next_unknown % self.size
            self._next_unknown += 1
            if var_id not in without and var_id not in self._kept and self.is_unknown(var_id, now):
                found.append(var_id)
        return found

    def left(self, now: int, without: Collection[int] = ()) -> int:
        """How many identifiers are unknown to the database, but for those that are kept."""
        # Those that nobody has used are not asked one by one: there are hundreds, and this is asked for often.
        taken = {*self._kept, *without, *self.in_use()}
        taken.update([each for each in tuple(self._uses) if each not in taken and not self.is_unknown(each, now)])
        every = self._all()
        return self.size - sum(each in every for each in taken)

    def for_own(self, now: int, without: Collection[int] = ()) -> int | None:
        """An unknown identifier that is going to be created; None if those left are kept for what stays unknown."""
        if self.left(now, without) <= self.size // _KEPT:
            return None
        return next(iter(self.unknown(1, now, without)), None)

    def for_peer(
        self, now: int, creation_time: int, without: Collection[int] = (), *, reuse: bool = True
    ) -> int | None:
        """An identifier that a peer can create with this creationTime; None if there is none.

        Since 2.0 those are used again that peers have created before, so that the unknown ones last. ``reuse`` False:
        only identifiers that the database cannot hold, as for a variable of the implementation's own. A receiver with
        a fault in its creation times may take a variable that is created again for an old one.
        """
        if not reuse:
            return self.for_own(now, without)
        without = {*without, *self.in_use()}
        shared = self.size // 2 if self._timed and self.size >= 2 * _KEPT else self.size
        # An earlier case may still be on the air with the last ones: those are given only if there are no others.
        for settled in (True, False):
            for step in range(shared):
                var_id = self.first + (self._next_for_peers + step) % shared
                if var_id in without or var_id in self._kept:
                    continue
                if self._can_be_created(var_id, now, creation_time, settled=settled):
                    self._next_for_peers += step + 1
                    return var_id
        return None

    def _can_be_created(self, var_id: int, now: int, creation_time: int, *, settled: bool) -> bool:
        if self.is_unknown(var_id, now):
            return True
        use = self._uses[var_id]
        if settled and (use.leaves is None or use.leaves > now):
            return False
        return self._timed and use.peers_only and (use.newest is None or use.newest < creation_time)

    def _all(self) -> range:
        return range(self.first, self.first + self.size)
