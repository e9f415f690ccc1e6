"""What a permitted variant is, and how variants are found.

A variant is a node that follows the specification and differs from ours in one point that the specification leaves
open. It may also be our node with another upper tester, PICS or PIXIT: the contract of the upper tester and the files
leave freedoms as well.
"""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from types import ModuleType
from typing import Any, Final, Protocol

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.rules import contradictions

from dcp_codec.codec import Codec
from dcp_conformance.errors import UsageError
from dcp_conformance.model.pics import Capabilities, Pics, Testing
from dcp_conformance.reference.inprocess import NODE_ID, MakeNode, plain_node, reference_config
from dcp_conformance.selftest.mutants.mutant import node_with
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig

PACKAGE: Final = "dcp_conformance.selftest.variants"


class Application(Protocol):
    """An application on the node, which acts while the tester tests. Times are ns."""

    def due(self) -> int:
        """The monotonic time at which :meth:`act` is to be called next."""
        ...

    def act(self, node: Any, now: int, wall: int) -> None:
        """Ask services of the node. Called as well after ``UT-Reset`` or a restart has taken everything away."""
        ...


def same_clock(now: int) -> int:
    """No difference between the node's clock and the tester's."""
    del now
    return 0


class UpperTesting(msgspec.Struct, frozen=True, kw_only=True):
    """How the node's upper tester differs from ours."""

    there: bool = True
    """Whether there is an upper tester at all."""
    without: frozenset[str] = frozenset()
    """Methods that it does not offer."""
    call_ms: float = 0.0
    """Time that each call takes, half of it before the node is asked."""
    answers: Callable[[str, dict[str, Any], Any], Any] | None = None
    """Changes an :class:`~dcp_conformance.upper_tester.Answer`; is given method, parameters and answer."""
    one_connection: bool = False
    """Whether there cannot be a second connection at the same time."""


@dataclass(frozen=True, slots=True)
class Setup:
    """A node and everything that the tester is told about it."""

    config: NodeConfig
    make: MakeNode = plain_node
    pics: Pics = field(default_factory=Pics)
    upper: UpperTesting = field(default_factory=UpperTesting)
    can_restart: bool = True
    application: Callable[[], Application] | None = None
    clock: Callable[[int], int] = same_clock
    """By how many ns the node's wall clock is ahead of the tester's, by monotonic time in ns."""


def anywhere(profile: Profile) -> bool:
    """Every profile has room for the freedom."""
    del profile
    return True


@dataclass(frozen=True, slots=True)
class Variant:
    """One permitted node."""

    id: str
    """``V-<part>-<freedom>``, never used for another freedom."""
    what: str
    """What is different, as a sentence whose subject is the node."""
    why: str
    """Reading, requirement, or place in the text that permits it."""
    build: Callable[[str], Setup]
    """Makes the node for the profile of a name."""
    since: SpecVersion = SpecVersion.V1_0
    until: SpecVersion | None = None
    """First and last version of the specification that permits it; None: no last one."""
    explains: tuple[str, ...] = ()
    """Regular expressions, searched for in ``<case>: <reason>`` of an inconclusive verdict that cannot be avoided."""
    where: Callable[[Profile], bool] = field(default=anywhere)
    """Whether a profile has room for the freedom."""

    def applies_to(self, profile: str) -> bool:
        """Whether the freedom exists on the profile of this name."""
        loaded = codec_of(profile).profile
        return loaded.spec_version.is_within(self.since, self.until) and self.where(loaded)

    def explanation(self, case: str, reason: str) -> str:
        """The expression that explains an inconclusive verdict; empty if it is not explained."""
        text = f"{case}: {reason}"
        return next((each for each in self.explains if re.search(each, text)), "")


@cache
def codec_of(profile: str) -> Codec:
    """The codec of a built-in profile."""
    return Codec(profile)


def setup(
    profile: str | Codec,
    *,
    part: type | None = None,
    make: MakeNode | None = None,
    readings: dict[str, str] | None = None,
    bp: BPConfig | None = None,
    srp: SRPConfig | None = None,
    vardis: VardisConfig | None = None,
    pics: Capabilities | None = None,
    pixit: Testing | None = None,
    **more: Any,
) -> Setup:
    """A set-up of our node with one thing changed.

    ``part``: the subclass of a part of the node to put into its place. ``more``: further fields of :class:`Setup`.
    """
    codec = profile if isinstance(profile, Codec) else codec_of(profile)
    layout = codec.profile.types.node_id
    own = NODE_ID if layout.length is not None or layout.width == len(NODE_ID) else _node_id(layout.width)
    config = reference_config(codec, node_id=own)
    changes: dict[str, Any] = {"bp": bp, "vardis": vardis, "readings": readings}
    if srp is not None and config.srp is not None:
        changes["srp"] = srp
    config = msgspec.structs.replace(config, **{name: value for name, value in changes.items() if value is not None})
    if part is not None:
        make = node_of(part)
    return Setup(
        config, make=make or plain_node, pics=Pics(pics=pics or Capabilities(), pixit=pixit or Testing()), **more
    )


def _node_id(width: int) -> bytes:
    return (1).to_bytes(width, "big")


def node_of(part: type) -> MakeNode:
    """Makes a node that has ``part`` where ours has the class that ``part`` derives from."""
    made_of = node_with(part)

    def make(config: NodeConfig, rng: Any, now: int, wall: int) -> Any:
        return made_of(config, rng=rng, now=now, wall=wall)

    return make


def derived(name: str, change: Callable[[Profile], Profile]) -> Codec:
    """The codec of a changed copy of a built-in profile.

    Raises ``ValueError`` if the copy contradicts itself.
    """
    profile = change(codec_of(name).profile)
    if wrong := list(contradictions(profile)):
        raise ValueError(f"{name} with another layout: {'; '.join(wrong)}")
    return Codec(profile)


def by_letter(profile: Profile) -> bool:
    """Whether the profile is the specification's own: the others describe one implementation each."""
    return profile.name.startswith("dcp-")


def has_srp(profile: Profile) -> bool:
    """Whether the profile has octets for state reports."""
    return bool(profile.srp.is_report)


def variants_of(module: ModuleType) -> Iterable[Variant]:
    """The variants of a module: its ``VARIANTS``."""
    found: Iterable[Variant] = getattr(module, "VARIANTS", ())
    return found


@cache
def all_variants() -> dict[str, Variant]:
    """All variants by identifier. Raises ``ValueError`` for an identifier that is there twice."""
    found: dict[str, Variant] = {}
    package = importlib.import_module(PACKAGE)
    for name in sorted(info.name for info in pkgutil.iter_modules(package.__path__)):
        if name == __name__.rpartition(".")[2]:
            continue
        for each in variants_of(importlib.import_module(f"{PACKAGE}.{name}")):
            if each.id in found:
                raise ValueError(f"{each.id} is there twice, the second time in {name}")
            found[each.id] = each
    return found


def chosen(patterns: Sequence[str]) -> list[Variant]:
    """The variants that identifiers or globs mean; all without any. Raises :class:`UsageError` for one without."""
    variants = list(all_variants().values())
    if not patterns:
        return variants
    found: set[str] = set()
    for pattern in patterns:
        meant = {each.id for each in variants if fnmatchcase(each.id, pattern)}
        if not meant:
            raise UsageError(
                f"no variant is called {pattern!r}; 'dcp-conformance selftest --variants --list' shows those there are"
            )
        found |= meant
    return [each for each in variants if each.id in found]


__all__ = [
    "Application",
    "Setup",
    "UpperTesting",
    "Variant",
    "all_variants",
    "by_letter",
    "chosen",
    "codec_of",
    "derived",
    "has_srp",
    "node_of",
    "setup",
    "variants_of",
]
