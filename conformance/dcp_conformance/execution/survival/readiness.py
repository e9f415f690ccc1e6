"""Wait after UT-Reset until the implementation can receive.

UT-Reset has to return when SRP and VarDis are registered with BP again (conformance/UPPER-TESTER.md). An upper tester
that restarts several processes may return earlier. What the tester then sends is lost, and a case that expects
survival or silence would pass without a stimulus.
"""

from __future__ import annotations

from typing import Final

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS

from dcp_conformance.definitions.case import Case
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.session import Session
from dcp_conformance.upper_tester import Checked

_LIST: Final = "BP-ListRegisteredProtocols"
#: Time between two questions, and maximum time until the protocols are registered, in ns.
_INTERVAL, _PATIENCE = 5_000_000, 2_000_000_000


class Readiness:
    """Knows which of SRP and VarDis an implementation registers, and waits until they are registered after a reset.

    Without BP-ListRegisteredProtocols, or if it never lists VarDis, there is no wait.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._own: frozenset[int] = frozenset({BP_PROTID_VARDIS})
        self._useless = False
        self._listed = False
        """Whether VarDis was ever listed."""
        self.lost = False
        """Whether VarDis is not registered any more after a reset."""
        self.longest = 0
        """Longest wait, in ns: how much too early UT-Reset returned."""

    @property
    def known(self) -> bool:
        """Whether the implementation lists its protocols, so that a wait ends when it can receive."""
        upper = self._session.upper
        return not self._useless and upper is not None and _LIST in upper.methods

    def wait(self, case: Case) -> None:
        """Wait after UT-Reset, before ``case``. The traffic in this time is not evidence of the case."""
        if not self.known:
            return
        bench = Bench(self._session, case)
        begun, waited = bench.now(), False
        while (registered := self._registered()) is not None:
            passed = bench.now() - begun
            if self._own <= registered:
                self._own |= registered
                self._listed = True
                # A slow answer alone does not show that the reset was not complete.
                self.longest = max(self.longest, passed) if waited else self.longest
                return
            if passed >= _PATIENCE:
                self._useless = True
                self.lost = self._listed and BP_PROTID_VARDIS not in registered
                if self.lost and isinstance(self._session.upper, Checked):
                    self._session.upper.faults.lost_registration("VarDis")
                return
            bench.waiting.wait_ns(_INTERVAL)
            waited = True

    def _registered(self) -> frozenset[int] | None:
        """Return which of SRP and VarDis are registered; None if the implementation does not list its protocols."""
        assert self._session.upper is not None
        try:
            answer = self._session.upper.call(_LIST, {})
        except UpperTesterError:
            return None
        listed = answer.result.get("protocols") if answer.ok else None
        if not isinstance(listed, list):
            return None
        found = {each.get("protocolId") for each in listed if isinstance(each, dict)}
        return frozenset({BP_PROTID_SRP, BP_PROTID_VARDIS} & found)
