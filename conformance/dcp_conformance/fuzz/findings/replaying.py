"""Doing findings again: is it fixed, does it still fail, now and then, or can it not be said."""

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
#: How often an artefact is done again.
ATTEMPTS = 3


class Replayed(NamedTuple):
    """What came of an artefact."""

    path: Path
    status: Status
    detail: str


def replay(path: Path, target_of: Callable[[Artefact], Target], *, attempts: int = ATTEMPTS) -> Replayed:
    """Do one artefact again, ``attempts`` times, on the target that ``target_of`` opens for it.

    ``failed``: the same effect each time; ``fixed``: no effect at all; ``flaky``: anything between, also another
    effect; ``error``: it could not be done.
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
    """The status of an artefact after these attempts."""
    seen = [effect for effect in effects if effect is not None]
    if not seen:
        return "fixed", f"no effect in {len(effects)} attempts"
    same = [effect for effect in seen if effect.signature == artefact.effect.signature]
    if len(same) == len(effects):
        return "failed", same[0].detail
    others = "" if len(same) == len(seen) else f", another one: {next(e for e in seen if e not in same).detail}"
    return "flaky", f"the effect in {len(same)} of {len(effects)} attempts{others}"


def target_in_process(artefact: Artefact) -> Target:
    """The target of an artefact of the codec or of a stack in process.

    Raises :class:`UsageError` for other artefacts, which need to be told where the implementation is.
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
    """Our node in process, or a mutant of it. Raises :class:`UsageError` for a mutant that does not exist."""
    if not mutant:
        return StackTarget(codec)
    from dcp_conformance.selftest.mutants import all_mutants

    known = all_mutants()
    if mutant not in known:
        near = ", ".join(name for name in known if name.startswith(mutant[:8])) or "see dcp-conformance selftest --list"
        raise UsageError(f"there is no mutant {mutant!r}: {near}")
    return StackTarget(codec, make=known[mutant].make, name=f"the mutant {mutant}")
