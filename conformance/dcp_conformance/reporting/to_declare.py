"""Keys of the PICS file on which verdicts of a run hang: what the implementer can state to have them decided."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from dcp_conformance.model.pics_file import QUESTIONS
from dcp_conformance.model.results import CaseResult
from dcp_conformance.model.verdict import Verdict

#: How checks name a key: "state its value (pixit.max_repetitions)", "[pixit] node_id".
_KEYS: Final = re.compile(r"\b(?:(pixit|pics|sut)\.|\[(pixit|pics|sut)\] )([a-z_]+)")
#: A key on which a pass or a verdict about another requirement hangs is not asked for.
_OPEN: Final = frozenset({Verdict.INCONCLUSIVE, Verdict.FAIL, Verdict.ERROR, Verdict.NOT_APPLICABLE})


class ToDeclare(NamedTuple):
    """A key, with the cases whose verdict hangs on it."""

    key: str
    """``pixit.max_repetitions``"""
    question: str
    """What the key answers."""
    cases: tuple[str, ...]


def keys_of(case: CaseResult) -> Iterator[str]:
    """The keys that a case names as the reason why it could not be decided, or failed; each once."""
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
    """All keys that cases of a run name, those of the most cases first."""
    found: dict[str, list[str]] = {}
    for case in cases:
        for key in keys_of(case):
            found.setdefault(key, []).append(case.id)
    return [
        ToDeclare(key, QUESTIONS[key], tuple(names))
        for key, names in sorted(found.items(), key=lambda each: (-len(each[1]), each[0]))
    ]
