"""The time from a request to its confirm."""

from __future__ import annotations

from dcp_conformance.test_system.bench import MS, Bench


def check_confirm_time(bench: Bench, delays: list[int], others: list[int]) -> None:
    """Check that the median of ``delays`` is less than half a beacon period, so that the confirm waits for no beacon.

    ``delays`` and ``others`` are times from request to confirm in ns. Each request to the upper tester takes time,
    which ``others``, those of another request, estimate.
    """
    median = sorted(delays)[len(delays) // 2]
    limit = bench.period // 2 + round(bench.sut.pixit.timer_tolerance_ms * MS) + sorted(others)[len(others) // 2]
    bench.some(
        median <= limit, f"a median time to the confirm of at most {limit / MS:.0f} ms", seen=f"{median / MS:.0f} ms"
    )
