"""Requirements that an implementation itself declares as not met: by its wire profile, or by its PICS.

A profile describes the octets of an implementation, also where they differ from the specification, and a PICS may deny
what the specification demands. Cases test what is left; passing them does not show these requirements. Each of them
fails in the result of every run and recording. ``TC_DCP_PROF_BV_01`` and ``TC_DCP_PICS_BV_01`` are the cases that fail
for them; an entry in a file of expected results accepts either.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final

from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.deviations import deviations as declared_by

from .results import CaseResult, Check
from .verdict import Verdict

if TYPE_CHECKING:
    from .pics import Capabilities

__all__ = ["declarations", "declared_by", "denied_by", "with_declared"]

#: Capabilities of the PICS that the specification does not leave open: what they stand for, and in which versions.
_MANDATORY: Final[Mapping[str, tuple[tuple[str, ...], str]]] = {
    "payload_transmitted_indication": (
        ("BP-PTI-01", "BP-PTI-02", "BP-PTI-03"),
        "there is no BP-PayloadTransmitted.indication",
    ),
    "transmit_payload_confirm": (("BP-TXP-11",), "there is no BP-TransmitPayload.confirm"),
    "runtime_parameters": (("BP-PAR-01", "BP-PAR-12"), "parameters cannot be set while running"),
}
#: Capabilities that a profile declares where the PICS does not.
_ALSO_IN_PROFILES: Final = ("payload_transmitted_indication", "transmit_payload_confirm")


def denied_by(capabilities: Capabilities, profile: Profile, *, recorded: bool = False) -> dict[str, str]:
    """Requirement -> what the PICS denies, for the mandatory requirements of the profile's version.

    A profile says how an implementation behaves as well; this counts where the PICS is silent, but not for a recording
    (``recorded``): its profile tells how to read octets, of whichever implementation.
    """
    return dict(_denials(capabilities, profile, recorded=recorded))


def _denials(capabilities: Capabilities, profile: Profile, *, recorded: bool) -> Iterator[tuple[str, str]]:
    for name, (identifiers, text) in _MANDATORY.items():
        claimed = getattr(capabilities, name)
        speaks = claimed is None and name in _ALSO_IN_PROFILES and not recorded
        by_profile = speaks and not getattr(profile.behaviour, name)
        if claimed is not False and not by_profile:
            continue
        who = f"the profile {profile.name}, as the PICS is silent" if by_profile else f"the PICS ({name} = false)"
        for each in identifiers:
            if requirement(each).holds_in(SpecVersion(profile.spec_version)):
                yield each, f"declared by {who}: {text}"


def with_declared(verdicts: Mapping[str, Verdict], *declared: Mapping[str, str]) -> dict[str, Verdict]:
    """The verdicts, with a fail for each requirement that is declared as not met."""
    return {**verdicts, **{name: Verdict.FAIL for each in declared for name in each}}


def declarations(capabilities: Capabilities, profile: Profile, rerun: str) -> list[CaseResult]:
    """The results of the two cases about declarations for a recording; empty if nothing is declared.

    ``rerun``: the command that judges the recording again.
    """
    from .case import CASES, DECLARED, DENIED, cases_of

    found = []
    by_profile = declared_by(profile).items()
    told = {
        DECLARED: {name: f"declared by the profile {profile.name}: {text}" for name, text in by_profile},
        DENIED: denied_by(capabilities, profile, recorded=True),
    }
    for case in cases_of(importlib.import_module(f"{CASES}.profile_declarations")):
        checks = tuple(
            Check(Verdict.FAIL, (name,), requirement(name).statement, text, shown=True)
            for name, text in told[case.id].items()
        )
        if checks:
            found.append(case.result(checks, rerun=rerun))
    return found
