"""Judge a sequence on the bench of a case: a counterexample counts if it is seen again, and is made shorter.

Only the first of several counterexamples with the same observation is made shorter, because that takes many executions.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial

from dcp_conformance.oracle.judgement import Finding
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.judgement.matchers import only_swapped
from dcp_conformance.test_system.known import UNREADABLE
from dcp_conformance.test_system.sut_properties import Capacity

from .driver import Counterexample, Driver, shorter, table
from .on_bench import BenchExecutor
from .steps import Beacon, Call, Content, Records, Report, Step

#: Executions to make a counterexample on a link shorter.
ATTEMPTS = 12


def execute(bench: Bench, steps: Sequence[Step], *, alone: bool) -> Counterexample | None:
    """Execute a sequence with new identifiers, and undo what it changed. Return the counterexample, if there is one."""
    driver = Driver(BenchExecutor(bench, alone=alone))
    try:
        driver.run(steps)
    except Counterexample as found:
        return found
    finally:
        bench.restoration.restore()
    return None


def judge(bench: Bench, steps: Sequence[Step], *, alone: bool) -> None:
    """Execute a sequence, and record a check with the requirement that the model names.

    A counterexample that a second execution does not show may be an effect of a loss or a delay, and is inconclusive.
    """
    expected = "every observation is one that the model allows"
    if unknown := BenchExecutor.unknown(bench, *_protocols(steps)):
        bench.verdicts.not_applicable(f"the value of {unknown} is not known: state it in the PIXIT")
    for what, count in _room(steps).items():
        if lacking := bench.sut.lacks(what, count):
            bench.verdicts.not_applicable(lacking)
    found = execute(bench, steps, alone=alone)
    if found is None:
        bench.passed(expected)
        return
    first = found
    if first.finding.about == "format":
        # Neither a repetition nor fewer steps can decide it.
        bench.inconclusive("beacons that can be read", f"{first.finding.observed}: {UNREADABLE}")
    for _ in range(0 if bench.session.provisional else 2):
        again = execute(bench, found.steps, alone=alone)
        if again is None or again.finding.requirements != first.finding.requirements:
            bench.inconclusive(
                expected, f"{first.finding.observed}, but not in another execution", *first.finding.requirements
            )
        found = again
    finding = found.finding
    cause = (*finding.requirements, finding.expected, finding.observed)
    if not bench.session.provisional and cause not in bench.session.counterexamples:
        bench.session.counterexamples.add(cause)
        found = shorter(partial(execute, bench, alone=alone), found, attempts=ATTEMPTS)
        finding = found.finding
    bench.excuses.relies_on("size")
    if finding.about == "creationTime":
        bench.excuses.relies_on("creationTime")
    blocks = _blocks(steps)
    if any(isinstance(each, Records) for each in blocks):
        bench.excuses.relies_on("VarCreate")
    if any(isinstance(each, Report) for each in blocks):
        bench.excuses.relies_on("report")
    shown = "\n".join(table(found.rows))
    bench.missing(
        finding.expected, f"{finding.observed}, after these steps:\n{shown}", *finding.requirements,
        turned=_swapped(finding),
    )  # fmt: skip


def _swapped(finding: Finding) -> bool:
    """Return whether a number of the expectation has been observed with its octets in the other order."""
    right, seen = (set(map(int, re.findall(r"\b\d+\b", text))) for text in (finding.expected, finding.observed))
    return any(only_swapped(one, other) for one in seen - right for other in right - seen)


def _blocks(steps: Sequence[Step]) -> list[Content]:
    return [block for each in steps if isinstance(each, Beacon) for block in each.blocks]


def _protocols(steps: Sequence[Step]) -> tuple[str, ...]:
    """Return the beginnings of the names of the parameters on which a sequence depends."""
    found, blocks = ["BPPAR"], _blocks(steps)
    methods = [each.method for each in steps if isinstance(each, Call)]
    if any(isinstance(each, Report) for each in blocks) or any(each.startswith("SRP") for each in methods):
        found.append("SRPPAR")
    if any(isinstance(each, Records) for each in blocks) or any(each.startswith(("RTDB", "VD")) for each in methods):
        found.append("VARDISPAR")
    return tuple(found)


def _room(steps: Sequence[Step]) -> dict[Capacity, int]:
    """Return how many entries of each kind a sequence needs at most."""
    blocks = _blocks(steps)
    params = [each.params for each in steps if isinstance(each, Call)]
    return {
        "queue_entries": max((each.get("maxEntries", 0) for each in params), default=0),
        "clients": len({each["protId"] for each in params if "protId" in each}),
        "neighbours": sum(each.count for each in blocks if isinstance(each, Report)),
        "variables": sum(each.count for each in blocks if isinstance(each, Records))
        + len({each["varId"] for each in params if "varId" in each}),
    }
