"""Counterexamples of the model as artefacts: files that ``fuzz replay`` repeats, and that ``run`` takes as cases."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
from dcp_spec.version import __version__

from dcp_conformance.errors import UsageError
from dcp_conformance.fuzz.steps import Effect
from dcp_conformance.stateful.driver import Counterexample
from dcp_conformance.stateful.steps import Step, text

from .artefact import Artefact, SavedEffect, SavedStep, SavedTarget


def artefact_of(
    found: Counterexample, profile: str, *, name: str, options: str, seed: int, directory: Path
) -> Artefact:
    """Return the artefact of a counterexample that will be saved in ``directory``.

    ``name``: that of the implementation. ``options``: those with which a command reaches it.
    """
    finding = found.finding
    steps = tuple(SavedStep(note=text(each), model=msgspec.to_builtins(each)) for each in found.steps)
    effect = effect_of(found)
    digest = hashlib.sha256(profile.encode() + effect.signature.encode() + msgspec.json.encode(steps)).hexdigest()
    identifier = f"model-{digest[:8]}"
    again = f"dcp-conformance fuzz replay {shlex.quote(f'{directory / identifier}.json')} {options}"
    return Artefact(
        id=identifier,
        tool=f"dcp-conformance {__version__}",
        profile=profile,
        seed=seed,
        target=SavedTarget("model", name, options=options),
        effect=SavedEffect("model", effect.detail, effect.step, effect.signature, finding.requirements),
        steps=steps,
        command=again.rstrip(),
    )


def effect_of(found: Counterexample) -> Effect:
    """Return a counterexample as the effect of its last step."""
    finding = found.finding
    detail = f"expected {finding.expected}; came {finding.observed}"
    return Effect("model", detail, max(len(found.steps) - 1, 0), " ".join(finding.requirements))


def steps_of(artefact: Artefact) -> list[Step]:
    """Return the steps of a counterexample; none for another artefact. Raises :class:`UsageError`."""
    if artefact.target.mode != "model":
        return []
    return list(_converted([each.model for each in artefact.steps], artefact.id))


def _converted(steps: Sequence[Any], where: str) -> Iterable[Step]:
    for number, each in enumerate(steps):
        try:
            yield msgspec.convert(each, Step)
        except msgspec.ValidationError as error:
            raise UsageError(f"artefact {where}: step {number}: {error}") from None
