"""``python -m dcp_lab.sim.testbed.cleanup PREFIX [DIRECTORY]``: remove what a testbed leaves on the machine.

The process waits for the end of its input: the testbed closes the other end of the pipe, and the kernel does if the
testbed is killed. Then it removes the namespaces with this prefix, with all processes and interfaces in them, and the
directory.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys

from dcp_codec.network.namespaces import PATIENCE, NamespaceError

from .namespaces import delete, existing


class CleanupProcess:
    """The process that cleans up after the testbed of this process."""

    def __init__(self, prefix: str, directory: str | None = None) -> None:
        """Start the process. It removes the namespaces with ``prefix``, and ``directory`` if given."""
        command = [sys.executable, "-m", "dcp_lab.sim.testbed.cleanup", prefix, *([directory] if directory else [])]
        # In its own session, so that signals from the terminal end the testbed but not this process.
        self._process = subprocess.Popen(  # noqa: S603 - our own module
            command, stdin=subprocess.PIPE, start_new_session=True
        )

    def finish(self) -> None:
        """Start the clean-up, and wait until it is complete, at most ``PATIENCE`` s."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def main(prefix: str, directory: str | None = None) -> int:
    """Wait for the end of input, then clean up; returns the exit status."""
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
