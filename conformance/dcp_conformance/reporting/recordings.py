"""Write the frames of each case as MCAP and pcapng, with the command that runs the case again."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import msgspec

from dcp_codec.capture import CaptureError, Frame, create_capture
from dcp_conformance.definitions.results import CaseResult, RunResult
from dcp_conformance.errors import UsageError

FOLDER = "cases"


def write_recordings(run: RunResult, directory: Path) -> RunResult:
    """Write the frames of each case into the subfolder ``cases``. Returns the run with the file names added.

    Raises ``OSError`` if a file cannot be written, and :class:`UsageError` for frames that the formats cannot store.
    """
    cases = []
    for case in run.cases:
        frames = _frames(case)
        if not frames:
            cases.append(case)
            continue
        (directory / FOLDER).mkdir(exist_ok=True)
        stem = re.sub(r"[^A-Za-z0-9._+=-]", "_", case.id) + (f".{case.attempt}" if case.attempt > 1 else "")
        for suffix in (".mcap", ".pcapng"):
            _write(directory / FOLDER / (stem + suffix), frames, run, case)
        cases.append(msgspec.structs.replace(case, recording=f"{FOLDER}/{stem}"))
    return msgspec.structs.replace(run, cases=tuple(cases))


def _frames(case: CaseResult) -> list[Frame]:
    events = [event for event in case.evidence if event.octets]
    # Events keep their order: a received frame has the time stamp of the kernel, which can be earlier than that of a
    # frame sent before.
    frames = [(event.frame, event.time, bytes.fromhex(event.octets)) for event in events]
    return [Frame(number, time, octets, len(octets)) for number, time, octets in frames]


def _write(path: Path, frames: list[Frame], run: RunResult, case: CaseResult) -> None:
    about = {
        "dcp.case": {
            "id": case.id,
            "purpose": case.purpose,
            "verdict": str(case.verdict),
            "reason": case.reason,
            "profile": run.profile,
            "command": case.rerun,
            "tool": run.tool,
        }
    }
    metadata = about if path.suffix == ".mcap" else {"interface.0": {"name": case.id, "description": case.rerun}}
    write_frames(path, frames, metadata)


def write_frames(path: Path, frames: Iterable[Frame], metadata: dict[str, dict[str, str]]) -> None:
    """Write frames as a recording. Raises :class:`UsageError` for frames that the format cannot store."""
    try:
        with create_capture(path, metadata=metadata) as writer:
            for frame in frames:
                writer.write(frame)
    except CaptureError as error:
        raise UsageError(str(error)) from None
