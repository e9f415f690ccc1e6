"""Tests come to the same result in any environment, alone or beside others."""

from __future__ import annotations

import importlib.util
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ..chance import FRESH
from ..conftest import STRAY

ROOT = Path(__file__).resolve().parents[2]
#: A number that is not drawn by chance.
ODD = 982_451_653_718_281_828
IGNORED = (signal.SIGINT, signal.SIGHUP, signal.SIGTERM)


def test_variables_and_signals() -> None:
    assert not [name for name in STRAY if name in os.environ and name != "XDG_CACHE_HOME"]
    assert os.environ["PYTHONHASHSEED"] == "0" or FRESH or "PYTEST_XDIST_WORKER" not in os.environ
    assert not [number for number in IGNORED if signal.getsignal(number) is signal.SIG_IGN]
    assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())


@pytest.mark.skipif(FRESH, reason="new examples are drawn")
def test_examples_do_not_depend_on_the_run() -> None:
    assert settings().derandomize
    assert settings().database is None
    assert settings().deadline is None


def test_examples_do_not_depend_on_imported_modules(tmp_path: Path) -> None:
    """Hypothesis draws constants that it finds in modules that are not installed packages."""
    path = tmp_path / "of_ours.py"
    path.write_text(f"NUMBER = {ODD}\n")
    spec = importlib.util.spec_from_file_location("of_ours", path)
    assert spec is not None
    assert spec.loader is not None
    sys.modules["of_ours"] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(sys.modules["of_ours"])
        drawn: set[int] = set()

        @settings(max_examples=1500)
        @given(st.integers(0, 1 << 62))
        def draw(number: int) -> None:
            drawn.add(number)

        draw()
    finally:
        del sys.modules["of_ours"]
    assert len(drawn) > 500
    assert ODD not in drawn


def test_the_environment_of_the_user_changes_nothing() -> None:
    hostile = dict.fromkeys(STRAY, "1") | {
        "HYPOTHESIS_PROFILE": "ci",
        "CI": "1",
        "TERM": "xterm-256color",
        "LC_ALL": "C",
    }
    # These act before any file of this folder is read: `make` removes them.
    for name in ("PYTEST_ADDOPTS", "PYTEST_PLUGINS", "PYTHONPATH", "PYTHONOPTIMIZE", "PYTHONWARNINGS", "PYTHONDEVMODE"):
        del hostile[name]
    hostile["PYTHONIOENCODING"] = "ascii"

    def ignore() -> None:
        for number in IGNORED:
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_BLOCK, IGNORED)

    tests = ["test_variables_and_signals", "test_examples_do_not_depend_on_the_run"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(f"{__file__}::{each}" for each in tests)],
        cwd=ROOT, env=os.environ | hostile, preexec_fn=ignore, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed" in done.stdout


def test_make_and_ci_run_the_same() -> None:
    """`.ci/run` only adds tools and DCP_REQUIRE_TOOLS; what a user exports for pytest does not get through."""
    ci = (ROOT / ".ci" / "run").read_text()
    assert re.findall(r"^export (.*)$", ci, re.MULTILINE) == ["DCP_REQUIRE_TOOLS=1"]
    assert re.findall(r"^(?:python3|exec) .*?(make \S+)$", ci, re.MULTILINE) == ["make test", "make test-all"]
    makefile = "include Makefile\nshow:\n\t@env\n"
    variables = {
        "PYTEST_ADDOPTS": "-k nothing",
        "HYPOTHESIS_PROFILE": "fresh",
        "PYTHONPATH": "/",
        "PYTHONHASHSEED": "7",
    }
    shown = subprocess.run(
        ["make", "-f", "-", "show"],
        input=makefile,
        cwd=ROOT,
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "PYTHONHASHSEED=0\n" in shown
    assert not re.search(r"^(PYTEST_ADDOPTS|HYPOTHESIS_PROFILE|PYTHONPATH)=", shown, re.MULTILINE)
