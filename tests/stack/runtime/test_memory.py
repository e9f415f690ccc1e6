"""How a node manages its memory."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.part("tools")
def test_live_objects_survive_the_freezing_of_memory():
    """In a process of its own: the collector is frozen, and pages move."""
    program = (
        "import gc, random\n"
        "from dcp_stack.runtime.memory import settle\n"
        "kept = [random.Random(n).randbytes(100) for n in range(60000)]\n"
        "settle()\n"
        "assert gc.get_freeze_count() > 1000\n"
        "assert kept == [random.Random(n).randbytes(100) for n in range(60000)]\n"
        "print('well')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("well\n", "")
