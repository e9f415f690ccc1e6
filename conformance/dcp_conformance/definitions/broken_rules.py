"""Which requirement the sender of octets has broken: the codec cites what a receiver has to do about them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dcp_spec.catalogue.requirements import requirements

from dcp_codec.errors import Problem

_OF_THE_SENDER: Final[Mapping[str, str]] = {
    "BP-RX-01": "BP-HDR-01",
    "BP-RX-02": "BP-HDR-02",
    "BP-RX-03": "BP-HDR-06",
    "BP-RX-04": "BP-HDR-07",
    "BP-RX-08": "BP-HDR-11",
    "BP-RX-09": "BP-FMT-01",
    "BP-RX-15": "BP-HDR-06",
    "SRP-RX-01": "SRP-FMT-01",
    "VD-RX-05": "VD-IC-02",
    "VD-RX-06": "VD-IC-03",
    "VD-RX-07": "VD-IC-01",
    "VD-PC-06": "VD-CRE-07",
}


def broken_by(problem: Problem) -> tuple[str, ...]:
    """The requirement that the sender of such octets has broken; empty if the catalogue has none."""
    cited = problem.requirement or ""
    found = _OF_THE_SENDER.get(cited, cited)
    return (found,) if found in requirements() else ()
