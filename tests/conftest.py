"""What all tests share: tools that must be there, recordings, codecs."""

from __future__ import annotations

import contextlib
import importlib
import os
import pkgutil
import shutil
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent

settings.register_profile("default", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", parent=settings.get_profile("default"), derandomize=True)
#: "ci" draws the same in every run; by default each run looks elsewhere.
PROFILE = os.environ.get("HYPOTHESIS_PROFILE") or ("ci" if os.environ.get("CI") else "default")
settings.load_profile(PROFILE)


def pytest_configure() -> None:
    """Let programs that tests start hear Ctrl-C: in background jobs it is ignored, and that is inherited."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Import all modules of ours, where every run has to be the same.

    Hypothesis draws constants of the modules that are there, and which tests a worker of pytest-xdist had before is a
    matter of chance.
    """
    if PROFILE != "ci":
        return
    for package in ("dcp_spec", "dcp_codec", "dcp_stack", "dcp_conformance"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            # Some need what not everybody has installed, some are commands.
            if not module.name.endswith("__main__"):
                with contextlib.suppress(ImportError):
                    importlib.import_module(module.name)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip loudly what needs a program that is not there; fail instead where all tools are promised."""
    for marker in item.iter_markers("tool"):
        for name in marker.args:
            if shutil.which(name) is None:
                message = f"{name} is not on PATH (apt-get install it, or see CONTRIBUTING.md)"
                if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
                    pytest.fail(message, pytrace=False)
                pytest.skip(message)
