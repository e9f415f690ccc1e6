"""Write a Markdown file, a Python program and a C header for each probable fault into one folder."""

from __future__ import annotations

import os
import re
import textwrap
from pathlib import Path
from typing import Any

from dcp_spec.catalogue.requirements import requirements
from jinja2 import Environment, PackageLoader, StrictUndefined

from dcp_codec.codec import Codec
from dcp_codec.common.atomic_write import write_whole
from dcp_codec.common.printable import plain
from dcp_conformance.definitions.results import CaseResult, Check, Probable, RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.reporting.frames import Frames
from dcp_conformance.reporting.overview import certainty, sentence, violated

from .stimulus import Step, needs_calls, stimulus

#: Maximum numbers: failed checks of the best case, frames of each check, cases in the list of evidence.
_CHECKS, _FRAMES, _CASES = 4, 2, 12


def write_issues(run: RunResult, folder: Path, codec: Codec | None) -> list[Path]:
    """Write one report for each fault of the diagnosis. Returns the Markdown files, the most important fault first.

    ``codec`` dissects the frames; without it the reports show octets only. Raises ``UsageError`` if the run has no
    diagnosed fault, or if a file cannot be written.
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
            name = f"{number:02d}-{_slug(fault.what if fault.likely else case.id)}"
            steps = stimulus(case, fault.check)
            context = _context(run, fault, case, steps, Frames(codec), name)
            for template, suffix in (("issue.md", ".md"), ("reproduce.py.txt", ".py"), ("stimulus.h.txt", ".h")):
                if suffix == ".md" or any(step.octets for step in steps):
                    text = environment.get_template(template).render(**context)
                    write_whole(folder / f"{name}{suffix}", text.encode())
            written.append(folder / f"{name}.md")
    except OSError as error:
        raise UsageError(f"{error.filename or folder}: cannot be written: {error.strerror or error}") from None
    return written


def _environment() -> Environment:
    # The output is Markdown, Python and C, not HTML, so autoescape would not help. Text from the implementation or the
    # results goes through the filters below.
    found = Environment(
        loader=PackageLoader("dcp_conformance.reporting.issues"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        autoescape=False,  # noqa: S701
        keep_trailing_newline=True,
    )
    found.filters.update(md=markdown, literal=repr, comment=comment, code=code, c_octets=c_octets, py_octets=py_octets)
    return found


def markdown(text: object) -> str:
    """Escape untrusted text for Markdown, so that it has no markup, links, HTML or control characters."""
    return re.sub(r"([\\`*_{}\[\]()#+!|<>~@&])", r"\\\1", plain(str(text)).replace("\n", " "))


def comment(text: object) -> str:
    """Escape untrusted text for a comment on one line in C or in Python."""
    return plain(str(text)).replace("\n", " ").replace("*/", "* /").replace("\\", "/").replace('"', "'")


def code(text: object) -> str:
    """Format untrusted text as a code span in Markdown."""
    return f"`{plain(str(text)).replace(chr(10), ' ').replace('`', chr(39))}`"


def c_octets(octets: bytes) -> str:
    """Format octets as the elements of a C array initialiser."""
    return textwrap.fill(
        ", ".join(f"0x{octet:02x}" for octet in octets), 76, initial_indent="    ", subsequent_indent="    "
    )


def py_octets(octets: bytes) -> str:
    """Format octets as hexadecimal Python string literals of at most 80 digits, one on each line."""
    digits = octets.hex()
    return "\n".join(f'        "{digits[place : place + 80]}"' for place in range(0, len(digits), 80))


def _context(
    run: RunResult, fault: Probable, case: CaseResult, steps: list[Step], frames: Frames, name: str
) -> dict[str, Any]:
    """Return the variables of the templates for one fault."""
    known = requirements()
    # If the fault is uncertain, the requirements are those of the check that failed.
    broken = fault.requirements if fault.likely or fault.check is None else fault.check.requirements
    failed = [check for check in case.checks if check.verdict is Verdict.FAIL]
    sut = " ".join(filter(None, (run.sut.name, run.sut.version))) or "the implementation"
    link = run.sut.link.split(":")
    udp = link[0] == "udp"
    return {
        "run": run,
        "sut": sut,
        "fault": fault,
        "case": case,
        "certainty": certainty(fault),
        "sentence": sentence(fault),
        "title": _title(fault, sut),
        "entries": [known[each] for each in broken if each in known],
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


def _title(fault: Probable, sut: str) -> str:
    """Return the fault if it is likely; else what was expected and observed, which does not depend on the fault."""
    if fault.certain:
        return f"{sut} violates {', '.join(violated(fault))}: it probably {fault.what}"
    if fault.likely or fault.check is None:
        return f"{sut} probably {fault.what}"
    observed = f"; observed {fault.check.observed}" if fault.check.observed else ""
    return f"{sut}: expected {fault.check.expected}{observed}"


def _shown(case: CaseResult, check: Check, frames: Frames) -> list[dict[str, Any]]:
    """Return the first frames that a check cites, dissected, with the octets that the check is about marked."""
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
    """Return the text as a file name of at most 60 lower-case letters, digits and hyphens."""
    words = re.findall(r"[a-z0-9]+", text.lower())
    return "-".join(words)[:60].strip("-") or "fault"
