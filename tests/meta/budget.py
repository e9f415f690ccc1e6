"""Run a command, and fail if it has used more CPU seconds than it may: ``budget.py SECONDS COMMAND...``.

CPU seconds of the command and of all processes that it waited for; wall time depends on what else the machine does.
The exit status is that of the command, or 1 if the command succeeded but exceeded the budget.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import time


def main(arguments: list[str]) -> int:
    budget, command = float(arguments[0]), arguments[1:]
    begun = time.monotonic()
    status = subprocess.run(command, check=False).returncode
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = spent.ru_utime + spent.ru_stime
    print(f"{' '.join(command)}: {cpu:.0f} CPU s of {budget:.0f}, {time.monotonic() - begun:.0f} s", file=sys.stderr)
    if status == 0 and cpu > budget:
        print("more CPU seconds than the budget: see the most expensive tests above", file=sys.stderr)
        return 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
