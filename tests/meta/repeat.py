"""Run a target of the Makefile in fresh clones of the committed tree, and print a table of the results.

``make test-repeat N=10 LOAD=4`` runs `make test` in ten clones, in succession, beside four processes that keep
processors busy. ``WHAT=demo`` or ``WHAT=test-all`` runs another target, ``JOBS=4`` keeps four clones running at a
time. A clone in which the target fails is kept, with the output beside it; the others are removed. Exit status 1 if any
failed.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: A process that uses one processor until its parent has ended or a time is over.
BUSY = """
import os, sys, time
parent, end = os.getppid(), time.monotonic() + float(sys.argv[1])
while os.getppid() == parent and time.monotonic() < end:
    sum(range(100_000))
"""
#: Seconds that one clone may take.
LONGEST = 7200.0
_SUMMARY = re.compile(r"^=*\s*(\d+ (?:passed|failed|error).* in [\d.]+s.*?)\s*=*$", re.MULTILINE)


@dataclass(frozen=True)
class Done:
    """The result of one clone."""

    number: int
    status: int
    """Exit status of make; 124 if the time was over."""
    wall_s: float
    cpu_s: float
    """CPU seconds of make and all that it started."""
    summary: str
    failed: tuple[str, ...]
    """Lines of the output that name a failure."""
    load: float
    """Load average of the machine at the end."""
    undecided: tuple[str, ...] = ()
    """Cases of a demo whose verdict is not pass, info or not applicable, as ``ID verdict``."""


@contextmanager
def busy(number: int, seconds: float) -> Iterator[None]:
    """Keep ``number`` processors busy, for ``seconds`` at most."""
    started = [subprocess.Popen([sys.executable, "-c", BUSY, str(seconds)]) for _ in range(number)]
    try:
        yield
    finally:
        for each in started:
            each.kill()
            each.wait()


def environment() -> dict[str, str]:
    """The environment without that of a `make` or a virtual environment around this process."""
    inner = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MAKEOVERRIDES", "VIRTUAL_ENV", "N", "LOAD", "JOBS", "WHAT")
    return {name: value for name, value in os.environ.items() if name not in inner}


def make(clone: Path, log: Path, target: str) -> tuple[int, float]:
    """Clone, run `make TARGET`, and return its exit status and CPU seconds."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    with log.open("wb") as output:
        process = subprocess.Popen(
            ["make", target], cwd=clone, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            env=environment(), start_new_session=True,
        )  # fmt: skip
        signals = ThreadPoolExecutor(1)
        try:
            waiting = signals.submit(os.wait4, process.pid, 0)
            _, code, usage = waiting.result(LONGEST)
        except BaseException as error:
            # make alone would leave the tests running.
            os.killpg(process.pid, signal.SIGKILL)
            if not isinstance(error, TimeoutError):
                raise
            return 124, 0.0
        finally:
            signals.shutdown()
    process.returncode = os.waitstatus_to_exitcode(code)
    return process.returncode, usage.ru_utime + usage.ru_stime


def run(folder: Path, number: int, target: str) -> Done:
    """Run the target in a clone; remove the clone if it succeeds."""
    clone, log = folder / f"clone{number}", folder / f"clone{number}.log"
    begun = time.monotonic()
    status, cpu = make(clone, log, target)
    wall = time.monotonic() - begun
    text = log.read_text(errors="replace")
    summary = "; ".join(_SUMMARY.findall(text)) or (text.splitlines() or ["no output"])[-1]
    failed = tuple(line for line in text.splitlines() if line.startswith(("FAILED", "ERROR", "make: ***")))
    undecided = undecided_cases(clone / "demo-report" / "results.json")
    if status == 0:
        shutil.rmtree(clone)
    return Done(number, status, wall, cpu, summary, failed, os.getloadavg()[0], undecided)


def undecided_cases(path: Path) -> tuple[str, ...]:
    """The cases in the results of a run whose verdict decides nothing or fails; none without such a file."""
    if not path.exists():
        return ()
    cases = json.loads(path.read_text(encoding="utf-8"))["cases"]
    fine = ("pass", "info", "not-applicable")
    return tuple(f"{each['id']} {each['verdict']}" for each in cases if each["verdict"] not in fine)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=10, help="number of clones (default 10)")
    parser.add_argument("--load", type=int, default=0, help="processes that keep processors busy (default 0)")
    parser.add_argument("--jobs", type=int, default=1, help="clones that run at the same time (default 1)")
    parser.add_argument("target", nargs="?", default="test", help="target of the Makefile (default test)")
    arguments = parser.parse_args()
    if subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, check=True).stdout:
        print("only what is committed is cloned; there are changes that are not", file=sys.stderr)
    folder = Path(tempfile.mkdtemp(prefix="make-test-repeat-"))
    failed = 0
    undecided: Counter[str] = Counter()
    print(f"make {arguments.target} in {arguments.n} clones in {folder}, {arguments.jobs} at a time,", end=" ")
    print(f"beside {arguments.load} busy processes", flush=True)
    print("run  result  wall       CPU      load  last line", flush=True)
    with busy(arguments.load, LONGEST * arguments.n), ThreadPoolExecutor(arguments.jobs) as pool:
        for done in pool.map(lambda number: run(folder, number, arguments.target), range(1, arguments.n + 1)):
            minutes, seconds = divmod(round(done.wall_s), 60)
            verdict = "ok" if done.status == 0 else f"{done.status}"
            print(f"{done.number:3}  {verdict:6}  {minutes:2}:{seconds:02} min  {done.cpu_s:5.0f} s", end="  ")
            print(f"{done.load:4.1f}  {done.summary}", flush=True)
            for line in done.failed:
                print(f"     {line}", flush=True)
            undecided.update(done.undecided)
            failed += done.status != 0
    for case, times in undecided.most_common():
        print(f"{times:3} times {case}")
    print(f"{failed} of {arguments.n} failed" + (f"; see {folder}" if failed else ""), flush=True)
    if not failed:
        shutil.rmtree(folder)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
