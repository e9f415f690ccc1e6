"""Build the example node in C with sanitizers and run the suite against it, in a network namespace of its own.

    python -m tests.ccodec.suite [OPTION OF dcp-conformance run]...

Exit status: that of ``dcp-conformance run``, but 0 also if cases are inconclusive, as on a busy machine. Without rights
for a namespace or without a compiler nothing is run; that is a failure if DCP_REQUIRE_TOOLS is 1.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parent.parent.parent / "examples" / "c-node"
BIN = Path(sys.executable).parent
#: Exit status of ``dcp-conformance run``: nothing fails, but something is inconclusive.
INCONCLUSIVE = 3
RUN = """
ip link add sut type veth peer name tester
ip link set lo up; ip link set sut up; ip link set tester up
exec "$0" run --interface tester --pics c-node.pics.toml --ut unix:ut.sock \\
    --start './c-node -i sut -c ut.sock' --report-dir report "$@"
"""


def build(folder: Path, target: str) -> str:
    """Build the node in ``folder``; return what the compiler says. Raises CalledProcessError if it fails."""
    for name in ("Makefile", "node.c", "node.h", "upper_tester.c", "upper_tester.h", "main.c", "c-node.pics.toml"):
        shutil.copy(EXAMPLE / name, folder)
    command = ["make", target, f"DCP={BIN / 'dcp-codec'}"]
    return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stderr


def command(options: Sequence[str]) -> list[str]:
    """Return the command that runs the suite against the node in the current folder."""
    return ["unshare", "--net", "sh", "-c", RUN, str(BIN / "dcp-conformance"), *options]


def main() -> int:
    missing = [name for name in ("unshare", "ip", "make", "cc") if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        print(f"skipped: the suite against the node in C needs {', '.join(missing) or 'root'}", file=sys.stderr)
        return int(os.environ.get("DCP_REQUIRE_TOOLS") == "1")
    with tempfile.TemporaryDirectory() as folder:
        print(build(Path(folder), "sanitize"), end="")
        status = subprocess.run(command(sys.argv[1:]), cwd=folder, check=False).returncode
        return 0 if status == INCONCLUSIVE else status


if __name__ == "__main__":
    sys.exit(main())
