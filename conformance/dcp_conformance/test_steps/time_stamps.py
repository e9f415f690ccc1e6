"""Checks of the implementation's time stamps, whose clock may differ from the tester's and be set during a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from dcp_conformance.test_steps.services import Moment, nanoseconds
from dcp_conformance.test_system.bench import MS, Bench

#: Number of comparisons of two stamps if their difference is wrong.
_MEASUREMENTS = 3


@dataclass(frozen=True, slots=True)
class Stamps:
    """Two time stamps of the implementation, in ns, and the requests that caused them."""

    first: int
    second: int
    requests: tuple[Moment, Moment]


def stamp_in(bench: Bench, entry: Mapping[str, object], *requirements: str) -> int:
    """Return the time stamp in a database entry, in ns; fails and stops the case if it is not a number."""
    found = entry.get("tStamp")
    number = found if isinstance(found, int) else None
    return bench.present(number, "a number of nanoseconds as tStamp", *requirements, seen=repr(found))


def check_apart(bench: Bench, what: str, measure: Callable[[], Stamps]) -> Stamps:
    """Check that the difference of two stamps is that of the requests that caused them; return the last measurement.

    The difference is known up to the duration of the requests, whatever the offset of the implementation's clock. The
    clock may be set between two stamps, which is not a fault: a wrong difference is measured again, at most twice.
    """
    for _ in range(_MEASUREMENTS):
        found = measure()
        first, second = found.requests
        slack = bench.period + nanoseconds(bench, 1)
        low, high = second.before - first.after - slack, second.after - first.before + slack
        apart = found.second - found.first
        if low <= apart <= high:
            break
    expected = f"the second {what} {low / MS:.0f} to {high / MS:.0f} ms after the first"
    bench.proved(low <= apart <= high, expected, f"{apart / MS:.0f} ms")
    return found


def check_later(bench: Bench, expected: str, least: int, measure: Callable[[], int], *requirements: str) -> None:
    """Check that the second of two stamps is at least ``least`` ns later; ``measure`` returns their difference.

    The implementation's clock may be set between the two: a wrong difference is measured again, at most twice.
    """
    for _ in range(_MEASUREMENTS):
        later = measure()
        if later >= least:
            break
    bench.proved(later >= least, expected, f"{later / MS:.0f} ms later", *requirements)


def check_now(bench: Bench, what: str, stamp: int, request: Moment) -> None:
    """Check that a stamp, in ns since 1970, is the time of the request, within the tolerance of the clocks (PIXIT)."""
    slack = round(bench.sut.pixit.clock_tolerance_ms * MS) + nanoseconds(bench, 1)
    near = request.before - slack <= stamp <= request.after + slack
    off = (stamp - request.before) / MS
    bench.proved(near, f"{what} within {slack / MS:.0f} ms of the time of the request", f"{off:.0f} ms off")
