"""dcp-vardis.md: Receive Path, Sequence Numbers.

Older and newer numbers in a circular number space (X28): each distance is tested from several stored numbers, so that
some of the intervals include the wrap-around.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate, VardisRecord
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import holds_two_octets, produced
from dcp_conformance.test_steps.variable_queries import INSTRUCTIONS, modulus, named, stepped, teach_variables, traces
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

#: A distance as a number of halves of the number space, plus a number of steps.
Distance = tuple[int, int]
HALF: Distance = (1, 0)
NEWER: dict[str, Distance] = {"1": (0, 1), "2": (0, 2), "half-1": (1, -1)}
EQUAL: dict[str, Distance] = {"0": (0, 0)}
OLDER: dict[str, Distance] = {"half+1": (1, 1), "M-2": (0, -2), "M-1": (0, -1)}


def _steps(bench: Bench, distance: Distance) -> int:
    halves, more = distance
    return halves * (modulus(bench) // 2) + more


def _starts(bench: Bench) -> list[int]:
    """Return stored sequence numbers: at both ends of the number space, around its middle, and in between."""
    top = modulus(bench)
    return [0, 1, 5, top // 2 - 1, top // 2, top - 2, top - 1]


@dataclass(frozen=True)
class Question:
    """A record whose sequence number has a given distance from the stored one."""

    make: Callable[[Peer, int, int], VardisRecord]
    answers: tuple[ICType | None, ICType | None, ICType | None]
    """The reaction to a newer, an equal and an older sequence number."""
    newer_is_stored: bool
    requirements: tuple[str, str, str]


UPDATE = Question(
    lambda peer, var_id, seqno: peer.update(var_id, seqno),
    (ICType.UPDATES, None, ICType.UPDATES),
    True,
    ("VD-PU-07", "VD-PU-05", "VD-PU-06"),
)
SUMMARY = Question(
    lambda peer, var_id, seqno: peer.summary(var_id, seqno),
    (ICType.REQUEST_VARUPDATES, None, ICType.UPDATES),
    False,
    ("VD-PS-04", "VD-PS-02", "VD-PS-03"),
)
REQUEST = Question(
    lambda peer, var_id, seqno: peer.request_update(var_id, seqno),
    (None, None, ICType.UPDATES),
    False,
    ("VD-RU-03", "VD-RU-03", "VD-RU-04"),
)


def _variants(question: Question) -> dict[str, Variant]:
    """Return all distances except half the number space, for which the specification defines nothing."""
    return {
        name: Variant((question, distance, which), requirements=question.requirements[which])
        for which, distances in enumerate((NEWER, EQUAL, OLDER))
        for name, distance in distances.items()
    }


def _ask(bench: Bench, question: Question, distance: Distance) -> tuple[list[VarCreate], int]:
    """Teach variables with several sequence numbers, and send a record at the distance from each."""
    peer, starts = bench.peer(), _starts(bench)
    creates = [
        peer.create(var_id, value=b"value", seqno=seqno)
        for var_id, seqno in zip(bench.identifiers.var_ids(len(starts)), starts, strict=True)
    ]
    teach_variables(bench, peer, creates)
    since, step = bench.mark(), _steps(bench, distance)
    peer.send(*(question.make(peer, each.spec.var_id, stepped(bench, each.upd.seqno, step)) for each in creates))
    return creates, since


@case(
    "TC_VD_SEQ_BV_01",
    "The sequence number of a VarUpdate is compared correctly, also across wrap-around (distance {variant})",
    requirements="VD-PU-07",
    stimulus="VarUpdates with sequence numbers at distance {variant} (mod M) from seven stored ones",
    expect=(
        "a newer one is stored and forwarded; an older one is answered with the stored value; an equal one is ignored"
    ),
    variants=_variants(UPDATE),
)
@case(
    "TC_VD_SEQ_BV_02",
    "The sequence number of a summary is compared correctly, also across wrap-around (distance {variant})",
    requirements="VD-PS-04",
    stimulus="summaries with sequence numbers at distance {variant} (mod M) from seven stored ones",
    expect="a newer one causes a request; an older one is answered with the stored value; an equal one is ignored",
    variants=_variants(SUMMARY),
)
@case(
    "TC_VD_SEQ_BV_03",
    "The sequence number of a VarReqUpdate is compared correctly, also across wrap-around (distance {variant})",
    requirements="VD-RU-04",
    stimulus="VarReqUpdates with sequence numbers at distance {variant} (mod M) from seven stored ones",
    expect="an older one is answered with the stored value; the others are ignored",
    variants=_variants(REQUEST),
)
def compared(bench: Bench, what: tuple[Question, Distance, int]) -> None:
    question, distance, which = what
    creates, since = _ask(bench, question, distance)
    kind, step = question.answers[which], _steps(bench, distance)
    if kind is not None:
        wanted = {each.spec.var_id for each in creates}
        bench.until(lambda heard: wanted <= {each.var_id for each in heard.instructions(kind)}, bench.sut.reaction)
    bench.require_processed("the records")
    for create in creates:
        var_id, stored = create.spec.var_id, create.upd.seqno
        name = f"stored sequence number {stored}, received {stepped(bench, stored, step)}"
        found = traces(bench, var_id, since, INSTRUCTIONS)
        bench.every(
            found,
            lambda each: each.kind is kind,
            f"{name}: no record other than {kind.label}" if kind else f"{name}: no record",
        )
        if kind is None:
            continue
        # The implementation sends the number it had before, or the one that it has just stored.
        number = stepped(bench, stored, step) if which == 0 and question.newer_is_stored else stored
        numbers = [each.record.seqno for each in found if each.kind is kind]
        bench.in_order(numbers, [number], f"{name}: one {kind.label} record with {number}", frames=found)


@case(
    "TC_VD_SEQ_BO_01",
    "Reports how a sequence number half the number space away from the stored one is compared",
    requirements="VD-ROB-01",
    stimulus="a VarUpdate, a summary and a VarReqUpdate half the number space away from the stored sequence number",
    expect="any result: the number is neither newer nor older; VarDis continues",
    window=8,
)
def half_the_range(bench: Bench) -> None:
    heard: dict[str, str] = {}
    for name, question in {"VarUpdate": UPDATE, "summary": SUMMARY, "VarReqUpdate": REQUEST}.items():
        creates, since = _ask(bench, question, HALF)
        bench.require_processed(f"a {name} half the number space away")
        # Of the seven stored numbers, an implementation without circular comparison treats some as older and some as
        # newer.
        kinds = []
        for create in creates:
            found = traces(bench, create.spec.var_id, since, INSTRUCTIONS)
            moved = [each for each in found if each.kind is ICType.UPDATES and each.record.seqno != create.upd.seqno]
            kinds.append("stored" if moved else named(found))
        heard[name] = "/".join(dict.fromkeys(kinds))
        bench.info(
            f"What is the reaction to a {name} half the number space away from the stored sequence number?", heard[name]
        )
    own = ICType.UPDATES.label
    answers = {own: "half-range-answered", "nothing": "half-range-neither"}
    if heard["VarUpdate"] == "stored" and heard["summary"] == ICType.REQUEST_VARUPDATES.label:
        if heard["VarReqUpdate"] in answers:
            bench.reading("X28", answers[heard["VarReqUpdate"]])
    elif heard["VarUpdate"] == own and heard["summary"] == own:
        bench.reading("X28", "half-range-older")


@case(
    "TC_VD_SEQ_BV_04",
    ("The sequence number of a variable starts at 0, increases by one with each update and wraps at SEQNO-MODULUS"),
    requirements="VD-TYP-03",
    stimulus=(
        "one of the node's own variables is updated through the whole range of a one-octet number (20 times if it "
        "is wider)"
    ),
    expect="each update heard has the number of updates so far, modulo SEQNO-MODULUS",
    window=10,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update"), when=holds_two_octets),
)
def counting(bench: Bench) -> None:
    since = bench.mark()
    var_id = produced(bench)
    created = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    bench.equal(created and created.upd.seqno, 0, "sequence number for a new variable")
    top, made = modulus(bench), 0
    targets = [1, 2, top - 2, top - 1, top, top + 1] if top == 256 else [1, 2, 20]
    for target in targets:
        while made < target:
            made += 1
            bench.must("RTDB-Update", varId=var_id, value=made.to_bytes(2, "big").hex())
        want = made.to_bytes(2, "big")

        def newest(heard: object, want: bytes = want) -> bool:  # noqa: ARG001 - every record so far is checked
            return any(each.record.value == want for each in bench.instructions(ICType.UPDATES, var_id, since))

        bench.required(bench.until(newest), f"the value of update {made}")
    bench.every(
        bench.instructions(ICType.UPDATES, var_id, since),
        lambda each: each.record.seqno == int.from_bytes(each.record.value, "big") % top,
        "sequence number n modulo SEQNO-MODULUS in update n",
    )


@case(
    "TC_VD_SEQ_BV_05",
    "Each variable has its own sequence of numbers",
    requirements="VD-TYP-03",
    stimulus="two of the node's own variables are updated in turn, one three times and the other twice",
    expect="sequence numbers 3 and 2 in the last updates",
    window=10,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update")),
)
def counted_each(bench: Bench) -> None:
    one, two, since = produced(bench), produced(bench), bench.mark()
    for number, var_id in enumerate((one, two, one, two, one)):
        bench.must("RTDB-Update", varId=var_id, value=f"{number:02x}")
    for var_id, last, number in ((one, b"\4", 3), (two, b"\3", 2)):

        def newest(_: object, it: int = var_id, value: bytes = last) -> list[int]:
            updates = bench.instructions(ICType.UPDATES, it, since)
            return [each.record.seqno for each in updates if each.record.value == value]

        came = newest(None) or bench.until(newest)
        bench.equal(came[0] if came else None, number, "sequence number of the last update")
