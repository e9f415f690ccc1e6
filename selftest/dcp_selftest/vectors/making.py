"""Make behaviour vectors: expectations on which all permitted nodes agree.

The steps of a vector are replayed on every permitted variant that differs from the reference node in its behaviour
alone, and with several seeds, hence with other intervals between beacons, orders and readings. What they do is the
freedom of the text: a vector allows all of it, requires what none of them leaves out, and forbids the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, Final

import msgspec
from dcp_conformance.definitions.case import Case, all_cases
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config
from dcp_conformance.reference.surroundings import UpperTesting, same_clock
from dcp_conformance.upper_tester import Answer
from dcp_conformance.vectors.behaviour import BehaviourGroup, Event, Expect, Settings, Step, Vector, flat
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import ICType

from dcp_codec.codec import Codec, get_codec
from dcp_codec.export.example import example_beacon
from dcp_selftest.runner import in_processes
from dcp_selftest.variants.variant import all_variants
from dcp_stack.config import NodeConfig
from dcp_stack.virtual.world import EPOCH

from .model import Watcher
from .replay import Trace, trace
from .stimuli import Stimulus, is_query, mentioned, recorded, steps_of

#: Seeds of the reference node: intervals between beacons.
_SEEDS: Final = (1, 2, 3, 4, 5)
#: Milliseconds by which a node is started earlier: the phases of its timers are its own.
_PHASES: Final = (37, 210, 330, 450, 570, 690, 810, 930)
#: Milliseconds after the last occurrence of an event in which it may still come.
_LATER: Final = 500
#: Cases in which another freedom shows that no variant has: examples/c-node composes a payload between two calls at the
#: same time, with the value of the first.
_ELSEWHERE: Final = frozenset({"TC_VD_PAR_BV_03"})
#: Longest time from one event of a series to the next, in milliseconds.
_NEXT: Final = 250
_PARAMETERS: Final = ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters")
#: Events whose number depends on how many beacons there are.
_STEADY: Final = 4
#: Members of confirms whose values the text leaves to the implementation.
_OPEN: Final = frozenset({"buffered", "timeStampRegistration", "countCreate", "countDelete", "countUpdate"})
#: The rows of SRP and VarDis in the list of client protocols: how they register is left to the implementation.
_OWN_ROWS: Final = ("protocols[1]", "protocols[2]")
#: The requirements of confirms that show a state, and of events.
_SHOWN: Final = {
    "BP-ListRegisteredProtocols": "BP-LST-01", "BP-QueryNumberBufferedPayloads": "BP-QRY-02",
    "RTDB-Read": "VD-REA-04", "RTDB-DescribeVariable": "VD-DVA-03", "RTDB-DescribeDatabase": "VD-DDB-02",
}  # fmt: skip
_EVENTS: Final = {"indication": "BP-RX-07", "transmitted": "BP-PTI-01", "beacon": "BP-FMT-01", "payload": "BP-TX-04"}
_RECORDS: Final = {
    ICType.CREATE_VARIABLES: "VD-CMP-06", ICType.DELETE_VARIABLES: "VD-CMP-10", ICType.UPDATES: "VD-CMP-09",
    ICType.SUMMARIES: "VD-CMP-03", ICType.REQUEST_VARCREATES: "VD-PAY-06", ICType.REQUEST_VARUPDATES: "VD-PAY-06",
}  # fmt: skip


def parameters(sut: InProcess) -> dict[str, Any]:
    """Return the values of all parameters of a node."""
    upper = sut.upper_tester()
    return {
        name: value
        for method in _PARAMETERS
        if method in upper.methods
        for name, value in upper.call(method, {}).result.get("parameters", {}).items()
    }


@cache
def family(profile: str) -> tuple[tuple[str, NodeConfig, MakeNode], ...]:
    """Return the permitted variants that a unit test can replace the reference node by: name, settings, constructor.

    Those with other parameters, capacities, layouts, clocks, applications or upper testers are left out.
    """
    codec = get_codec(profile)
    plain = reference_config(codec)
    usual = parameters(InProcess(plain))
    found: list[tuple[str, NodeConfig, MakeNode]] = [("", plain, plain_node)]
    for each in all_variants().values():
        if not each.applies_to(profile) or each.id.startswith("V-LIM-"):
            continue
        setup = each.build(profile)
        alone = setup.surroundings is None and setup.application is None and setup.clock is same_clock
        if not alone or setup.upper != UpperTesting() or setup.config.codec.profile != codec.profile:
            continue
        if setup.config == plain and setup.make is plain_node:
            continue
        if parameters(InProcess(setup.config, make=setup.make)) == usual:
            found.append((each.id, setup.config, setup.make))
    return tuple(found)


def settings(profile: str) -> Settings:
    """Return the settings that the vectors assume."""
    sut = InProcess(reference_config(get_codec(profile)))
    return Settings(sut.config.node_id.hex(":"), EPOCH, parameters(sut))


def traces(profile: str, steps: Sequence[Step], end: int) -> list[Trace]:
    """Replay steps on all permitted nodes."""
    found = [trace(config, make, steps, end) for _, config, make in family(profile)]
    _, config, make = family(profile)[0]
    found += [trace(config, make, steps, end, seed) for seed in _SEEDS[1:]]
    for early in _PHASES:
        before = trace(config, make, steps, end, 1, None, early)
        found.append(before._replace(events=[each for each in before.events if each.time >= 0]))
    return found


def vector(profile: str, case: Case, stimuli: Sequence[Stimulus]) -> Vector | None:
    """Return the vector of a case; None if its steps are not suitable."""
    codec = get_codec(profile)
    made = steps_of(codec, stimuli)
    needed = [each for each in case.requirements if _holds(codec, each)]
    if made is None or not needed or case.id in _ELSEWHERE:
        return None
    steps, end = made
    found = traces(profile, steps, end)
    if any(each.died for each in found):
        return None
    variables, protocols, neighbours = mentioned(codec, stimuli)
    _, config, make = family(profile)[0]
    watcher = Watcher(codec, config.node_id, parameters(InProcess(config)), variables)
    trace(config, make, steps, end, 1, watcher)
    if watcher.finding is not None:
        # The steps need knowledge that the model does not have.
        return None
    rows: dict[str, list[Any]] = {
        "varId": variables,
        "protocolId": protocols,
        "nodeId": [each.hex(":") for each in neighbours],
    }
    done = []
    for place, step in enumerate(steps):
        which = watcher.requirements.get(place) or _SHOWN.get(step.call or "", "")
        which = which if _holds(codec, which) else needed[0]
        done.append(_answered(step, [each.answers[place] for each in found], rows, which))
    expect = list(_expected(codec, steps, end, found, needed[0]))
    return Vector(f"{profile}/behaviour/{case.id}", case.purpose, (), tuple(needed), end, done, expect)


def _holds(codec: Codec, name: str) -> bool:
    """Return whether a requirement, or the place of a disputed text, exists in the version of a profile."""
    if "-" not in name:
        return bool(name)
    return requirement(name).holds_in(codec.profile.spec_version)


# -- answers --------------------------------------------------------------------------------------------------------


def _answered(step: Step, answers: list[Answer | None], rows: dict[str, list[Any]], requirement: str) -> Step:
    """Return a step with the statuses and values that all permitted nodes have."""
    if step.call is None:
        return step
    there = [each for each in answers if each is not None and each.code is None]
    if len(there) != len(answers):
        return step
    statuses = sorted({each.status for each in there})
    shown = [flat(step.call, each.result) for each in there]
    result = {}
    for path, value in shown[0].items():
        open_ = path.startswith(_OWN_ROWS) or path.rpartition(".")[2] in _OPEN
        if not open_ and all(each.get(path, each) == value for each in shown):
            result[path] = value
    for name, key in _lists(step.call):
        for each in rows[key]:
            path = f"{name}[{each}]"
            if not any(path in one for one in shown):
                result[path] = None
    return msgspec.structs.replace(step, status=statuses, result=result, requirement=requirement)


def _lists(method: str) -> Iterator[tuple[str, str]]:
    from dcp_conformance.vectors.behaviour import LISTS

    if method in LISTS:
        yield LISTS[method]


# -- events --------------------------------------------------------------------------------------------------------


def _expected(
    codec: Codec, steps: Sequence[Step], end: int, found: Sequence[Trace], otherwise: str
) -> Iterator[Expect]:
    """Yield the expectations about events: each interval has all occurrences in all traces.

    ``otherwise``: the requirement of an event that has none of its own in this version.
    """
    own, created = reference_config(codec).node_id.hex(), _creation(codec)
    counted = [_by_key(each.events, own, created) for each in found]
    keys = dict.fromkeys(key for each in counted for key in each)
    for key in keys:
        kind, number, octets = key
        times = [each.get(key, []) for each in counted]
        first = min(at[0] for at in times if at)
        last = max(at[-1] for at in times if at)
        after = max((step.at for step in steps if step.at <= first), default=0)
        before = end if last + _LATER + 200 >= end else math.ceil(last) + _LATER
        least, most = min(map(len, times)), max(map(len, times))
        steady = kind == "beacon" or (kind == "record" and number == ICType.SUMMARIES) or most > _STEADY
        if steady:
            least, upper = least * 2 // 3, None if kind in ("beacon", "record") else most * 3 // 2
            least = max(least, min(1, min(map(len, times))))
        elif least == most:
            upper = most
        else:
            # Where permitted nodes differ, one more or less is permitted, too.
            least, upper = least - (least > 1), most + 1
        if kind != "indication" and upper is not None and not steady and _cut(steps, before, end):
            least, upper = max(0, least - 1), max(upper, most + 1)
        which = _EVENTS.get(kind) or _RECORDS.get(ICType(number), "VD-PAY-02")
        which = which if _holds(codec, which) else otherwise
        yield Expect(kind, number, octets, after, before, least, upper, which)


def _cut(steps: Sequence[Step], before: int, end: int) -> bool:
    """Return whether another step, or the end, may have ended a series of events: the next would have come then."""
    last = before - _LATER
    stimuli = [step.at for step in steps if step.call is None or not is_query(step.call)]
    return before == end or any(last - _NEXT <= at <= last + _NEXT for at in stimuli)


def _by_key(
    events: Sequence[Event], own: str, created: tuple[slice, slice] | None
) -> dict[tuple[str, int, str], list[float]]:
    found: dict[tuple[str, int, str], list[float]] = {}
    for each in events:
        octets = each.octets
        if created is not None and each.kind == "record" and each.number == ICType.CREATE_VARIABLES:
            producer, time = created
            if octets[producer] == own:
                # The time at which this node created it, by a clock of its own.
                octets = octets[: time.start] + "?" * (time.stop - time.start) + octets[time.stop :]
        found.setdefault((each.kind, each.number, octets), []).append(each.time)
    return found


def _creation(codec: Codec) -> tuple[slice, slice] | None:
    """Return where producer and creation time are among the hex digits of a creation; None before 2.0."""
    root = codec.dissect(codec.encode(example_beacon(codec))).root
    spec = next(each for each in root.walk() if any(one.name == "repCnt" for one in each.children))
    found = [
        slice(2 * (each.offset - spec.offset), 2 * (each.offset - spec.offset + each.length))
        for name in ("prodId", "creationTime")
        if (each := spec.child(name)) is not None
    ]
    return (found[0], found[1]) if len(found) == 2 else None


# -- all --------------------------------------------------------------------------------------------------------


def _task(task: tuple[str, str, list[Stimulus]]) -> Vector | None:
    profile, case, stimuli = task
    return vector(profile, all_cases()[case], stimuli)


def collection(profile: str, jobs: int | None = None) -> BehaviourGroup:
    """Return the vectors of all cases of the suite."""
    family(profile)
    tasks = [(profile, case.id, stimuli) for case, stimuli in recorded(get_codec(profile))]
    made = dict(in_processes(_task, tasks, jobs))
    tests = [each for place in range(len(tasks)) if (each := made[place]) is not None]
    return BehaviourGroup(settings(profile), tests)


__all__ = ["collection", "family", "parameters", "settings", "traces", "vector"]
