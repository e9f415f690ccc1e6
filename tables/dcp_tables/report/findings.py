"""The findings of ``dcp-conformance check`` about a recording, read from its results.json."""

from __future__ import annotations

from pathlib import Path

import msgspec


class FindingsError(Exception):
    """The file is not a result of ``check``; the message has its name."""


class _Mark(msgspec.Struct):
    frame: int = 0


class _Check(msgspec.Struct):
    verdict: str
    expected: str = ""
    observed: str = ""
    frames: list[_Mark] = []
    seconds: float | None = None


class _Case(msgspec.Struct):
    id: str
    checks: list[_Check] = []


class _Sut(msgspec.Struct):
    link: str = ""


class _Run(msgspec.Struct):
    kind: str = ""
    sut: _Sut = msgspec.field(default_factory=_Sut)
    cases: list[_Case] = []
    notes: list[str] = []


class Finding(msgspec.Struct, frozen=True):
    """An observation of a rule. ``seconds``: time since the first frame; None if it has no time."""

    verdict: str
    rule: str
    text: str
    frames: tuple[int, ...]
    seconds: float | None


class Judged(msgspec.Struct, frozen=True):
    """The result of ``check``. ``recording`` is the name of the file; ``links`` tells where the links come from."""

    recording: str
    links: str
    findings: tuple[Finding, ...]


#: Verdicts of findings, in the order in which they are shown.
VERDICTS = ("fail", "inconclusive", "info")


def read_findings(path: Path) -> Judged:
    """Return the findings in a results.json. Raises :class:`FindingsError`."""
    try:
        run = msgspec.json.decode(path.read_bytes(), type=_Run)
    except OSError as error:
        raise FindingsError(f"{path}: cannot be read: {error.strerror}") from None
    except msgspec.MsgspecError as error:
        raise FindingsError(f"{path}: not a results.json of dcp-conformance check: {error}") from None
    if run.kind != "check":
        raise FindingsError(f"{path}: not a result of dcp-conformance check")
    found = [
        Finding(
            check.verdict,
            case.id,
            check.observed or check.expected,
            tuple(dict.fromkeys(mark.frame for mark in check.frames if mark.frame)),
            check.seconds,
        )
        for case in run.cases
        for check in case.checks
        if check.verdict in VERDICTS
    ]
    links = next((note for note in run.notes if note.startswith("links: ")), "")
    found.sort(key=lambda each: VERDICTS.index(each.verdict))
    return Judged(run.sut.link.removeprefix("recording "), links, tuple(found))
