"""Run a command, and fail if it has used more CPU seconds than it may: ``budget.py SECONDS COMMAND...``.

CPU seconds of the command and of all processes that it waited for; wall time depends on what else the machine does. A
second of a slow or shared processor does less than one of a fast one. The speed is therefore measured during the run.
On a processor slower than that for which budgets are stated, the seconds are converted. On a faster one they
are not: a small sample can fit the cache better than the command does. The exit status is that of the command,
or 1 if the command succeeded but exceeded the budget.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import time

#: CPU seconds of :func:`sample` on the machine for which budgets are stated, with all of its processors busy.
REFERENCE = 0.0069
#: Seconds between two samples.
INTERVAL = 2.0


def sample() -> float:
    """Return the CPU seconds of a fixed piece of work, as Python programs do it."""
    begun = time.thread_time()
    table: dict[str, int] = {}
    for number in range(30_000):
        key = str(number % 997)
        table[key] = table.get(key, 0) + number
    json.loads(json.dumps(table))
    return time.thread_time() - begun


def main(arguments: list[str]) -> int:
    budget, command = float(arguments[0]), arguments[1:]
    begun = time.monotonic()
    samples = []
    with subprocess.Popen(command) as process:
        while process.poll() is None:
            samples.append(sample())
            try:
                process.wait(INTERVAL)
            except subprocess.TimeoutExpired:
                continue
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = spent.ru_utime + spent.ru_stime
    slowness = max(1.0, statistics.mean(samples) / REFERENCE) if samples else 1.0
    used = f"{cpu / slowness:.0f} CPU s of {budget:.0f} ({cpu:.0f} s, each worth {1 / slowness:.2f})"
    print(f"{' '.join(command)}: {used}; {time.monotonic() - begun:.0f} s of wall time", file=sys.stderr)
    if process.returncode == 0 and cpu / slowness > budget:
        print("more CPU seconds than the budget: see the most expensive tests above", file=sys.stderr)
        return 1
    return process.returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
