"""Counterexamples of the model as artefacts: files that ``fuzz replay`` repeats, and that ``run`` takes as cases."""

from __future__ import annotations

from pathlib import Path

import msgspec
from dcp_conformance.errors import UsageError
from dcp_conformance.stateful.driver import Counterexample
from dcp_conformance.stateful.steps import Step, text

from dcp_lab.fuzz.steps import Effect

from .artefact import Artefact, SavedStep, SavedTarget, new_artefact


def artefact_of(
    found: Counterexample, profile: str, *, name: str, options: str, seed: int, directory: Path
) -> Artefact:
    """Return the artefact of a counterexample that will be saved in ``directory``.

    ``name``: that of the implementation. ``options``: those with which a command reaches it.
    """
    steps = tuple(SavedStep(note=text(each), model=msgspec.to_builtins(each)) for each in found.steps)
    target, decides = SavedTarget("model", name, options=options), found.finding.requirements
    return new_artefact(profile, target, effect_of(found), decides, steps, seed=seed, directory=directory)


def effect_of(found: Counterexample) -> Effect:
    """Return a counterexample as the effect of its last step."""
    finding = found.finding
    detail = f"expected {finding.expected}; came {finding.observed}"
    return Effect("model", detail, max(len(found.steps) - 1, 0), " ".join(finding.requirements))


def steps_of(artefact: Artefact) -> list[Step]:
    """Return the steps of a counterexample; none for another artefact. Raises :class:`UsageError`."""
    steps: list[Step] = []
    for number, each in enumerate(artefact.steps if artefact.target.mode == "model" else ()):
        try:
            steps.append(msgspec.convert(each.model, Step))
        except msgspec.ValidationError as error:
            raise UsageError(f"artefact {artefact.id}: step {number}: {error}") from None
    return steps
