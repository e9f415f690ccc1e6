"""Nodes without some of the protocols above BP."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec

from dcp_conformance.model.pics import Capabilities

from .services import NOBODY_TOLD
from .surroundings import without
from .variant import Setup, Variant, has_srp, setup

#: Without VarDis nothing in the specification answers a beacon. The tester cannot tell a node that lacks VarDis from
#: one whose VarDis is broken as long as the PICS does not say so.
_NO_VARDIS = (
    r"; but VarDis answered nothing that could be read when the run began$",
    r"if the implementation has no VarDis, set vardis = false in \[pics\]$",
    # It takes nothing that it is sent, as with parameters that nobody has told.
    NOBODY_TOLD,
    r"the implementation (learns|notices|sends) .*: it does not( repeat it| pass it on)?$",
    r"^TC_DCP_SANITY_BV_01: .*but not a summary of an unknown variable",
    # The node has nothing to say of its own.
    r"^TC_BP_HDR_BV_03: 4 beacons, which this case needs",
    r"^TC_BP_HDR_BV_09: a beacon with the answer to a probe, which this case needs",
    r"^TC_BP_INI_BV_01: a beacon after the restart",
    r"takes part again after its restart: no answer to five probes",
)
#: The same for SRP.
_NO_SRP = (r"^TC_SRP_INI_BV_0[123]: .*srp = false in \[pics\]",)


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
            explains=() if told else (*_NO_VARDIS, *_NO_SRP),
        )
        yield Variant(
            f"V-BP-SRP{end}",
            f"has BP and SRP, no VarDis; {pics}",
            why,
            _only(srp=True, vardis=False, told=told),
            explains=() if told else _NO_VARDIS,
            where=has_srp,
        )
        yield Variant(
            f"V-BP-VD{end}",
            f"has BP and VarDis, no SRP; {pics}",
            why,
            _only(srp=False, vardis=True, told=told),
            explains=() if told else _NO_SRP,
        )


VARIANTS = tuple(_variants())
