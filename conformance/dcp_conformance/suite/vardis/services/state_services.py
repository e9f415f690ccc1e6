"""dcp-vardis.md: Variable States, Services and Scrubbing.

Service requests and timeouts in every state of a variable. The variants are named ``state.event``, as in the cases of
received records.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.frames.received import Instruction
from dcp_conformance.test_steps.services import (
    EXISTS,
    NOT_PRODUCER,
    OK,
    UNKNOWN,
    create_request,
    deleted_status,
)
from dcp_conformance.test_steps.timeouts import scrubs
from dcp_conformance.test_steps.variable_queries import INSTRUCTIONS, ask, check_state, stepped, traces
from dcp_conformance.test_system.bench import MS, Bench

METHODS = ("RTDB-Create", "RTDB-Update", "RTDB-Delete", "RTDB-Read")
STATES = {
    "unknown": "an unknown variable",
    "alive-producer": "one of the node's own variables",
    "alive-consumer": "a variable of another node",
    "deleted-producer": "one of the node's own deleted variables",
    "deleted-consumer": "a deleted variable of another node",
}
#: Number of repetitions that keep a deleted variable in the database long enough to be tested, up to 1.3.
_LASTING = 4
_VALUE = b"fresh"


@dataclass
class Place:
    """A variable in a given state."""

    var_id: int
    state: str
    stored: VarCreate | None
    rep_cnt: int = 1
    fleeting: bool = False
    """Whether it may have been removed from the database by now."""


def _sent(bench: Bench, var_id: int) -> VarCreate:
    record = bench.until_instruction(ICType.CREATE_VARIABLES, var_id)
    if not isinstance(record, VarCreate):
        bench.inconclusive("a VarCreate of the variable, which this case needs", "none in time")
    return record


def place(bench: Bench, state: str, *, timeout: int = 0) -> Place:
    """Create a variable and bring it into a state."""
    own = state.endswith("producer")
    if state == "unknown":
        return Place(bench.identifiers.own_var_id(), state, None)
    var_id = bench.identifiers.own_var_id() if own else bench.var_id()
    removed = bench.features.removed_after_deletion
    rep_cnt = bench.sut.rep_cnt(_LASTING) if state.startswith("deleted") and removed else 1
    peer, since = bench.peer(), bench.mark()
    if own:
        bench.must("RTDB-Create", **create_request(bench, var_id, rep_cnt=rep_cnt, timeout=timeout))
    else:
        peer.send(peer.create(var_id, rep_cnt=rep_cnt, seqno=5, timeout=timeout))
    stored = _sent(bench, var_id)
    found = Place(var_id, state, stored, rep_cnt)
    if rep_cnt > 1:
        bench.until_quiet(lambda heard: heard.instructions(ICType.CREATE_VARIABLES, var_id), since=since)
    if state.startswith("deleted"):
        if own:
            bench.must("RTDB-Delete", varId=var_id)
        else:
            peer.send(peer.delete(var_id))
        if bench.until_instruction(ICType.DELETE_VARIABLES, var_id) is None:
            bench.inconclusive("a VarDelete of the variable, which this case needs", "none in time")
        # One repetition was heard, and the next payload may already be composed.
        found.fleeting = removed and rep_cnt < _LASTING
    return found


def _may_be_over(bench: Bench, where: Place) -> bool:
    """Return whether the last repetition of a deletion may have been sent, after which the variable is removed."""
    if not where.state.startswith("deleted") or not bench.features.removed_after_deletion:
        return False
    bench.mark()
    return len(bench.receiver.frames_with(ICType.DELETE_VARIABLES, where.var_id)) >= where.rep_cnt - 1


def _statuses(bench: Bench, method: str, where: Place) -> list[str]:
    """Return the statuses that the specification allows for a request in a state; the usual one first."""
    state, old = where.state, bench.profile.spec_version < SpecVersion.V2_0
    if method == "RTDB-Create":
        free = state == "unknown" or (state.endswith("producer") and not old)
        found = [OK] if free else [EXISTS]
        if where.fleeting:
            found.append(OK)
    else:
        if state == "unknown":
            found = [UNKNOWN]
        elif method != "RTDB-Read" and state.endswith("consumer"):
            found = [NOT_PRODUCER]
        else:
            found = [deleted_status(bench) if state.startswith("deleted") else OK]
        if where.fleeting:
            found.append(UNKNOWN)
    return found


def _disputed(bench: Bench, where: Place) -> str:
    """Return the other status of RTDB-Create according to the reading ``by-description`` of X20; empty if there is
    none.
    """
    if bench.profile.spec_version < SpecVersion.V2_0:
        return ""
    return {"alive-producer": EXISTS, "deleted-consumer": OK}.get(where.state, "")


def _only(bench: Bench, where: Place, kind: ICType, since: int) -> Instruction | None:
    found = bench.check_repeated(kind, where.var_id, 1, since)
    wanted = [each for each in INSTRUCTIONS if each is not kind]
    if where.state == "deleted-producer" and kind is ICType.CREATE_VARIABLES:
        wanted.remove(ICType.DELETE_VARIABLES)
    bench.none(traces(bench, where.var_id, since, wanted), f"no records other than {kind.label}")
    return found[-1] if found else None


def _created(bench: Bench, where: Place, since: int) -> None:
    found = _only(bench, where, ICType.CREATE_VARIABLES, since)
    if found is None:
        return
    spec, upd = found.record.spec, found.record.upd
    bench.answered(
        (spec.prod_id, upd.seqno, upd.value),
        (bench.identifiers.sut_id, 0, bench.records.value(_VALUE)),
        "producer, sequence number and value of the VarCreate",
        frames=[found],
    )
    before = where.stored.spec.creation_time if where.stored is not None else None
    if spec.creation_time is not None and before is not None:
        later = f"{spec.creation_time}, before it {before}"
        bench.excuses.relies_on("creationTime")
        bench.proved(spec.creation_time > before, "a later creationTime", later, frames=[found])


def _updated(bench: Bench, where: Place, since: int) -> None:
    found = _only(bench, where, ICType.UPDATES, since)
    if found is None or where.stored is None:
        return
    expected = (stepped(bench, where.stored.upd.seqno, 1), bench.records.value(_VALUE))
    bench.answered((found.record.seqno, found.record.value), expected, "sequence number and value", frames=[found])


def _deleted(bench: Bench, where: Place, since: int) -> None:
    _only(bench, where, ICType.DELETE_VARIABLES, since)
    after = "unknown" if bench.features.removed_after_deletion else "deleted"
    check_state(bench, ask(bench, where.var_id), after, "state of the variable")


def _unchanged(bench: Bench, where: Place, since: int) -> None:
    """Check that a rejected request, or RTDB-Read, has changed nothing."""
    if where.state.startswith("deleted") and bench.features.removed_after_deletion:
        return
    bench.require_alive("the request")
    found = traces(bench, where.var_id, since, set(INSTRUCTIONS) - {ICType.DELETE_VARIABLES})
    bench.none(found, "no record as a reaction")
    held = ask(bench, where.var_id)
    expected = where.state.partition("-")[0]
    check_state(bench, held, expected, "state of the variable, as before")
    if expected == "alive":
        bench.answered(held.record, where.stored, "the stored contents unchanged")


_EFFECTS = {"RTDB-Create": _created, "RTDB-Update": _updated, "RTDB-Delete": _deleted, "RTDB-Read": _unchanged}

_DECIDED = {
    "unknown.RTDB-Create": "VD-CRE-10 VD-CRE-12",
    "alive-producer.RTDB-Create": "VD-CRE-03 VD-CRE-16",
    "alive-consumer.RTDB-Create": "VD-CRE-02 VD-CRE-16",
    "deleted-producer.RTDB-Create": "VD-CRE-03 VD-CRE-16",
    "deleted-consumer.RTDB-Create": "VD-CRE-02 VD-CRE-16",
    "unknown.RTDB-Update": "VD-UPD-02",
    "alive-producer.RTDB-Update": "VD-UPD-07",
    "alive-consumer.RTDB-Update": "VD-UPD-03",
    "deleted-producer.RTDB-Update": "VD-UPD-04 VD-UPD-12",
    "deleted-consumer.RTDB-Update": "VD-UPD-03",
    "unknown.RTDB-Delete": "VD-DEL-02",
    "alive-producer.RTDB-Delete": "VD-DEL-05",
    "alive-consumer.RTDB-Delete": "VD-DEL-03",
    "deleted-producer.RTDB-Delete": "VD-DEL-04 VD-DEL-09",
    "deleted-consumer.RTDB-Delete": "VD-DEL-03",
    "unknown.RTDB-Read": "VD-REA-02",
    "alive-producer.RTDB-Read": "VD-REA-04",
    "alive-consumer.RTDB-Read": "VD-REA-04",
    "deleted-producer.RTDB-Read": "VD-REA-03 VD-REA-06",
    "deleted-consumer.RTDB-Read": "VD-REA-03 VD-REA-06",
}


def _services(methods: tuple[str, ...]) -> Iterator[tuple[str, Variant]]:
    for method in methods:
        for state, words in STATES.items():
            event = method.removeprefix("RTDB-").lower()
            yield (
                f"{state}.app-{event}",
                Variant(
                    (state, method),
                    purpose=f"{method} for {words}",
                    requirements=_DECIDED[f"{state}.{method}"],
                    stimulus=f"{method} for {words}",
                    expect=f"the status and the effect of {method} for {words}",
                ),
            )


@case(
    "TC_VD_STATE_BV_03",
    "{variant}",
    requirements="VD-CRE-10",
    stimulus="{variant}",
    expect="the status and the effect that the specification gives for this request in this state",
    needs=Needs(ut=METHODS),
    variants=dict(_services(METHODS)),
)
def service(bench: Bench, cell: tuple[str, str]) -> None:
    state, method = cell
    where = place(bench, state)
    since = bench.mark()
    params = {
        "RTDB-Create": create_request(bench, where.var_id, value=_VALUE),
        "RTDB-Update": {"varId": where.var_id, "value": bench.records.value(_VALUE).hex()},
    }.get(method, {"varId": where.var_id})
    answer = bench.call(method, **params)
    where.fleeting = where.fleeting or _may_be_over(bench, where)
    usual, disputed = _statuses(bench, method, where), _disputed(bench, where) if method == "RTDB-Create" else ""
    bench.services.check_status(answer, [*usual, disputed] if disputed else usual, method)
    if disputed and any(map(answer.is_status, (*usual, disputed))):
        bench.reading("X20", "by-description" if answer.is_status(disputed) else "by-steps")
    if method == "RTDB-Read" and answer.is_status(OK) and where.stored is not None:
        bench.answered(answer.result.get("value"), where.stored.upd.value.hex(), "value")
    if not answer.ok:
        _unchanged(bench, where, since)
    elif not where.fleeting:
        _EFFECTS[method](bench, where, since)


# -- scrubbing ---------------------------------------------------------------------------------------------------------


def _scrubs() -> Iterator[tuple[str, Variant]]:
    for state, words in STATES.items():
        if state == "unknown":
            continue
        own = state.endswith("producer")
        yield (
            f"{state}.timeout",
            Variant(
                state,
                purpose=f"Timeout of {words}",
                requirements="VD-SCR-02" if state.startswith("deleted") else "VD-SCR-04" if own else "VD-SCR-05",
                needs=Needs(since=SpecVersion.V2_0, ut=("RTDB-Create", "RTDB-Delete") if own else ()),
            ),
        )


@case(
    "TC_VD_STATE_TI_01",
    "{variant}",
    requirements="VD-SCR-04",
    stimulus="a variable with a timeout of two beacon periods is not updated",
    expect="it is deleted at most one scrubbing period after its timeout; no reaction if it was deleted before",
    window=20,
    variants=dict(_scrubs()),
)
def timeout(bench: Bench, state: str) -> None:
    lapse = max(1, 2 * bench.period // MS)
    begun = bench.now()
    where = place(bench, state, timeout=lapse)
    var_id, since = where.var_id, bench.mark()
    scrubbing = bench.sut.parameter("VARDISPAR_SCRUBBING_PERIOD")
    window = (lapse + scrubbing + bench.sut.pixit.timer_tolerance_ms) * MS / bench.period + bench.sut.reaction
    if state.startswith("deleted"):
        bench.wait(window)
        bench.none(traces(bench, var_id, since), "no record of a deleted variable")
        return
    came = bench.until(lambda heard: heard.instructions(ICType.DELETE_VARIABLES, var_id), window) or []
    if not came:
        bench.sut.bound("VARDISPAR_SCRUBBING_PERIOD")
    if not came and state.endswith("consumer"):
        if check_state(bench, ask(bench, var_id), "alive", "state of a variable that is not scrubbed"):
            scrubs(bench, by_consumers=False)
        return
    late = f"within {lapse} ms and a scrubbing period of {scrubbing} ms"
    bench.required(came, f"a VarDelete {late}")
    passed = (came[0].heard.time - begun) // MS if came else 0
    bench.proved(
        passed >= lapse, f"not before {lapse} ms after its creation", f"{passed} ms after its creation", frames=came
    )
    bench.check_repeated(ICType.DELETE_VARIABLES, var_id, 1, since)
    if state.endswith("consumer"):
        scrubs(bench, by_consumers=True)
    check_state(bench, ask(bench, var_id), "deleted", "state of the variable")
