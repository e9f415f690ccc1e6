"""Variants without SRP, VarDis or both."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
from dcp_conformance.definitions.pics import Capabilities
from dcp_conformance.reference.surroundings import Setup

from .services import ASSUMED_VALUE
from .variant import Variant, has_srp, setup, without

#: Only VarDis answers beacons. Without a PICS the tester cannot distinguish a node without VarDis from one whose VarDis
#: does not work.
_NO_VARDIS = (
    r"; but VarDis answered nothing that could be read when the run began$",
    r"if the implementation has no VarDis, set vardis = false in \[pics\]$",
    # The node ignores all VarDis payloads, as it would with unknown parameters.
    ASSUMED_VALUE,
    r": a (forwarded VarCreate|VarCreate of the variable).*: (none|not forwarded) in time$",
    # The node sends no beacon by itself.
    r"^TC_BP_HDR_BV_03: 4 beacons, which this case needs",
    r"^TC_BP_HDR_BV_09: a beacon with the answer to a probe, which this case needs",
    r"^TC_BP_INI_BV_01: a beacon after the restart",
    r": an answer of the implementation after its restart: no answer to five probes$",
)
#: Inconclusive verdicts that follow from a node without SRP.
_NO_SRP = (r"^TC_SRP_INI_BV_0[123]: .*srp = false in \[pics\]",)


def _only(*, srp: bool, vardis: bool, declared: bool, hidden: tuple[str, ...] = ()) -> Callable[[str], Setup]:
    """Return a builder of nodes with these protocols; ``declared``: in their PICS."""

    def build(profile: str) -> Setup:
        there = Capabilities(srp=srp, vardis=vardis) if declared else Capabilities()
        made = setup(profile, pics=there, upper=without(*hidden))
        config = msgspec.structs.replace(
            made.config, srp=made.config.srp if srp else None, vardis=made.config.vardis if vardis else None
        )
        return Setup(config, made.make, made.pics, made.upper)

    return build


def _variants() -> Iterator[Variant]:
    why = "dcp-architecture.md: SRP and VarDis are client protocols of BP like others; PICS srp, vardis"
    for declared in (True, False):
        pics = "its PICS declares it" if declared else "its PICS does not declare it"
        end = "" if declared else "-silent"
        yield Variant(
            f"V-BP-alone{end}",
            f"has BP only; {pics}",
            why,
            _only(srp=False, vardis=False, declared=declared),
            explains=() if declared else (*_NO_VARDIS, *_NO_SRP),
        )
        yield Variant(
            f"V-BP-SRP{end}",
            f"has BP and SRP, no VarDis; {pics}",
            why,
            _only(srp=True, vardis=False, declared=declared),
            explains=() if declared else _NO_VARDIS,
            where=has_srp,
        )
        yield Variant(
            f"V-BP-VD{end}",
            f"has BP and VarDis, no SRP; {pics}",
            why,
            _only(srp=False, vardis=True, declared=declared),
            explains=() if declared else _NO_SRP,
        )


VARIANTS = tuple(_variants())
