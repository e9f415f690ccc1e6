"""From the results of cases to those of a run, and to an exit status."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal

import msgspec
from dcp_spec.catalogue.readings import differs_from_reference, reading
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.profile.definition import Profile
from dcp_spec.version import __version__

from .case import SANITY
from .declared import declared_by, denied_by, with_declared
from .pics import Pics
from .results import CaseResult, RunResult, Sut, requirement_verdicts, summarise
from .verdict import Verdict

AS_EXPECTED, UNEXPECTED, USAGE, INCONCLUSIVE, TESTER_ERROR = range(5)
"""The exit statuses of ``dcp-conformance``."""
INTERRUPTED: Final = 130
"""The exit status after Ctrl-C, SIGTERM or SIGHUP, as shells give it."""

TOOL: Final = f"dcp-conformance {__version__}"


def assemble(
    profile: Profile,
    pics: Pics,
    cases: Iterable[CaseResult],
    *,
    kind: Literal["run", "check", "replay", "selftest", "fuzz"] = "run",
    sut: Sut | None = None,
    started: str = "",
    duration: float = 0.0,
    command: str = "",
    notes: Iterable[str] = (),
) -> RunResult:
    """A run of these cases, with what follows from them."""
    cases = tuple(cases)
    declared = declared_by(profile)
    # A replay and a fuzzing campaign judge what they send, and not what is declared.
    judged = kind in ("run", "check")
    denied = denied_by(pics.pics, profile, recorded=kind == "check") if judged else {}
    observed: dict[str, dict[str, None]] = {}
    for case in cases:
        for identifier, name in case.readings.items():
            observed.setdefault(identifier, {})[name] = None
    return RunResult(
        tool=TOOL,
        kind=kind,
        started=started,
        duration=duration,
        command=command,
        profile=profile.name,
        profile_title=profile.title,
        spec_version=str(profile.spec_version),
        sut=sut or Sut(),
        pics=msgspec.to_builtins(pics),
        cases=cases,
        requirements=with_declared(
            {
                name: verdict
                for name, verdict in requirement_verdicts(cases).items()
                if verdict is not Verdict.NOT_APPLICABLE or requirement(name).holds_in(profile.spec_version)
            },
            *((declared, denied) if judged else ()),
        ),
        declared=declared,
        denied=denied,
        summary=summarise(cases),
        readings={identifier: tuple(names) for identifier, names in sorted(observed.items())},
        reference_readings=_references(observed),
        notes=tuple(dict.fromkeys(notes)),
    )


def _references(observed: Mapping[str, Iterable[str]]) -> dict[str, str]:
    """The reference's readings of the texts that were read otherwise."""
    found: dict[str, str] = {}
    for identifier, names in sorted(observed.items()):
        if any(differs_from_reference(identifier, each) for each in names):
            default = reading(identifier).default
            found[identifier] = "" if default is None else default.name
    return found


def exit_status(cases: Iterable[CaseResult], *, unexpected: bool | None = None) -> int:
    """The tester's own faults before everything, then what is unexpected, then doubts.

    ``unexpected``: whether anything is; None if every fail is. Where nothing was decided there is doubt.
    """
    cases = tuple(cases)
    verdicts = {case.verdict for case in cases}
    if Verdict.ERROR in verdicts:
        return TESTER_ERROR
    if Verdict.FAIL in verdicts if unexpected is None else unexpected:
        return UNEXPECTED
    return INCONCLUSIVE if Verdict.INCONCLUSIVE in verdicts or nothing_decided(cases) else AS_EXPECTED


def nothing_decided(cases: Iterable[CaseResult]) -> bool:
    """Whether no case has come to more than "not applicable" or "too little".

    The sanity case goes before the others and decides for none of them; alone it is a case like any other.
    """
    cases = tuple(cases)
    asked_for = [case for case in cases if case.id != SANITY] or cases
    return all(case.verdict in (Verdict.NOT_APPLICABLE, Verdict.TOO_LITTLE) for case in asked_for)
