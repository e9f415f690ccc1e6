"""dcp-bp.md: Receive Path.

What has to be ignored is shown by a variable that must not become known, and by a probe behind it that must.
"""

from __future__ import annotations

from dcp_spec.constants import ICType

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case


@case(
    "TC_BP_RX_BI_01",
    "A beacon with version octet {variant} is dropped",
    requirements="BP-RX-01",
    stimulus="a beacon with the summary of an unknown variable and version octet {variant}; then an honest one",
    expect="no request for the first variable, a request for the second",
    needs=Needs(header=("version",)),
    variants={"00": 0, "02": 2, "ff": 0xFF},
)
def wrong_version(bench: Bench, version: int) -> None:
    peer, ignored = bench.peer(), bench.var_id()
    peer.send(peer.summary(ignored, 1), lies={"bp.version": version})
    bench.require_alive("a beacon that it must ignore")
    requests = bench.instructions(ICType.REQUEST_VARCREATES, ignored)
    bench.check(not requests, "nothing of the beacon is processed", "its variable is requested", frames=requests)
