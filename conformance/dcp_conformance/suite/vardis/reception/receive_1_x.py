"""dcp-vardis.md: Processing Order of Instruction Containers, invalid containers in versions up to 1.1."""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_REQUEST = ICType.REQUEST_VARCREATES
_V1_0, _V1_1 = SpecVersion.V1_0, SpecVersion.V1_1
_Bad = Callable[[Bench, Peer, int], bytes]


def _unknown_type(bench: Bench, peer: Peer, var_id: int) -> bytes:
    taken = bench.profile.vardis.container_names()
    free = next(each for each in range(255, -1, -1) if each not in taken)
    return bench.builder.container(peer.summary(var_id, 1), lies={"icType": free})


def _cut_off(bench: Bench, peer: Peer, var_id: int) -> bytes:
    return bench.builder.container(peer.create(var_id))[:-1]


def _no_records(bench: Bench, peer: Peer, var_id: int) -> bytes:
    return bench.builder.container(peer.summary(var_id, 1), lies={"icNumRecords": 0})[
        : bench.builder.container_header_size
    ]


_IN_1_0 = Needs(until=_V1_0)


@case(
    "TC_VD_RX_BV_12",
    "Up to 1.1, containers before an invalid one are processed ({variant})",
    requirements="VD-RX-11",
    stimulus="a payload with a valid container and an invalid one ({variant})",
    expect="the reaction to the valid container",
    window=8,
    needs=Needs(since=_V1_1, until=_V1_1),
    variants={
        "unknown-type": _unknown_type,
        "cut-off": _cut_off,
        "no-records": _no_records,
        "unknown-type-1.0": Variant(_unknown_type, requirements="VD-RX-10", needs=_IN_1_0),
        "cut-off-1.0": Variant(_cut_off, requirements="VD-RX-10", needs=_IN_1_0),
    },
)
def before_the_error(bench: Bench, bad: _Bad) -> None:
    peer, (wanted, damaged) = bench.peer(), bench.identifiers.unknown_ids(2)
    bench.identifiers.created.add(damaged)
    peer.send(bench.builder.container(peer.summary(wanted, 1)), bad(bench, peer, damaged))
    found = bench.until_instruction(_REQUEST, wanted)
    bench.some(found, "a request for the variable in the container before the invalid one")


@case(
    "TC_VD_RX_BV_13",
    "In 1.1, containers after an invalid one are not processed ({variant})",
    requirements="VD-RX-11",
    stimulus="a payload with an invalid container ({variant}) and a valid one",
    expect="no reaction to the valid container",
    window=8,
    needs=Needs(since=_V1_1, until=_V1_1),
    variants={"unknown-type": _unknown_type, "no-records": _no_records},
)
def after_the_error(bench: Bench, bad: _Bad) -> None:
    peer, (wanted, damaged) = bench.peer(), bench.identifiers.unknown_ids(2)
    since = peer.stimulate(bad(bench, peer, damaged), bench.builder.container(peer.summary(wanted, 1)))
    bench.require_processed("the payload")
    found = bench.instructions(_REQUEST, wanted, since)
    bench.none(found, "no request for the variable in the container after the invalid one")
