"""Compare what was observed in a failed case with what is observed there at a node with a known fault.

Texts of checks are reworded, and two runs never observe the same numbers. The digest of a failed check therefore holds
what neither affects: the requirements that it decides, whether received octets prove it and frames show it, and the
names of the specification in its observation.
"""

from __future__ import annotations

import re
from hashlib import blake2s
from typing import Final

from dcp_conformance.definitions.results import CaseResult, Check
from dcp_conformance.definitions.survival import SURVIVAL
from dcp_conformance.definitions.verdict import Verdict

#: Statuses and parameters of the specification, and codes of JSON-RPC.
_NAME: Final = re.compile(r"\b[A-Z]{2,}(?:[-_][A-Z]+)*[-_]STATUS[-_][A-Z-_]+|\b[A-Z]{3,}PAR_[A-Z_]+|error -?\d+")
#: Octets of a digest. Two of the few thousand digests that are alike by chance cost one match of one case.
_OCTETS: Final = 4


def digest(check: Check) -> str:
    """Return the digest of a failed check: 8 hexadecimal digits."""
    names = sorted(set(_NAME.findall(check.observed)))
    text = f"{sorted(check.requirements)}{check.shown}{bool(check.frames)}{names}"
    return blake2s(text.encode(), digest_size=_OCTETS).hexdigest()


def observations(result: CaseResult) -> frozenset[str]:
    """Return the digests of the failed checks of a case, without those of survival."""
    return frozenset(
        digest(check)
        for check in result.checks
        if check.verdict is Verdict.FAIL and not check.expected.startswith(SURVIVAL)
    )
