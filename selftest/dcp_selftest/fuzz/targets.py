"""Targets of our own code in this process: the reference node, a mutant of it, and functions."""

from __future__ import annotations

from dcp_conformance.errors import UsageError
from dcp_lab.fuzz.execute.stack import StackTarget
from dcp_lab.fuzz.findings.artefact import Artefact, codec_of
from dcp_lab.fuzz.steps import Target

from dcp_codec.codec import Codec
from dcp_selftest.mutants import ALL_MUTANTS

from .functions import FunctionTarget


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
        f"artefact {artefact.id} is of a live implementation: 'dcp-conformance fuzz replay' repeats it, "
        "with --interface IF or --link udp"
    )


def stack_target(codec: Codec, mutant: str = "") -> StackTarget:
    """Return the reference node in process, or a mutant of it. Raises :class:`UsageError` for an unknown mutant."""
    if not mutant:
        return StackTarget(codec)
    return StackTarget(codec, make=ALL_MUTANTS.get(mutant).make, name=f"the mutant {mutant}")
