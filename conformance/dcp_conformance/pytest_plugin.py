"""pytest plugin that executes the cases as pytest items, so that ``-k``, ``--lf``, ``--durations`` and plugins work.

``dcp-conformance run`` executes cases without pytest, so that no setting of pytest can change a verdict. With
``--pytest`` it calls pytest with this plugin. The plugin can also be used directly:
``pytest -p dcp_conformance.pytest_plugin --pyargs dcp_conformance.suite --dcp-in-process``. The outcomes of pytest
(passed, failed, skipped) are derived from the verdicts.

With pytest-xdist (``-n 2``) each worker tests its own reference node, and the process that has started the workers
collects the results (:mod:`dcp_conformance.execution.workers.pytest_workers`).
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from dcp_conformance.definitions.case import CASES
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError

from .execution.run import ConformanceRun
from .execution.selection import Selection
from .execution.target import TargetOptions
from .execution.workers.pytest_items import CASES_DIRECTORY, DRIVER, CaseFile, CaseItem, Driver

_PACKAGE_DIRECTORY = Path(__file__).parent
#: Short and long form of each verdict in the terminal output of pytest.
_SHOWN = {
    Verdict.PASS: (".", "PASS"),
    Verdict.INFO: ("i", "INFO"),
    Verdict.NOT_APPLICABLE: ("-", "N/A"),
    Verdict.TOO_LITTLE: ("-", "TOO LITTLE"),
    Verdict.INCONCLUSIVE: ("?", "INCONCLUSIVE"),
    Verdict.FAIL: ("F", "FAIL"),
    Verdict.ERROR: ("E", "ERROR"),
}


def run_with_pytest(run: ConformanceRun, options: list[str]) -> None:
    """Execute the cases with pytest in this process; ``options`` are the user's options for pytest.

    Settings of pytest in the current directory and in the environment are ignored.
    """
    arguments = ["--pyargs", CASES, "-c", os.devnull, "--rootdir", str(_PACKAGE_DIRECTORY)]
    arguments += ["-p", "no:cacheprovider", "--noconftest"]
    # If installed, pytest-benchmark would create a folder in the current directory.
    arguments += ["-p", "no:benchmark"]
    driver = Driver(run)
    kept = {name: os.environ.pop(name) for name in ("PYTEST_ADDOPTS", "PYTEST_PLUGINS") if name in os.environ}
    try:
        status = pytest.main([*arguments, *options], plugins=[importlib.import_module(__name__), driver])
    finally:
        os.environ.update(kept)
    if not driver.finished:
        # No session was started; pytest has printed the reason.
        run.trouble, run.usage = f"pytest could not begin (its status is {int(status)})", True


# -- hooks of the module -----------------------------------------------------------------------------------------------


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of ``pytest -p dcp_conformance.pytest_plugin``."""
    group = parser.getgroup("dcp-conformance", "testing an implementation of DCP")
    group.addoption("--dcp-in-process", action="store_true", help="test the reference node, in virtual time")
    for name, text in (
        ("profile", "wire profile"),
        ("interface", "network interface of the implementation"),
        ("link", "udp[:GROUP:PORT]"),
        ("ut", "upper tester: unix:PATH, tcp:HOST:PORT, exec:COMMAND, commands:FILE"),
        ("pics", "PICS and PIXIT, a TOML file"),
        ("restart", "command that restarts the implementation"),
        ("expected", "file of expected results"),
        ("artefacts", "folder with findings of the fuzzer, to be executed as cases"),
    ):
        group.addoption(f"--dcp-{name}", help=text)


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Use the run of ``dcp-conformance``, or create one from the options of pytest."""
    driver = next((plugin for plugin in config.pluginmanager.get_plugins() if isinstance(plugin, Driver)), None)
    if driver is not None and _has_workers(config):
        raise pytest.UsageError(
            f"-n: dcp-conformance run has processes of its own (--jobs); to use workers call pytest with -p {__name__}"
        )
    if driver is None:
        driver = _driver_of(config)
        config.pluginmanager.register(driver, "dcp-conformance-run")
    config.stash[DRIVER] = driver


def _has_workers(config: pytest.Config) -> bool:
    """Return whether this process is the controller of workers of pytest-xdist."""
    return config.getoption("dist", "no") != "no" and not hasattr(config, "workerinput")


def _driver_of(config: pytest.Config) -> Driver:
    """Create a run from the options of pytest, and return its plugin object. Raise ``pytest.UsageError``."""
    from .execution.workers.pytest_workers import Controller, Worker

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
        target = target.with_access()
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
            "-n: the implementation exists only once, and workers would disturb each other; leave -n out "
            "(only the reference node can be tested by several workers, each with its own node)"
        )
    if option("dist") == "each":
        raise pytest.UsageError("--dist each: every case would have several results; leave it out")
    return Controller(run)


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> CaseFile | None:
    """Collect the cases of a module of the suite; leave other files to pytest."""
    if file_path.suffix == ".py" and CASES_DIRECTORY in file_path.parents and file_path.stem != "__init__":
        return CaseFile.from_parent(parent, path=file_path)
    return None


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Add the verdict to the report; in a worker, also the result."""
    outcome: Any = yield
    if isinstance(item, CaseItem) and item.result is not None:
        # Workers can send only plain data in reports.
        report = outcome.get_result()
        report.dcp_verdict = str(item.result.verdict)
        if hasattr(item.config, "workerinput") and report.when == "call":
            report.dcp_result = msgspec.json.encode(item.result).decode()


def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """Show verdicts in the terminal output of pytest."""
    name = getattr(report, "dcp_verdict", None)
    if name is None or report.when != "call":
        return None
    letter, word = _SHOWN[Verdict(name)]
    return (name if report.outcome != "failed" else "failed"), letter, word
