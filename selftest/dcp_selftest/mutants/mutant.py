"""Mutants: our node with one small fault each, which a case that names the violated requirement must detect.

A mutant replaces one part of the node (an entity, its queue, its receiver, the node itself) with a subclass, while
the node is made (:func:`replaced`). Mutants do not depend on each other.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, Final, TypeVar

from dcp_conformance.definitions.registry import Registry
from dcp_conformance.reference.inprocess import MakeNode
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import SpecVersion

from dcp_stack.bp.clients import ClientList
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.parameters import BPParameters
from dcp_stack.bp.receive import Receiver as BPReceiver
from dcp_stack.bp.timing import BeaconSchedule
from dcp_stack.bp.wire import BPWire
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.srp.entity import StateReporting
from dcp_stack.srp.neighbour_table import NeighbourTable
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.core import Core, Sequence
from dcp_stack.vardis.database import Database
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.parameters import VardisParameters
from dcp_stack.vardis.receive import Receiver as VardisReceiver
from dcp_stack.vardis.wire import Extractor

_ATTRIBUTE: Final = "__dcp_mutant__"

#: Parts of the node, and the class in whose module each is made.
_MADE_BY: Final[Mapping[type, type]] = {
    BPWire: BeaconingProtocol,
    BPParameters: BeaconingProtocol,
    ClientList: BeaconingProtocol,
    BPReceiver: BeaconingProtocol,
    BeaconSchedule: BeaconingProtocol,
    BeaconingProtocol: Node,
    NeighbourTable: StateReporting,
    StateReporting: Node,
    Database: Core,
    Sequence: Core,
    VardisParameters: Core,
    Core: Vardis,
    Composer: Vardis,
    Extractor: Vardis,
    VardisReceiver: Vardis,
    Vardis: Node,
}

Part = TypeVar("Part", bound=type)


@dataclass(frozen=True, slots=True)
class Mutant:
    """One faulty node."""

    id: str
    """``M-<requirement>-<fault>``, never used for another fault."""
    requirement: str
    """The requirement that the mutant violates."""
    also: tuple[str, ...]
    """Further requirements that the same fault violates; a case may name one of them instead."""
    what: str
    """The fault, as a sentence whose subject is the node: ``sends version 0x02``."""
    make: MakeNode
    since: SpecVersion = SpecVersion.V1_0
    until: SpecVersion | None = None
    """First and last version of the specification in which this is a fault; None: no last one."""
    unseen: Mapping[SpecVersion, str] = field(default_factory=dict)
    """By version: why this is not a fault although the version has the requirement, or cannot be observed."""
    part: type | None = None
    """The changed part of the node; None if the fault is not a single part, and cannot be combined with others."""

    @property
    def versions(self) -> tuple[SpecVersion, ...]:
        """The versions of the specification on which the suite must detect the mutant, oldest first."""
        return tuple(each for each in SpecVersion if self.exists_in(each))

    @property
    def profiles(self) -> tuple[str, ...]:
        """The profiles on which the mutant is tried: one for each of its versions, newest first."""
        return tuple(f"dcp-{each}" for each in reversed(self.versions))

    @property
    def requirements(self) -> tuple[str, ...]:
        """The requirement that the mutant violates, and those that a case may name instead."""
        return (self.requirement, *self.also)

    @property
    def profile(self) -> str:
        """The profile of the newest version in which this is a fault."""
        return self.profiles[0]

    def exists_in(self, version: SpecVersion) -> bool:
        """Return whether this is an observable fault in a version."""
        return version.is_within(self.since, self.until) and version not in self.unseen


def mutant(
    fault: str,
    requirements: str,
    what: str,
    *,
    since: SpecVersion | None = None,
    until: SpecVersion | None = None,
    unseen: Mapping[str, str] | None = None,
) -> Callable[[Part], Part]:
    """Make a mutant of a subclass of a part of the node.

    ``requirements`` are ids separated by spaces, the violated one first. ``since`` and ``until`` are by default the
    first and the last version that has this requirement. ``unseen`` gives the reason for each version that has it and
    on which the mutant is nevertheless not tried; its keys are versions separated by spaces. Raises
    ``UnknownRequirementError`` for an id that is none, ``TypeError`` for a class that is not part of the node,
    ``ValueError`` for a version that has the requirement and is neither tried nor excused.
    """
    first, *also = requirements.split()
    for each in also:
        requirement(each)
    begin = requirement(first).since if since is None else since
    end = until or requirement(first).until
    excused = {SpecVersion(each): why for names, why in (unseen or {}).items() for each in names.split()}
    for version in SpecVersion:
        if requirement(first).holds_in(version) and not version.is_within(begin, end) and version not in excused:
            raise ValueError(f"M-{first}-{fault} is not tried on {version}, which has {first}: give a reason in unseen")

    def decorate(part: Part) -> Part:
        made = Mutant(f"M-{first}-{fault}", first, tuple(also), what, maker(node_with(part)), begin, end, excused, part)
        setattr(part, _ATTRIBUTE, made)
        return part

    return decorate


def part_of(changed: type) -> type:
    """Return the part of the node that a class derives from. Raises ``TypeError`` if there is none."""
    for part in (Node, *_MADE_BY):
        if issubclass(changed, part):
            return part
    raise TypeError(f"{changed.__name__} does not derive from a part of the node")


@contextmanager
def replaced(changed: Mapping[type, type]) -> Iterator[None]:
    """Make nodes with other parts (part -> subclass of it) inside the block.

    The modules of the node find the subclasses under the names of the parts, so that the node needs no hooks. Nodes
    that exist already keep their parts. Other threads must not make nodes while the block runs.
    """
    with ExitStack() as restoring:
        for part, other in changed.items():
            module = sys.modules[_MADE_BY[part].__module__]
            restoring.callback(setattr, module, part.__name__, getattr(module, part.__name__))
            setattr(module, part.__name__, other)
        yield


def node_with(*changed: type) -> type[Node]:
    """Return the class of a node that has ``changed`` instead of the parts that they derive from, also after a reset.

    Raises ``TypeError`` for a class that derives from no part of the node.
    """
    parts = {part_of(each): each for each in changed}
    base = parts.pop(Node, Node)
    if not parts:
        return base

    class Changed(base):  # type: ignore[misc, valid-type]
        def _build(self, now: int, wall: int) -> None:
            with replaced(parts):
                super()._build(now, wall)

    return Changed


def maker(made_of: type[Node]) -> MakeNode:
    """Make nodes of a class."""

    def make(config: NodeConfig, rng: random.Random, now: int, wall: int) -> Any:
        return made_of(config, rng=rng, now=now, wall=wall)

    return make


def mutants_of(module: ModuleType) -> Iterator[Mutant]:
    """Yield the mutants of a module, in their order in the module."""
    for value in vars(module).values():
        # A mutant that derives from another mutant has its own attribute.
        made = vars(value).get(_ATTRIBUTE) if isinstance(value, type) else value
        if isinstance(made, Mutant) and (not isinstance(value, type) or value.__module__ == module.__name__):
            yield made


ALL_MUTANTS: Final = Registry[Mutant](
    "mutant",
    "dcp_selftest.mutants",
    "dcp-selftest mutants --list",
    entries_of=mutants_of,
    names_of=lambda each: (each.id, each.requirement),
)
all_mutants = ALL_MUTANTS.all

__all__ = ["ALL_MUTANTS", "Mutant", "all_mutants", "maker", "mutant", "mutants_of", "node_with", "part_of", "replaced"]
