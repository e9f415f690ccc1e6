"""What all tests share: tools that must be there, recordings, codecs."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent

settings.register_profile("default", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", parent=settings.get_profile("default"), derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


def pytest_configure() -> None:
    """Let programs that tests start hear Ctrl-C: in background jobs it is ignored, and that is inherited."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip loudly what needs a program that is not there; fail instead where all tools are promised."""
    for marker in item.iter_markers("tool"):
        for name in marker.args:
            if shutil.which(name) is None:
                message = f"{name} is not on PATH (apt-get install it, or see CONTRIBUTING.md)"
                if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
                    pytest.fail(message, pytrace=False)
                pytest.skip(message)
