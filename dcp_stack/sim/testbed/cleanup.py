"""``python -m dcp_stack.sim.testbed.cleanup PREFIX [DIRECTORY]``: clean up after a testbed.

Waits for the end of its input, which comes when the testbed lets go of the other end of the pipe: also if it was
killed. Then the namespaces with this prefix go, with all processes and interfaces in them, and the directory.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys

from .namespaces import PATIENCE, NamespaceError, delete, existing


class Janitor:
    """The janitor of this process."""

    def __init__(self, prefix: str, directory: str | None = None) -> None:
        """``directory`` is removed, too, in the end."""
        command = [sys.executable, "-m", "dcp_stack.sim.testbed.cleanup", prefix, *([directory] if directory else [])]
        # In a session of its own: what ends the testbed from the terminal must not end who cleans up behind it.
        self._process = subprocess.Popen(  # noqa: S603 - our own module
            command, stdin=subprocess.PIPE, start_new_session=True
        )

    def finish(self) -> None:
        """Let it do its work, and wait until it is done."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def main(prefix: str, directory: str | None = None) -> int:
    """Wait, then clean up."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sys.stdin.buffer.read()
    try:
        delete(existing(prefix))
    except NamespaceError as error:
        sys.stderr.write(f"dcp-node: the testbed could not be removed: {error}\n")
        return 1
    finally:
        if directory is not None:
            shutil.rmtree(directory, ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
