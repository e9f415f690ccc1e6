"""The cases as pytest items.

``dcp-conformance run`` calls pytest with this plugin, so that ``-k``, ``-x``, ``--durations`` and other plugins work;
so does ``pytest -p dcp_conformance.plugin --pyargs dcp_conformance.cases --dcp-in-process``. What pytest calls passed,
failed and skipped is derived from the verdict and never the other way round.
"""

from __future__ import annotations

import contextlib
import datetime
import importlib
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from .case import CASES, SANITY, Case, all_cases, cases_of
from .errors import ConformanceError, LowerTesterError, UpperTesterError, UsageError
from .expected import ExpectedResults
from .outcome import TESTER_ERROR, USAGE, assemble, exit_status
from .results import CaseResult, RunResult, Sut
from .runner import timestamp
from .selection import Selection, select
from .target import Target, TargetOptions, describe, open_target
from .verdict import Verdict

if TYPE_CHECKING:
    from .lanes import LaneEnd

_CASES_DIRECTORY = Path(__file__).parent / "cases"
#: Verdict -> (letter, word) for pytest's own terminal.
_SHOWN = {
    Verdict.PASS: (".", "PASS"),
    Verdict.INFO: ("i", "INFO"),
    Verdict.NOT_APPLICABLE: ("-", "N/A"),
    Verdict.INCONCLUSIVE: ("?", "INCONCLUSIVE"),
    Verdict.FAIL: ("F", "FAIL"),
    Verdict.ERROR: ("E", "ERROR"),
}


class ConformanceRun:
    """One run: what was asked for, what came of it. The plugin object that pytest knows."""

    def __init__(
        self,
        target: TargetOptions,
        selection: Selection,
        *,
        expected: Path | None = None,
        repeat: int = 1,
        until_fail: bool = False,
        command: str = "",
        artefacts: Path | None = None,
        on_start: Callable[[int], None] | None = None,
        on_result: Callable[[Case, CaseResult, str], None] | None = None,
    ) -> None:
        """``on_start`` is told the number of cases, ``on_result`` each result and what is unexpected about it.

        ``artefacts``: a folder of findings of the fuzzer, which become cases. Raises :class:`UsageError`.
        """
        self.options = target
        self.cases = all_cases()
        self.artefacts = artefacts
        self._found_by_fuzzer: dict[str, Case] = {}
        if artefacts is not None:
            from .fuzz.cases import artefact_cases

            self._found_by_fuzzer = {case.id: case for case in artefact_cases(artefacts)}
            self.cases |= self._found_by_fuzzer
        self.codec, self.pics = describe(target)
        self.selected = select(self.cases, selection)
        self.expected = ExpectedResults() if expected is None else ExpectedResults.load(expected, self.cases.values())
        self.repeat = repeat
        self.until_fail = until_fail
        self.command = command
        self.results: list[CaseResult] = []
        self.unexpected: list[str] = []
        self.trouble = ""
        """Why nothing could be run, or not to the end: the tester's own fault."""
        self.usage = False
        """Whether the trouble is what the user asked for."""
        self._on_start = on_start
        self._on_result = on_result
        self._stack = contextlib.ExitStack()
        self._target: Target | None = None
        self._sut: Sut | None = None
        self._notes: list[str] = []
        self._attempts: dict[str, int] = {}
        self._began = time.monotonic()
        self._started = timestamp()
        self.finished = False
        """Whether there was a session of pytest, with or without results."""

    # -- collection --------------------------------------------------------------------------------------------

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """The selected cases in their order, sanity also last and behind every destructive case."""
        by_id = {item.case.id: item for item in items if isinstance(item, CaseItem)}
        left_out = [item for item in items if isinstance(item, CaseItem)]
        chosen: list[pytest.Item] = [item for item in items if not isinstance(item, CaseItem)]
        module = next(iter(by_id.values())).parent if by_id else None
        sanity = self.cases[SANITY]
        for round_number in range(self.repeat):
            cases = [case for case in self.selected if case.id in by_id or case.id in self._found_by_fuzzer]
            for case in self._with_sanity(cases, sanity):
                if round_number == 0 and case.id in by_id and by_id[case.id] in left_out:
                    item = by_id[case.id]
                    left_out.remove(item)
                elif module is not None:
                    item = CaseItem.from_parent(module, name=case.id, case=case)
                else:
                    continue
                chosen.append(item)
        if left_out:
            config.hook.pytest_deselected(items=left_out)
        items[:] = chosen

    def _with_sanity(self, cases: list[Case], sanity: Case) -> Iterator[Case]:
        if not cases:
            return
        yield sanity
        for case in cases:
            if case.base != SANITY:
                yield case
                if case.destructive:
                    yield sanity
        if len(cases) > 1 and not cases[-1].destructive:
            yield sanity

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """How many there are."""
        if self._on_start is not None:
            self._on_start(len(session.items))

    # -- running -----------------------------------------------------------------------------------------------

    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Open the way to the implementation, if there is anything to run."""
        if session.config.option.collectonly or not session.items:
            return None
        try:
            self._target = self._stack.enter_context(open_target(self.options))
            self._target.runner.prepare()
            if self.options.foreign and self.options.start:
                self._target.runner.await_answer(self.cases[SANITY])
        except ConformanceError as error:
            self.trouble = str(error)
            self.usage = isinstance(error, UsageError)
            return True
        except Exception as error:
            self.trouble = f"a fault of the tester: {type(error).__name__}: {error}"
            self._notes.append("".join(traceback.format_exception(error)))
            return True
        return None

    def run_case(self, case: Case) -> tuple[CaseResult, str]:
        """Run one; its result and what is unexpected about it."""
        assert self._target is not None
        attempt = self._attempts[case.id] = self._attempts.get(case.id, 0) + 1
        result = self._target.runner.run(case, attempt)
        return result, self.take(case, result)

    def take(self, case: Case, result: CaseResult) -> str:
        """Take a result, of this process or of a lane; what is unexpected about it."""
        surprise = self.expected.judge(case, result)
        if surprise:
            self.unexpected.append(f"{case.id}: {surprise}")
        self.results.append(result)
        if self._on_result is not None:
            self._on_result(case, result, surprise)
        return surprise

    def begin(self, total: int) -> None:
        """So many cases are to be run, in lanes."""
        if self._on_start is not None:
            self._on_start(total)

    def close_lanes(self, ends: Sequence[LaneEnd], lanes: int) -> None:
        """All lanes are done: what they say of the implementation, and in which order their results belong."""
        self._sut = next((end.sut for end in ends if end.sut is not None), None)
        self._notes += [note for end in ends for note in end.notes]
        if lanes > 1:
            self._notes.append(f"{lanes} nodes were tested side by side, each with a share of the cases")
        for end in ends:
            if end.trouble and not self.trouble:
                self.trouble, self.usage = end.trouble, end.usage
        order = {case.id: number for number, case in enumerate(self.cases.values())}
        self.results.sort(key=lambda result: (result.id != SANITY, order[result.id], result.attempt))

    def should_stop(self, result: CaseResult) -> str:
        """Why the run should end here; empty if it should go on."""
        if self.until_fail and result.verdict in (Verdict.FAIL, Verdict.ERROR):
            return f"{result.id}: {result.verdict}"
        if result.id == SANITY and result.attempt == 1 and result.verdict is not Verdict.PASS:
            return f"the implementation does not take part: {result.reason}"
        return ""

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """Close everything; whatever was still to be said is said by :meth:`result`."""
        self.finished = True
        self._note_end(session, exitstatus)
        if self._target is not None:
            self._sut = self._target.runner.about()
            self._notes = list(self._target.runner.notes)
        with contextlib.suppress(LowerTesterError, UpperTesterError):
            self._stack.close()
        session.exitstatus = self.exit_status()

    def _note_end(self, session: pytest.Session, status: int) -> None:
        """What pytest says of the session, where that is more than the results say."""
        if self.trouble or session.config.option.collectonly:
            return
        if status == pytest.ExitCode.NO_TESTS_COLLECTED or not session.items:
            self.trouble, self.usage = "no case is left to run", True
        elif status == pytest.ExitCode.INTERNAL_ERROR:
            self.trouble = "pytest has failed; what it said of it is above"
        elif status == pytest.ExitCode.INTERRUPTED and not session.shouldstop:
            self.trouble = f"interrupted after {len(self.results)} of {len(session.items)} cases"

    # -- results -----------------------------------------------------------------------------------------------

    def complaints(self) -> list[str]:
        """What is unexpected: results, and entries of the file of expected results."""
        today = datetime.datetime.now(datetime.UTC).date()
        ran = {result.id for result in self.results}
        selected = [case for case in self.selected if case.id in ran]
        return [*self.unexpected, *self.expected.complaints(selected, today)]

    def exit_status(self) -> int:
        """As documented: the tester's own trouble before everything, then what is unexpected, then doubts."""
        if self.trouble:
            return USAGE if self.usage else TESTER_ERROR
        return exit_status(self.results, unexpected=bool(self.complaints()))

    def result(self) -> RunResult:
        """Everything that is known of the run, also of one that could not begin."""
        notes = [*self._notes, *([self.trouble] if self.trouble else [])]
        if self.expected.entries:
            notes += self.complaints()
        return assemble(
            self.codec.profile,
            self.pics,
            self.results,
            sut=self._sut,
            started=self._started,
            duration=time.monotonic() - self._began,
            command=self.command,
            notes=notes,
        )


class CaseFile(pytest.File):
    """A module of cases."""

    def collect(self) -> Iterator[CaseItem]:
        """Its cases as items."""
        module = importlib.import_module(f"{CASES}.{self.path.stem}")
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
        run = _run_of(self.config)
        self.result, self.surprise = run.run_case(self.case)
        self.user_properties.append(("verdict", str(self.result.verdict)))
        stop = run.should_stop(self.result)
        if stop:
            self.session.shouldstop = stop
        if self.surprise or self.result.verdict is Verdict.ERROR:
            raise CaseVerdictError(self.result, self.surprise)
        if self.result.verdict in (Verdict.NOT_APPLICABLE, Verdict.INCONCLUSIVE):
            pytest.skip(f"{self.result.verdict}: {self.result.reason}")
        if self.result.verdict is Verdict.FAIL:
            pytest.xfail(f"as expected: {self.result.reason}")

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """A verdict is shown as what was expected and what came instead, not as a traceback."""
        if isinstance(excinfo.value, CaseVerdictError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Where the case stands, and what it is for."""
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
        super().__init__("\n".join(lines))


_RUN = pytest.StashKey[ConformanceRun]()


def _run_of(config: pytest.Config) -> ConformanceRun:
    return config.stash[_RUN]


# -- hooks of the module ----------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    """What ``pytest -p dcp_conformance.plugin`` takes; ``dcp-conformance run`` has options of its own."""
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


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Take the run over from ``dcp-conformance``, or make one from the options."""
    run = next((plugin for plugin in config.pluginmanager.get_plugins() if isinstance(plugin, ConformanceRun)), None)
    if run is None:
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
        config.pluginmanager.register(run, "dcp-conformance-run")
    config.stash[_RUN] = run


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> CaseFile | None:
    """Modules with cases are ours."""
    if file_path.suffix == ".py" and file_path.parent == _CASES_DIRECTORY and file_path.stem != "__init__":
        return CaseFile.from_parent(parent, path=file_path)
    return None


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Give the report its verdict."""
    outcome: Any = yield
    if isinstance(item, CaseItem) and item.result is not None:
        outcome.get_result().dcp_verdict = item.result.verdict


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """Show verdicts in pytest's own terminal."""
    verdict = getattr(report, "dcp_verdict", None)
    if verdict is None or report.when != "call":
        return None
    letter, word = _SHOWN[verdict]
    return (str(verdict) if report.outcome != "failed" else "failed"), letter, word
