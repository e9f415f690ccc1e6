"""Many generated mutants: drawn by a seed, tried on all processors, held against the ledger."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

import msgspec
from dcp_spec.version import __version__

from .ledger import Entry, ledger
from .sites import Site, sites
from .trial import CPU_SECONDS, Outcome, limit, try_site

SCHEMA: Final = "dcp-conformance-generated/1"
#: Seconds that a process may take by the clock: the processors may have other work.
_PATIENCE: Final = 10.0 * CPU_SECONDS


class Trial(msgspec.Struct, frozen=True):
    """A change and what became of it."""

    site: Site
    outcome: Outcome
    excused: str = ""
    """Why it cannot be seen from outside, as the ledger says; empty if it is not in the ledger."""

    @property
    def killed(self) -> bool:
        """Whether the suite noticed in a way that a user sees: a failed case, or a node that does not work at all."""
        return self.outcome.fate in ("killed", "broken")


class GeneratedResult(msgspec.Struct, frozen=True, kw_only=True):
    """What ``generated.json`` holds."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    seed: int | None = None
    drawn: int = 0
    sites: int = 0
    """All changes that can be made."""
    ledger: int = 0
    """Those of them that the ledger excuses."""
    duration: float = 0.0
    """Seconds."""
    trials: tuple[Trial, ...] = ()

    @property
    def judged(self) -> tuple[Trial, ...]:
        """Trials that count: those that the ledger does not excuse."""
        return tuple(each for each in self.trials if not each.excused)

    @property
    def survivors(self) -> tuple[Trial, ...]:
        """Trials that count and were not killed."""
        return tuple(each for each in self.judged if not each.killed)

    @property
    def misplaced(self) -> tuple[Trial, ...]:
        """Entries of the ledger that a case kills: the reason given there is wrong."""
        return tuple(each for each in self.trials if each.excused and each.outcome.fate == "killed")

    @property
    def score(self) -> float:
        """The share of the trials that count which were killed, 0 to 1; 1 if there are none."""
        return 1 - len(self.survivors) / len(self.judged) if self.judged else 1.0


def draw(count: int, seed: int, *, patterns: Sequence[str] = ()) -> list[Site]:
    """Different changes, drawn at random; the same for the same seed and source. ``patterns``: parts of their text."""
    pool = [site for site in sites() if not patterns or any(each in str(site) or each == site.key for each in patterns)]
    rng = random.Random(seed)  # noqa: S311 - a draw that can be repeated
    return rng.sample(pool, min(count, len(pool)))


def run(
    chosen: Iterable[Site],
    *,
    seed: int | None = None,
    jobs: int | None = None,
    on_result: Callable[[Trial], None] | None = None,
) -> GeneratedResult:
    """Try each of the changes in a process of its own."""
    began = time.monotonic()
    excuses = ledger()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([f"{__package__}.preload"])

    def attempt(site: Site) -> Trial:
        entry: Entry | None = excuses.get(site.key)
        return Trial(site, _in_process(context, site), entry.text if entry is not None else "")

    trials: list[Trial] = []
    chosen = list(chosen)
    with ThreadPoolExecutor(jobs or os.cpu_count() or 1) as pool:
        waiting = [pool.submit(attempt, site) for site in chosen]
        try:
            for done in as_completed(waiting):
                trials.append(done.result())
                if on_result is not None:
                    on_result(trials[-1])
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
    order = {site.key: number for number, site in enumerate(sites())}
    known = set(order)
    return GeneratedResult(
        seed=seed,
        drawn=len(chosen),
        sites=len(order),
        ledger=len(known & set(excuses)),
        duration=round(time.monotonic() - began, 1),
        trials=tuple(sorted(trials, key=lambda trial: order[trial.site.key])),
    )


def _in_process(context: multiprocessing.context.ForkServerContext, site: Site) -> Outcome:
    began = time.monotonic()
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(theirs, site), daemon=True)
    process.start()
    theirs.close()
    try:
        if ours.poll(_PATIENCE):
            outcome: Outcome = msgspec.json.decode(ours.recv_bytes(), type=Outcome)
            return outcome
        fate = f"did not come to an end within {_PATIENCE:g} s"
    except (EOFError, OSError):
        process.join(5)
        # SIGXCPU, or out of memory: the node does not come to an end.
        fate = f"its process ended with status {process.exitcode}"
    finally:
        process.kill()
        process.join()
        ours.close()
    return Outcome(site.key, "broken", fate, "", round(time.monotonic() - began, 2))


def _child(to: Connection, site: Site) -> None:
    # What a broken node says of itself is not ours to show: there may be any amount of it.
    with Path(os.devnull).open("r+b") as nowhere:
        for descriptor in (1, 2):
            os.dup2(nowhere.fileno(), descriptor)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit()
    to.send_bytes(msgspec.json.encode(try_site(Site(*site))))
    to.close()
