"""``dcp-conformance selftest --smoke-plan``: durations of the cases, and the smoke plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dcp_codec.common.commandline import say
from dcp_conformance.errors import UsageError


def make_smoke_plan(options: dict[str, Any]) -> int:
    """Measure the durations of the cases, choose the smoke plan, and write both. Return the exit status."""
    from dcp_conformance.diagnosis import load
    from dcp_conformance.model.case_times import encode
    from dcp_conformance.model.results import CaseResult
    from dcp_conformance.selftest.smoke_plan import make

    from .display import progress_bar

    file: Path = options["smoke_plan"]
    with progress_bar(quiet=options["quiet"]) as progress:
        task = progress.add_task("cases", total=None)

        def done(result: CaseResult) -> None:
            progress.update(task, advance=1, description=result.id)

        times = make(done)
    try:
        file.write_bytes(encode(times))
    except OSError as error:
        raise UsageError(f"{file}: cannot be written: {error.strerror or error}") from None
    detected, known = sum(times.smoke.values()), sum(bool(fault.fails) for fault in load().faults)
    say(f"{len(times.smoke)} of {len(times.seconds)} cases detect {detected} of {known} faults; {file}")
    return 0
