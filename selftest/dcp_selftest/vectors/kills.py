"""Test the vectors: permitted nodes must pass, and mutants must fail by the vectors alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final

import msgspec
from dcp_conformance.reference.inprocess import MakeNode, reference_config
from dcp_conformance.vectors.behaviour import BehaviourGroup, Vector
from dcp_spec.markdown import table

from dcp_codec.codec import get_codec
from dcp_selftest.mutants import Mutant, all_mutants
from dcp_selftest.runner import in_processes
from dcp_stack.config import NodeConfig

from .making import family
from .replay import failures, trace
from .wire_kills import outcomes

_COLUMNS: Final = (
    "profile", "behaviour vectors", "permitted nodes", "refusals", "wire mutants", "behaviour mutants",
)  # fmt: skip
#: Shares of the mutants that the vectors must detect.
WIRE_GOAL: Final = 0.8
BEHAVIOUR_GOAL: Final = 0.6


class Killed(msgspec.Struct, frozen=True):
    """The outcome of the vectors for one mutant."""

    mutant: str
    vector: str
    """The first vector that fails; empty if all pass."""
    why: str


def failure(vector: Vector, config: NodeConfig, make: MakeNode, seed: int = 1) -> str:
    """Return what is wrong first when a node replays a vector; empty if nothing is."""
    found = trace(config, make, vector.steps, vector.end, seed)
    return next(failures(vector, found), "")


def ordered(vectors: Iterable[Vector], mutant: Mutant) -> list[Vector]:
    """Return the vectors, those about the requirements of a mutant first, and shorter ones before longer ones."""
    named = set(mutant.requirements)
    return sorted(vectors, key=lambda each: (not named & set(each.requirements), each.end * len(each.steps)))


def kill(profile: str, mutant: Mutant, vectors: Sequence[Vector]) -> Killed:
    """Replay vectors on a mutant until one fails."""
    config = reference_config(get_codec(profile))
    for each in vectors:
        if why := failure(each, config, mutant.make):
            return Killed(mutant.id, each.tc_id, why)
    return Killed(mutant.id, "", "")


def mutants_of(profile: str) -> Iterator[Mutant]:
    """Yield the mutants that are faults in the version of a profile."""
    version = get_codec(profile).profile.spec_version
    return (each for each in all_mutants().values() if each.exists_in(version))


class Refused(msgspec.Struct, frozen=True):
    """A permitted node that fails a vector."""

    node: str
    vector: str
    why: str


class Result(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome for the vectors of one profile."""

    profile: str
    vectors: int
    nodes: tuple[str, ...]
    """The permitted nodes that passed or failed."""
    refused: tuple[Refused, ...]
    wire: tuple[Killed, ...]
    behaviour: tuple[Killed, ...]

    def summary(self) -> Iterator[str]:
        """Yield the numbers as lines."""
        yield (
            f"{self.profile}: {self.vectors} behaviour vectors, {len(self.nodes)} permitted nodes, "
            f"{len(self.refused)} refusals"
        )
        yield f"{self.profile}: wire mutants: {share(self.wire)} detected"
        yield f"{self.profile}: behaviour mutants: {share(self.behaviour)} detected"

    def exit_status(self) -> int:
        """Return 0 if all permitted nodes pass, and the goals are met."""
        goals = ((self.wire, WIRE_GOAL), (self.behaviour, BEHAVIOUR_GOAL))
        enough = all(sum(bool(each.vector) for each in found) >= goal * len(found) for found, goal in goals)
        return 0 if enough and not self.refused else 1


class Results(msgspec.Struct, frozen=True):
    """The content of ``vectors.json``."""

    profiles: tuple[Result, ...]

    def section(self) -> str:
        """Return the section ``vectors`` of docs/selftest.md."""
        rows = [
            (each.profile, each.vectors, len(each.nodes), len(each.refused), share(each.wire), share(each.behaviour))
            for each in self.profiles
        ]
        survivors: dict[str, list[str]] = {}
        for result in self.profiles:
            for each in result.behaviour:
                if not each.vector:
                    survivors.setdefault(each.mutant, []).append(result.profile)
        lines = [
            "## Test vectors",
            "",
            "Made by `dcp-selftest vectors --document docs/selftest.md`.",
            "",
            "Permitted nodes replay the behaviour vectors of their profile and must pass. A mutant is detected if it",
            "fails a vector. Wire mutants are all single changes of the generated decoder and encoder that octets can",
            "show, behaviour mutants the mutants of the node that are faults in the version.",
            "",
            table(_COLUMNS, rows, "lrrrrr"),
            "",
            "Behaviour mutants that no vector detects:",
            "",
            table(
                ("mutant", "profiles"), ((f"`{name}`", ", ".join(found)) for name, found in sorted(survivors.items()))
            ),
        ]
        return "\n".join(lines) + "\n"


def share(found: Sequence[Killed]) -> str:
    """Return the number of mutants that are detected, of how many."""
    killed = sum(bool(each.vector) for each in found)
    return f"{killed} of {len(found)} ({100 * killed / max(1, len(found)):.1f} %)"


#: The vectors that are tested, by profile: set before processes are forked, which share them.
_TESTED: dict[str, BehaviourGroup] = {}


def _refused(task: tuple[str, int]) -> list[Refused]:
    profile, place = task
    name, config, make = family(profile)[place]
    failed = ((each, failure(each, config, make)) for each in _TESTED[profile].tests)
    return [Refused(name or "reference node", each.tc_id, why) for each, why in failed if why]


def _killed(task: tuple[str, str]) -> Killed:
    profile, name = task
    mutant = all_mutants()[name]
    return kill(profile, mutant, ordered(_TESTED[profile].tests, mutant))


def detected_by(profile: str, found: BehaviourGroup, jobs: int | None = None) -> list[Killed]:
    """Return the outcome of vectors for each mutant of the node."""
    _TESTED[profile] = found
    mutants = [(profile, each.id) for each in mutants_of(profile)]
    killed = dict(in_processes(_killed, mutants, jobs))
    return [killed[place] for place in range(len(mutants))]


def refusals(profile: str, found: BehaviourGroup, jobs: int | None = None) -> list[Refused]:
    """Return the vectors that permitted nodes fail."""
    _TESTED[profile] = found
    places = [(profile, place) for place in range(len(family(profile)))]
    refused = dict(in_processes(_refused, places, jobs))
    return [each for place in range(len(places)) for each in refused[place]]


def campaign(profile: str, found: BehaviourGroup, jobs: int | None = None) -> Result:
    """Test the vectors of a profile."""
    return Result(
        profile=profile,
        vectors=len(found.tests),
        nodes=tuple(name or "reference node" for name, _, _ in family(profile)),
        refused=tuple(refusals(profile, found, jobs)),
        wire=tuple(Killed(each.change, each.vector, "") for each in outcomes(get_codec(profile))),
        behaviour=tuple(detected_by(profile, found, jobs)),
    )


__all__ = [
    "Killed",
    "Refused",
    "Result",
    "Results",
    "campaign",
    "detected_by",
    "failure",
    "kill",
    "mutants_of",
    "ordered",
    "refusals",
    "share",
]
