"""dcp-vardis.md: Global vs. Local Dissemination.

Repetitions are counted per beacon, from the stimulus until the last one, so the time at which an implementation
composes its payloads does not matter.
"""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import max_repetitions, teach_variable
from dcp_conformance.test_steps.variable_queries import INSTRUCTIONS, ask, check_stored, stepped, traces
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

CREATES, UPDATES, DELETES = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES

Count = Callable[[Bench], int]
_COUNTS: dict[str, Count] = {"r1": lambda _: 1, "r2": lambda _: 2, "max": max_repetitions}


def _too_many(bench: Bench) -> str | None:
    if bench.sut.bound("VARDISPAR_MAX_REPETITIONS", missing=True) < 2:
        return "VARDISPAR_MAX_REPETITIONS is 1"
    return None


_TWO = Needs(when=_too_many)
_COUNT_VARIANTS = {name: Variant(count, needs=Needs() if name == "r1" else _TWO) for name, count in _COUNTS.items()}


def _learnt(bench: Bench, peer: Peer, rep_cnt: int, seqno: int = 0) -> int:
    """Teach a variable with a repetition count, wait for the last repetition of its VarCreate, and return its
    identifier.
    """
    var_id = bench.var_id()
    bench.learn(peer, peer.create(var_id, rep_cnt=rep_cnt, seqno=seqno))
    return var_id


def _taught(bench: Bench, peer: Peer, rep_cnt: int, seqno: int = 0) -> int:
    """As :func:`_learnt`, but do not wait for the repetitions of the VarCreate."""
    return teach_variable(bench, peer, rep_cnt=rep_cnt, seqno=seqno)


def _require_left(bench: Bench, kind: ICType, var_id: int, count: int, since: int) -> int:
    """Return the number of repetitions so far; inconclusive if the last of ``count`` may already have been sent."""
    sent = bench.now()
    bench.mark()
    before = sum(each.heard.time <= sent for each in bench.instructions(kind, var_id, since))
    if before > max(1, count - 2):
        bench.inconclusive("remaining repetitions", f"{before} of {count} sent before the next stimulus")
    return before


def _nothing_else(bench: Bench, var_id: int, since: int, *kinds: ICType) -> None:
    found = traces(bench, var_id, since, [each for each in INSTRUCTIONS if each not in kinds])
    bench.none(found, "no other record of the variable")


# -- exactly r ---------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_FWD_BV_01",
    "The VarCreate of a new variable is sent in exactly repCnt beacons, and summaries follow ({variant})",
    requirements="VD-SCP-02 VD-PC-09",
    stimulus="a VarCreate of an unknown variable with repCnt {variant}",
    expect="one unchanged VarCreate in each of exactly repCnt beacons; summaries with its sequence number",
    window=20,
    variants=_COUNT_VARIANTS,
)
def creation(bench: Bench, count: Count) -> None:
    peer, var_id, since = bench.peer(), bench.var_id(), bench.mark()
    record = peer.create(var_id, rep_cnt=count(bench), seqno=9)
    peer.send(record)
    found = bench.check_repeated(CREATES, var_id, count(bench), since)
    bench.every(found, record, "the record unchanged")
    _nothing_else(bench, var_id, since, CREATES)
    if bench.sut.bound("VARDISPAR_MAX_SUMMARIES"):
        bench.until_instruction(ICType.SUMMARIES, var_id)
        summaries = bench.instructions(ICType.SUMMARIES, var_id, since)
        bench.some(summaries, "summaries of the variable", "VD-PC-09")
        bench.every(summaries, lambda each: each.record.seqno == 9, "sequence number 9 in the summaries", "VD-PC-09")


@case(
    "TC_VD_FWD_BV_02",
    "A newer VarUpdate is sent in exactly repCnt beacons ({variant})",
    requirements="VD-SCP-02 VD-PU-07",
    stimulus="a newer VarUpdate of a variable with repCnt {variant}",
    expect="one unchanged VarUpdate in each of exactly repCnt beacons",
    window=20,
    variants=_COUNT_VARIANTS,
)
def update(bench: Bench, count: Count) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer, rep_cnt=count(bench))
    since, record = bench.mark(), peer.update(var_id, 1, b"other")
    peer.send(record)
    found = bench.check_repeated(UPDATES, var_id, count(bench), since)
    bench.every(found, record, "the record unchanged")
    _nothing_else(bench, var_id, since, UPDATES, CREATES)


@case(
    "TC_VD_FWD_BV_03",
    "A VarDelete is sent in exactly repCnt beacons, and no other record of the variable after it ({variant})",
    requirements="VD-SCP-02 VD-PD-04",
    stimulus="a VarDelete of a variable with repCnt {variant}",
    expect="one VarDelete in each of exactly repCnt beacons; no other record of the variable after the first",
    window=20,
    variants=_COUNT_VARIANTS,
)
def deletion(bench: Bench, count: Count) -> None:
    peer = bench.peer()
    var_id = teach_variable(bench, peer, rep_cnt=count(bench))
    since = peer.stimulate(peer.delete(var_id))
    found = bench.check_repeated(DELETES, var_id, count(bench), since)
    # A summary composed before the deletion may still be sent.
    others = traces(bench, var_id, bench.heard.index(found[0].heard) if found else since, set(ICType) - {DELETES})
    bench.none(others, "no other record of the variable after the first VarDelete", "VD-PD-04", given=found)


_Trigger = Callable[[Bench, Peer, int], VardisRecord]
_TRIGGERS: dict[str, tuple[str, str, ICType, _Trigger]] = {
    "request-create": ("a VarReqCreate", "VD-RC-03", CREATES, lambda _, peer, var_id: peer.request_create(var_id)),
    "request-update": (
        "a VarReqUpdate with an older number",
        "VD-RU-04",
        UPDATES,
        lambda bench, peer, var_id: peer.request_update(var_id, stepped(bench, 5, -1)),
    ),
    "older-summary": (
        "a summary with an older number",
        "VD-PS-03",
        UPDATES,
        lambda bench, peer, var_id: peer.summary(var_id, stepped(bench, 5, -1)),
    ),
    "older-update": (
        "a VarUpdate with an older number",
        "VD-PU-06",
        UPDATES,
        lambda bench, peer, var_id: peer.update(var_id, stepped(bench, 5, -1)),
    ),
}


def _answers() -> dict[str, Variant]:
    return {
        f"{name}.{count}": Variant(
            (trigger, kind, number),
            purpose=f"{words[0].upper()}{words[1:]} is answered in exactly repCnt beacons ({count})",
            requirements=requirement,
            stimulus=f"{words} of a variable with repCnt {count}",
            needs=Needs() if count == "r1" else _TWO,
        )
        for name, (words, requirement, kind, trigger) in _TRIGGERS.items()
        for count, number in _COUNTS.items()
        # These use the same counters as the cases above: the largest count is tested where it takes the least time.
        if count != "max" or name == "request-update"
    }


@case(
    "TC_VD_FWD_BV_04",
    "{variant}",
    requirements="VD-RC-03",
    stimulus="{variant}",
    expect="one record of the requested kind, with the stored contents, in each of exactly repCnt beacons",
    window=20,
    variants=_answers(),
)
def answer(bench: Bench, what: tuple[_Trigger, ICType, Count]) -> None:
    trigger, kind, count = what
    peer = bench.peer()
    # Repetitions of the VarCreate itself must not be counted.
    var_id = (_learnt if kind is CREATES else _taught)(bench, peer, count(bench), 5)
    since = bench.peer().stimulate(trigger(bench, peer, var_id))
    found = bench.check_repeated(kind, var_id, count(bench), since)
    numbers = [each.record.upd.seqno if kind is CREATES else each.record.seqno for each in found]
    bench.every(numbers, 5, "the stored sequence number in the answer")
    _nothing_else(bench, var_id, since, kind, CREATES)


# -- counting again ----------------------------------------------------------------------------------------------------


@case(
    "TC_VD_FWD_BV_05",
    "A newer VarUpdate restarts the repetitions, with the newer value only",
    requirements="VD-PU-07",
    stimulus="a newer VarUpdate, and after its first repetition another one",
    expect="repCnt beacons with the second VarUpdate; at most one VarUpdate of the variable in each beacon",
    window=20,
    needs=_TWO,
)
def update_again(bench: Bench) -> None:
    peer, count = bench.peer(), min(4, max_repetitions(bench))
    var_id = _learnt(bench, peer, count)
    since = peer.stimulate(peer.update(var_id, 1, b"one"))
    bench.until_instruction(UPDATES, var_id)
    peer.send(peer.update(var_id, 2, b"two"))
    found = bench.waiting.repeated(UPDATES, var_id, since)
    bench.one_each(found, "at most one VarUpdate of the variable in each beacon")
    second = [each for each in found if each.record.seqno == 2]
    bench.repeated(second, count, "beacons with the second VarUpdate")
    after = [each for each in found if each.record.seqno == 1 and second and each.heard.number > second[0].heard.number]
    bench.none(after, "no repetition of the first VarUpdate after the second")


@case(
    "TC_VD_FWD_BV_06",
    "While a VarUpdate is being repeated, older information does not restart the repetitions ({variant})",
    requirements="VD-PU-06",
    stimulus="a newer VarUpdate, and after its first repetition an older {variant}",
    expect="exactly repCnt beacons with the VarUpdate",
    window=20,
    needs=_TWO,
    variants={
        "update": Variant(lambda peer, var_id: peer.update(var_id, 5, b"old"), requirements="VD-PU-06"),
        "summary": Variant(lambda peer, var_id: peer.summary(var_id, 5), requirements="VD-PS-03"),
    },
)
def not_again(bench: Bench, stimulus: Callable[[Peer, int], VardisRecord]) -> None:
    # With four or more, at least one repetition is still queued when the first one is heard.
    peer, count = bench.peer(), min(5, max_repetitions(bench))
    var_id = _learnt(bench, peer, count, seqno=5)
    since = peer.stimulate(peer.update(var_id, 6))
    bench.until_instruction(UPDATES, var_id)
    other = bench.peer()
    other.send(stimulus(peer, var_id))
    if count >= 4 and bench.session.known.processing < count - 1:
        _require_left(bench, UPDATES, var_id, count, since)
        bench.check_repeated(UPDATES, var_id, count, since)
        return
    came = len(bench.waiting.repeated(UPDATES, var_id, since))
    bench.info(
        "How many repetitions are there if older information arrives between them?",
        f"{came} for repCnt {count}: the older information may have arrived too late",
    )


@case(
    "TC_VD_FWD_BV_07",
    "A request received while its answer is being repeated restarts the repetitions ({variant})",
    requirements="VD-RU-04",
    stimulus="a request, and after the first repetition of the answer the same request again",
    expect=(
        "the repetitions until the second request, and repCnt more; a payload composed before it may count for either"
    ),
    window=20,
    needs=_TWO,
    variants={
        "request-update": Variant((UPDATES, _TRIGGERS["request-update"][3]), requirements="VD-RU-04"),
        "request-create": Variant((CREATES, _TRIGGERS["request-create"][3]), requirements="VD-RC-03"),
    },
)
def requested_again(bench: Bench, what: tuple[ICType, _Trigger]) -> None:
    kind, trigger = what
    peer, count = bench.peer(), min(4, max_repetitions(bench))
    var_id = _learnt(bench, peer, count, seqno=5)
    since = bench.peer().stimulate(trigger(bench, peer, var_id))
    bench.until_instruction(kind, var_id)
    other = bench.peer()
    other.send(trigger(bench, peer, var_id))
    before = _require_left(bench, kind, var_id, count, since)
    found = bench.waiting.repeated(kind, var_id, since)
    # Payloads may be composed up to two beacons before they are sent, and a slow implementation processes the request
    # later.
    bench.repeated(found, before + count, "records", most=before + count + bench.sut.ahead)
    bench.one_each(found, "at most one record in each beacon")


# -- nothing new -------------------------------------------------------------------------------------------------------


@case(
    "TC_VD_FWD_BV_08",
    "Information that is not new is not forwarded",
    requirements="VD-SCP-03",
    stimulus="a VarCreate, a VarUpdate and a VarDelete, each sent again after the repetitions of the first",
    expect="no record after the second of each",
    window=16,
)
def nothing_new(bench: Bench) -> None:
    peer, var_id, since = bench.peer(), bench.var_id(), bench.mark()
    create, newer = peer.create(var_id), peer.update(var_id, 1)
    for kind, record in ((CREATES, create), (UPDATES, newer), (DELETES, peer.delete(var_id))):
        start = peer.stimulate(record)
        bench.check_repeated(kind, var_id, 1, start)
        start = bench.peer().stimulate(record)
        bench.require_processed(f"a {kind.label} record that is not new")
        found = traces(bench, var_id, start, (CREATES, UPDATES, DELETES))
        bench.none(found, f"no record after the same {kind.label} record again")
    bench.repeated(bench.instructions(CREATES, var_id, since), 1, "VarCreates in total")


@case(
    "TC_VD_FWD_BV_09",
    "The same VarUpdate from several neighbours is forwarded repCnt times in total",
    requirements="VD-SCP-03",
    stimulus="the same newer VarUpdate from five peers in succession",
    expect="exactly repCnt beacons with it",
    window=20,
)
def from_all_sides(bench: Bench) -> None:
    peer, count = bench.peer(), min(2, max_repetitions(bench))
    var_id = _learnt(bench, peer, count)
    since = bench.mark()
    for each in (peer, *(bench.peer() for _ in range(4))):
        each.send(peer.update(var_id, 1))
    bench.check_repeated(UPDATES, var_id, count, since)


@case(
    "TC_VD_FWD_BV_10",
    "A VarCreate requested after an update has the newer value and sequence number",
    requirements="VD-RC-03",
    stimulus="a newer VarUpdate and a VarReqCreate; then a VarCreate with the first value",
    expect="a VarCreate with the value and sequence number of the VarUpdate; the old VarCreate changes nothing",
    window=10,
)
def newest_value(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    create = bench.learnt(peer, var_id, value=b"first")
    peer.send(peer.update(var_id, 1, b"newer"))
    updated = bench.until_instruction(UPDATES, var_id)
    for what in ("after the update", "after a VarCreate with the first value"):
        held = ask(bench, var_id)
        check_stored(bench, held, 1, b"newer", f"sequence number and value {what}", given=updated)
        if held.record is not None:
            bench.answered(held.record.spec, create.spec, "the specification")
        peer.send(create)
