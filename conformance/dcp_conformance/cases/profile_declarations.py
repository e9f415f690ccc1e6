"""dcp-datatypes.md: Conventions; Data Types of all protocols.

What the wire profile in use says of the implementation. A profile that describes other octets than the specification
asks for lets all other cases talk to the implementation; it does not make these octets right. The checks name the
requirements that the profile declares as not met, whichever they are.
"""

from __future__ import annotations

from dcp_spec.deviations import deviations
from dcp_spec.requirements import requirement

from dcp_conformance.bench import Bench
from dcp_conformance.case import DECLARED, Needs, case


def _declares_nothing(bench: Bench) -> str | None:
    if deviations(bench.profile):
        return None
    return f"the profile {bench.profile.name} declares nothing that its version of the specification does not allow"


@case(
    DECLARED,
    "The profile declares nothing that the specification does not allow",
    requirements="DATA-01 DATA-02",
    stimulus="none: the profile as it is",
    expect="no requirement of its version of the specification is declared as not met; accept what is with --expected",
    needs=Needs(entities=(), when=_declares_nothing),
)
def declared(bench: Bench) -> None:
    for identifier, instead in deviations(bench.profile).items():
        observed = f"declared by the profile {bench.profile.name}: {instead}"
        bench.check(False, requirement(identifier).statement, observed, identifier, shown=True)
