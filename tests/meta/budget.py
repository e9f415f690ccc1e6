"""Run a command, and fail if it has used more CPU seconds than it may: ``budget.py SECONDS COMMAND...``.

CPU seconds of the command and of all processes that it waited for; wall time depends on what else the machine does. A
second of a slow or shared processor does less than one of a fast one. The speed is therefore measured during the run,
with a sample that needs more memory than the caches of one processor have, as the command does: other machines on the
same host slow down memory more than arithmetic. On a processor slower than that for which budgets are stated, the
seconds are converted; on a faster one they are not. The exit status is that of the command,
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
REFERENCE = 0.0206
#: Seconds between two samples.
INTERVAL = 2.0


class _Entry:
    __slots__ = ("content", "number", "text")

    def __init__(self, number: int) -> None:
        self.number, self.text, self.content = number, (number, str(number)), {"number": number}


def sample() -> float:
    """Return the CPU seconds of a fixed piece of work, as Python programs do it: many small objects, out of order."""
    begun = time.thread_time()
    many = 15_000
    table = {number * 7919 % 1_000_003: _Entry(number) for number in range(many)}
    total = 0
    for number in range(many):
        entry = table[number * 4729 % many * 7919 % 1_000_003]
        total += entry.number + entry.content["number"] + len(entry.text[1])
    json.loads(json.dumps(list(range(total % 7 + 3000))))
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
