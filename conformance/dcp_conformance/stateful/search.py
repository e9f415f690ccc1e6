"""Search for a counterexample with Hypothesis: the same seed draws the same sequences everywhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Final

import msgspec
from hypothesis import HealthCheck, Phase, Verbosity, settings
from hypothesis.database import DirectoryBasedExampleDatabase
from hypothesis.errors import Flaky
from hypothesis.stateful import get_state_machine_test

from .driver import Counterexample
from .executor import Executor
from .machine import NodeMachine

#: Sequences of one run of Hypothesis. From the tenth on, it varies the ones before instead of drawing new ones.
_INDEPENDENT: Final = 9


class Found(msgspec.Struct):
    """The result of a search."""

    counterexample: Counterexample | None
    reached: Counter[tuple[str, str]]
    sequences: int
    steps: int
    flaky: bool = False
    """Whether a counterexample was not seen again."""


def search(
    make: Callable[[], Executor] | None,
    *,
    sequences: int,
    steps: int = 12,
    seed: int = 1,
    shrink: bool = True,
    database: str = "",
    machine: type[NodeMachine] = NodeMachine,
    reached: Counter[tuple[str, str]] | None = None,
) -> Found:
    """Draw up to so many sequences of so many steps; stop at the first counterexample, and shrink it.

    ``make`` returns an implementation in its initial state; None: the machine does. ``database``: folder of examples,
    which are tried first.
    """
    counts: Counter[tuple[str, str]] = reached if reached is not None else Counter()
    done: Counter[str] = Counter()

    class Machine(machine):  # type: ignore[misc, valid-type]
        def open(self) -> Executor:
            return make() if make is not None else super().open()

    Machine.reached, Machine.executed = counts, done
    Machine.__name__ = Machine.__qualname__ = machine.__name__
    phases = [Phase.explicit, Phase.reuse, Phase.generate, *([Phase.shrink] if shrink else [])]
    chosen = settings(
        max_examples=min(sequences, _INDEPENDENT),
        stateful_step_count=steps,
        deadline=None,
        database=DirectoryBasedExampleDatabase(database) if database else None,
        derandomize=False,
        phases=phases if database else [each for each in phases if each is not Phase.reuse],
        suppress_health_check=list(HealthCheck),
        report_multiple_bugs=False,
        print_blob=False,
        verbosity=Verbosity.quiet,
    )
    found: Counterexample | None = None
    flaky = False
    runs = 0
    while found is None and not flaky and done["sequences"] < sequences:
        Machine._hypothesis_internal_use_seed = seed * 1_000_003 + runs
        runs += 1
        try:
            get_state_machine_test(Machine, settings=chosen)()
        except Counterexample as error:
            found = error
        except Flaky:
            flaky = True
    return Found(found, counts, done["sequences"], done["steps"], flaky)
