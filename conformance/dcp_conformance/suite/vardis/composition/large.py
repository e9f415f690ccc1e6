"""dcp-vardis.md: Receive Path, payloads larger than the receiver's own maximum."""

from __future__ import annotations

from dcp_spec.constants import IC_MAX_RECORDS, ICType

from dcp_codec.values import VarSumm
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.bp_clients import areas_of_fixed_size, block_header_octets, header_octets
from dcp_conformance.test_steps.services import teach_variable
from dcp_conformance.test_steps.variable_queries import ask, check_state
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

#: Octets of a bearer payload that Ethernet and UDP carry in one frame.
_LARGEST = 1450
_LIMITS = {"own-payload": "VARDISPAR_MAX_PAYLOAD_SIZE", "own-beacon": "BPPAR_MAXIMUM_PACKET_SIZE"}


def _octets(bench: Bench, limit: str) -> int:
    """Return the size in octets of a VarDis payload one octet larger than the implementation's own may be."""
    headers = header_octets(bench) + block_header_octets(bench) if limit.startswith("BP") else 0
    return bench.sut.parameter(limit) + 1 - headers


def _carried(limit: str) -> Needs:
    def when(bench: Bench) -> str | None:
        size = _octets(bench, limit) + header_octets(bench) + block_header_octets(bench)
        if size > _LARGEST:
            return f"{limit} is as large as a frame"
        return areas_of_fixed_size(bench)

    return Needs(when=when)


@case(
    "TC_VD_ROB_BV_01",
    "A receiver survives a payload larger than its own maximum ({variant})",
    requirements="VD-ROB-01 VD-RX-04",
    stimulus=(
        "a payload one octet larger than the implementation's own maximum, with summaries of two unknown variables "
        "in its first and last container, and many equal summaries of a known variable between them; then a valid "
        "payload"
    ),
    expect="VarDis continues, and its database is unchanged; the case reports whether it processes the large payload",
    window=14,
    variants={name: Variant(limit, needs=_carried(limit)) for name, limit in _LIMITS.items()},
    destructive=True,
    robustness=True,
)
def larger_than_own(bench: Bench, limit: str) -> None:
    peer = bench.peer()
    known = teach_variable(bench, peer, value=b"stays")
    first, last = bench.identifiers.unknown_ids(2)
    since = peer.stimulate(bench.builder.vardis(*_filled(bench, peer, first, last, known, _octets(bench, limit))))
    bench.require_processed("a payload larger than its own maximum", "VD-ROB-01")
    asked = [bool(bench.instructions(ICType.REQUEST_VARCREATES, each, since)) for each in (first, last)]
    observed = {(True, True): "yes", (False, False): "no", (True, False): "only its first container"}
    question = f"Is a payload processed that is larger than {limit} allows the implementation's own?"
    bench.info(question, observed.get((asked[0], asked[1]), "only its last container"), "VD-RX-04")
    held = ask(bench, known)
    check_state(bench, held, "alive", "state of a known variable", "VD-ROB-01")
    bench.equal(held.record and held.record.upd.value, bench.records.value(b"stays"), "its value", "VD-ROB-01")


def _filled(bench: Bench, peer: Peer, first: int, last: int, known: int, octets: int) -> list[bytes]:
    """Return containers with ``octets`` octets in total, or a few more."""
    container = bench.builder.container
    ends = [container(peer.summary(first, 1)), container(peer.summary(last, 1))]
    left = octets - sum(map(len, ends))
    one, two = (len(container(*[peer.summary(known, 0)] * count)) for count in (1, 2))
    equal: list[VarSumm] = [peer.summary(known, 0)] * max(1, -(-left // (two - one)))
    groups = [equal[at : at + IC_MAX_RECORDS] for at in range(0, len(equal), IC_MAX_RECORDS)]
    return [ends[0], *(container(*group) for group in groups), ends[1]]
