"""Expected results: known failures with reason and expiry date.

With a file of expected results, a run reports only changes. The file cannot become outdated unnoticed: an entry without
a reason is rejected, and an entry that matches no result or has expired makes the run fail.

::

    [[expected]]
    case = "TC_VD_STATE_BV_01-*"        # identifier or glob
    verdict = "fail"                    # expected verdict; default "fail"
    reason = "answers an equal sequence number, reported as #12"
    match = "equal"                     # regular expression that the verdict's reason must contain
    expires = 2027-03-31
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import msgspec

from dcp_conformance.definitions.case import Case
from dcp_conformance.definitions.input_files import load_file
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError

from .selection import matches


class Expectation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One entry of the file."""

    case: str
    reason: str
    verdict: Verdict = Verdict.FAIL
    match: str = ""
    expires: datetime.date | None = None

    def __post_init__(self) -> None:
        if not self.reason.strip():
            raise ValueError("`reason` is empty")
        re.compile(self.match)


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    expected: tuple[Expectation, ...] = ()


class ExpectedResults:
    """The entries of a file, and which of them have matched a result."""

    def __init__(self, entries: Sequence[Expectation] = (), name: str = "") -> None:
        self.entries = tuple(entries)
        self.name = name
        self._used: set[int] = set()

    @classmethod
    def load(cls, path: Path, cases: Iterable[Case]) -> ExpectedResults:
        """Read a file. Raise :class:`UsageError` if it is unreadable or malformed, or if an entry matches no case."""
        entries = load_file(path, _File, decode=msgspec.toml.decode).expected
        known = list(cases)
        for number, entry in enumerate(entries, 1):
            if not any(matches(case, entry.case) for case in known):
                raise UsageError(f"{path}: expected[{number}]: no case is called {entry.case!r}")
        return cls(entries, str(path))

    def judge(self, case: Case, result: CaseResult) -> str:
        """Return why a result is unexpected, empty if it is expected; remember the entries that it matches."""
        about = [(number, entry) for number, entry in enumerate(self.entries) if matches(case, entry.case)]
        if not about:
            return f"unexpected {result.verdict}" if result.verdict is Verdict.FAIL else ""
        for number, entry in about:
            if result.verdict is entry.verdict and re.search(entry.match, result.reason):
                self._used.add(number)
                return ""
        wanted = " or ".join(dict.fromkeys(str(entry.verdict) for _, entry in about))
        if result.verdict in (Verdict.NOT_APPLICABLE, Verdict.TOO_LITTLE, Verdict.INCONCLUSIVE, Verdict.ERROR):
            # This verdict does not show whether the entry is still true, but the entry is not unused.
            self._used.update(number for number, _ in about)
            return ""
        if any(result.verdict is entry.verdict for _, entry in about):
            return f"{result.verdict} as expected, but for another reason"
        return f"unexpected {result.verdict}: {wanted} was expected ({about[0][1].reason})"

    def complaints(self, selected: Sequence[Case], today: datetime.date) -> list[str]:
        """Return messages on entries for the cases ``selected`` that matched no result of the run or have expired."""
        found = []
        for number, entry in enumerate(self.entries):
            if not any(matches(case, entry.case) for case in selected):
                continue
            if entry.expires is not None and entry.expires < today:
                found.append(f"{self.name}: {entry.case}: expired on {entry.expires} ({entry.reason})")
            elif number not in self._used:
                found.append(f"{self.name}: {entry.case}: no result matches this entry; remove it ({entry.reason})")
        return found
