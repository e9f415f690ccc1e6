"""Run `make test` in fresh clones of the committed tree, in succession, and print a table of the results.

``make test-repeat N=10 LOAD=2`` makes ten clones, with two processes beside that keep processors busy. A clone whose
tests fail is kept, with the output of `make test` beside it; the others are removed. Exit status 1 if any failed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
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


@contextmanager
def load(number: int, seconds: float) -> Iterator[None]:
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
    inner = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MAKEOVERRIDES", "VIRTUAL_ENV", "N", "LOAD")
    return {name: value for name, value in os.environ.items() if name not in inner}


def run(clone: Path, log: Path) -> tuple[int, str]:
    """Clone, run `make test`, and return its exit status and the summaries of pytest."""
    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
    with log.open("wb") as output:
        process = subprocess.Popen(
            ["make", "test"], cwd=clone, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            env=environment(), start_new_session=True,
        )  # fmt: skip
        try:
            status = process.wait(LONGEST)
        except BaseException as error:
            # make alone would leave the tests running.
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            return 124, f"not over after {LONGEST:g} s"
    return status, "; ".join(_SUMMARY.findall(log.read_text(errors="replace"))) or "no tests were run"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=10, help="number of clones (default 10)")
    parser.add_argument("--load", type=int, default=0, help="processes that keep processors busy (default 0)")
    arguments = parser.parse_args()
    if subprocess.run(["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, check=True).stdout:
        print("only what is committed is cloned; there are changes that are not", file=sys.stderr)
    folder = Path(tempfile.mkdtemp(prefix="make-test-repeat-"))
    failed = 0
    print(f"{arguments.n} clones in {folder}, {arguments.load} busy processes", flush=True)
    print("run  result  time     tests", flush=True)
    for number in range(1, arguments.n + 1):
        clone, log = folder / f"clone{number}", folder / f"clone{number}.log"
        begun = time.monotonic()
        with load(arguments.load, LONGEST + 60):
            status, summary = run(clone, log)
        minutes, seconds = divmod(round(time.monotonic() - begun), 60)
        verdict = "ok" if status == 0 else f"{status}"
        print(f"{number:3}  {verdict:6}  {minutes:2}:{seconds:02} min  {summary}", flush=True)
        if status:
            failed += 1
            for line in log.read_text(errors="replace").splitlines():
                if line.startswith(("FAILED", "ERROR", "make: ***")):
                    print(f"     {line}", flush=True)
        else:
            shutil.rmtree(clone)
    print(f"{failed} of {arguments.n} failed" + (f"; see {folder}" if failed else ""), flush=True)
    if not failed:
        shutil.rmtree(folder)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
