"""The pytest plugin with pytest-xdist: workers run cases, each with a node of its own; the controller has the results.

The controller is the process that was started by the user.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from dcp_conformance.model.case import Case
from dcp_conformance.model.results import CaseResult

from .parallel import WorkerEnd
from .pytest_items import Driver
from .run import ConformanceRun

#: The key of ``workeroutput`` under which a worker puts its :class:`End`, as JSON.
_END = "dcp_conformance"


class End(msgspec.Struct, frozen=True):
    """What a worker has to say when it is done."""

    about: WorkerEnd
    revised: tuple[CaseResult, ...]
    """Results that replace those of reports."""


class Worker(Driver):
    """Drives a worker, which gets its share of the cases from the controller."""

    def __init__(self, run: ConformanceRun, config: pytest.Config) -> None:
        super().__init__(run)
        self._output: dict[str, Any] = config.workeroutput  # type: ignore[attr-defined]
        self._revised: list[CaseResult] = []
        run.on_revised = self._revised.append

    def plan(self, collected: Sequence[Case]) -> list[Case]:
        """Each case once: no worker knows whether it runs the last case, after which the sanity case is repeated."""
        return list({case.id: case for case in super().plan(collected)}.values())

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Start the node; without one the whole session ends."""
        ended = super().pytest_runtestloop(session)
        if ended:
            session.shouldstop = self.run.trouble
        return ended

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:  # noqa: ARG002
        """Close everything, and tell the controller what no report has told."""
        if self.run.results:
            self.run.finish()
        self.run.close()
        told = self.run.result()
        about = WorkerEnd(told.sut, told.notes, self.run.trouble, self.run.usage, tuple(self.run.passive))
        self._output[_END] = msgspec.json.encode(End(about, tuple(self._revised))).decode()


class Controller(Driver):
    """Drives the process that has started the workers: it runs no case, and takes all results."""

    def __init__(self, run: ConformanceRun) -> None:
        super().__init__(run)
        self._planned: list[Case] = []
        self._ends: list[End] = []
        self._workers = 0

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:  # noqa: ARG002
        """Leave the loop to pytest-xdist."""
        return None

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: Sequence[str]) -> None:
        """Remember what is planned: all workers collect the same, and an item ends with the identifier of its case."""
        names = (each.rpartition("::")[2].partition("@")[0] for each in ids)
        self._planned = [self.run.cases[name] for name in names if name in self.run.cases]
        self._workers += 1

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take the result of a case."""
        text = getattr(report, "dcp_result", None)
        if text is not None:
            result = msgspec.json.decode(text, type=CaseResult)
            self.run.take(self.run.cases[result.id], result)

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: object | None) -> None:
        """A worker has ended, with what it has to say, or without a word."""
        text = getattr(node, "workeroutput", {}).get(_END)
        if text is not None:
            self._ends.append(msgspec.json.decode(text, type=End))
        elif error:
            about = WorkerEnd(None, (), f"a worker of pytest-xdist has ended: {error}", usage=False)
            self._ends.append(End(about, ()))

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Put together what all workers have said; each planned case has a result, unless the session was ended."""
        self.finished = True
        run, listing = self.run, session.config.option.collectonly
        for result in (result for end in self._ends for result in end.revised):
            run.revise(result)
        if self.signalled:
            run.interrupt(len(run.results), len(self._planned))
        elif exitstatus == pytest.ExitCode.INTERNAL_ERROR:
            run.trouble = "pytest has failed; what it said of it is above"
        elif not self._planned and not listing:
            run.trouble, run.usage = "no case is left to run", True
        whole = not listing and exitstatus != pytest.ExitCode.INTERRUPTED
        run.close_workers([end.about for end in self._ends], self._workers, self._planned if whole else [])
        session.exitstatus = run.exit_status()
