"""Definition and lookup of permitted variants.

A variant is a node that follows the specification and differs from the reference node in one point that the
specification leaves open. It can also be the reference node with another upper tester, PICS or PIXIT, because the
contract of the upper tester and these files leave freedoms, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from functools import cache
from types import ModuleType
from typing import Any, Final

import msgspec
from dcp_conformance.definitions.pics import Capabilities, Pics, Testing
from dcp_conformance.definitions.registry import Registry
from dcp_conformance.reference.inprocess import MakeNode, plain_node, reference_config
from dcp_conformance.reference.surroundings import Setup, UpperTesting
from dcp_spec.constants import SpecVersion
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.rules import contradictions

from dcp_codec.codec import Codec
from dcp_selftest.mutants.mutant import node_with
from dcp_stack.config import BPConfig, NodeConfig, SRPConfig, VardisConfig

PACKAGE: Final = "dcp_selftest.variants"


def anywhere(profile: Profile) -> bool:
    """Return True: the freedom exists on every profile."""
    del profile
    return True


@dataclass(frozen=True, slots=True)
class Variant:
    """One permitted variant."""

    id: str
    """``V-<part>-<freedom>``; an identifier is never used for another freedom."""
    what: str
    """The difference, as a sentence whose subject is the node."""
    why: str
    """Reading, requirement, or place in the text that permits it."""
    build: Callable[[str], Setup]
    """Function of the name of a profile that returns the node."""
    since: SpecVersion = SpecVersion.V1_0
    until: SpecVersion | None = None
    """First and last version of the specification that permits it; None: no last one."""
    explains: tuple[str, ...] = ()
    """Regular expressions for ``<case>: <reason>`` of unavoidable inconclusive verdicts."""
    where: Callable[[Profile], bool] = field(default=anywhere)
    """Function that returns whether the freedom exists on a profile."""

    def applies_to(self, profile: str) -> bool:
        """Return whether the freedom exists on the profile of this name."""
        loaded = codec_of(profile).profile
        return loaded.spec_version.is_within(self.since, self.until) and self.where(loaded)

    def explanation(self, case: str, reason: str) -> str:
        """Return the expression that explains an inconclusive verdict; empty if none matches."""
        text = f"{case}: {reason}"
        return next((each for each in self.explains if re.search(each, text)), "")


@cache
def codec_of(profile: str) -> Codec:
    """Return the codec of a built-in profile."""
    return Codec(profile)


def setup(
    profile: str | Codec,
    *,
    part: type | None = None,
    make: MakeNode | None = None,
    readings: dict[str, str] | None = None,
    declared: Collection[str] | None = None,
    bp: BPConfig | None = None,
    srp: SRPConfig | None = None,
    vardis: VardisConfig | None = None,
    pics: Capabilities | None = None,
    pixit: Testing | None = None,
    **more: Any,
) -> Setup:
    """Return a set-up of the reference node with changes.

    The PICS declares the ``readings``, or those of them with the identifiers in ``declared``.

    ``part`` is a subclass of a part of the node that replaces the part. ``more`` has further fields of :class:`Setup`.
    """
    codec = profile if isinstance(profile, Codec) else codec_of(profile)
    config = reference_config(codec)
    changes: dict[str, Any] = {"bp": bp, "vardis": vardis, "readings": readings}
    if srp is not None and config.srp is not None:
        changes["srp"] = srp
    config = msgspec.structs.replace(config, **{name: value for name, value in changes.items() if value is not None})
    if part is not None:
        make = node_of(part)
    claimed = {name: each for name, each in (readings or {}).items() if declared is None or name in declared}
    return Setup(
        config,
        make=make or plain_node,
        pics=Pics(pics=pics or Capabilities(), readings=claimed, pixit=pixit or Testing()),
        **more,
    )


def slow(call_ms: float, without: frozenset[str] = frozenset()) -> UpperTesting:
    """Return an upper tester that takes ``call_ms`` for each call and lacks the methods ``without``."""
    return UpperTesting(call_ms=call_ms, without=without)


def without(*methods: str) -> UpperTesting:
    """Return an upper tester that lacks ``methods``."""
    return UpperTesting(without=frozenset(methods))


def node_of(part: type) -> MakeNode:
    """Return a constructor of nodes in which ``part`` replaces the base class that it is derived from."""
    made_of = node_with(part)

    def make(config: NodeConfig, rng: Any, now: int, wall: int) -> Any:
        return made_of(config, rng=rng, now=now, wall=wall)

    return make


def derived(name: str, change: Callable[[Profile], Profile]) -> Codec:
    """Return the codec of a changed copy of the built-in profile ``name``.

    Raise ``ValueError`` if the copy contradicts itself.
    """
    profile = change(codec_of(name).profile)
    if wrong := list(contradictions(profile)):
        raise ValueError(f"{name} with another layout: {'; '.join(wrong)}")
    return Codec(profile)


def by_letter(profile: Profile) -> bool:
    """Return whether the profile is that of a specification, not that of one implementation."""
    return profile.name.startswith("dcp-")


def has_srp(profile: Profile) -> bool:
    """Return whether the profile defines the octets of state reports."""
    return bool(profile.srp.is_report)


def variants_of(module: ModuleType) -> Iterable[Variant]:
    """Return the variants in ``VARIANTS`` of a module; empty without it."""
    found: Iterable[Variant] = getattr(module, "VARIANTS", ())
    return found


ALL_VARIANTS: Final = Registry[Variant]("variant", PACKAGE, "dcp-selftest variants --list", entries_of=variants_of)
all_variants = ALL_VARIANTS.all

__all__ = [
    "ALL_VARIANTS",
    "Variant",
    "all_variants",
    "by_letter",
    "codec_of",
    "derived",
    "has_srp",
    "node_of",
    "setup",
    "slow",
    "variants_of",
    "without",
]
