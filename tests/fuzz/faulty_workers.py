"""Campaigns for workers with a fault; workers import this by name, from the path that the tests have."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from typing import Any

from dcp_conformance.cli.fuzz import stack_campaign
from dcp_conformance.errors import UsageError
from dcp_conformance.fuzz import Campaign, Effect, Step, Target


class Crashing:
    """Ends its process with the test after so many, as code that is not Python's may."""

    name = "crashing"

    def __init__(self, target: Target, after: int) -> None:
        self.target = target
        self.left = after

    def run(self, steps: list[Step]) -> Effect | None:
        if not self.left:
            os.kill(os.getpid(), signal.SIGSEGV)
        self.left -= 1
        return self.target.run(steps)


@contextlib.contextmanager
def crashing(options: dict[str, Any], after: int, seed: str) -> Iterator[Campaign]:
    """The second worker crashes."""
    with stack_campaign(options, seed) as campaign:
        if seed.endswith("/1"):
            campaign.target = Crashing(campaign.target, after)
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
