"""Campaigns for workers with a fault; workers import this by name, from the path that the tests have."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dcp_conformance.errors import UsageError
from dcp_lab.fuzz import Campaign, Effect, Step, Target
from dcp_selftest.cli.fuzz import stack_campaign


class Crashing:
    """Ends its process with the test after so many, as code that is not Python's may.

    It crashes once another worker has done as many tests, so that the outcome does not depend on which is faster.
    """

    name = "crashing"

    def __init__(self, target: Target, after: int, others: Path) -> None:
        self.target = target
        self.left = after
        self.others = others

    def run(self, steps: list[Step]) -> Effect | None:
        if not self.left:
            # If the other one ends before, the campaign ends this process.
            while not self.others.exists():
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGSEGV)
        self.left -= 1
        return self.target.run(steps)


class Marking:
    """Makes a file with the test after so many."""

    name = "marking"

    def __init__(self, target: Target, after: int, file: Path) -> None:
        self.target = target
        self.left = after
        self.file = file

    def run(self, steps: list[Step]) -> Effect | None:
        if not self.left:
            self.file.touch()
        self.left -= 1
        return self.target.run(steps)


@contextlib.contextmanager
def crashing(options: dict[str, Any], after: int, file: Path, seed: str) -> Iterator[Campaign]:
    """The second worker crashes; the first one makes ``file`` for it."""
    with stack_campaign(options, seed) as campaign:
        kind = Crashing if seed.endswith("/1") else Marking
        campaign.target = kind(campaign.target, after, file)
        yield campaign


class Failing:
    """Draws so many tests."""

    def __init__(self, campaign: Campaign, tests: int) -> None:
        self.generator = campaign.generator
        self.left = tests

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.generator.kinds

    def draw(self) -> list[Step]:
        if not self.left:
            raise MemoryError("nothing left")
        self.left -= 1
        return self.generator.draw()

    def keep(self, steps: list[Step]) -> None:
        self.generator.keep(steps)


@contextlib.contextmanager
def failing(options: dict[str, Any], tests: int, seed: str) -> Iterator[Campaign]:
    """The generator of the first worker runs out of memory."""
    with stack_campaign(options, seed) as campaign:
        if seed.endswith("/0"):
            campaign.generator = Failing(campaign, tests)
        yield campaign


def unusable(seed: str) -> contextlib.AbstractContextManager[Campaign]:
    """No worker can begin."""
    raise UsageError(f"nothing is there for {seed}")
