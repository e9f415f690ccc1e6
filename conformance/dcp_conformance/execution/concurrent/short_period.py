"""Shorten the beacon period of the implementation while cases are executed whose verdict does not depend on it.

Nearly all time of a run passes in waits of some beacon periods. An upper tester with BP-SetParameter can shorten the
period, and nothing but the length of these waits changes: what a node must answer, forward and repeat does not depend
on it. Only a plain pass counts at the short period; every other case is repeated at the configured one.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from dcp_conformance.errors import ConformanceError
from dcp_conformance.interconnection.reaction import measure
from dcp_conformance.model.case import Case
from dcp_conformance.test_system.bench import MS, Bench
from dcp_conformance.test_system.session import FLOOR

if TYPE_CHECKING:
    from dcp_conformance.test_system.session import Reaction, Session

PERIOD: Final = "BPPAR_BEACON_PERIOD"
#: The configured period divided by one of these is the short one: by the first with which the implementation keeps up.
FACTORS: Final = (4, 2)
#: ms: no shorter period is set, so that the timing of a busy machine does not decide.
_LEAST: Final = 20
#: Beacon periods that a reaction may take at most at the short period; where it takes longer, little time is saved.
_SLOWEST: Final = 2 * FLOOR
#: An interval below this share of the configured period shows that the implementation uses the short one.
_SHORTER: Final = 0.75


class ShortPeriod:
    """The short beacon period of one session: set, set again after each reset, and given up."""

    def __init__(self, session: Session, case: Case) -> None:
        """``case``: in whose name the implementation is asked how fast it reacts."""
        self._session = session
        self._case = case
        self._configured: Any = None
        self._reaction: Reaction | None = None
        self.milliseconds = 0
        """The short period in ms."""

    def begin(self, reset: Callable[[], object]) -> bool:
        """Shorten the period, if the implementation can be seen to use it and reacts as fast as usual.

        ``reset``: brings the implementation into its initial state. Returns whether the short period is in force.
        """
        session = self._session
        upper, told = session.upper, session.parameters.get(PERIOD)
        configured = session.pics.pixit.beacon_period_ms
        if upper is None or not {"BP-SetParameter", "UT-Reset"} <= upper.methods or told != configured:
            return False
        self._configured, self._reaction = told, session.reaction
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
                session.reaction = found
                return True
        except ConformanceError:
            # The cases will meet what is wrong, if it lasts.
            pass
        self.end()
        return False

    def renew(self) -> bool:
        """Set the period again, after a reset. Returns whether the implementation has accepted it."""
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
        """The implementation uses the configured period again: it was restarted."""
        session = self._session
        if session.short_period is self:
            session.short_period = None
            session.parameters[PERIOD] = self._configured
            session.reaction = self._reaction
            session.passive.another_period(False)
