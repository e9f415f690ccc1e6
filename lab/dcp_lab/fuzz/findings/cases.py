"""Make conformance cases of artefacts, so that earlier findings are tested again in each run.

The identifier of a case is ``TC_DCP_FUZZ_BI_01-`` and the identifier of its artefact, which depends only on the
contents of the artefact.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from dcp_conformance.definitions.case import Case, Kind
from dcp_conformance.stateful.judged import judge
from dcp_conformance.test_system.bench import Bench

from dcp_lab.fuzz.execute.live import RATE, carry_out
from dcp_lab.fuzz.execute.liveness import lifelessness
from dcp_lab.fuzz.reduce.causes import decided_by
from dcp_lab.fuzz.steps import ROBUSTNESS, STOPPED

from .artefact import Artefact, found_in, load
from .counterexample import steps_of

BASE = "TC_DCP_FUZZ_BI_01"


def artefact_cases(folder: Path) -> list[Case]:
    """Return the cases of a folder, without artefacts of functions in process. Raises ``UsageError``."""
    artefacts = [(path, load(path)) for path in found_in([folder])]
    return [case_of(artefact, path, folder) for path, artefact in artefacts if artefact.target.mode != "codec"]


def case_of(artefact: Artefact, path: Path, folder: Path) -> Case:
    """Return the case of one artefact in a folder. Its implicit requirement is that the implementation survives."""
    modelled = steps_of(artefact)
    stops = artefact.effect.kind in STOPPED
    return Case(
        id=f"{BASE}-{artefact.id}",
        purpose=f"An earlier finding of the fuzzer does not occur again: {artefact.effect.detail}"[:160],
        # Older artefacts of a crash name no requirement.
        requirements=artefact.effect.requirements or ROBUSTNESS,
        kind=Kind.INVALID,
        stimulus=f"the {len(artefact.steps)} steps of {path.name}"
        + ("" if modelled else f", {artefact.frames} of them frames"),
        expect="the implementation lives and answers; for a sequence of the model: nothing that the model forbids",
        window=4,
        section="Fuzzing: findings of earlier campaigns",
        module=__name__,
        run=partial(run, artefact),
        destructive=stops,
        robustness=stops or not artefact.effect.requirements,
        options=("--artefacts", str(folder)),
    )


def run(artefact: Artefact, bench: Bench) -> None:
    """Execute the steps of an artefact as a case, and check that no effect occurs."""
    if artefact.profile != bench.profile.name:
        bench.inconclusive(
            f"the profile of the artefact, {artefact.profile}", f"the implementation speaks {bench.profile.name}"
        )
    if steps := steps_of(artefact):
        judge(bench, steps, alone=True)
        return
    if (why := lifelessness(bench, None)) is not None:
        bench.inconclusive("a healthy implementation before anything is sent", why.detail)
    effect = carry_out(bench, artefact.as_steps(), None, round(1e9 / RATE))
    if effect is None:
        bench.passed("nothing is wrong after these steps", *artefact.effect.requirements)
        return
    # The artefact names the requirements of its own effect; another effect is decided by its own signature.
    known = effect.signature == artefact.effect.signature and artefact.effect.requirements
    bench.some(False, "nothing is wrong after these steps", *(known or decided_by(effect)), seen=effect.detail)
