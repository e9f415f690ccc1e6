"""Shared by all tests: the environment, Hypothesis profiles, parts, required tools, random order, CPU seconds.

`make`, `.ci/run` and a plain `pytest` run the same tests on the same examples. Only `make test-fresh` differs: it sets
HYPOTHESIS_PROFILE=fresh (see tests/meta/fresh.py).
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture.providers import HypothesisProvider
from hypothesis.internal.constants_ast import Constants

from .chance import FRESH, examples
from .costs import Costs

ROOT = Path(__file__).resolve().parent.parent
RUNTIME = tempfile.TemporaryDirectory(prefix="dcp-tests-")
#: The parts of the tests, in the order of ``make test-all``. `make test` runs the first one: all tests without a mark.
PARTS = ("core", "suite", "tools", "tables", "links")
#: Folders whose tests belong to a part as a whole: they start processes and wait in real time.
PART_OF_FOLDER = {"link": "links", "foreign": "links"}
#: Variables of the user's environment that change what commands print, import or find.
STRAY = (
    *("PYTEST_ADDOPTS", "PYTEST_PLUGINS", "PYTEST_THEME", "PYTHONPATH", "PYTHONOPTIMIZE", "PYTHONWARNINGS"),
    *("PYTHONUNBUFFERED", "PYTHONIOENCODING", "PYTHONUTF8", "PYTHONDEVMODE", "PYTHONDONTWRITEBYTECODE"),
    *("COLUMNS", "LINES", "FORCE_COLOR", "NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE", "SOURCE_DATE_EPOCH"),
    # Set by the make that runs the tests; a make in a test would look for its job server.
    *("MAKEFLAGS", "MFLAGS", "MAKELEVEL"),
    *("NUMBA_DISABLE_JIT", "NUMBA_CACHE_DIR", "NUMBA_NUM_THREADS", "MPLBACKEND", "XDG_CACHE_HOME"),
)

# deadline=None: how long an example takes depends on the machine. derandomize draws the same examples in every run and
# keeps no database, in which one failing example would fail a clone for ever.
settings.register_profile(
    "default",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=True,
    print_blob=True,
    max_examples=examples(100),
)
# Other examples for each seed (--hypothesis-seed), and more of them: this is what finds something new.
settings.register_profile("fresh", parent=settings.get_profile("default"), derandomize=False, database=None)
settings.load_profile("fresh" if FRESH else "default")
# Hypothesis also draws constants that it finds in modules of ours, of which a test process may have imported any
# number: the same test would draw other examples alone than beside others. There is no setting for this;
# tests/meta/test_environment.py notices if the attribute gets another name.
HypothesisProvider._local_constants = Constants()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--costs", type=Path, metavar="FILE", help="write the CPU seconds of each item as JSON")
    parser.addoption("--part", choices=PARTS, action="append", help="run only this part of the tests (repeatable)")
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run modules, and tests in them, in a random order")


def pytest_configure(config: pytest.Config) -> None:
    """Make the environment that of every other run, for this process and those that it starts."""
    config.pluginmanager.register(Costs(config.getoption("--costs")))
    for name in STRAY:
        os.environ.pop(name, None)
    # Nodes have a control socket by default: never that of the user, or of the system.
    os.environ["XDG_RUNTIME_DIR"] = RUNTIME.name
    # For the workers of pytest-xdist and for commands that tests start.
    os.environ.setdefault("PYTHONHASHSEED", "0")
    os.environ["TERM"] = "xterm-256color"
    # Compiled decoders and fonts: kept from run to run, as they would be in the user's cache.
    os.environ["XDG_CACHE_HOME"] = str(ROOT / ".pytest_cache" / "xdg")
    # Programs that tests start inherit what is ignored: SIGINT in background jobs of a shell, SIGHUP after nohup.
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())


def part_of(item: pytest.Item) -> str:
    """The part to which a test belongs: that of its mark or folder; `tools` if it drives a program; or the core."""
    mark = item.get_closest_marker("part")
    if mark is None:
        return PART_OF_FOLDER.get(
            item.path.parent.name, PARTS[0] if item.get_closest_marker("tool") is None else "tools"
        )
    (part,) = mark.args
    if part not in PARTS:
        raise pytest.UsageError(f"{item.nodeid}: {part!r} is not one of the parts {', '.join(PARTS)}")
    if part == "links" and not may_be_in_links(item.path):
        raise pytest.UsageError(f"{item.nodeid}: the mark of part links must be in the file of the test")
    return part


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Fail a test of the core that sleeps: its result would depend on real time."""

    def refuse(seconds: float) -> None:
        # Popen.wait sleeps until a process has ended; that does not depend on the time either.
        if sys._getframe(1).f_globals["__name__"] != "subprocess":
            pytest.fail(f"time.sleep({seconds}): use virtual time, or mark the test as part of links")
        slept(seconds)

    slept = time.sleep

    with pytest.MonkeyPatch.context() as patch:
        if part_of(item) == PARTS[0]:
            patch.setattr(time, "sleep", refuse)
        return (yield)


@cache
def may_be_in_links(path: Path) -> bool:
    """Return whether the path of a file of tests, or a literal mark in it, makes tests part of links."""
    return path.parent.name in PART_OF_FOLDER or 'part("links")' in path.read_text(encoding="utf-8")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Skip what has no selected test, without importing it, if only the core or only links is selected."""
    selected = config.getoption("--part")
    if selected == ["core"]:
        skipped = collection_path.is_dir() and collection_path.name in PART_OF_FOLDER
    else:
        skipped = selected == ["links"] and collection_path.is_file() and not may_be_in_links(collection_path)
    return True if skipped else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Select parts. Shuffle modules, and the tests in each: the fixtures of a module are still set up once."""
    selected = [(item, part_of(item) in (config.getoption("--part") or PARTS)) for item in items]
    config.hook.pytest_deselected(items=[item for item, wanted in selected if not wanted])
    items[:] = [item for item, wanted in selected if wanted]
    seed = config.getoption("--shuffle")
    if seed is None:
        return
    chance = random.Random(seed)
    modules: dict[Path, list[pytest.Item]] = {}
    for item in items:
        modules.setdefault(item.path, []).append(item)
    names = sorted(modules)
    chance.shuffle(names)
    items[:] = [item for name in names for item in shuffled(modules[name], chance)]


def shuffled(items: Iterable[pytest.Item], chance: random.Random) -> list[pytest.Item]:
    """A copy in random order."""
    copy = list(items)
    chance.shuffle(copy)
    return copy


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip loudly what needs a program that is not there; fail instead where all tools are promised."""
    for marker in item.iter_markers("tool"):
        for name in marker.args:
            if shutil.which(name) is None:
                message = f"{name} is not on PATH (apt-get install it, or see CONTRIBUTING.md)"
                if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
                    pytest.fail(message, pytrace=False)
                pytest.skip(message)
