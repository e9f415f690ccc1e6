"""dcp-datatypes.md: Conventions; Data Types of all protocols.

What an implementation declares of itself. A profile that describes other octets than the specification asks for lets
all other cases talk to the implementation; it does not make these octets right. Likewise a PICS that denies a mandatory
service keeps cases from waiting for it, and does not make its absence right. The checks name the requirements that are
declared as not met, whichever they are.
"""

from __future__ import annotations

from dcp_spec.deviations import deviations
from dcp_spec.requirements import requirement

from dcp_conformance.bench import Bench
from dcp_conformance.case import DECLARED, DENIED, Needs, case
from dcp_conformance.declared import denied_by


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


def _denies_nothing(bench: Bench) -> str | None:
    if denied_by(bench.pics, bench.profile):
        return None
    return f"the PICS denies nothing that version {bench.profile.spec_version} demands"


@case(
    DENIED,
    "The PICS denies nothing that the specification demands",
    requirements="BP-PTI-01 BP-PTI-02 BP-PTI-03",
    stimulus="none: the PICS as it is; where it is silent, what the profile says of the behaviour",
    expect="no mandatory requirement of its version of the specification is denied; accept what is with --expected",
    needs=Needs(entities=(), when=_denies_nothing),
)
def denied(bench: Bench) -> None:
    for identifier, observed in denied_by(bench.pics, bench.profile).items():
        bench.check(False, requirement(identifier).statement, observed, identifier, shown=True)
