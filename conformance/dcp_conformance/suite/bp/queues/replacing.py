"""dcp-bp.md: Data Types, queueing modes; Transmit Path: payloads that are replaced, displaced or alike."""

from __future__ import annotations

from typing import NamedTuple

from dcp_spec.constants import QueueingMode, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.suite.bp.services.indications import no_indication
from dcp_conformance.test_steps.beacon_gaps import between_beacons
from dcp_conformance.test_steps.bp_clients import (
    CLEAR,
    CLIENT,
    DROPHEAD,
    DROPTAIL,
    ONCE,
    REPEAT,
    TRANSMITTED,
    BPClient,
    each_mode,
    indications,
    listed,
    needed,
    wait_for_notifications,
)
from dcp_conformance.test_system.bench import Bench

#: Octets of a short and of a long payload.
_SHORT, _LONG = 5, 41


class _Pair(NamedTuple):
    """Two payloads of a buffer: its mode, and their sizes in octets."""

    mode: QueueingMode
    first: int
    second: int


@case(
    "TC_BP_QM_BV_21",
    "A payload replaces the one in a buffer as a whole, however long both are ({variant})",
    requirements="BP-TXP-06 BP-FMT-01",
    stimulus="a client submits A and then B, of another length, into the same buffer ({variant})",
    expect="each beacon has all octets of A or of B, and no others",
    needs=Needs(entities=(), ut=CLIENT),
    variants={
        f"{mode.name.lower()}-{name}": Variant(_Pair(mode, *sizes), requirements=f"BP-TXP-06 BP-FMT-01 {rule}")
        for mode, rule in ((ONCE, "BP-QM-04"), (REPEAT, "BP-QM-05"))
        for name, sizes in (("shorter", (_LONG, _SHORT)), ("longer", (_SHORT, _LONG)))
    },
    window=8,
)
def replaced(bench: Bench, pair: _Pair) -> None:
    with BPClient(bench, pair.mode) as client:
        known = [client.payload(pair.first), client.payload(pair.second)]
        start = bench.mark()

        def act() -> None:
            for payload in known:
                client.transmit(payload)

        if pair.mode is REPEAT:
            client.transmit(known[0])
            needed(bench, client.until_sent(), "a beacon with payload A")
            client.transmit(known[1])
        else:
            between_beacons(bench, "submission of two payloads", act, client.in_frame)
        client.until_sent(known[1])
        client.until_sent()
        sent = client.sent(start)
        needed(bench, sent, "a beacon with a payload of the client")
        strange = [each.hex() for each in sent if each not in known]
        bench.none(strange, "payload A or B in each beacon", frames=client.frames(start))
        bench.some(known[1] in sent, "payload B in a beacon", seen=listed(sent, known), frames=client.frames(start))


@case(
    "TC_BP_QM_BV_22",
    "A payload that equals the one sent before is sent, too ({variant})",
    requirements="BP-QM-03 BP-QM-04 BP-TXP-06",
    stimulus="a client with mode {variant} submits a payload; after its beacon it submits the same octets again",
    expect="a beacon with the payload after each submission",
    needs=Needs(entities=(), ut=CLIENT),
    variants={name: each for name, each in each_mode(*CLIENT).items() if each.value is not REPEAT},
    window=8,
)
def sent_again(bench: Bench, mode: QueueingMode) -> None:
    rule = "BP-QM-03" if mode.is_queue else "BP-QM-04 BP-TXP-06"
    with BPClient(bench, mode) as client:
        payload = client.payload()
        client.transmit(payload)
        needed(bench, client.until_sent(payload), "a beacon with the payload")
        client.transmit(payload)
        bench.some(client.until_sent(payload), "a beacon with the payload that was submitted again", rule)


@case(
    "TC_BP_QM_BV_23",
    "Equal payloads in a queue are all sent ({variant})",
    requirements="BP-QM-03",
    stimulus="between two beacons, a client with mode {variant} submits the same octets three times",
    expect="the payload three times",
    needs=Needs(entities=(), ut=CLIENT),
    variants={name: each for name, each in each_mode(*CLIENT).items() if each.value.is_queue},
    window=8,
)
def equal_entries(bench: Bench, mode: QueueingMode) -> None:
    with BPClient(bench, mode) as client:
        payload = client.payload()
        start, _ = client.submit_between("submission of three payloads", lambda: [payload] * 3)
        bench.until_quiet(client.in_frame, since=start)
        bench.repeated(len(client.sent(start)), 3, "payloads in beacons", frames=client.frames(start))


class _Full(NamedTuple):
    """Three payloads submitted between two beacons: the mode, how many are sent, and whether they are cleared."""

    mode: QueueingMode
    sent: int
    clears: bool = False


@case(
    "TC_BP_PTI_BV_04",
    "A payload that is not sent has no BP-PayloadTransmitted.indication ({variant})",
    requirements="BP-PTI-01",
    stimulus=(
        "between two beacons, a client with maxEntries 2 submits three payloads, or clears them again ({variant})"
    ),
    expect="an indication for each payload in a beacon, and no more",
    needs=Needs(since=SpecVersion.V1_1, entities=(), ut=CLIENT, when=no_indication),
    variants={
        "droptail": _Full(DROPTAIL, 2),
        "drophead": _Full(DROPHEAD, 2),
        "once": _Full(ONCE, 1),
        "cleared-droptail": Variant(
            _Full(DROPTAIL, 0, clears=True),
            needs=Needs(since=SpecVersion.V1_1, entities=(), ut=(*CLIENT, CLEAR), when=no_indication),
        ),
        "cleared-once": Variant(
            _Full(ONCE, 0, clears=True),
            needs=Needs(since=SpecVersion.V1_1, entities=(), ut=(*CLIENT, CLEAR), when=no_indication),
        ),
    },
    window=8,
)
def told_of_sent_only(bench: Bench, full: _Full) -> None:
    with BPClient(bench, full.mode, entries=2) as client:
        since = 0

        def act() -> None:
            nonlocal since
            since = len(indications(bench, TRANSMITTED, client.prot_id))
            client.transmit_new(3)
            if full.clears:
                bench.must(CLEAR, protId=client.prot_id)

        start = bench.mark()
        between_beacons(bench, "submission of three payloads", act, client.in_frame)
        bench.until_quiet(client.in_frame, since=start)
        wait_for_notifications(bench)
        told = indications(bench, TRANSMITTED, client.prot_id)[since:]
        if full.sent:
            bench.repeated(len(told), full.sent, "indications", most=full.sent, frames=client.frames(start))
        else:
            bench.none(told, "no indication, because the payloads were cleared", frames=client.frames(start))
