"""Run the tests with new random seeds, round after round, until a time is over or a test fails.

Each round has a seed, which decides what Hypothesis draws, the order of the tests and the hashes of texts. The first
round runs all tests except those in real time (part `links`); later rounds run those that draw examples, as the others
would do the same again. What the failing round printed is kept in a file, and the command that
runs it again is printed: it needs no other state.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"
#: Where the output of a round that failed is kept.
KEPT = ROOT / "fresh-failure.log"
_LAST = re.compile(r"^=*\s*(\d+ (?:passed|failed|error).* in [\d.]+s.*?)\s*=*$", re.MULTILINE)


def drawing() -> list[str]:
    """The test modules that use Hypothesis, directly or by a module of their folder."""
    return sorted(
        str(path.relative_to(ROOT))
        for path in TESTS.rglob("test_*.py")
        if re.search(r"^(from|import) hypothesis|^from \.beacons", path.read_text(encoding="utf-8"), re.MULTILINE)
    )


def command_of(seed: int, examples: int, tests: list[str]) -> tuple[dict[str, str], list[str]]:
    """Variables and command of a round."""
    variables = {
        "HYPOTHESIS_PROFILE": "fresh",
        "DCP_EXAMPLES": str(examples),
        "PYTHONHASHSEED": str(seed),
    }
    pytest = [str(Path(sys.executable).parent / "pytest"), "-q", "-x", "-n", "auto", "-p", "no:cacheprovider"]
    pytest += [f"--part={part}" for part in ("core", "suite", "tools", "tables")]
    return variables, [*pytest, f"--hypothesis-seed={seed}", f"--shuffle={seed}", *tests]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=3600, help="begin no round later than this (default 3600)")
    parser.add_argument("--examples", type=int, default=5, help="times the usual number of examples (default 5)")
    parser.add_argument("--seed", type=int, help="seed of the first round, below 2**32 (default: random)")
    parser.add_argument("--all", action="store_true", help="run all tests in each round")
    parser.add_argument("tests", nargs="*", help="only these files and folders, in each round")
    arguments = parser.parse_args()
    seed = random.SystemRandom().randrange(2**32) if arguments.seed is None else arguments.seed
    chance = random.Random(seed)
    begun = time.monotonic()
    rounds = 0
    while rounds == 0 or time.monotonic() < begun + arguments.seconds:
        rounds += 1
        tests = arguments.tests or ([] if rounds == 1 or arguments.all else drawing())
        variables, command = command_of(seed, arguments.examples, tests)
        print(f"round {rounds}, seed {seed}: ", end="", flush=True)
        done = subprocess.run(
            command, cwd=ROOT, env={**os.environ, **variables}, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True, errors="replace", check=False,
        )  # fmt: skip
        print("; ".join(_LAST.findall(done.stdout)) or f"exit status {done.returncode}", flush=True)
        if done.returncode:
            again = " ".join(f"{name}={value}" for name, value in variables.items())
            said = f"To run this round again:\n  cd {shlex.quote(str(ROOT))} && {again} {shlex.join(command)}\n"
            failed = re.findall(r"^(?:FAILED|ERROR) (\S+::.*?)(?: - .*)?$", done.stdout, re.MULTILINE)
            if failed:
                alone = [each for each in command if each not in tests and each not in ("-n", "auto")]
                said += f"The failed tests alone:\n  {again} {shlex.join([*alone, *failed])}\n"
            KEPT.write_text(done.stdout + said, encoding="utf-8")
            print(f"{done.stdout[-6000:]}\n{said}All of the output is in {KEPT}", flush=True)
            return 1
        seed = chance.randrange(2**32)
    print(f"{rounds} rounds in {time.monotonic() - begun:.0f} s without a failure", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
