"""CPU seconds of each test: measured in the process that runs it, shown at the end of a run.

CPU time, unlike wall time, hardly depends on what else the machine does. The cost of a test includes that of the
processes that it starts and waits for, and of the fixtures that are set up for it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

#: Number of tests that are listed at the end of a run.
LISTED = 10


def cpu_seconds() -> float:
    """CPU seconds of this process and of the processes that it has waited for."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def function_of(nodeid: str) -> str:
    """The test function of an item, without its parameters."""
    return nodeid.partition("[")[0]


class Costs:
    """Pytest plugin that adds up CPU seconds by item."""

    def __init__(self, path: Path | None) -> None:
        """``path``: a JSON file for the cost of each item."""
        self._path = path
        self._begun = 0.0
        self._costs: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self) -> Iterator[None]:
        self._begun = cpu_seconds()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, call: pytest.CallInfo[None]) -> Iterator[None]:
        report = yield
        if call.when == "teardown":
            # An attribute of the report: pytest-xdist transmits it.
            report.cpu_seconds = cpu_seconds() - self._begun
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            self._costs[report.nodeid] = report.cpu_seconds

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self._costs or hasattr(terminalreporter.config, "workerinput"):
            return
        functions: dict[str, list[float]] = {}
        for nodeid, spent in self._costs.items():
            functions.setdefault(function_of(nodeid), []).append(spent)
        total = sum(self._costs.values())
        terminalreporter.section(f"{len(functions)} test functions took {total:.0f} CPU s; the most expensive")
        for name, spent in sorted(functions.items(), key=lambda each: -sum(each[1]))[:LISTED]:
            items = f" ({len(spent)} items)" if len(spent) > 1 else ""
            terminalreporter.write_line(f"{sum(spent):7.1f} CPU s  {name}{items}")
        if self._path is not None:
            self._path.write_text(json.dumps(self._costs, indent=0, sort_keys=True), encoding="utf-8")
