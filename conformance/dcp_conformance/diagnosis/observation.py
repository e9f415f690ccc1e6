"""Compare what was observed in a failed case with what is observed there at a node with a known fault.

Two runs never observe the same numbers: sequence numbers, times and identifiers differ. The digest of a failed check
is therefore that of its text without numbers.
"""

from __future__ import annotations

import re
from hashlib import blake2s
from typing import Final

from dcp_conformance.model.results import CaseResult, Check
from dcp_conformance.model.survival import SURVIVAL
from dcp_conformance.model.verdict import Verdict

#: Octets in hexadecimal (with or without separators), and decimal numbers.
_NUMBER: Final = re.compile(
    r"0x[0-9a-f]+|(?<![0-9a-z])[0-9a-f]{2}(?:[:.\- ]?[0-9a-f]{2})+(?![0-9a-z])|(?:(?<![^\s(])[-+])?\d+(?:\.\d+)?",
    re.IGNORECASE,
)
_LIST: Final = re.compile(r"#(?:(?:, | and |-| to )#)+")
_PLURAL: Final = re.compile(r"(?<=# )([a-z]{3,}?)s?\b")
#: Octets of a digest. Two of the few thousand texts that are alike by chance cost one match of one case.
_OCTETS: Final = 4


def pattern(text: str) -> str:
    """Return the text with ``#`` in place of each number and each list of numbers, and in the singular after it.

    >>> pattern("3 beacons, numbers 17, 18 and 20")
    '# beacon, numbers #'
    """
    return _PLURAL.sub(r"\1", _LIST.sub("#", _NUMBER.sub("#", text)))


def digest(check: Check) -> str:
    """Return the digest of the expectation and the observation of a check: 8 hexadecimal digits."""
    text = f"{pattern(check.expected)}\n{pattern(check.observed)}"
    return blake2s(text.encode(), digest_size=_OCTETS).hexdigest()


def observations(result: CaseResult) -> frozenset[str]:
    """Return the digests of the failed checks of a case, without those of survival."""
    return frozenset(
        digest(check)
        for check in result.checks
        if check.verdict is Verdict.FAIL and not check.expected.startswith(SURVIVAL)
    )
