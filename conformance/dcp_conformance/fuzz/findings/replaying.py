"""Replay findings, and classify each as fixed, failed, flaky or error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

from dcp_codec.codec import Codec
from dcp_conformance.errors import ConformanceError, UsageError
from dcp_conformance.fuzz.execute.functions import FunctionTarget
from dcp_conformance.fuzz.execute.stack import StackTarget
from dcp_conformance.fuzz.steps import Effect, Target

from .artefact import Artefact, codec_of, load

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


def target_in_process(artefact: Artefact) -> Target:
    """Return the target of an artefact of the codec or of a stack in process.

    Raises :class:`UsageError` for other artefacts: they need the address of an implementation.
    """
    codec = codec_of(artefact)
    if artefact.target.mode == "codec":
        return FunctionTarget(codec)
    if artefact.target.mode == "stack":
        return stack_target(codec, artefact.target.mutant)
    raise UsageError(
        f"artefact {artefact.id} is of a live implementation: say where it is (--interface IF or --link udp)"
    )


def stack_target(codec: Codec, mutant: str = "") -> StackTarget:
    """Return the reference node in process, or a mutant of it. Raises :class:`UsageError` for an unknown mutant."""
    if not mutant:
        return StackTarget(codec)
    from dcp_conformance.selftest.mutants import all_mutants

    known = all_mutants()
    if mutant not in known:
        near = ", ".join(name for name in known if name.startswith(mutant[:8])) or "see dcp-conformance selftest --list"
        raise UsageError(f"there is no mutant {mutant!r}: {near}")
    return StackTarget(codec, make=known[mutant].make, name=f"the mutant {mutant}")
