"""Cases of the suite against our node in this process."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

from dcp_conformance.definitions.case import CASES, DECLARED, DENIED, SANITY, Case, all_cases, cases_of
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import ordered
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import Session
from dcp_conformance.upper_tester import UpperTester
from dcp_selftest.costs import COUNTING

from dcp_codec import Codec

PROFILES = ("dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-1.2", "cpp-1.3", "cpp-2.0")
"""Profiles on which every case must come out as expected against our node."""
OTHER_PROFILES = ("student-2024", "sim-1.0", "sim-2.0")
"""Profiles on which no case may stumble."""


@cache
def codec_of(profile: str) -> Codec:
    return Codec(profile)


@cache
def known_cases() -> dict[str, Case]:
    return all_cases()


def every_case() -> list[Case]:
    """Return the cases in the order of execution, without those that wait for 65,536 beacons."""
    return [each for each in ordered(known_cases().values()) if each.id not in COUNTING]


def ids_of(*modules: str) -> list[str]:
    """The identifiers of the cases in modules of ``dcp_conformance.suite``, by their names without the package."""
    return [each.id for name in modules for each in cases_of(importlib.import_module(f"{CASES}.{name}"))]


def sampled_cases(seed: int, *requirements: str) -> list[Case]:
    """Return a third of the suite: one variant of each third case function, in the order of execution.

    Three consecutive ``seed`` values select all case functions. All cases that name one of ``requirements`` are added.
    Cases about statements of a PICS or profile are left out: these are not behaviour of a node.
    """
    functions: dict[str, list[Case]] = {}
    for case in known_cases().values():
        if case.id not in (DECLARED, DENIED, *COUNTING):
            functions.setdefault(case.base, []).append(case)
    drawn = {
        variants[seed % len(variants)].id
        for number, variants in enumerate(functions.values())
        if number % 3 == seed % 3 or variants[0].id == SANITY
    }
    every = (each for variants in functions.values() for each in variants)
    return ordered(each for each in every if each.id in drawn or set(each.requirements) & set(requirements))


def in_session(
    cases: Iterable[str],
    profile: str = "dcp-2.0",
    make: MakeNode | None = None,
    *,
    upper: bool | Callable[[InProcess], UpperTester] = True,
    pics: Pics | None = None,
    kind: type[InProcess] = InProcess,
) -> list[CaseResult]:
    """Run cases in succession against one node; ``make`` builds another node, ``kind`` is what holds it.

    ``upper``: whether there is an upper tester besides the wire, or what opens it.
    """
    codec = codec_of(profile)
    sut = kind(reference_config(codec), make=make or plain_node)
    told = upper(sut) if callable(upper) else sut.upper_tester() if upper else None
    runner = Runner(Session(codec, sut.lower_tester(), told, pics or Pics()), sut)
    runner.prepare()
    return [runner.run(known_cases()[each]) for each in cases]


def one_case(case_id: str, profile: str = "dcp-2.0", make: MakeNode | None = None, **how: Any) -> CaseResult:
    """Run one case against a fresh node; the options are those of :func:`in_session`."""
    (result,) = in_session([case_id], profile, make, **how)
    return result
