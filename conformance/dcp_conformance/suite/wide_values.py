"""Data Types: counters, numbers and names beyond 8 and 16 bits, and identifiers that differ in a single octet."""

from __future__ import annotations

from dcp_spec.constants import BP_SEQNO_MODULUS, SRP_SEQNO_MODULUS, ICType, QueueingMode, SpecVersion

from dcp_conformance.frames.builder import Block
from dcp_conformance.model.case import Needs, case
from dcp_conformance.test_steps.bp_clients import CLIENT, LIST, ONCE, QUERY, REPEAT, BPClient, needed
from dcp_conformance.test_steps.services import neighbours, parameters_set
from dcp_conformance.test_steps.state_reports import Reporter
from dcp_conformance.test_system.bench import MS, Bench

#: More than a number of 16 bits can count.
_WRAP = (1 << 16) + 1
#: More places than a number of 8 bits can count, and a longer name than most buffers of text.
_PLACES, _NAME = 300, "n" * 200
_CREATES = ICType.CREATE_VARIABLES


def _numeric(bench: Bench) -> str | None:
    """Return why octets of node identifiers cannot be changed, or None; for ``Needs.when``."""
    return "identifiers are text" if bench.profile.types.node_id.representation == "text" else None


def _alike(node_id: bytes) -> list[bytes]:
    """Return identifiers that each differ in another octet; they remain local addresses of single stations."""
    return [node_id[:place] + bytes([node_id[place] ^ 0x44]) + node_id[place + 1 :] for place in range(len(node_id))]


@case(
    "TC_DCP_WIDE_BV_01",
    "Neighbours whose identifiers differ in one octet have entries of their own",
    requirements="SRP-RX-05 SRP-RX-03 DATA-04",
    alone="it fills the neighbour table",
    stimulus="a record of one neighbour, and one of each neighbour whose identifier differs from it in one octet",
    expect="an entry of each with the sequence number of its record",
    needs=Needs(
        ut=("SRP-NeighbourTable",),
        entities=("srp",),
        when=lambda bench: _numeric(bench) or bench.sut.lacks("neighbours", 8) or None,
    ),
)
def neighbours_alike(bench: Bench) -> None:
    peer = bench.peer()
    names = [peer.node_id, *_alike(peer.node_id)]
    right = {node_id: number for number, node_id in enumerate(names, 10)}
    found: dict[bytes, object] = {}
    # A record may be lost.
    for _ in range(2):
        for node_id, number in right.items():
            peer.send(bench.records.report(node_id, number))
        bench.wait(bench.sut.processing)
        bench.waiting.wait_ns(50 * MS)
        table = neighbours(bench)
        found = {node_id: table[node_id][0].get("seqno") for node_id in names if node_id in table}
        if found == right:
            break
    wrong = {each.hex(":"): number for each, number in found.items() if number != right[each]}
    bench.check(not wrong, "the number of its own record in each entry", f"{wrong}", "SRP-RX-05", shown=True)
    missing = [each.hex(":") for each in names if each not in found]
    bench.check(not missing, f"entries of all {len(names)} neighbours", f"none of {', '.join(missing)}")


@case(
    "TC_DCP_WIDE_BV_02",
    "Producers whose identifiers differ from the implementation's in one octet are other nodes",
    requirements="VD-PC-03 VD-PC-09",
    stimulus="VarCreates of such producers, one for each octet",
    expect="each VarCreate is forwarded",
    window=8,
    needs=Needs(since=SpecVersion.V2_0, when=_numeric),
)
def producers_alike(bench: Bench) -> None:
    peer = bench.peer()
    creates = [peer.create(bench.var_id(), producer=each) for each in _alike(bench.identifiers.sut_id)]
    for create in creates:
        peer.send(create)
        if not bench.until_instruction(_CREATES, create.spec.var_id):
            peer.send(create)
            bench.until_instruction(_CREATES, create.spec.var_id)
    came = {each.var_id for each in bench.instructions(_CREATES)}
    missing = [each.spec.prod_id.hex(":") for each in creates if each.spec.var_id not in came]
    own = bench.identifiers.sut_id.hex(":")
    what = f"VarCreates of all producers whose identifiers resemble {own}"
    bench.check(not missing, what, f"none of {', '.join(missing)}")


@case(
    "TC_DCP_WIDE_BV_03",
    "Senders whose identifiers differ from the implementation's in one octet are other nodes",
    requirements="BP-RX-06 DATA-04",
    stimulus="beacons of such senders with a block for a client, one for each octet",
    expect="an indication of each block",
    needs=Needs(entities=(), ut=CLIENT, header=("senderId",), when=_numeric),
)
def senders_alike(bench: Bench) -> None:
    with BPClient(bench, ONCE) as client:
        if bench.session.sut_id is None:
            client.transmit(client.payload())
            needed(bench, client.until_sent(), "a beacon of the implementation")
        missing = []
        for number, sender in enumerate(_alike(bench.identifiers.sut_id)):
            octets = b"sender %d" % number
            for _ in range(2):
                bench.peer().send(Block(client.prot_id, octets), sender=sender)
                if octets in client.until_received(len(client.received()) + 1):
                    break
            else:
                missing.append(sender.hex(":"))
        bench.check(not missing, "an indication of each block", f"none of the blocks of {', '.join(missing)}")


@case(
    "TC_DCP_WIDE_BV_04",
    "The list of clients has a long name unchanged",
    requirements="BP-LST-01",
    stimulus=f"a registration with a name of {len(_NAME)} characters; BP-ListRegisteredProtocols",
    expect="the name; an implementation may refuse such a name",
    needs=Needs(entities=(), ut=(*CLIENT, LIST)),
)
def long_name(bench: Bench) -> None:
    with BPClient(bench, ONCE, name=_NAME) as client:
        shown = str((client.entry() or {}).get("protocolName"))
        what = f"a name of {len(_NAME)} characters"
        bench.check(shown == _NAME, what, f"{shown[:40]} ({len(shown)} characters)", shown=True)


@case(
    "TC_DCP_WIDE_BV_05",
    f"A queue of {_PLACES} entries holds {_PLACES} payloads",
    requirements="BP-QM-01 BP-QRY-02",
    stimulus=f"while BP is inactive, a client with maxEntries {_PLACES} submits two payloads more",
    expect=f"BP-QueryNumberBufferedPayloads answers {_PLACES}",
    needs=Needs(
        since=SpecVersion.V1_2,
        entities=(),
        ut=(*CLIENT, QUERY, "BP-MGMT-Activate", "BP-MGMT-Deactivate"),
        when=lambda bench: bench.sut.lacks("queue_entries", _PLACES) or None,
    ),
)
def long_queue(bench: Bench) -> None:
    with BPClient(bench, QueueingMode.QUEUE_DROPTAIL, entries=_PLACES, size=4) as client:
        with bench.services.deactivated("BP"):
            for _ in range(_PLACES + 2):
                client.transmit(client.payload(4), must=False)
            number = client.number()
        text = f"{number} buffered payloads"
        bench.check(number == _PLACES, f"{_PLACES} buffered payloads", text, shown=True)


@case(
    "TC_DCP_WIDE_BV_06",
    f"Sequence numbers of state reports count {_WRAP} submissions",
    requirements="SRP-SEQ-01 SRP-TYP-01",
    stimulus=f"{_WRAP} submissions of safety data",
    expect=f"a sequence number larger by {_WRAP}",
    window=40,
    needs=Needs(ut=("SRP-UpdateSafetyData",), entities=("srp",)),
    long=True,
)
def many_reports(bench: Bench) -> None:
    reporter = Reporter(bench)
    first = reporter.sent()
    reporter.fill(_WRAP - 1)
    last = reporter.sent()
    grown = (last.report.seqno - first.report.seqno) % SRP_SEQNO_MODULUS
    exact = last.submissions - first.submissions
    right = grown == exact or (grown > exact and reporter.application())
    what = f"a sequence number larger by {exact}"
    bench.check(right, what, f"larger by {grown}", frames=[first.heard, last.heard], shown=True)


@case(
    "TC_DCP_WIDE_BV_07",
    f"Sequence numbers of beacons count {_WRAP} beacons",
    requirements="BP-HDR-08",
    stimulus="a client repeats a payload at the shortest beacon period, until there were enough beacons",
    expect="a sequence number above 65535, and consecutive ones",
    window=40,
    needs=Needs(entities=(), ut=(*CLIENT, "BP-SetParameter", "UT-Reset"), header=("seqno",)),
    long=True,
)
def many_beacons(bench: Bench) -> None:
    with BPClient(bench, REPEAT) as client, parameters_set(bench, "BP", BPPAR_BEACON_PERIOD=1):
        client.transmit(client.payload())
        needed(bench, client.until_sent(), "a beacon with the payload")
        before, begun = bench.heard[-1], bench.now()
        numbers = [each.seqno for each in bench.heard if each.seqno is not None]
        while max(numbers, default=0) < _WRAP and bench.now() - begun < _WRAP * 8 * MS:
            frames = bench.waiting.wait_ns(500 * MS)
            numbers += [each.seqno for each in frames if each.seqno is not None]
            lower = [each for each in frames if each.seqno is not None and each.seqno < (before.seqno or 0)]
            if lower:
                text = f"{lower[0].seqno} after {before.seqno}"
                bench.fail("sequence numbers that grow", text, frames=[before, lower[0]], shown=True)
            before = frames[-1] if frames else before
            # The recording of all beacons would take much memory.
            del bench.heard[:-2]
    most = max(numbers) % BP_SEQNO_MODULUS
    if most < _WRAP:
        bench.inconclusive(f"{_WRAP} beacons, which this case needs", f"{most} in {_WRAP * 8 // 1000} s")
    bench.check(True, "sequence numbers above 65535 that grow")
