"""How long a full run takes against an implementation over Ethernet, and whether its verdicts repeat.

    python benchmarks/run_time.py [--runs N] [--load N] [--succession] [--slow MS] [--link-only] [--plan PLAN]

The implementation is `dcp-node run` with beacons every 100 ms, which `dcp-conformance run` tests as it tests a foreign
one: over a virtual Ethernet in a namespace, with ``--start`` and with ``--ut`` on the node's control socket. The table
has the time of each run and its verdicts; after it come the cases whose verdicts differ between the runs.

``--succession`` also runs the cases in succession, with ``--side-by-side 1``. ``--slow`` puts an adapter between
tester and node that delays each answer. ``--load`` keeps processors busy beside. Needs root, or user namespaces.
Exit status 1 if a verdict differs.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from dcp_conformance.reference.namespace import SUT_INTERFACE, TESTER_INTERFACE, Namespace

BIN = Path(sys.executable).parent
ADDRESS = bytes.fromhex("020000000001")
#: A process that uses one processor until its parent has ended.
BUSY = """
import os
parent = os.getppid()
while os.getppid() == parent:
    sum(range(100_000))
"""
#: An adapter between standard input and output and the control socket of the node: one JSON-RPC message a line. Answers
#: are delayed, each after the one before; notifications are not. It waits for a node that has not started yet, and ends
#: with it.
ADAPTER = """
import json, os, queue, socket, sys, threading, time
path, delay = sys.argv[1], float(sys.argv[2]) / 1000
while True:
    link = socket.socket(socket.AF_UNIX)
    try:
        link.connect(path)
        break
    except OSError:
        link.close()
        time.sleep(0.02)
answers, writing = queue.Queue(), threading.Lock()
def write(line):
    with writing:
        sys.stdout.buffer.write(line)
        sys.stdout.buffer.flush()
def calls():
    for line in sys.stdin.buffer:
        link.sendall(line)
    os._exit(0)
def delayed():
    while True:
        line = answers.get()
        time.sleep(delay)
        write(line)
threading.Thread(target=calls, daemon=True).start()
threading.Thread(target=delayed, daemon=True).start()
for line in link.makefile("rb"):
    if "method" in json.loads(line):
        write(line)
    else:
        answers.put(line)
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=1, help="runs side by side (default 1)")
    parser.add_argument("--load", type=int, default=0, help="processes that keep processors busy (default 0)")
    parser.add_argument("--succession", action="store_true", help="also one run in which no two cases run at once")
    parser.add_argument("--slow", type=float, metavar="MS", help="delay of each answer of the upper tester")
    parser.add_argument("--link-only", action="store_true", help="without an upper tester")
    parser.add_argument("--plan", default="full", help="plan of the run (default full)")
    parser.add_argument("cases", nargs="*", help="only these cases")
    arguments = parser.parse_args()
    busy = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(arguments.load)]
    try:
        with tempfile.TemporaryDirectory() as folder:
            return compare(arguments, Path(folder))
    finally:
        for each in busy:
            each.kill()
            each.wait()


def compare(arguments: argparse.Namespace, folder: Path) -> int:
    """Execute the runs, print a line for each, and print the cases whose verdicts differ."""
    kinds = (["in succession"] if arguments.succession else []) + ["side by side"] * arguments.runs
    verdicts: dict[str, list[str]] = {}
    print("run  cases          time     verdicts", flush=True)
    for number, kind in enumerate(kinds, 1):
        seconds, found = run(arguments, folder / str(number), kind)
        for name, verdict in found.items():
            verdicts.setdefault(name, []).append(verdict)
        count = ", ".join(f"{many} {verdict}" for verdict, many in Counter(found.values()).most_common())
        print(f"{number:3}  {kind:13}  {seconds:6.1f} s  {count}", flush=True)
    differ = {name: each for name, each in verdicts.items() if len(set(each)) > 1 or len(each) != len(kinds)}
    for name, each in sorted(differ.items()):
        print(f"     {name}: {', '.join(each)}")
    print(f"{len(differ)} of {len(verdicts)} cases differ between {len(kinds)} runs")
    return 1 if differ else 0


def run(arguments: argparse.Namespace, folder: Path, kind: str) -> tuple[float, dict[str, str]]:
    """Execute one run in a new namespace. Returns its seconds and the verdict of each case."""
    folder.mkdir()
    control, adapter = folder / "control", folder / "adapter.py"
    adapter.write_text(ADAPTER)
    upper = f"unix:{control}"
    if arguments.slow is not None:
        upper = f"exec:{sys.executable} {adapter} {control} {arguments.slow:g}"
    start = (
        f"{BIN / 'dcp-node'} run --interface {SUT_INTERFACE} --control {control} --beacon-period 100 --log-level error"
    )
    command = [
        str(BIN / "dcp-conformance"), "run", "--interface", TESTER_INTERFACE, "--start", start,
        "--beacon-period", "100", "--plan", arguments.plan, "--report-dir", str(folder / "report"), "-q",
        *(() if arguments.link_only else ("--ut", upper)),
        *(("--side-by-side", "1") if kind == "in succession" else ()),
        *arguments.cases,
    ]  # fmt: skip
    network = Namespace(ADDRESS)
    try:
        begun = time.monotonic()
        with network.entered():
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
        output, _ = process.communicate()
        seconds = time.monotonic() - begun
    finally:
        network.close()
    results = folder / "report" / "results.json"
    if not results.exists():
        raise SystemExit(f"the run has no results; its output:\n{output}")
    cases = json.loads(results.read_text())["cases"]
    return seconds, {each["id"]: each["verdict"] for each in cases}


if __name__ == "__main__":
    sys.exit(main())
