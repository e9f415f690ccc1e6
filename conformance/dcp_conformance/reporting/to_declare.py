"""Find the keys of the PICS file that the implementer can set so that undecided cases of a run are decided."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from dcp_conformance.definitions.pics_file import QUESTIONS
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict

#: A key in the text of a check: "state its value (pixit.max_repetitions)", "[pixit] node_id".
_KEYS: Final = re.compile(r"\b(?:(pixit|pics|sut)\.|\[(pixit|pics|sut)\] )([a-z_]+)")
#: Verdicts of cases that the report asks keys for. A pass or an info needs no further declaration.
_OPEN: Final = frozenset({Verdict.INCONCLUSIVE, Verdict.FAIL, Verdict.ERROR, Verdict.NOT_APPLICABLE})


class ToDeclare(NamedTuple):
    """A key of the PICS file, and the cases whose verdicts depend on it."""

    key: str
    """Section and name, such as ``pixit.max_repetitions``."""
    question: str
    """The question that the value of the key answers."""
    cases: tuple[str, ...]
    """Identifiers of the cases."""


def keys_of(case: CaseResult) -> Iterator[str]:
    """Yield each key that a case names as the reason why it failed or could not be decided."""
    if case.verdict not in _OPEN:
        return
    seen: set[str] = set()
    decisive = [check for check in case.checks if check.verdict is case.verdict]
    texts = [text for check in decisive for text in (check.expected, check.observed)]
    for match in (each for text in texts for each in _KEYS.finditer(text)):
        key = f"{match[1] or match[2]}.{match[3]}"
        if key in QUESTIONS and key not in seen:
            seen.add(key)
            yield key


def to_declare(cases: Iterable[CaseResult]) -> list[ToDeclare]:
    """Return all keys that cases of a run name, the key with the most cases first."""
    found: dict[str, list[str]] = {}
    for case in cases:
        for key in keys_of(case):
            found.setdefault(key, []).append(case.id)
    return [
        ToDeclare(key, QUESTIONS[key], tuple(names))
        for key, names in sorted(found.items(), key=lambda each: (-len(each[1]), each[0]))
    ]
