"""Draw generated mutants by a seed, try them on all processors, and compare the outcomes with the ledger."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from multiprocessing.context import ForkServerContext
from typing import Final

import msgspec
from dcp_conformance.errors import ConformanceError
from dcp_spec.version import __version__

from dcp_codec.common.workers import completed

from .isolation import ask, process_context
from .ledger import Entry, ledger
from .reach import Reach
from .sites import Site, sites
from .trial import NODES, PROFILES, Outcome, Step, limit, measure, steps, try_site

SCHEMA: Final = "dcp-conformance-generated/1"
#: Number of changes from which on it saves time to measure first which cases execute them.
_MANY: Final = 40


class Trial(msgspec.Struct, frozen=True):
    """A change and its outcome."""

    site: Site
    outcome: Outcome
    excused: str = ""
    """The reason in the ledger why the change cannot be observed from outside; empty if it is not in the ledger."""

    @property
    def killed(self) -> bool:
        """Whether a case failed, or the node does not work at all."""
        return self.outcome.fate in ("killed", "broken")


class GeneratedResult(msgspec.Struct, frozen=True, kw_only=True):
    """The content of ``generated.json``."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    seed: int | None = None
    drawn: int = 0
    sites: int = 0
    """The number of all possible changes."""
    ledger: int = 0
    """The number of possible changes that are in the ledger."""
    duration: float = 0.0
    """Seconds."""
    trials: tuple[Trial, ...] = ()

    @property
    def judged(self) -> tuple[Trial, ...]:
        """The trials that count: changes that are not in the ledger."""
        return tuple(each for each in self.trials if not each.excused)

    @property
    def survivors(self) -> tuple[Trial, ...]:
        """The trials that count and were not killed."""
        return tuple(each for each in self.judged if not each.killed)

    @property
    def by_model(self) -> tuple[Trial, ...]:
        """The trials that count and were killed by a case of the model, but by no hand-written case."""
        return tuple(each for each in self.judged if each.killed and each.outcome.by_model)

    @property
    def misplaced(self) -> tuple[Trial, ...]:
        """The trials of changes that are in the ledger although a case kills them: the reason there is wrong."""
        return tuple(each for each in self.trials if each.excused and each.outcome.fate == "killed")

    @property
    def score(self) -> float:
        """The share of counted trials that were killed, 0 to 1; 1 without any trial."""
        return 1 - len(self.survivors) / len(self.judged) if self.judged else 1.0


def draw(count: int, seed: int, *, patterns: Sequence[str] = ()) -> list[Site]:
    """Draw ``count`` different changes at random, reproducibly by ``seed`` for the same source.

    ``patterns`` restricts the draw to changes whose text contains one of them, or whose key equals one of them.
    """
    pool = [site for site in sites() if not patterns or any(each in str(site) or each == site.key for each in patterns)]
    rng = random.Random(seed)  # noqa: S311 - a draw that can be repeated
    return rng.sample(pool, min(count, len(pool)))


def reach(*, jobs: int | None = None) -> tuple[Reach, ...]:
    """Measure the lines that the cases execute on each node. Takes about as long as ten runs of the suite per node."""
    measured = dict(completed(partial(_measured, process_context()), NODES, jobs, start="thread"))
    return tuple(measured[place] for place in range(len(NODES)))


def run(
    chosen: Iterable[Site],
    *,
    seed: int | None = None,
    jobs: int | None = None,
    excused: bool = False,
    reached: Sequence[Reach] | None = None,
    on_result: Callable[[Trial], None] | None = None,
) -> GeneratedResult:
    """Try each of the changes in a separate process, ``jobs`` at a time (default: one for each processor).

    ``excused`` also tries changes in the ledger, to find entries that a case kills. ``reached`` has the lines that the
    cases execute (see :func:`reach`); by default they are measured if many changes are tried. ``seed`` is only stored
    in the result. ``on_result`` is called with each trial when it is complete.

    Raise :class:`ConformanceError` if the node does not work without a change: every change would count as killed.
    """
    began = time.monotonic()
    excuses = ledger()
    context = process_context()
    _require_working(context)

    def attempt(site: Site) -> Trial:
        entry: Entry | None = excuses.get(site.key)
        if entry is not None and not excused:
            return Trial(site, Outcome(site.key, "excused"), entry.text)
        outcome = _in_process(context, site, steps(site, known))
        return Trial(site, outcome, entry.text if entry is not None else "")

    trials: list[Trial] = []
    chosen = list(chosen)
    if reached is None:
        reached = reach(jobs=jobs) if len(chosen) >= _MANY else ()
    known = tuple(reached)

    with contextlib.suppress(KeyboardInterrupt):
        for _, trial in completed(attempt, chosen, jobs, start="thread"):
            trials.append(trial)
            if on_result is not None:
                on_result(trial)
    order = {site.key: number for number, site in enumerate(sites())}
    return GeneratedResult(
        seed=seed,
        drawn=len(chosen),
        sites=len(order),
        ledger=len(set(order) & set(excuses)),
        duration=round(time.monotonic() - began, 1),
        trials=tuple(sorted(trials, key=lambda trial: order[trial.site.key])),
    )


def _require_working(context: ForkServerContext) -> None:
    """Run the sanity case against the unchanged node. Raise :class:`ConformanceError` if it fails."""
    answer, fate = ask(context, _try, None, (Step(PROFILES[0], (0,)),))
    outcome = msgspec.json.decode(answer, type=Outcome) if answer else None
    if outcome is None or outcome.fate != "survived":
        raise ConformanceError(f"the node does not work without a change: {outcome.by if outcome else fate}")


def _in_process(context: ForkServerContext, site: Site, plan: Sequence[Step]) -> Outcome:
    if not plan:
        return Outcome(site.key, "survived", "no case executes this code")
    began = time.monotonic()
    answer, fate = ask(context, _try, site, plan)
    if answer:
        outcome: Outcome = msgspec.json.decode(answer, type=Outcome)
        return outcome
    # The process ended by SIGXCPU or for lack of memory: an endless loop of the node.
    return Outcome(site.key, "broken", fate, "", round(time.monotonic() - began, 2))


def _measured(context: ForkServerContext, node: str) -> Reach:
    answer, fate = ask(context, _measure, node)
    if not answer:
        raise RuntimeError(f"cannot measure the lines that the cases execute on {node}: {fate}")
    return msgspec.msgpack.decode(answer, type=Reach)


def _try(site: Site | None, plan: Sequence[Step]) -> bytes:
    limit()
    return msgspec.json.encode(try_site(site, plan))


def _measure(node: str) -> bytes:
    return msgspec.msgpack.encode(measure(node))
