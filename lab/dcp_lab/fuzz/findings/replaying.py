"""Replay findings, and classify each as fixed, failed, flaky or error."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal, NamedTuple

from dcp_conformance.errors import ConformanceError

from dcp_lab.fuzz.steps import Effect, Target

from .artefact import Artefact, load

Status = Literal["fixed", "failed", "flaky", "error"]
#: Default number of executions of an artefact.
ATTEMPTS = 3


class Replayed(NamedTuple):
    """Result of the replay of an artefact."""

    path: Path
    status: Status
    detail: str


def replay(path: Path, target_of: Callable[[Artefact], Target], *, attempts: int = ATTEMPTS) -> Replayed:
    """Execute one artefact ``attempts`` times on the target that ``target_of`` opens for it.

    ``failed``: the same effect each time; ``fixed``: no effect at all; ``flaky``: the effect in some executions, or
    another effect; ``error``: it could not be executed.
    """
    try:
        artefact = load(path)
        target = target_of(artefact)
        steps = artefact.as_steps()
        effects = [target.run(list(steps)) for _ in range(attempts)]
    except ConformanceError as error:
        return Replayed(path, "error", str(error))
    return Replayed(path, *judged(artefact, effects))


def judged(artefact: Artefact, effects: list[Effect | None]) -> tuple[Status, str]:
    """Return the status of an artefact after these executions, and its description."""
    seen = [effect for effect in effects if effect is not None]
    if not seen:
        return "fixed", f"no effect in {len(effects)} attempts"
    same = [effect for effect in seen if effect.signature == artefact.effect.signature]
    if len(same) == len(effects):
        return "failed", same[0].detail
    others = "" if len(same) == len(seen) else f", another one: {next(e for e in seen if e not in same).detail}"
    return "flaky", f"the effect in {len(same)} of {len(effects)} attempts{others}"


def replay_all(
    paths: Iterable[Path],
    target_of: Callable[[Artefact], Target],
    *,
    attempts: int,
    on_result: Callable[[Replayed], None],
) -> int:
    """Replay artefacts in succession. Return the exit status: 4 after an error, 1 if a finding is not fixed, else 0."""
    statuses = set()
    for path in paths:
        found = replay(path, target_of, attempts=attempts)
        on_result(found)
        statuses.add(found.status)
    return 4 if "error" in statuses else 1 if statuses & {"failed", "flaky"} else 0
