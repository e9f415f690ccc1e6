"""dcp-vardis.md: Composing the ICTYPE-SUMMARIES Container."""

from __future__ import annotations

from dcp_spec.constants import ICType

from dcp_conformance.definitions.case import FILLS, Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.full_payloads import settable
from dcp_conformance.test_steps.services import produced
from dcp_conformance.test_system.bench import Bench

SUMMARIES = "VARDISPAR_MAX_SUMMARIES"
_SUMMARY = ICType.SUMMARIES
#: Maximum number of variables that a case teaches for their summaries.
_MANY = 60


def summarises(bench: Bench) -> str | None:
    """Return why cases about summaries do not apply, or None; for ``Needs.when``."""
    return (
        None if bench.sut.bound(SUMMARIES, missing=True) else f"{SUMMARIES} is 0: the implementation sends no summaries"
    )


_WIRE = Needs(when=summarises)


def _never_summarises(bench: Bench) -> str | None:
    """Return why the parameter cannot be 0, or None; for ``Needs.when``."""
    if settable(bench) or not bench.sut.bound(SUMMARIES):
        return None
    return f"{SUMMARIES} is {bench.sut.bound(SUMMARIES)} and cannot be set (VD-SetParameter, UT-Reset)"


def _know(bench: Bench, count: int) -> list[int]:
    """Teach the implementation ``count`` variables with short values and descriptions."""
    peer, names = bench.peer(), bench.identifiers.var_ids(count)
    bench.learn(peer, *(peer.create(each, value=b"v", descr=b"d") for each in names))
    return names


def _named(heard: ReceivedBeacon) -> list[int]:
    return [each.var_id for each in heard.instructions(_SUMMARY)]


def _check_rotation(bench: Bench, names: list[int], most: int, *requirements: str) -> None:
    """Listen for two rounds and check that each payload has at most ``most`` summaries and that the variables take
    turns.
    """
    bench.beacons(1)
    mark = bench.mark()
    frames = [each for each in bench.beacons(2 * -(-len(names) // most) + 2) if each.has_vardis]
    over = [each for each in frames if len(_named(each)) > most]
    text = f"{max(map(len, map(_named, frames)), default=0)}"
    bench.none(over, f"at most {most} summaries in each payload", "VD-CMP-02", seen=text)
    # An application on the node may have variables of its own, and may create another one in the meantime.
    sequence = [each.var_id for each in bench.instructions(_SUMMARY, since=mark) if each.var_id in names]
    known = set(sequence)
    missing = sorted(set(names) - known)
    text = f"no variable {', '.join(map(str, missing[:8]))} in {len(sequence)} summaries"
    bench.complete(missing, "summaries of all variables", *requirements, frames=frames[-1:])
    # A rotating queue repeats the same sequence.
    turn = len(known)
    wrong = [place for place in range(turn, len(sequence)) if sequence[place] != sequence[place - turn]]
    text = ""
    if wrong:
        text = f"variable {sequence[wrong[0]]} instead of {sequence[wrong[0] - turn]}"
    bench.some(not wrong, "the variables in rotation", *requirements, seen=text, frames=frames[-1:])
    short = [each for each in frames if len(_named(each)) < min(most, turn)]
    text = f"{min(map(len, map(_named, frames)), default=0)}"
    bench.none(short, f"{min(most, turn)} summaries in each payload that has room for them", "VD-PAY-02", seen=text)


@case(
    "TC_VD_SUM_BV_01",
    "Summaries rotate if there are more variables than summaries in a payload",
    requirements="VD-CMP-02 VD-CMP-03 VD-PAY-02",
    alone=FILLS,
    stimulus="one and a half times as many variables as VARDISPAR_MAX_SUMMARIES are known",
    expect=(
        "payloads with exactly VARDISPAR_MAX_SUMMARIES summaries; all variables in rotation, in the same order in "
        "each round"
    ),
    window=14,
    needs=_WIRE,
)
def rotation(bench: Bench) -> None:
    most = bench.sut.bound(SUMMARIES)
    names = _know(bench, min(max(3, most + most // 2), _MANY))
    _check_rotation(bench, names, most, "VD-CMP-03")


@case(
    "TC_VD_SUM_BV_02",
    (
        "A payload has at most VARDISPAR_MAX_SUMMARIES summaries ({variant} for ten variables, or as close to it "
        "as possible)"
    ),
    requirements="VD-CMP-02 VD-CMP-03 VD-PAY-02",
    alone=FILLS,
    stimulus=(
        "ten variables are known; the parameter is set to {variant}. If it cannot be set, the number of variables "
        "is 1, 3, the value of the parameter, or one more"
    ),
    expect="at most VARDISPAR_MAX_SUMMARIES summaries in each payload; all variables in rotation",
    window=24,
    needs=Needs(when=lambda bench: None if settable(bench) else summarises(bench)),
    variants={"1": 1, "3": 3, "10": 10, "11": 11},
)
def most_summaries(bench: Bench, most: int) -> None:
    if settable(bench):
        names = _know(bench, 10)
        bench.must("VD-SetParameter", name=SUMMARIES, value=most)
    else:
        count, most = most, bench.sut.bound(SUMMARIES)
        names = _know(bench, min(count if count < 10 else most + count - 10, _MANY))
    bench.beacons(2)
    _check_rotation(bench, names, most, "VD-CMP-03")


@case(
    "TC_VD_SUM_BV_03",
    "With VARDISPAR_MAX_SUMMARIES 0 no summaries are sent, and VarDis otherwise works",
    requirements="VD-CMP-01 VD-PAR-06",
    alone=FILLS,
    stimulus=(
        "a variable is known; the parameter is 0 or set to 0; a summary of an unknown variable and an update of "
        "the known one arrive"
    ),
    expect="no SUMMARIES container; a request for the unknown variable and the VarUpdate",
    window=10,
    needs=Needs(when=_never_summarises),
)
def no_summaries(bench: Bench) -> None:
    (name,) = _know(bench, 1)
    peer = bench.peer()
    if settable(bench):
        bench.must("VD-SetParameter", name=SUMMARIES, value=0)
    bench.wait(3)
    unknown = bench.unknown_id()
    mark = peer.stimulate(peer.summary(unknown, 1), peer.update(name, 1))
    asked = bench.until_instruction(ICType.REQUEST_VARCREATES, unknown)
    bench.some(asked, "a request for the unknown variable", "VD-CMP-01")
    bench.wait(4)
    bench.none(bench.instructions(_SUMMARY, since=mark), "no summaries")
    bench.some(bench.instructions(ICType.UPDATES, name, mark), "the VarUpdate is forwarded", "VD-CMP-01")


@case(
    "TC_VD_SUM_BV_04",
    "An empty database causes no SUMMARIES container",
    requirements="VD-CMP-01",
    stimulus="a summary of an unknown variable while the database is empty",
    expect="a request for the variable, in payloads without a SUMMARIES container",
    needs=Needs(ut=("UT-Reset",)),
)
def nothing_to_summarise(bench: Bench) -> None:
    bench.wait(2)
    mark = bench.mark()
    bench.require_alive("a reset")
    bench.wait(2)
    number = bench.builder.ic_type(_SUMMARY)
    found = [each for each in bench.heard[mark:] if any(one.ic_type == number for one in each.containers)]
    if any(bench.identifiers.is_applications(name) for each in found for name in _named(each)):
        bench.inconclusive(
            "an empty database, which this case needs", "an application on the node has created a variable"
        )
    bench.none(found, "no SUMMARIES container while no variable is known")


@case(
    "TC_VD_SUM_BV_06",
    "Summaries have the current sequence number of the database",
    requirements="VD-CMP-04",
    stimulus="a variable is created with sequence number 3, and updated to 4 and 9",
    expect="summaries with 3; from each VarUpdate on, with its number",
    window=12,
    needs=_WIRE,
)
def current_number(bench: Bench) -> None:
    peer, name = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(name, seqno=3))
    _check_number(bench, name, 3, bench.mark())
    for number in (4, 9):
        mark = peer.stimulate(peer.update(name, number))
        bench.required(bench.until_instruction(ICType.UPDATES, name), "the VarUpdate is forwarded")
        # A payload composed before the update was sent before the VarUpdate.
        _check_number(bench, name, number, bench.heard.index(bench.receiver.frames_with(ICType.UPDATES, name, mark)[0]))


def _check_number(bench: Bench, name: int, number: int, since: int) -> None:
    found = bench.until_instruction(_SUMMARY, name, 12) or bench.instructions(_SUMMARY, name, since)
    bench.some(found, f"a summary of variable {name}", seen="none in 12 periods")
    bench.every(
        bench.instructions(_SUMMARY, name, since),
        lambda each: each.record.seqno == number,
        f"summaries with sequence number {number}",
    )


@case(
    "TC_VD_SUM_BV_07",
    "Deleted variables are no longer summarised, all others are",
    requirements="VD-CMP-05",
    stimulus="one beacon deletes three of six variables",
    expect="after the first VarDelete no summary of the three, and summaries of the others",
    window=12,
    needs=_WIRE,
)
def deleted_not_summarised(bench: Bench) -> None:
    names = _know(bench, 6)
    peer, mark = bench.peer(), bench.mark()
    gone, left = names[::2], names[1::2]
    peer.send(*(peer.delete(each) for each in gone))
    bench.required(bench.until_instruction(ICType.DELETE_VARIABLES, gone[0]), "the VarDelete is forwarded")
    begun = bench.heard.index(bench.receiver.frames_with(ICType.DELETE_VARIABLES, gone[0], mark)[0])
    bench.until(lambda _: set(left) <= {each.var_id for each in bench.instructions(_SUMMARY, since=begun)}, 16)
    late = [each for each in bench.instructions(_SUMMARY, since=begun) if each.var_id in gone]
    bench.none(late, "no summary of a deleted variable")
    still = {each.var_id for each in bench.instructions(_SUMMARY, since=begun)} & set(left)
    bench.some(still == set(left), "summaries of the remaining variables", seen=f"only of {sorted(still)}")


@case(
    "TC_VD_SUM_BV_08",
    "A node's own variables are summarised with their current sequence number",
    requirements="VD-CMP-04",
    stimulus="the application creates a variable and updates it twice",
    expect="summaries with sequence number 2",
    window=10,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update"), when=summarises),
)
def own_summarised(bench: Bench) -> None:
    name = produced(bench)
    bench.required(bench.until_instruction(_SUMMARY, name, 8), "a summary of the node's own variable")
    mark = bench.mark()
    for value in ("01", "02"):
        bench.must("RTDB-Update", varId=name, value=value)
    bench.required(bench.until_instruction(ICType.UPDATES, name), "the VarUpdate")
    begun = bench.heard.index(bench.receiver.frames_with(ICType.UPDATES, name, mark)[-1])
    if bench.instructions(ICType.UPDATES, name, begun)[0].record.seqno != 2:
        # The first VarUpdate was composed before the second update.
        bench.until(lambda heard: any(each.record.seqno == 2 for each in heard.instructions(ICType.UPDATES, name)))
        begun = len(bench.heard) - 1
    _check_number(bench, name, 2, begun)


@case(
    "TC_VD_SUM_BO_01",
    "Variables that are not in the database are not summarised",
    requirements="VD-TYP-08",
    stimulus="summaries, requests and a deletion of unknown variables",
    expect="requests for them, but no summary of any of them",
    window=8,
    needs=_WIRE,
)
def unknown_not_summarised(bench: Bench) -> None:
    _know(bench, 1)
    peer, names = bench.peer(), bench.identifiers.unknown_ids(4)
    mark = bench.mark()
    unknown = peer.summary(names[0], 1), peer.request_update(names[1], 2), peer.request_create(names[2])
    for record in (*unknown, peer.delete(names[3])):
        peer.send(record)
    bench.require_alive("records about unknown variables")
    bench.beacons(3)
    found = [each for each in bench.instructions(_SUMMARY, since=mark) if each.var_id in names]
    bench.none(found, "no summary of an unknown variable")
