"""``dcp-conformance report --minimise``: execute cases again to determine the necessary frames of their stimuli."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from dcp_codec.common.commandline import say
from dcp_conformance.errors import UsageError

from .options import target_of

if TYPE_CHECKING:
    from dcp_conformance.model.results import CaseResult, Check
    from dcp_conformance.reporting.issues.write import Minimise


@contextmanager
def minimiser(options: dict[str, Any]) -> Iterator[Minimise]:
    """Open the implementation; provide a function for :func:`~dcp_conformance.reporting.issues.write_issues`.

    Raise ``UsageError`` if the options name no implementation, and the errors of
    :func:`~dcp_conformance.execution.target.open_target`.
    """
    from dcp_conformance.execution.minimising import executor, minimise
    from dcp_conformance.execution.runner import Runner
    from dcp_conformance.execution.target import open_target
    from dcp_conformance.model.case import SANITY, all_cases
    from dcp_conformance.model.pics import Pics
    from dcp_conformance.reference.inprocess import InProcess, reference_config
    from dcp_conformance.test_system.session import Session

    target = target_of(options)
    if not (target.foreign or target.in_process):
        raise UsageError(
            "--minimise executes cases again: name the implementation as for the run (--interface or --link, --ut, "
            "--pics, --start, ...)"
        )
    cases = all_cases()
    with open_target(target) as opened:
        runner = opened.runner
        runner.prepare()
        if target.foreign and target.start:
            runner.life.await_start(cases[SANITY], lambda _: None)
        sut = InProcess(reference_config(opened.codec))
        upper = sut.upper_tester() if runner.session.upper is not None else None
        reference = Runner(Session(opened.codec, sut.lower_tester(), upper, Pics()), sut)
        reference.prepare()
        for each in (runner, reference):
            each.run(cases[SANITY])

        def needed(result: CaseResult, check: Check, frames: Sequence[int]) -> tuple[int, ...] | None:
            case = cases.get(result.id)
            if case is None or not frames or runner.dead:
                return None
            found = minimise(check, frames, executor(runner, case), executor(reference, case))
            outcome = f"{len(found or ())} of {len(frames)} frames are needed"
            say(f"{case.id}: {outcome if found is not None else 'the check did not fail again'}", err=True)
            return found

        yield needed
