"""Build the example node in C and run the suite against it, in a network namespace of its own.

python -m tests.ccodec.suite [OPTION OF dcp-conformance run]...
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parent.parent.parent / "examples" / "c-node"
BIN = Path(sys.executable).parent
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
    with tempfile.TemporaryDirectory() as folder:
        print(build(Path(folder), "c-node"), end="")
        return subprocess.run(command(sys.argv[1:]), cwd=folder, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
