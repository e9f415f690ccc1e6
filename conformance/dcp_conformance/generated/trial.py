"""The suite against our node with one change in its source, in a process that has never seen the node without it."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import resource
import sys
import time
from collections.abc import Sequence
from types import CodeType, ModuleType
from typing import Final, Literal

import msgspec

from dcp_conformance.errors import ConformanceError
from dcp_conformance.verdict import Verdict

from .sites import Site, mutated

PROFILES: Final = ("dcp-2.0", "dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "cpp-2.0")
"""Profiles on which a change is tried, until one notices: much of the source serves one version only."""
#: Bounds of one process: seconds of CPU time, octets of address space.
CPU_SECONDS: Final = 120
_ADDRESS_SPACE: Final = 4 << 30

Fate = Literal["killed", "broken", "noticed", "survived"]


class Outcome(msgspec.Struct, frozen=True):
    """What became of one change."""

    key: str
    fate: Fate
    """``killed``: a case failed; ``broken``: the node did not start, or did not come to an end; ``noticed``: cases
    became inconclusive or stumbled, none failed; ``survived``: every case came out as without the change."""
    by: str = ""
    """The first case that noticed, and why."""
    profile: str = ""
    seconds: float = 0.0


class _Mutator(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module of the node from changed source."""

    def __init__(self, site: Site) -> None:
        self._name = f"dcp_stack.{site.module}"
        self._code: CodeType = compile(mutated(site), f"<changed {site.module}.py>", "exec")

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """The changed module; None for every other."""
        del path, target
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._name else None

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        exec(self._code, module.__dict__)  # noqa: S102 - our own source with one change


def limit() -> None:
    """Bound this process: a change can make a loop endless, or a list."""
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS + 5))
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def try_site(site: Site, profiles: Sequence[str] = PROFILES) -> Outcome:
    """Run the suite until a case notices. For a new process only: it must not have imported ``dcp_stack``."""
    loaded = [name for name in sys.modules if name == "dcp_stack" or name.startswith("dcp_stack.")]
    if loaded:
        raise RuntimeError(f"the node without the change has been imported already: {', '.join(loaded[:3])}")
    began = time.monotonic()
    sys.meta_path.insert(0, _Mutator(site))

    def outcome(fate: Fate, by: str, profile: str) -> Outcome:
        return Outcome(site.key, fate, by[:300], profile, round(time.monotonic() - began, 2))

    noticed: Outcome | None = None
    profile = ""
    try:
        from dcp_conformance.case import all_cases
        from dcp_conformance.selection import ordered
        from dcp_conformance.selftest import Suite

        cases = list(ordered(all_cases().values()))
        for profile in profiles:
            for result in Suite(profile).run(cases):
                if result.verdict is Verdict.FAIL:
                    return outcome("killed", f"{result.id}: {result.reason}", profile)
                if noticed is None and result.verdict in (Verdict.ERROR, Verdict.INCONCLUSIVE):
                    noticed = outcome("noticed", f"{result.id}: {result.verdict}: {result.reason}", profile)
    except ConformanceError as error:
        return outcome("broken", str(error), profile)
    except Exception as error:
        return outcome("broken", f"{type(error).__name__}: {error}", profile)
    return noticed or outcome("survived", "", profile)
