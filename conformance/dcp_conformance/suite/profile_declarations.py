"""dcp-datatypes.md: Conventions; Data Types of all protocols.

Deviations that an implementation declares. With a profile for another wire format, all other cases can communicate with
the implementation; that does not make the format conforming. Likewise, a PICS that denies a mandatory service keeps
cases from waiting for it, but the service is still missing. The checks name the requirements that are declared as not
met.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dcp_spec.catalogue.requirements import requirement
from dcp_spec.profile.deviations import deviations

from dcp_conformance.definitions.case import DECLARED, DENIED, Needs, case
from dcp_conformance.definitions.declared import denied_by

if TYPE_CHECKING:
    # 'check' imports this module, and does not need the tester.
    from dcp_conformance.test_system.bench import Bench


def _declares_nothing(bench: Bench) -> str | None:
    if deviations(bench.profile):
        return None
    return f"the profile {bench.profile.name} declares no deviation from its version of the specification"


@case(
    DECLARED,
    "The profile declares no deviation from the specification",
    requirements="DATA-01 DATA-02",
    stimulus="none; the profile is inspected",
    expect=(
        "no requirement of its version of the specification is declared as not met (to accept deviations, use "
        "--expected)"
    ),
    needs=Needs(entities=(), when=_declares_nothing),
)
def declared(bench: Bench) -> None:
    for identifier, instead in deviations(bench.profile).items():
        observed = f"declared by the profile {bench.profile.name}: {instead}"
        bench.proved(False, requirement(identifier).statement, observed, identifier)


def _denies_nothing(bench: Bench) -> str | None:
    if denied_by(bench.sut.pics, bench.profile):
        return None
    return f"the PICS denies nothing that is mandatory in version {bench.profile.spec_version}"


@case(
    DENIED,
    "The PICS denies nothing that is mandatory",
    requirements="BP-PTI-01 BP-PTI-02 BP-PTI-03",
    stimulus="none; the PICS is inspected, and for missing entries the behaviour declared by the profile",
    expect="no mandatory requirement of its version of the specification is denied (to accept denials, use --expected)",
    needs=Needs(entities=(), when=_denies_nothing),
)
def denied(bench: Bench) -> None:
    for identifier, observed in denied_by(bench.sut.pics, bench.profile).items():
        bench.proved(False, requirement(identifier).statement, observed, identifier)
