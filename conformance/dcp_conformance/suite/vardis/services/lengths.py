"""dcp-vardis.md: Receive Path, lengths and repetition counts at their limits."""

from __future__ import annotations

from collections.abc import Callable

from dcp_spec.constants import ICType, SpecVersion

from dcp_codec.values import VarCreate, VardisRecord, VarUpdate
from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import longest_description, teach_variable
from dcp_conformance.test_steps.variable_queries import INSTRUCTIONS, ask, check_state, check_stored, named, traces
from dcp_conformance.test_system.bench import Bench

_ANY, _V1_1, _V1_2 = SpecVersion.V1_0, SpecVersion.V1_1, SpecVersion.V1_2
Bound = Callable[[int], int]
#: Lengths and counts as functions of the maximum, whether they are allowed, and the first version that rejects the
#: others.
_BOUNDS: dict[str, tuple[Bound, bool, SpecVersion]] = {
    "0": (lambda _: 0, False, _V1_2),
    "1": (lambda _: 1, True, _ANY),
    "max": (lambda most: most, True, _ANY),
    "max+1": (lambda most: most + 1, False, _V1_1),
    "255": (lambda _: 255, False, _V1_1),
}


def _field(bench: Bench, what: str) -> tuple[int, int]:
    """Return the largest allowed value of a field, and the largest value that it can hold."""
    types = bench.profile.types
    if what == "repCnt":
        return bench.sut.bound("VARDISPAR_MAX_REPETITIONS"), (1 << 8 * types.var_rep_cnt.width) - 1
    if what == "description":
        return longest_description(bench), 254
    return bench.sut.bound("VARDISPAR_MAX_VALUE_LENGTH"), 255


def _variants() -> dict[str, Variant]:
    found = {}
    for what, requirement in (("value", "VD-PC-04"), ("description", "VD-PC-05"), ("repCnt", "VD-PC-06")):
        for name, (bound, allowed, since) in _BOUNDS.items():
            # Version 1.1 does not check repetition counts.
            found[f"{what}-{name}"] = Variant(
                (what, bound, allowed, (max(since, _V1_2) if what == "repCnt" else since)),
                purpose=f"A VarCreate is {'accepted' if allowed else 'ignored'} ({what}: {name})",
                requirements=requirement,
                stimulus=f"a VarCreate of an unknown variable ({what}: {name}; a length or count, max: the parameter)",
                expect="it is forwarded and stored" if allowed else "no reaction; the variable remains unknown",
            )
    return found


@case(
    "TC_VD_LEN_BI_01",
    "{variant}",
    requirements="VD-PC-04",
    stimulus="{variant}",
    expect="{variant}",
    window=6,
    variants=_variants(),
)
def creations(bench: Bench, what: tuple[str, Bound, bool, SpecVersion]) -> None:
    _check(bench, *what)


def _check(bench: Bench, field: str, bound: Bound, allowed: bool, refused: SpecVersion, *, known: bool = False) -> None:
    """Check the reaction to a VarCreate, or to a VarUpdate of a ``known`` variable, with a field of this length."""
    most, widest = _field(bench, field)
    number = bound(most)
    if not _expressible(bench, number, most, widest, allowed=allowed):
        return
    if number <= 1:
        # Accepted or rejected whatever the maximum is.
        bench.assumptions.discard()
    peer, value = bench.peer(), b"v" * (number if field == "value" else 1)
    record: VarCreate | VarUpdate
    if known:
        var_id, name, which = teach_variable(bench, peer, value=b"value"), "VarUpdate", f"value of {number} octets"
        record = peer.update(var_id, 1, value, exact=True)
    else:
        var_id, name, which = bench.unknown_id(), "VarCreate", f"{field} of {number}"
        bench.identifiers.created.add(var_id)
        descr, rep_cnt = b"d" * (number if field == "description" else 1), number if field == "repCnt" else 1
        record = peer.create(var_id, value=value, descr=descr, rep_cnt=rep_cnt, exact=True)
    since = peer.stimulate(record)
    if allowed:
        came = bench.until_instruction(ICType.UPDATES if known else ICType.CREATE_VARIABLES, var_id)
        bench.equal(came, record, f"the accepted {name}, forwarded unchanged")
        if came is not None:
            stored = ask(bench, var_id).record
            bench.equal(stored and stored.upd if known else stored, record, f"the {name} unchanged in the database")
        return
    bench.require_alive(f"the {name}")
    bench.beacons(*((1, 1.5) if known else (2, 2.5)))
    found = traces(bench, var_id, since, INSTRUCTIONS if known else ICType)
    if bench.profile.spec_version < refused:
        bench.info(f"What is the reaction to a {name} with a {which}, which no rule forbids?", named(found))
        return
    bench.none(found, f"a {name} with a {which} is ignored")
    held = ask(bench, var_id)
    if known:
        check_stored(bench, held, 0, b"value", "stored sequence number and value, as before")
    else:
        check_state(bench, held, "unknown", "state of the variable")


def _expressible(bench: Bench, number: int, most: int, widest: int, *, allowed: bool) -> bool:
    """Return whether a number can be sent and is on the intended side of the limit; report it if not."""
    if number > widest:
        bench.info("Can the limit be tested?", f"no: {number} does not fit into the field, whose maximum is {widest}")
        return False
    if not allowed and 0 < number <= most:
        bench.info("Can the limit be tested?", f"no: {number} is allowed, because the maximum is {most}")
        return False
    return True


def _updates() -> dict[str, Variant]:
    return {
        name: Variant(
            what,
            purpose=f"A VarUpdate with a value of length {name} is {'accepted' if what[1] else 'ignored'}",
            expect="it is forwarded and stored" if what[1] else "no reaction; the old value remains",
        )
        for name, what in _BOUNDS.items()
    }


@case(
    "TC_VD_LEN_BI_02",
    "{variant}",
    requirements="VD-PU-04",
    stimulus="a newer VarUpdate of a known variable with a value of length {variant}",
    expect="{variant}",
    window=6,
    variants=_updates(),
)
def updates(bench: Bench, what: tuple[Bound, bool, SpecVersion]) -> None:
    _check(bench, "value", *what, known=True)


@case(
    "TC_VD_LEN_BI_03",
    "Records that are ignored because of their lengths do not affect others in the same container",
    requirements="VD-PC-04 VD-PC-06 VD-PU-04",
    stimulus=(
        "a container with a valid VarCreate among two with empty values and one with repCnt 0; then a container "
        "with a valid VarUpdate between two with empty values"
    ),
    expect="the valid records are forwarded; there is no record of the others",
    window=8,
    needs=Needs(since=_V1_2),
)
def among_others(bench: Bench) -> None:
    peer, (one, good, two, three) = bench.peer(), bench.identifiers.unknown_ids(4)
    bench.identifiers.created.update((one, good, two, three))
    record = peer.create(good)
    since = bench.mark()
    peer.send(peer.create(one, value=b""), peer.create(three, rep_cnt=0), record, peer.create(two, value=b""))
    came = bench.until_instruction(ICType.CREATE_VARIABLES, good)
    bench.equal(came, record, "the valid VarCreate, forwarded unchanged", "VD-PC-04")
    newer = peer.update(good, 2, b"good")
    peer.send(peer.update(good, 1, b""), newer, peer.update(good, 3, b""))
    came = bench.until_instruction(ICType.UPDATES, good)
    bench.equal(came, newer, "the valid VarUpdate, forwarded unchanged", "VD-PU-04")
    bench.require_alive("the containers")
    for var_id, requirement in ((one, "VD-PC-04"), (two, "VD-PC-04"), (three, "VD-PC-06")):
        found = traces(bench, var_id, since, INSTRUCTIONS)
        bench.none(found, "no record of the variables with invalid lengths or counts", requirement)


@case(
    "TC_VD_LEN_BV_01",
    ("A VarCreate with the longest value, the longest description and the maximum repCnt is accepted and forwarded"),
    requirements="VD-PC-04 VD-PC-05 VD-PC-06",
    stimulus="a VarCreate with all three at their maximum",
    expect="it is forwarded unchanged",
)
def longest(bench: Bench) -> None:
    peer = bench.peer()
    value, description = _field(bench, "value")[0], _field(bench, "description")[0]
    record: VarCreate = peer.create(
        bench.var_id(),
        value=b"v" * min(value, 255),
        descr=b"d" * min(description, 254),
        rep_cnt=_field(bench, "repCnt")[0],
        exact=True,
    )
    peer.send(record)
    came: VardisRecord | None = bench.until_instruction(ICType.CREATE_VARIABLES, record.spec.var_id)
    bench.equal(came, record, "the VarCreate, forwarded unchanged")


@case(
    "TC_VD_LEN_BI_04",
    "A VarUpdate of an unknown variable causes a request whatever the length of its value ({variant})",
    requirements="VD-PU-01",
    stimulus="a VarUpdate of an unknown variable with a value of length {variant}",
    expect="one VarReqCreate: the length is checked later",
    variants={name: _BOUNDS[name][0] for name in ("0", "max+1", "255")},
)
def unknown_variable(bench: Bench, bound: Bound) -> None:
    most, widest = bench.sut.parameter("VARDISPAR_MAX_VALUE_LENGTH"), 255
    if not _expressible(bench, bound(most), most, widest, allowed=True):
        return
    peer, var_id, since = bench.peer(), bench.unknown_id(), bench.mark()
    peer.send(peer.update(var_id, 1, b"v" * bound(most), exact=True))
    bench.check_repeated(ICType.REQUEST_VARCREATES, var_id, 1, since)


@case(
    "TC_DCP_DATA_BI_02",
    "The length of a received description counts octets, not characters",
    requirements="DATA-08 VD-PC-05",
    stimulus="a VarCreate whose description has fewer characters than the maximum, but more octets",
    expect="it is ignored",
    needs=Needs(since=SpecVersion.V1_1),
)
def length_of_received_text(bench: Bench) -> None:
    longest = longest_description(bench)
    descr = ("\u00e9" * (longest // 2 + 1)).encode()
    if len(descr) > 254:
        bench.inconclusive(
            "a description longer than the maximum",
            f"impossible: the maximum of {longest} is the largest length that can be sent",
        )
    peer, var_id, since = bench.peer(), bench.unknown_id(), bench.mark()
    bench.identifiers.created.add(var_id)
    peer.send(peer.create(var_id, descr=descr, value=b"v", exact=True))
    bench.require_processed("the VarCreate")
    found = bench.instructions(ICType.CREATE_VARIABLES, var_id, since)
    bench.none(found, f"a VarCreate with a description of {len(descr)} octets is ignored")
