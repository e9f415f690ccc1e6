"""Test cases as items of pytest, and the plugin object that runs them."""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from dcp_codec.common.printable import plain
from dcp_conformance.definitions.case import CASES, SANITY, Case, cases_of
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.run import ConformanceRun

CASES_DIRECTORY = Path(__file__).parents[2] / "suite"


class Driver:
    """The plugin object of one run: makes pytest collect and execute the selected cases."""

    def __init__(self, run: ConformanceRun) -> None:
        self.run = run
        self.finished = False
        """Whether a pytest session has ended, with or without results."""
        self.signalled = False
        """Whether Ctrl-C ended the session, not pytest itself (``-x``)."""

    def plan(self, collected: Sequence[Case]) -> list[Case]:
        """Return the planned executions. The order is that of the run, unless another plugin has changed it."""
        ids = {case.id for case in collected}
        planned = self.run.plan(lambda case: case.id in ids or case.id in self.run.found_by_fuzzer)
        order = {name: number for number, name in enumerate(self.run.cases)}
        places = [order[case.id] for case in collected]
        if places == sorted(places):
            return planned
        # Keep the sanity case first and last, and the other cases in the order of the other plugin.
        there = {case.id: number for number, case in enumerate(collected)}
        rounds = itertools.groupby(planned, lambda case: case.id == SANITY)
        last = len(there)
        return [case for _, cases in rounds for case in sorted(cases, key=lambda case: there.get(case.id, last))]

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> Generator[None, None, None]:
        """Order the selected cases after all other plugins have filtered them (``-k``, ``--lf``)."""
        yield
        collected = [item for item in items if isinstance(item, CaseItem)]
        chosen: list[pytest.Item] = [item for item in items if not isinstance(item, CaseItem)]
        module = collected[0].parent if collected else None
        unused = {item.case.id: item for item in collected}
        for case in self.plan([item.case for item in collected]):
            # pytest executes an item once: repetitions need further items.
            item = unused.pop(case.id, None)
            if item is None and module is not None:
                item = CaseItem.from_parent(module, name=case.id, case=case)
            if item is not None:
                chosen.append(item)
        if unused:
            config.hook.pytest_deselected(items=list(unused.values()))
        items[:] = chosen

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Report the number of executions."""
        if self.run.on_start is not None:
            self.run.on_start(len(session.items))

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Open the connections to the implementation if any case is to be executed; True ends the session."""
        if session.config.option.collectonly or not session.items:
            return None
        return None if self.run.open() else True

    def pytest_keyboard_interrupt(self, excinfo: pytest.ExceptionInfo[BaseException]) -> None:
        """Distinguish Ctrl-C from the exception that pytest raises after enough failures."""
        self.signalled = excinfo.type is KeyboardInterrupt

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Finish and close the run, and set the exit status; cases without a result become errors of the tester."""
        self.finished = True
        run = self.run
        planned = [item.case for item in session.items if isinstance(item, CaseItem)]
        if not session.config.option.collectonly and not run.trouble:
            if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED or not session.items:
                run.trouble, run.usage = "no case is left to run", True
            elif exitstatus == pytest.ExitCode.INTERNAL_ERROR:
                run.trouble = "pytest failed with an internal error; its messages are above"
            elif self.signalled:
                run.interrupt(len(run.results), len(planned))
        if run.results and not run.interrupted:
            run.finish()
        run.close()
        if run.results and not session.shouldstop and not session.shouldfail:
            run.account(planned)
        session.exitstatus = run.exit_status()


class CaseFile(pytest.File):
    """A module of cases."""

    def collect(self) -> Iterator[CaseItem]:
        """Yield the cases of the module as items."""
        inside = self.path.relative_to(CASES_DIRECTORY).with_suffix("")
        module = importlib.import_module(".".join((CASES, *inside.parts)))
        for case in cases_of(module):
            yield CaseItem.from_parent(self, name=case.id, case=case)


class CaseItem(pytest.Item):
    """A case as an item of pytest."""

    def __init__(self, *, case: Case, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.case = case
        self.result: CaseResult | None = None
        self.surprise = ""
        self.user_properties.append(("requirements", " ".join(case.requirements)))

    def runtest(self) -> None:
        """Execute the case. Not applicable and inconclusive are skipped items, an expected fail is an xfail.

        Raise :class:`CaseVerdictError` for an unexpected result or an error of the tester.
        """
        run = self.config.stash[DRIVER].run
        self.result, self.surprise = run.run_case(self.case)
        self.user_properties.append(("verdict", str(self.result.verdict)))
        if run.stops(self.result):
            self.session.shouldstop = f"{self.result.id}: {self.result.verdict}"
        if self.surprise or self.result.verdict is Verdict.ERROR:
            raise CaseVerdictError(self.result, self.surprise)
        if self.result.verdict in (Verdict.NOT_APPLICABLE, Verdict.INCONCLUSIVE):
            pytest.skip(plain(f"{self.result.verdict}: {self.result.reason}"))
        if self.result.verdict is Verdict.FAIL:
            pytest.xfail(plain(f"as expected: {self.result.reason}"))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Show an unexpected verdict by expectation and observation, not by a traceback."""
        if isinstance(excinfo.value, CaseVerdictError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return file and line (from 0) of the case, and its purpose."""
        return self.path, self.case.line - 1, f"{self.case.id}: {self.case.purpose}"


class CaseVerdictError(Exception):
    """The result of a case is unexpected, or an error of the tester."""

    def __init__(self, result: CaseResult, surprise: str) -> None:
        lines = [f"{result.id}: {surprise or result.verdict}", f"  purpose: {result.purpose}"]
        for check in result.checks:
            if check.verdict.rank > Verdict.PASS.rank:
                lines += [f"  expected: {check.expected}", f"  observed: {check.observed}"]
                lines.append(f"  decides:  {', '.join(check.requirements)}")
        lines.append(f"  again:    {result.rerun}")
        if result.error_detail:
            lines.append(result.error_detail)
        super().__init__(plain("\n".join(lines), keep="\n"))


DRIVER = pytest.StashKey[Driver]()
