"""Execute the body of a case, and record exceptions that end it as checks."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import (
    ConformanceError,
    CouldNotAskError,
    LowerTesterError,
    NamesUsedUp,
    StopCase,
    UpperTesterError,
)
from dcp_conformance.impaired_link import engaged

from .survival.attribution import Trial, likely_stimulus


@contextmanager
def recorded(trial: Trial) -> Iterator[None]:
    """Record an exception of the block as a check of the case. Exceptions outside of ``Exception`` are propagated."""
    case, checks = trial.case, trial.bench.verdicts.checks
    try:
        yield
    except NamesUsedUp:
        trial.used_up = True
    except StopCase:
        pass
    except CouldNotAskError as error:
        what = "the upper tester can ask the implementation"
        checks.append(Check(Verdict.INCONCLUSIVE, case.requirements, what, f"it could not: {error}"))
    except UpperTesterError as error:
        trial.upper_tester_error = str(error)
        checks.append(Check(Verdict.INCONCLUSIVE, case.requirements, "the upper tester answers", str(error)))
    except LowerTesterError as error:
        checks.append(Check(Verdict.ERROR, case.requirements, "the link can be used", str(error)))
    except ConformanceError as error:
        what = "the implementation is in its initial state"
        checks.append(Check(Verdict.INCONCLUSIVE, case.requirements, what, str(error)))
    except Exception as error:
        trial.detail = "".join(traceback.format_exception(error))
        what = f"{type(error).__name__}: {error}"
        checks.append(Check(Verdict.ERROR, case.requirements, "the case runs without an internal error", what))


def run_body(trial: Trial) -> None:
    """Run the body of the case, and undo what it has changed."""
    case, bench = trial.case, trial.bench
    bench.mark()
    bench.heard.clear()
    # Discard the losses before the case: they do not disturb it.
    bench.lower.health()
    try:
        # The sanity case runs without impairments that lose or change frames.
        with engaged(bench.lower) if case.id != SANITY else nullcontext():
            case.run(bench)
    finally:
        # Determined before restore(): calls that undo changes are not the cause of a death.
        trial.stimulus = likely_stimulus(case, bench)
        bench.restoration.restore()


def delete_variables(trial: Trial, serves: Callable[[], bool]) -> bool:
    """Delete the variables that the case has created, so that their summaries do not fill the beacons of later cases.

    ``serves`` returns whether the upper tester answers. Return False if the deletion did not succeed.
    """
    bench = trial.bench
    made = bench.identifiers.created | bench.identifiers.produced
    if not made or not (bench.traffic.frames or bench.identifiers.produced):
        return True
    upper = bench.session.upper
    try:
        if upper is not None and "RTDB-Delete" in upper.methods and bench.identifiers.produced:
            if "UT-Hello" in upper.methods and not serves():
                # The upper tester was lost before the deletions, so that they are not the cause.
                return False
            _delete_own(trial)
        peer = bench.peer()
        peer.send_all(peer.delete(var_id) for var_id in sorted(made))
        bench.wait(1)
        for var_id in made:
            bench.session.identifier_pool.deleted(var_id, bench.identifiers.departure())
    except UpperTesterError as error:
        trial.upper_tester_error = str(error)
        return False
    except LowerTesterError:
        return False
    return True


def _delete_own(trial: Trial) -> None:
    """Delete the variables of the implementation's application; if a call fails, it becomes the trial's stimulus."""
    bench = trial.bench
    for var_id in sorted(bench.identifiers.produced):
        try:
            bench.call("RTDB-Delete", varId=var_id)
        except UpperTesterError:
            calls = (event for event in reversed(bench.traffic.events) if event.direction == "call")
            trial.stimulus = next(calls, None)
            raise
