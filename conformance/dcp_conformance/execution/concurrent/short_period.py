"""Shorten the beacon period of the implementation for cases whose verdict does not depend on it.

Most of the time of a run is spent in waits of some beacon periods. An upper tester with BP-SetParameter can shorten the
period, and with it these waits. The reactions that a node must show do not depend on the period. With the short period
only an undisturbed pass counts; every other case is repeated with the configured period.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from dcp_conformance.definitions.case import Case
from dcp_conformance.errors import ConformanceError
from dcp_conformance.interconnection.reaction import measure
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.session import FLOOR

if TYPE_CHECKING:
    from dcp_conformance.test_system.session import Session

PERIOD: Final = "BPPAR_BEACON_PERIOD"
#: Divisors of the configured period; the first one at which the implementation still reacts in time is used.
FACTORS: Final = (4, 2)
#: Minimum of the short period in ms: with shorter ones, delays of a busy machine would affect verdicts.
_LEAST: Final = 20
#: Maximum reaction time at the short period, in beacon periods; with longer ones, little time would be saved.
_SLOWEST: Final = 2 * FLOOR
#: An interval below this share of the configured period shows that the implementation uses the short one.
_SHORTER: Final = 0.75


class ShortPeriod:
    """Sets the short beacon period of one session, sets it again after each reset, and restores the configured one."""

    def __init__(self, session: Session, case: Case) -> None:
        """``case``: the case of the measurement of the reaction time."""
        self._session = session
        self._case = case
        self._configured: Any = None
        self._reaction = self._short_reaction = session.known.reaction
        self.milliseconds = 0
        """The short period in ms."""

    def begin(self, reset: Callable[[], object]) -> bool:
        """Shorten the period if the implementation demonstrably uses it and still reacts in time.

        ``reset`` brings the implementation into its initial state. Return whether the short period is in force.
        """
        session = self._session
        upper, reported = session.upper, session.parameters.get(PERIOD)
        configured = session.pics.pixit.beacon_period_ms
        if upper is None or not {"BP-SetParameter", "UT-Reset"} <= upper.methods or reported != configured:
            return False
        self._configured, self._reaction = reported, session.known.reaction
        return any(self._try(int(configured / factor), reset) for factor in FACTORS)

    def _try(self, milliseconds: int, reset: Callable[[], object]) -> bool:
        if milliseconds < _LEAST:
            return False
        session, configured = self._session, self._configured
        self.milliseconds = milliseconds
        try:
            reset()
            if not self.renew():
                return False
            session.short_period = self
            session.parameters[PERIOD] = self.milliseconds
            session.passive.another_period(True)
            bench = Bench(session, self._case)
            found = measure(bench)
            intervals = [after.time - before.time for before, after in pairwise(bench.heard)]
            used = min(intervals, default=configured * MS) < _SHORTER * configured * MS
            if used and found.samples and found.periods <= _SLOWEST and not found.per_payload:
                session.known.reaction = self._short_reaction = found
                return True
        except ConformanceError:
            # If the problem persists, the cases will report it.
            pass
        self.end()
        return False

    def resume(self, reset: Callable[[], object]) -> None:
        """Set the short period again after a restart, without another measurement."""
        session = self._session
        if not self.milliseconds or session.short_period is self:
            return
        try:
            reset()
            if not self.renew():
                return
        except ConformanceError:
            return
        session.short_period = self
        session.parameters[PERIOD] = self.milliseconds
        session.passive.another_period(True)
        session.known.reaction = self._short_reaction

    def renew(self) -> bool:
        """Set the short period, also after a reset; return whether the implementation has accepted it."""
        upper = self._session.upper
        assert upper is not None
        return upper.call("BP-SetParameter", {"name": PERIOD, "value": self.milliseconds}).ok

    def end(self) -> None:
        """Restore the configured period, if the upper tester still answers; a reset does so in any case."""
        session = self._session
        if session.short_period is not self:
            return
        self.forget()
        assert session.upper is not None
        try:
            session.upper.call("BP-SetParameter", {"name": PERIOD, "value": self._configured})
        except ConformanceError:
            return

    def forget(self) -> None:
        """Record that the implementation uses the configured period again, after a restart."""
        session = self._session
        if session.short_period is self:
            session.short_period = None
            session.parameters[PERIOD] = self._configured
            session.known.reaction = self._reaction
            session.passive.another_period(False)
