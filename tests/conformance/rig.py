"""Cases of the suite against our node in this process."""

from __future__ import annotations

import importlib
from functools import cache

from dcp_conformance.execution.runner import Runner
from dcp_conformance.model.case import CASES, Case, all_cases, cases_of
from dcp_conformance.model.pics import Pics
from dcp_conformance.model.results import CaseResult
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.test_system.bench import Session

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


def ids_of(*modules: str) -> list[str]:
    """The identifiers of the cases in modules of ``dcp_conformance.suite``, by their names without the package."""
    return [each.id for name in modules for each in cases_of(importlib.import_module(f"{CASES}.{name}"))]


def one_case(
    case_id: str,
    profile: str = "dcp-2.0",
    make: MakeNode | None = None,
    *,
    upper: bool = True,
    pics: Pics | None = None,
    kind: type[InProcess] = InProcess,
) -> CaseResult:
    """Run one case against a fresh node; ``make`` builds another node, ``upper=False`` leaves only the wire.

    ``kind`` is what holds the node.
    """
    codec = codec_of(profile)
    sut = kind(reference_config(codec), make=make or plain_node)
    session = Session(codec, sut.lower_tester(), sut.upper_tester() if upper else None, pics or Pics())
    runner = Runner(session, sut)
    runner.prepare()
    return runner.run(known_cases()[case_id])
