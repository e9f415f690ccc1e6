"""dcp-vardis.md: Composing the ICTYPE-SUMMARIES Container."""

from __future__ import annotations

from dcp_spec.constants import ICType

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.filling import settable
from dcp_conformance.heard import Heard
from dcp_conformance.services import produced

SUMMARIES = "VARDISPAR_MAX_SUMMARIES"
_SUMMARY = ICType.SUMMARIES
#: The most variables that a case makes known for their summaries.
_MANY = 60


def summarises(bench: Bench) -> str | None:
    """The reason for which cases about summaries do not apply, or None."""
    return None if bench.bound(SUMMARIES, missing=True) else f"{SUMMARIES} is 0: it sends no summaries"


_WIRE = Needs(when=summarises)


def _never_summarises(bench: Bench) -> str | None:
    """For ``Needs.when``: why the parameter is not 0."""
    if settable(bench) or not bench.bound(SUMMARIES):
        return None
    return f"{SUMMARIES} is {bench.bound(SUMMARIES)} and cannot be set (VD-SetParameter, UT-Reset)"


def _know(bench: Bench, count: int) -> list[int]:
    """Let the implementation know so many variables, with little to say about each."""
    peer, names = bench.peer(), bench.var_ids(count)
    bench.learn(peer, *(peer.create(each, value=b"v", descr=b"d") for each in names))
    return names


def _named(heard: Heard) -> list[int]:
    return [each.var_id for each in heard.instructions(_SUMMARY)]


def _check_rotation(bench: Bench, names: list[int], most: int, *requirements: str) -> None:
    """Listen for two rounds: at most so many in a payload, each in its turn."""
    bench.beacons(1)
    mark = bench.mark()
    rounds = 2 * -(-len(names) // most) + 2
    frames = [each for each in bench.beacons(rounds) if each.has_vardis]
    over = [each for each in frames if len(_named(each)) > most]
    text = f"{max(map(len, map(_named, frames)), default=0)}"
    bench.check(not over, f"at most {most} summaries in a payload", text, "VD-CMP-02", frames=over[:4], shown=True)
    # An application of the implementation may have variables of its own, and create one meanwhile.
    sequence = [each.var_id for each in bench.instructions(_SUMMARY, since=mark) if each.var_id in names]
    known = set(sequence)
    missing = sorted(set(names) - known)
    text = f"not {', '.join(map(str, missing[:8]))} in {len(sequence)} summaries"
    bench.check(not missing, "every variable is summarised", text, *requirements, frames=frames[-1:])
    # A rotating queue gives the same sequence again and again.
    turn = len(known)
    wrong = [place for place in range(turn, len(sequence)) if sequence[place] != sequence[place - turn]]
    text = ""
    if wrong:
        text = f"variable {sequence[wrong[0]]} where it was the turn of {sequence[wrong[0] - turn]}"
    bench.check(not wrong, "variables are summarised in turn", text, *requirements, frames=frames[-1:])
    short = [each for each in frames if len(_named(each)) < min(most, turn)]
    text = f"{min(map(len, map(_named, frames)), default=0)}"
    what = f"{min(most, turn)} summaries in a payload with room for them"
    bench.check(not short, what, text, "VD-PAY-02", frames=short[:4], shown=True)


@case(
    "TC_VD_SUM_BV_01",
    "Summaries rotate through more variables than a payload may name",
    requirements="VD-CMP-02 VD-CMP-03 VD-PAY-02",
    stimulus="half as many variables again as VARDISPAR_MAX_SUMMARIES are known",
    expect="payloads with just that many summaries, and all variables in turn, in the same order in each round",
    window=14,
    needs=_WIRE,
    smoke=True,
)
def rotation(bench: Bench) -> None:
    most = bench.bound(SUMMARIES)
    names = _know(bench, min(max(3, most + most // 2), _MANY))
    _check_rotation(bench, names, most, "VD-CMP-03")


@case(
    "TC_VD_SUM_BV_02",
    "A payload names at most VARDISPAR_MAX_SUMMARIES variables ({variant} for ten variables, or as near as can be)",
    requirements="VD-CMP-02 VD-CMP-03 VD-PAY-02",
    stimulus="ten variables are known; the parameter is set to {variant}. Where it cannot be set, there are one, 3, "
    "as many as the parameter says, or one more",
    expect="at most as many summaries in a payload as the parameter says, and all variables in turn",
    window=24,
    needs=Needs(when=lambda bench: None if settable(bench) else summarises(bench)),
    variants={"1": 1, "3": 3, "10": 10, "11": 11},
)
def most_summaries(bench: Bench, most: int) -> None:
    if settable(bench):
        names = _know(bench, 10)
        bench.must("VD-SetParameter", name=SUMMARIES, value=most)
    else:
        count, most = most, bench.bound(SUMMARIES)
        names = _know(bench, min(count if count < 10 else most + count - 10, _MANY))
    bench.beacons(2)
    _check_rotation(bench, names, most, "VD-CMP-03")


@case(
    "TC_VD_SUM_BV_03",
    "With VARDISPAR_MAX_SUMMARIES 0 there are no summaries, and all else goes on",
    requirements="VD-CMP-01 VD-PAR-06",
    stimulus="a variable is known; the parameter is 0, or set to it; an unknown variable is summarised, the known one "
    "updated",
    expect="no SUMMARIES container any more; the request and the VarUpdate",
    window=10,
    needs=Needs(when=_never_summarises),
)
def no_summaries(bench: Bench) -> None:
    (name,) = _know(bench, 1)
    peer = bench.peer()
    if settable(bench):
        bench.must("VD-SetParameter", name=SUMMARIES, value=0)
    bench.wait(3)
    mark = bench.mark()
    unknown = bench.unknown_id()
    peer.send(peer.summary(unknown, 1), peer.update(name, 1))
    asked = bench.until_instruction(ICType.REQUEST_VARCREATES, unknown)
    bench.check(asked, "a request for the unknown variable", "none", "VD-CMP-01")
    bench.wait(4)
    found = bench.instructions(_SUMMARY, since=mark)
    bench.check(not found, "no summaries", f"{len(found)} came", frames=found[:4], shown=True)
    passed = bench.instructions(ICType.UPDATES, name, mark)
    bench.check(passed, "the VarUpdate is passed on", "it is not", "VD-CMP-01")


@case(
    "TC_VD_SUM_BV_04",
    "Without a variable there is no SUMMARIES container",
    requirements="VD-CMP-01",
    stimulus="a summary of an unknown variable, with an empty database",
    expect="the request for it, in payloads without a SUMMARIES container",
    needs=Needs(ut=("UT-Reset",)),
)
def nothing_to_summarise(bench: Bench) -> None:
    bench.wait(2)
    mark = bench.mark()
    bench.require_alive("a reset")
    bench.wait(2)
    number = bench.forge.ic_type(_SUMMARY)
    found = [each for each in bench.heard[mark:] if any(one.ic_type == number for one in each.containers)]
    if any(bench.is_applications(name) for each in found for name in _named(each)):
        bench.inconclusive("the database is empty, which this case needs", "an application on the node has a variable")
    bench.check(
        not found,
        "no SUMMARIES container while no variable is known",
        f"{len(found)} came",
        frames=found[:4],
        shown=True,
    )


@case(
    "TC_VD_SUM_BV_06",
    "Summaries carry the number that the database has now",
    requirements="VD-CMP-04",
    stimulus="a variable is created with number 3, and updated to 4 and 9",
    expect="summaries with 3; from the VarUpdate on with its number",
    window=12,
    needs=_WIRE,
)
def current_number(bench: Bench) -> None:
    peer, name = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(name, seqno=3))
    _check_number(bench, name, 3, bench.mark())
    for number in (4, 9):
        mark = bench.mark()
        peer.send(peer.update(name, number))
        bench.require(bench.until_instruction(ICType.UPDATES, name), "the VarUpdate is passed on", "it is not")
        # What was composed before the update has left before the VarUpdate.
        begun = bench.heard.index(bench.frames_with(ICType.UPDATES, name, mark)[0])
        _check_number(bench, name, number, begun)


def _check_number(bench: Bench, name: int, number: int, since: int) -> None:
    found = bench.until_instruction(_SUMMARY, name, 12) or bench.instructions(_SUMMARY, name, since)
    bench.check(found, f"a summary of variable {name}", "none in 12 periods")
    wrong = [each for each in bench.instructions(_SUMMARY, name, since) if each.record.seqno != number]
    text = f"{wrong[0].record.seqno}" if wrong else ""
    bench.check(not wrong, f"summaries with number {number}", text, frames=wrong[:4], shown=True)


@case(
    "TC_VD_SUM_BV_07",
    "Deleted variables leave the summaries, the others stay",
    requirements="VD-CMP-05",
    stimulus="of six variables three are deleted by one beacon",
    expect="behind the first VarDelete no summary of the three, and summaries of the others",
    window=12,
    needs=_WIRE,
)
def deleted_not_summarised(bench: Bench) -> None:
    names = _know(bench, 6)
    peer, mark = bench.peer(), bench.mark()
    gone, left = names[::2], names[1::2]
    peer.send(*(peer.delete(each) for each in gone))
    found = bench.until_instruction(ICType.DELETE_VARIABLES, gone[0])
    bench.require(found, "the VarDelete is passed on", "it is not")
    begun = bench.heard.index(bench.frames_with(ICType.DELETE_VARIABLES, gone[0], mark)[0])
    bench.until(lambda _: set(left) <= {each.var_id for each in bench.instructions(_SUMMARY, since=begun)}, 16)
    late = [each for each in bench.instructions(_SUMMARY, since=begun) if each.var_id in gone]
    bench.check(not late, "no summary of a deleted variable", f"{len(late)} came", frames=late[:4], shown=True)
    still = {each.var_id for each in bench.instructions(_SUMMARY, since=begun)} & set(left)
    bench.check(still == set(left), "summaries of the variables that are left", f"only of {sorted(still)}")


@case(
    "TC_VD_SUM_BV_08",
    "Own variables are summarised with their current number",
    requirements="VD-CMP-04",
    stimulus="the application creates a variable and updates it twice",
    expect="summaries with number 2",
    window=10,
    needs=Needs(ut=("RTDB-Create", "RTDB-Update"), when=summarises),
)
def own_summarised(bench: Bench) -> None:
    name = produced(bench)
    bench.require(bench.until_instruction(_SUMMARY, name, 8), "a summary of the own variable", "none")
    mark = bench.mark()
    for value in ("01", "02"):
        bench.must("RTDB-Update", varId=name, value=value)
    bench.require(bench.until_instruction(ICType.UPDATES, name), "the VarUpdate", "none")
    begun = bench.heard.index(bench.frames_with(ICType.UPDATES, name, mark)[-1])
    last = bench.instructions(ICType.UPDATES, name, begun)[0].record.seqno
    if last != 2:
        # The first of them was composed before the second update came.
        bench.until(lambda heard: any(each.record.seqno == 2 for each in heard.instructions(ICType.UPDATES, name)))
        begun = len(bench.heard) - 1
    _check_number(bench, name, 2, begun)


@case(
    "TC_VD_SUM_BO_01",
    "Variables that are only known by name are not summarised",
    requirements="VD-TYP-08",
    stimulus="summaries, requests and a deletion of unknown variables",
    expect="requests for them, no summary of any of them",
    window=8,
    needs=_WIRE,
)
def unknown_not_summarised(bench: Bench) -> None:
    _know(bench, 1)
    peer, names = bench.peer(), bench.unknown_ids(4)
    mark = bench.mark()
    peer.send(peer.summary(names[0], 1), peer.request_update(names[1], 2), peer.request_create(names[2]))
    peer.send(peer.delete(names[3]))
    bench.require_alive("names of unknown variables")
    bench.beacons(3)
    found = [each for each in bench.instructions(_SUMMARY, since=mark) if each.var_id in names]
    bench.check(not found, "no summary of an unknown variable", f"{len(found)} came", frames=found[:4], shown=True)
