"""Test cases: what they are called, what they decide, what they need.

A case is a function that is given a :class:`~dcp_conformance.test_system.bench.Bench` and says with it what it
expects. The
decorator holds everything that people and reports must know without running it. Vocabulary of ISO/IEC 9646 and of
ETSI test purposes: valid behaviour (BV), invalid (BI) and inopportune (BO) stimuli, timer behaviour (TI).

Identifiers are ``TC_<protocol>_<group>_<kind>_<number>``, and ``...-<variant>`` for each variant of a case. They are
never reused: ``data/case-ids.txt`` remembers those that ever were.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_conformance.errors import UsageError

from .registry import Registry, define, defined_in
from .results import CaseResult, Check
from .verdict import Verdict, worst

if TYPE_CHECKING:
    from dcp_conformance.test_system.bench import Bench

if sys.flags.optimize > 1:
    raise UsageError(
        "Python runs without docstrings (-OO, PYTHONOPTIMIZE=2), which hold sections and purposes of cases; "
        "unset PYTHONOPTIMIZE"
    )

CASES: Final = "dcp_conformance.suite"
#: The module that makes cases of findings of the fuzzer.
ARTEFACT_CASES: Final = "dcp_lab.fuzz.findings.cases"
DECLARED: Final = "TC_DCP_PROF_BV_01"
"""The case about what the wire profile itself declares as not met."""
DENIED: Final = "TC_DCP_PICS_BV_01"
"""The case about what the PICS denies although the specification demands it."""
SANITY: Final = "TC_DCP_SANITY_BV_01"
"""The case that shows that the implementation is there and answers: first, last, and after every destructive case."""
FILLS: Final = "it fills payloads or beacons, and depends on the room in them"
LISTENS: Final = "it judges the whole content of beacons"
REPLACES: Final = "it deregisters SRP or VarDis"
TIMES_DELETION: Final = "it measures when a variable is deleted"
"""Frequent values of :attr:`Case.alone`."""
_ID = re.compile(r"TC_(?:DCP|BP|SRP|VD|NET)_[A-Z0-9]+_(BV|BI|BO|TI)_\d\d")
_VARIANT = re.compile(r"[a-zA-Z0-9][a-zA-Z0-9.+_=-]*")


class Kind(StrEnum):
    """The kind of stimulus, after ISO/IEC 9646."""

    VALID = "BV"
    INVALID = "BI"
    INOPPORTUNE = "BO"
    TIMER = "TI"


@dataclass(frozen=True, slots=True)
class Needs:
    """Conditions for a case to apply. A missing one makes the case not applicable, with a reason."""

    since: SpecVersion = SpecVersion.V1_0
    until: SpecVersion | None = None
    """First and last version of the specification (of the profile) that the case is about; None: no last one."""
    ut: tuple[str, ...] = ()
    """Methods of the upper tester interface that the case calls."""
    entities: tuple[str, ...] = ("vardis",)
    """Of ``vardis`` and ``srp``: the client protocols that must be there (PICS)."""
    pics: tuple[str, ...] = ()
    """Capabilities that must be declared true in the PICS, by their names there."""
    header: tuple[str, ...] = ()
    """Fields that the profile's beacon header must have."""
    link: bool = False
    """Whether the tester must be able to take the implementation's link down and up."""
    restart: bool = False
    """Whether a command to restart the implementation must be known."""
    when: Callable[[Bench], str | None] | None = None
    """Anything else: the reason for which the case does not apply, or None."""


@dataclass(frozen=True, slots=True)
class Case:
    """One test case, or one variant of it."""

    id: str
    purpose: str
    """One line: what is to be shown."""
    requirements: tuple[str, ...]
    """The requirements of the catalogue that the case decides."""
    kind: Kind
    stimulus: str
    expect: str
    window: float
    """How long the expected behaviour may take to show, in beacon periods."""
    section: str
    """The section of the specification: first line of the module's docstring."""
    module: str
    run: Callable[[Bench], None]
    needs: Needs = Needs()
    destructive: bool = False
    """May leave the implementation dead or in a state that needs a restart: runs after all others."""
    robustness: bool = False
    """The specification leaves the reaction open: a crash counts in the table of robustness."""
    long: bool = False
    """Belongs to the long plan only: takes more than about 20 s at a beacon period of 100 ms, or repeats others."""
    alone: str = ""
    """Why it cannot be executed beside other cases, if that does not follow from its needs; empty if it can.

    The steps about the room in beacons refuse to serve a case beside others that does not declare this.
    """
    family: str = ""
    """The name of the cases beside which alone it can be executed; empty if it can be beside any."""
    line: int = 0
    options: tuple[str, ...] = ()
    """Options that a command needs beside the identifier to find the case."""

    @property
    def smoke(self) -> bool:
        """Whether it belongs to the smoke plan (``data/case-times.json``)."""
        # Needed by the few commands that ask for it.
        from .case_times import load

        return self.id == SANITY or self.id in load().smoke

    @property
    def base(self) -> str:
        """The identifier without its variant."""
        return self.id.partition("-")[0]

    def result(self, checks: Iterable[Check], **about: Any) -> CaseResult:
        """Return the result of the case: the worst check decides it, and is the reason if it is not a pass.

        ``about``: further members of the result, and members with another value than follows from the case.
        """
        checks = tuple(checks)
        verdict = worst(check.verdict for check in checks) or Verdict.INCONCLUSIVE
        decisive = next((check.text for check in checks if check.verdict is verdict), "the case has made no check")
        members = {
            "id": self.id,
            "purpose": self.purpose,
            "section": self.section,
            "kind": str(self.kind),
            "requirements": self.requirements,
            "verdict": verdict,
            "reason": "" if verdict is Verdict.PASS else decisive,
            "stimulus": self.stimulus,
            "expectation": self.expect,
            "table": "robustness" if self.robustness else "conformance",
            "checks": checks,
        }
        return CaseResult(**members | about)


@dataclass(frozen=True, slots=True)
class Variant:
    """A variant that differs from the others of its case in more than its value; None: as the case says."""

    value: Any
    purpose: str | None = None
    requirements: str | None = None
    stimulus: str | None = None
    expect: str | None = None
    needs: Needs | None = None
    long: bool | None = None


_Body = Callable[..., None]


def case(
    identifier: str,
    purpose: str,
    *,
    requirements: str,
    stimulus: str,
    expect: str,
    window: float = 4,
    needs: Needs = Needs(),
    variants: Mapping[str, Any] | None = None,
    value: Any = None,
    destructive: bool = False,
    robustness: bool = False,
    long: bool = False,
    alone: str = "",
    family: str = "",
) -> Callable[[_Body], _Body]:
    """Make a test case of ``body(bench)``, or with ``variants`` one of ``body(bench, value)`` for each of them.

    A body may have several of these decorators; with ``value``, the case is one of ``body(bench, value)``.
    ``requirements`` are ids separated by spaces; with variants, ``purpose``, ``stimulus`` and ``expect`` may contain
    ``{variant}``, and a value may be a :class:`Variant`. ``window`` is in beacon periods. Raises
    ``ValueError`` for an identifier of another form and ``UnknownRequirementError`` for an id that the catalogue does
    not have.
    """
    match = _ID.fullmatch(identifier)
    if match is None:
        raise ValueError(f"{identifier!r} is not a case identifier; expected one such as TC_BP_RX_BI_01")
    _ids(identifier, requirements)

    def decorate(body: _Body) -> _Body:
        module = inspect.getmodule(body)
        section = (module.__doc__ or "").partition("\n")[0].rstrip(".") if module is not None else ""

        def build(suffix: str, run: Callable[[Bench], None], own: Variant = Variant(None)) -> Case:
            variant = suffix.removeprefix("-")
            return Case(
                id=identifier + suffix,
                purpose=(own.purpose or purpose).replace("{variant}", variant),
                requirements=_ids(identifier + suffix, own.requirements or requirements),
                kind=Kind(match[1]),
                stimulus=(own.stimulus or stimulus).replace("{variant}", variant),
                expect=(own.expect or expect).replace("{variant}", variant),
                window=window,
                section=section,
                module=body.__module__,
                run=run,
                needs=own.needs or needs,
                destructive=destructive,
                robustness=robustness,
                long=long if own.long is None else own.long,
                alone=alone,
                family=family,
                line=body.__code__.co_firstlineno,
            )

        cases = [build("", body if value is None else lambda bench: body(bench, value))] if variants is None else []
        for name, given in (variants or {}).items():
            if not _VARIANT.fullmatch(name):
                raise ValueError(f"{identifier}: {name!r} cannot be the name of a variant")
            own = given if isinstance(given, Variant) else Variant(given)

            def bound(bench: Bench, value: Any = own.value) -> None:
                body(bench, value)

            cases.append(build(f"-{name}", bound, own))
        return define(body, cases)

    return decorate


def _ids(identifier: str, requirements: str) -> tuple[str, ...]:
    ids = tuple(requirements.split())
    for each in ids:
        requirement(each)
    if not ids:
        raise ValueError(f"{identifier} decides no requirement")
    return ids


def cases_of(module: ModuleType) -> Iterator[Case]:
    """Return the cases of a module, in the order of their definition."""
    return defined_in(module)


_REGISTRY: Final = Registry[Case]("case", CASES, "dcp-conformance list")
all_cases = _REGISTRY.all
