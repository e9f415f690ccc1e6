"""The pytest plugin with pytest-xdist: workers execute cases, each against its own node; a controller collects results.

The controller is the process that the user has started.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from dcp_conformance.definitions.case import Case
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.execution.run import ConformanceRun, WorkerEnd

from .pytest_items import Driver

#: The key of a worker's :class:`End` in ``workeroutput``, as JSON.
_END = "dcp_conformance"


class End(msgspec.Struct, frozen=True):
    """The last report of a worker."""

    about: WorkerEnd
    revised: tuple[CaseResult, ...]
    """Results that replace results which were sent earlier."""


class Worker(Driver):
    """Plugin object of a worker, which gets its share of the cases from the controller."""

    def __init__(self, run: ConformanceRun, config: pytest.Config) -> None:
        super().__init__(run)
        self._output: dict[str, Any] = config.workeroutput  # type: ignore[attr-defined]
        self._revised: list[CaseResult] = []
        run.on_revised = self._revised.append

    def plan(self, collected: Sequence[Case]) -> list[Case]:
        """Return each case once: a worker cannot know when to repeat the sanity case after the last case."""
        return list({case.id: case for case in super().plan(collected)}.values())

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Start the node; end the session if that fails."""
        ended = super().pytest_runtestloop(session)
        if ended:
            session.shouldstop = self.run.trouble
        return ended

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:  # noqa: ARG002
        """Finish and close the run, and send the controller its notes, revised and passive results."""
        if self.run.results:
            self.run.finish()
        self.run.close()
        self._output[_END] = msgspec.json.encode(End(self.run.end(), tuple(self._revised))).decode()


class Controller(Driver):
    """Plugin object of the process that has started the workers: it executes no case, and collects all results."""

    def __init__(self, run: ConformanceRun) -> None:
        super().__init__(run)
        self._planned: list[Case] = []
        self._ends: list[End] = []
        self._workers = 0

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:  # noqa: ARG002
        """Leave the test loop to pytest-xdist."""
        return None

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: Sequence[str]) -> None:
        """Remember the planned cases by the ends of item identifiers; all workers collect the same items."""
        names = (each.rpartition("::")[2].partition("@")[0] for each in ids)
        self._planned = [self.run.cases[name] for name in names if name in self.run.cases]
        self._workers += 1

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add the result of a case to the run."""
        text = getattr(report, "dcp_result", None)
        if text is not None:
            result = msgspec.json.decode(text, type=CaseResult)
            self.run.take(self.run.cases[result.id], result)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: object | None) -> None:
        """Store the last report of a worker that has ended, or its error if it sent no report."""
        text = getattr(node, "workeroutput", {}).get(_END)
        if text is not None:
            self._ends.append(msgspec.json.decode(text, type=End))
        elif error:
            about = WorkerEnd(None, (), f"a worker of pytest-xdist has ended: {error}", usage=False)
            self._ends.append(End(about, ()))

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Merge the reports of all workers; planned cases without a result become errors unless it was interrupted."""
        self.finished = True
        run, listing = self.run, session.config.option.collectonly
        for result in (result for end in self._ends for result in end.revised):
            run.revise(result)
        if self.signalled:
            run.interrupt(len(run.results), len(self._planned))
        elif exitstatus == pytest.ExitCode.INTERNAL_ERROR:
            run.trouble = "pytest failed with an internal error; its messages are above"
        elif not self._planned and not listing:
            run.trouble, run.usage = "no case is left to run", True
        whole = not listing and exitstatus != pytest.ExitCode.INTERRUPTED
        run.close_workers([end.about for end in self._ends], self._workers, self._planned if whole else [])
        session.exitstatus = run.exit_status()
