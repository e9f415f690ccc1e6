"""Run the suite against the node with one change in its source, in a process that has not imported the node before."""

from __future__ import annotations

import gc
import itertools
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import msgspec
from dcp_conformance.definitions.case import Case, all_cases
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import ConformanceError
from dcp_conformance.execution.selection import ordered
from dcp_spec.catalogue.readings import readings
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import load_profile

from dcp_selftest.costs import COUNTING

from .isolation import import_changed
from .reach import Reach, Tracer, of_module
from .sites import Site, cited, mutated

if TYPE_CHECKING:
    from dcp_selftest.runner import Suite

PROFILES: Final = ("dcp-2.0", "dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "cpp-2.0")
"""Profiles on which a change is tried until a case detects it: much of the source is used for one version only."""
OTHER_READINGS: Final = "dcp-2.0 with other readings"
"""The node with the second alternative of every reading: some of the source is used for these only."""
NODES: Final = (*PROFILES, OTHER_READINGS)
"""The names of all nodes on which a change is tried."""
#: Prefixes of the cases about a module, by the first part of its name.
_PREFIXES: Final[dict[str, tuple[str, ...]]] = defaultdict(
    lambda: ("TC_",),
    vardis=("TC_VD", "TC_NET"),
    bp=("TC_BP",),
    client=("TC_BP",),
    srp=("TC_SRP",),
    neighbours=("TC_SRP",),
)
#: Readings that the node does not follow with the second alternative of every reading: blocks that end with the frame
#: (X02) are not compared with numPayloads (X48).
OVERRIDDEN: Final = frozenset({"X48"})
#: Alternatives of X28 and X34 by their names in profiles, where these are different.
_HALF_RANGE: Final = {"neither": "half-range-neither", "newer": "half-range-answered", "older": "half-range-older"}
#: Prefix of the cases of the model.
MODEL: Final = "TC_DCP_MODEL_"
_RECEIVE_ERRORS: Final = {"skip-element": "skip-container"}
#: Limits of a process: CPU time for each case in seconds (the longest takes 0.1 s), and address space in octets.
CPU_SECONDS: Final = 10
_ADDRESS_SPACE: Final = 4 << 30

Fate = Literal["killed", "broken", "noticed", "survived", "excused"]


class Outcome(msgspec.Struct, frozen=True):
    """The outcome of one change."""

    key: str
    fate: Fate
    """``killed``: a case failed; ``broken``: the node did not start, or looped endlessly; ``noticed``: cases became
    inconclusive or ended with an error, none failed; ``survived``: no case was affected; ``excused``: the change is in
    the ledger and was not tried."""
    by: str = ""
    """The first case that detected the change, with its reason."""
    profile: str = ""
    seconds: float = 0.0
    by_model: bool = False
    """Whether the case that detected the change is one of the model, and no hand-written case does."""


@cache
def cases() -> tuple[Case, ...]:
    """Return the cases in the order of a run. The number of a case is its index in this tuple."""
    return tuple(each for each in ordered(all_cases().values()) if each.id not in COUNTING)


class Step(NamedTuple):
    """One part of a trial: cases to run on one node."""

    node: str
    """One of :data:`NODES`."""
    cases: tuple[int, ...] | None
    """Numbers of the cases to run (see :func:`cases`); None: all."""


#: Every case on every node.
_EVERYTHING: Final = tuple(Step(node, None) for node in NODES)


def suite_of(node: str) -> tuple[Suite, Profile]:
    """Return the suite for the node of this name in :data:`NODES`, and the profile of the node."""
    # Import the node only here: the change must be installed first.
    from dcp_conformance.reference.inprocess import plain_node

    from dcp_selftest.runner import Suite

    if node != OTHER_READINGS:
        profile = load_profile(node)
        return Suite(node, pics=Pics(readings=declared_readings(profile))), profile
    profile = load_profile(PROFILES[0])
    others = {each.id: each.alternatives[1].name for each in readings().values() if len(each.alternatives) > 1}
    return (
        Suite(
            profile.name,
            lambda config, *rest: plain_node(msgspec.structs.replace(config, readings=others), *rest),
            Pics(readings={name: chosen for name, chosen in others.items() if name not in OVERRIDDEN}),
        ),
        profile,
    )


def declared_readings(profile: Profile) -> dict[str, str]:
    """Return the readings that the PICS of the unchanged node declares on ``profile``.

    The node follows the first alternative of each reading, except where the profile states the behaviour (X28, X34).
    """
    behaviour = profile.behaviour
    found = {each.id: each.alternatives[0].name for each in readings().values() if each.alternatives}
    found["X28"] = _HALF_RANGE[behaviour.seqno_half_range]
    found["X34"] = _RECEIVE_ERRORS.get(behaviour.vardis_receive_error, behaviour.vardis_receive_error)
    return found


def steps(site: Site, reached: Sequence[Reach] = ()) -> tuple[Step, ...]:
    """Return the steps of a trial of ``site``; empty if no case executes the changed code.

    ``reached`` has the lines that the cases execute on each node; without it every case is run on every node.
    """
    if not reached:
        return _EVERYTHING
    found = [(each.node, each.cases(site)) for each in reached]
    return tuple(
        Step(name, None if some is None else tuple(sorted(some))) for name, some in found if some is None or some
    )


def limit(seconds: int = CPU_SECONDS) -> None:
    """Limit the memory of this process, and its CPU time until the first case: a change can cause an endless loop."""
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    _limit_time(seconds)
    # Collect garbage rarely: reference counts free most objects of a trial.
    gc.freeze()
    gc.set_threshold(100_000)


def _limit_time(seconds: int = CPU_SECONDS) -> None:
    """End the process by SIGXCPU after so many further seconds of CPU time."""
    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + seconds, hard))


def try_site(site: Site | None, plan: Sequence[Step] | None = None) -> Outcome:
    """Run the suite until a case detects the change: the hand-written cases on all nodes, then those of the model.

    ``plan`` has the steps to run, by default all cases on all nodes. Cases that name a requirement cited near the
    change are run first. Without a ``site`` the node is unchanged, and the outcome must be ``survived``. Raise
    RuntimeError if the process has imported ``dcp_stack``: it must be new.
    """
    loaded = [name for name in sys.modules if name == "dcp_stack" or name.startswith("dcp_stack.")]
    if loaded:
        raise RuntimeError(f"the node without the change has been imported already: {', '.join(loaded[:3])}")
    began = time.monotonic()
    key = "" if site is None else site.key
    if site is not None:
        import_changed(f"dcp_stack.{site.module}", compile(mutated(site), f"<changed {site.module}.py>", "exec"))

    noticed: Outcome | None = None
    profile = ""
    by_model = False

    def outcome(fate: Fate, by: str, profile: str) -> Outcome:
        return Outcome(key, fate, by[:300], profile, round(time.monotonic() - began, 2), by_model)

    try:
        from dcp_selftest.runner import is_declared

        for by_model, (profile, numbers) in itertools.product((False, True), _EVERYTHING if plan is None else plan):
            chosen = [each for each in _in_order(site, numbers) if each.id.startswith(MODEL) is by_model]
            if not chosen:
                continue
            suite, wire = suite_of(profile)
            for result in itertools.chain(suite.run(_timed(chosen)), suite.passive()):
                if result.verdict is Verdict.FAIL and not is_declared(result, wire):
                    return outcome("killed", f"{result.id}: {result.reason}", profile)
                if noticed is None and result.verdict in (Verdict.ERROR, Verdict.INCONCLUSIVE):
                    noticed = outcome("noticed", f"{result.id}: {result.verdict}: {result.reason}", profile)
    except ConformanceError as error:
        return outcome("broken", str(error), profile)
    except Exception as error:
        return outcome("broken", f"{type(error).__name__}: {error}", profile)
    if not profile:
        return outcome("survived", "no case executes this code", "")
    return noticed or outcome("survived", "", profile)


def _timed(chosen: Iterable[Case]) -> Iterator[Case]:
    for case in chosen:
        _limit_time()
        yield case


def _in_order(site: Site | None, numbers: tuple[int, ...] | None) -> list[Case]:
    """Return the cases with these numbers; cases that are likely to detect the change are first."""
    chosen = list(cases()) if numbers is None else [cases()[number] for number in numbers]
    if site is None:
        return chosen
    place = {identifier: number for number, identifier in enumerate(cited(site))}
    variants: dict[str, int] = {}
    ranks: dict[str, tuple[bool, int, int, bool]] = {}
    for case in chosen:
        nth = variants[case.base] = variants.get(case.base, -1) + 1
        near = min((place[each] for each in case.requirements if each in place), default=len(place))
        elsewhere = not case.id.startswith(_PREFIXES[site.module.partition("_")[0]])
        # Destructive cases are last, because they may crash the node. The first variant of each case precedes the
        # second variants, because variants of one case mostly detect the same faults.
        ranks[case.id] = case.destructive, nth, near, elsewhere
    return sorted(chosen, key=lambda case: ranks[case.id])


def measure(node: str, numbers: Sequence[int] | None = None) -> Reach:
    """Run cases on ``node`` under the tracer, and return the lines that each executes.

    ``numbers`` selects cases, of which the first must be the sanity case; None selects all. The process must be new,
    because the function modifies the class of the configuration.
    """
    chosen = cases() if numbers is None else [cases()[number] for number in numbers]
    place = {case.id: number for number, case in enumerate(cases())}
    tracer = Tracer()
    found: dict[str, dict[int, list[int]]] = {}
    sys.settrace(tracer)
    try:
        # Import the node under the tracer: some functions are called during the import only.
        from dcp_stack.config import NodeConfig

        # Disable the cache of the configuration: otherwise only the first case would execute the cached functions.
        setattr(NodeConfig, "once", lambda config, find: find(config))  # noqa: B010 - of a frozen class
        suite, _ = suite_of(node)
        always = tracer.take()
        for result in suite.run(chosen):
            for module, line in tracer.take():
                found.setdefault(module, {}).setdefault(line, []).append(place[result.id])
    finally:
        sys.settrace(None)
    return Reach(
        node,
        {module: {line: tuple(each) for line, each in lines.items()} for module, lines in found.items()},
        {module: of_module(module, always) for module in {module for module, _ in always}},
    )
