"""Nodes without some of the protocols above BP."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec

from dcp_conformance.pics import Capabilities

from .surroundings import without
from .variant import Setup, Variant, has_srp, setup

#: Without VarDis nothing in the specification answers a beacon: what only VarDis would show cannot be decided.
_NO_PROBE = ()


def _only(*, srp: bool, vardis: bool, told: bool, hidden: tuple[str, ...] = ()) -> Callable[[str], Setup]:
    def build(profile: str) -> Setup:
        there = Capabilities(srp=srp, vardis=vardis) if told else Capabilities()
        made = setup(profile, pics=there, upper=without(*hidden))
        config = msgspec.structs.replace(
            made.config, srp=made.config.srp if srp else None, vardis=made.config.vardis if vardis else None
        )
        return Setup(config, made.make, made.pics, made.upper)

    return build


def _variants() -> Iterator[Variant]:
    why = "dcp-architecture.md: SRP and VarDis are client protocols of BP like others; PICS srp, vardis"
    for told in (True, False):
        pics = "its PICS says so" if told else "its PICS is silent"
        end = "" if told else "-silent"
        yield Variant(
            f"V-BP-alone{end}",
            f"has BP and nothing above it; {pics}",
            why,
            _only(srp=False, vardis=False, told=told),
            explains=_NO_PROBE,
        )
        yield Variant(
            f"V-BP-SRP{end}",
            f"has BP and SRP, no VarDis; {pics}",
            why,
            _only(srp=True, vardis=False, told=told),
            explains=_NO_PROBE,
            where=has_srp,
        )
        yield Variant(
            f"V-BP-VD{end}", f"has BP and VarDis, no SRP; {pics}", why, _only(srp=False, vardis=True, told=told)
        )


VARIANTS = tuple(_variants())
