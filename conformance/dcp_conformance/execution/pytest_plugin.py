"""The cases as pytest items, if the user wants pytest: ``-k``, ``--lf``, ``--durations`` and other plugins work.

``dcp-conformance run`` runs cases without pytest, so that no setting of pytest changes a verdict; with ``--pytest``
it calls pytest with this plugin. So does ``pytest -p dcp_conformance.execution.pytest_plugin --pyargs
dcp_conformance.suite
--dcp-in-process``. What pytest calls passed, failed and skipped is derived from the verdict and never the other way
round.

With pytest-xdist (``-n 2``) each worker tests a node of ours of its own, and the results come together in the process
that has started the workers (:mod:`dcp_conformance.execution.pytest_workers`).
"""

from __future__ import annotations

import importlib
import itertools
import os
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pytest

from dcp_codec.common.printable import plain
from dcp_conformance.errors import UsageError
from dcp_conformance.model.case import CASES, SANITY, Case, cases_of
from dcp_conformance.model.results import CaseResult
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.sut.target import TargetOptions

from .run import ConformanceRun
from .selection import Selection

_PACKAGE_DIRECTORY = Path(__file__).parents[1]
_CASES_DIRECTORY = _PACKAGE_DIRECTORY / "suite"
#: Verdict -> (letter, word) for pytest's own terminal.
_SHOWN = {
    Verdict.PASS: (".", "PASS"),
    Verdict.INFO: ("i", "INFO"),
    Verdict.NOT_APPLICABLE: ("-", "N/A"),
    Verdict.TOO_LITTLE: ("-", "TOO LITTLE"),
    Verdict.INCONCLUSIVE: ("?", "INCONCLUSIVE"),
    Verdict.FAIL: ("F", "FAIL"),
    Verdict.ERROR: ("E", "ERROR"),
}


class Driver:
    """The plugin object of one run: has pytest collect and run what the run has selected."""

    def __init__(self, run: ConformanceRun) -> None:
        self.run = run
        self.finished = False
        """Whether there was a session of pytest, with or without results."""
        self.signalled = False
        """Whether Ctrl-C has ended the session, and not pytest itself (``-x``)."""

    def plan(self, collected: Sequence[Case]) -> list[Case]:
        """The executions, of cases in the order in which pytest has them; another plugin may have changed it."""
        ids = {case.id for case in collected}
        planned = self.run.plan(lambda case: case.id in ids or case.id in self.run.found_by_fuzzer)
        order = {name: number for number, name in enumerate(self.run.cases)}
        places = [order[case.id] for case in collected]
        if places == sorted(places):
            return planned
        # Sanity first and last, all else as another plugin wants it.
        there = {case.id: number for number, case in enumerate(collected)}
        rounds = itertools.groupby(planned, lambda case: case.id == SANITY)
        last = len(there)
        return [case for _, cases in rounds for case in sorted(cases, key=lambda case: there.get(case.id, last))]

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> Generator[None, None, None]:
        """Put the selected cases in their order, once all other plugins have chosen among them (``-k``, ``--lf``)."""
        yield
        collected = [item for item in items if isinstance(item, CaseItem)]
        chosen: list[pytest.Item] = [item for item in items if not isinstance(item, CaseItem)]
        module = collected[0].parent if collected else None
        unused = {item.case.id: item for item in collected}
        for case in self.plan([item.case for item in collected]):
            # An item runs once: repetitions are items of their own.
            item = unused.pop(case.id, None)
            if item is None and module is not None:
                item = CaseItem.from_parent(module, name=case.id, case=case)
            if item is not None:
                chosen.append(item)
        if unused:
            config.hook.pytest_deselected(items=list(unused.values()))
        items[:] = chosen

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Say how many executions there are."""
        if self.run.on_start is not None:
            self.run.on_start(len(session.items))

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Open the way to the implementation, if there is anything to run."""
        if session.config.option.collectonly or not session.items:
            return None
        return None if self.run.open() else True

    def pytest_keyboard_interrupt(self, excinfo: pytest.ExceptionInfo[BaseException]) -> None:
        """Tell Ctrl-C from what pytest raises itself when it has failed often enough."""
        self.signalled = excinfo.type is KeyboardInterrupt

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Close everything; results are complete then, or the run says what is missing."""
        self.finished = True
        run = self.run
        planned = [item.case for item in session.items if isinstance(item, CaseItem)]
        if not session.config.option.collectonly and not run.trouble:
            if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED or not session.items:
                run.trouble, run.usage = "no case is left to run", True
            elif exitstatus == pytest.ExitCode.INTERNAL_ERROR:
                run.trouble = "pytest has failed; what it said of it is above"
            elif self.signalled:
                run.interrupt(len(run.results), len(planned))
        if run.results and not run.interrupted:
            run.finish()
        run.close()
        if run.results and not session.shouldstop and not session.shouldfail:
            run.account(planned)
        session.exitstatus = run.exit_status()


def run_with_pytest(run: ConformanceRun, options: list[str]) -> None:
    """Run the cases with pytest in this process; ``options`` are those of the user for pytest.

    Settings of the directory that the user is in, and of its environment, do not count.
    """
    arguments = ["--pyargs", CASES, "-c", os.devnull, "--rootdir", str(_PACKAGE_DIRECTORY)]
    arguments += ["-p", "no:cacheprovider", "--noconftest"]
    # Where it is installed it makes a folder for its results in the current directory.
    arguments += ["-p", "no:benchmark"]
    driver = Driver(run)
    kept = {name: os.environ.pop(name) for name in ("PYTEST_ADDOPTS", "PYTEST_PLUGINS") if name in os.environ}
    try:
        status = pytest.main([*arguments, *options], plugins=[importlib.import_module(__name__), driver])
    finally:
        os.environ.update(kept)
    if not driver.finished:
        # It has not come to a session, and has said why.
        run.trouble, run.usage = f"pytest could not begin (its status is {int(status)})", True


class CaseFile(pytest.File):
    """A module of cases."""

    def collect(self) -> Iterator[CaseItem]:
        """Its cases as items."""
        inside = self.path.relative_to(_CASES_DIRECTORY).with_suffix("")
        module = importlib.import_module(".".join((CASES, *inside.parts)))
        for case in cases_of(module):
            yield CaseItem.from_parent(self, name=case.id, case=case)


class CaseItem(pytest.Item):
    """A case."""

    def __init__(self, *, case: Case, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.case = case
        self.result: CaseResult | None = None
        self.surprise = ""
        self.user_properties.append(("requirements", " ".join(case.requirements)))

    def runtest(self) -> None:
        """Run it; verdicts that pytest has no outcome for are skips with their reason."""
        run = self.config.stash[_DRIVER].run
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
        """Show a verdict as what was expected and what came instead, not as a traceback."""
        if isinstance(excinfo.value, CaseVerdictError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """The place of the case, and its purpose."""
        return self.path, self.case.line - 1, f"{self.case.id}: {self.case.purpose}"


class CaseVerdictError(Exception):
    """A case came out other than expected."""

    def __init__(self, result: CaseResult, surprise: str) -> None:
        lines = [f"{result.id}: {surprise or result.verdict}", f"  purpose: {result.purpose}"]
        for check in result.checks:
            if check.verdict.rank > Verdict.PASS.rank:
                lines += [f"  expected: {check.expected}", f"  instead:  {check.observed}"]
                lines.append(f"  decides:  {', '.join(check.requirements)}")
        lines.append(f"  again:    {result.rerun}")
        if result.error_detail:
            lines.append(result.error_detail)
        super().__init__(plain("\n".join(lines), keep="\n"))


_DRIVER = pytest.StashKey[Driver]()


# -- hooks of the module -----------------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of ``pytest -p dcp_conformance.execution.pytest_plugin``."""
    group = parser.getgroup("dcp-conformance", "testing an implementation of DCP")
    group.addoption("--dcp-in-process", action="store_true", help="our own node, in virtual time")
    for name, text in (
        ("profile", "wire profile"),
        ("interface", "network interface of the implementation"),
        ("link", "udp[:GROUP:PORT]"),
        ("ut", "upper tester: unix:PATH, tcp:HOST:PORT, exec:COMMAND, commands:FILE"),
        ("pics", "PICS and PIXIT, a TOML file"),
        ("restart", "command that restarts the implementation"),
        ("expected", "file of expected results"),
        ("artefacts", "folder with findings of the fuzzer, which become cases"),
    ):
        group.addoption(f"--dcp-{name}", help=text)


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Take the run over from ``dcp-conformance``, or make one from the options."""
    driver = next((plugin for plugin in config.pluginmanager.get_plugins() if isinstance(plugin, Driver)), None)
    if driver is not None and _has_workers(config):
        raise pytest.UsageError(
            f"-n: dcp-conformance run has processes of its own (--jobs); to use workers call pytest with -p {__name__}"
        )
    if driver is None:
        driver = _driver_of(config)
        config.pluginmanager.register(driver, "dcp-conformance-run")
    config.stash[_DRIVER] = driver


def _has_workers(config: pytest.Config) -> bool:
    """Whether this process only hands out what workers of pytest-xdist run."""
    return config.getoption("dist", "no") != "no" and not hasattr(config, "workerinput")


def _driver_of(config: pytest.Config) -> Driver:
    """What drives the run that the options of pytest ask for. Raises ``pytest.UsageError``."""
    from .pytest_workers import Controller, Worker

    option = config.getoption
    pics, expected, artefacts = option("--dcp-pics"), option("--dcp-expected"), option("--dcp-artefacts")
    target = TargetOptions(
        profile=option("--dcp-profile"),
        interface=option("--dcp-interface"),
        link=option("--dcp-link"),
        in_process=option("--dcp-in-process"),
        ut=option("--dcp-ut"),
        pics=Path(pics) if pics else None,
        restart=option("--dcp-restart"),
    )
    try:
        run = ConformanceRun(
            target,
            Selection(),
            expected=Path(expected) if expected else None,
            artefacts=Path(artefacts) if artefacts else None,
        )
    except UsageError as error:
        raise pytest.UsageError(str(error)) from None
    if hasattr(config, "workerinput"):
        return Worker(run, config)
    if not _has_workers(config):
        return Driver(run)
    if target.foreign:
        raise pytest.UsageError(
            "-n: the implementation is there only once, and workers would disturb each other; leave -n out "
            "(only our own node can be tested by several workers, each with a node of its own)"
        )
    if option("dist") == "each":
        raise pytest.UsageError("--dist each: every case would have several results; leave it out")
    return Controller(run)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> CaseFile | None:
    """Modules with cases are ours."""
    if file_path.suffix == ".py" and _CASES_DIRECTORY in file_path.parents and file_path.stem != "__init__":
        return CaseFile.from_parent(parent, path=file_path)
    return None


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Give the report its verdict."""
    outcome: Any = yield
    if isinstance(item, CaseItem) and item.result is not None:
        # Workers send reports as plain data.
        report = outcome.get_result()
        report.dcp_verdict = str(item.result.verdict)
        if hasattr(item.config, "workerinput") and report.when == "call":
            report.dcp_result = msgspec.json.encode(item.result).decode()


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """Show verdicts in pytest's own terminal."""
    name = getattr(report, "dcp_verdict", None)
    if name is None or report.when != "call":
        return None
    letter, word = _SHOWN[Verdict(name)]
    return (name if report.outcome != "failed" else "failed"), letter, word
