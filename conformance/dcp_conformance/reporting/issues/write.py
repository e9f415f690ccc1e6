"""One folder with a Markdown file, a Python program and a C array for each probable fault."""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from dcp_spec.catalogue.requirements import requirements
from jinja2 import Environment, PackageLoader, StrictUndefined

from dcp_codec.codec import Codec
from dcp_codec.common.atomic_write import write_whole
from dcp_codec.common.printable import plain
from dcp_conformance.errors import UsageError
from dcp_conformance.model.results import CaseResult, Check, Probable, RunResult
from dcp_conformance.model.verdict import Verdict
from dcp_conformance.reporting.frames import Frames
from dcp_conformance.reporting.overview import certainty

from .stimulus import Step, needs_calls, only, stimulus

#: Failed checks of the best case that are shown, frames of each, and cases that are listed.
_CHECKS, _FRAMES, _CASES = 4, 2, 12


Minimise = Callable[[CaseResult, Check, Sequence[int]], tuple[int, ...] | None]
"""Returns the frames of a case, of those at the given places (from 0, among all that the tester sent), that are needed
for the check to fail; None if that could not be found out."""


def write_issues(run: RunResult, folder: Path, codec: Codec | None, minimise: Minimise | None = None) -> list[Path]:
    """Write the reports of a run with a diagnosis. Returns the Markdown files, the most important fault first.

    ``codec`` takes frames apart; without one, octets are shown only. ``minimise`` finds the frames of a stimulus that
    are needed; without it, all are given. Raises ``UsageError`` if there is nothing to report, or if a file cannot be
    written.
    """
    if run.diagnosis is None or not run.diagnosis.faults:
        raise UsageError("there is no probable fault in these results; --issues needs a run in which cases failed")
    environment = _environment()
    by_id = {case.id: case for case in run.cases}
    written: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for number, fault in enumerate(run.diagnosis.faults, 1):
            case = by_id.get(fault.case)
            if case is None or fault.check is None:
                continue
            name = f"{number:02d}-{_slug(fault.what)}"
            steps = stimulus(case, fault.check)
            places = [step.frame for step in steps if step.octets]
            needed = minimise(case, fault.check, places) if minimise is not None and not case.left_out else None
            if needed is not None:
                steps = only(steps, needed)
            context = _context(run, fault, case, steps, Frames(codec), name)
            context["left_out"] = len(places) - len(needed) if needed is not None else 0
            context["minimised"] = needed is not None
            for template, suffix in (("issue.md", ".md"), ("reproduce.py.txt", ".py"), ("stimulus.h.txt", ".h")):
                if suffix == ".md" or any(step.octets for step in steps):
                    text = environment.get_template(template).render(**context)
                    write_whole(folder / f"{name}{suffix}", text.encode())
            written.append(folder / f"{name}.md")
    except OSError as error:
        raise UsageError(f"{error.filename or folder}: cannot be written: {error.strerror or error}") from None
    return written


def _environment() -> Environment:
    # Markdown and programs, no HTML: everything that is not ours goes through the filters below.
    found = Environment(
        loader=PackageLoader("dcp_conformance.reporting.issues"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,  # noqa: S701
        keep_trailing_newline=True,
    )
    found.filters["md"] = markdown
    found.filters["literal"] = repr
    found.filters["comment"] = comment
    found.filters["code"] = code
    found.filters["c_octets"] = c_octets
    found.filters["py_octets"] = py_octets
    return found


def markdown(text: object) -> str:
    """Text that is not ours, so that it is shown as it is: no markup, links, HTML or control characters."""
    return re.sub(r"([\\`*_{}\[\]()#+!|<>~@&])", r"\\\1", plain(str(text)).replace("\n", " "))


def comment(text: object) -> str:
    """Text that is not ours, for a comment of one line in C or Python."""
    return plain(str(text)).replace("\n", " ").replace("*/", "* /").replace("\\", "/").replace('"', "'")


def code(text: object) -> str:
    """Text that is not ours, as a code span of Markdown."""
    return f"`{plain(str(text)).replace(chr(10), ' ').replace('`', chr(39))}`"


def c_octets(octets: bytes) -> str:
    """Octets as the inside of a C initialiser."""
    return textwrap.fill(
        ", ".join(f"0x{octet:02x}" for octet in octets), 76, initial_indent="    ", subsequent_indent="    "
    )


def py_octets(octets: bytes) -> str:
    """Octets as Python string literals, several lines of them if needed."""
    digits = octets.hex()
    return "\n".join(f'        "{digits[place : place + 80]}"' for place in range(0, len(digits), 80))


def _context(
    run: RunResult, fault: Probable, case: CaseResult, steps: list[Step], frames: Frames, name: str
) -> dict[str, Any]:
    known = requirements()
    failed = [check for check in case.checks if check.verdict is Verdict.FAIL]
    link = run.sut.link.split(":")
    udp = link[0] == "udp"
    return {
        "run": run,
        "sut": " ".join(filter(None, (run.sut.name, run.sut.version))) or "the implementation",
        "fault": fault,
        "case": case,
        "certainty": certainty(fault),
        "entries": [known[each] for each in fault.requirements if each in known],
        "checks": [
            {"expected": check.expected, "observed": check.observed, "frames": _shown(case, check, frames)}
            for check in failed[:_CHECKS]
        ],
        "more_checks": max(0, len(failed) - _CHECKS),
        "steps": steps,
        "calls": needs_calls(steps),
        "direction": {"SUT \u2192": "sent by the implementation", "\u2192 SUT": "sent by the tester"},
        "cases": fault.explains[:_CASES],
        "more_cases": max(0, len(fault.explains) - _CASES),
        "name": name,
        "udp": udp,
        "group": link[1] if udp and len(link) > 1 else "",
        "port": int(link[2]) if udp and len(link) > 2 and link[2].isdigit() else 0,
        "recording": os.fspath(Path(case.recording).name) if case.recording else "",
    }


def _shown(case: CaseResult, check: Check, frames: Frames) -> list[dict[str, Any]]:
    """The frames of a check, taken apart; octets that matter are marked."""
    events = {event.frame: event for event in case.evidence if event.frame}
    begin = case.evidence[0].time if case.evidence else 0
    numbers = list(dict.fromkeys(mark.frame for mark in check.frames if mark.frame in events))
    shown = [
        frames.frame(events[number], [mark for mark in check.frames if mark.frame == number], begin)
        for number in numbers[:_FRAMES]
    ]
    return [
        {**frame, "marked": any(kind == "bad" for row in frame["rows"] for _, kind in row["cells"])} for frame in shown
    ]


def _slug(text: str) -> str:
    words = re.findall(r"[a-z0-9]+", text.lower())
    return "-".join(words)[:60].strip("-") or "fault"
