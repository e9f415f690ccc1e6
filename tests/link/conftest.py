"""A network of its own for each test: a namespace with two virtual interfaces, ``near`` and ``far``, cabled together.

Nothing here touches an interface of the machine. Without the right to make namespaces the tests are skipped, or fail
where all tools are promised (DCP_REQUIRE_TOOLS=1).
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from dcp_codec.network.namespaces import entered

from ..waiting import PATIENCE, eventually


class Process:
    """A Python process in the namespace; its output is read line by line, with an end to patience."""

    def __init__(self, command: list[str]) -> None:
        self.popen = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
        )
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self._lines.put(line.rstrip("\n"))
        self._lines.put(None)

    def line(self, patience: float = PATIENCE) -> str:
        """The next line; fails the test when the process ends or prints nothing."""
        try:
            found = self._lines.get(timeout=patience)
        except queue.Empty:
            pytest.fail(f"nothing came from the process in {patience} s")
        if found is None:
            _, errors = self.popen.communicate()
            pytest.fail(f"the process ended with {self.popen.returncode}: {errors}")
        return found

    def line_or_none(self, patience: float) -> str | None:
        """The next line, or None if none comes within ``patience`` seconds."""
        try:
            return self._lines.get(timeout=patience)
        except queue.Empty:
            return None

    def say(self, text: str) -> None:
        """Write a line to the process."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(text + "\n")
        self.popen.stdin.flush()

    def end(self) -> None:
        """End the process if it has not ended."""
        if self.popen.poll() is None:
            self.popen.kill()
        self.popen.wait(PATIENCE)
        self._thread.join(PATIENCE)
        for stream in (self.popen.stdin, self.popen.stdout, self.popen.stderr):
            if stream is not None:
                stream.close()


class Namespace:
    """A network namespace with a virtual cable in it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._processes: list[Process] = []

    def ip(self, *arguments: str) -> None:
        """Run ``ip`` in the namespace."""
        done = subprocess.run(["ip", "-n", self.name, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"ip {' '.join(arguments)}: {done.stderr}"

    def cable(self) -> None:
        """Make the interfaces ``near`` and ``far``, up and silent."""
        self.ip("link", "add", "near", "type", "veth", "peer", "name", "far")
        for interface in ("near", "far"):
            # Without an address the kernel has nothing to say on the interface by itself.
            self.ip("link", "set", interface, "addrgenmode", "none")
            self.ip("link", "set", interface, "up")
        self.wait_for_carrier()

    def links(self) -> dict[str, dict[str, Any]]:
        """Interfaces that are up, by name, as ``ip`` reports them."""
        shown = subprocess.run(
            ["ip", "-n", self.name, "-json", "-stats", "link", "show", "up"], capture_output=True, text=True, check=True
        ).stdout
        # Interfaces that are down leave an empty entry.
        return {each["ifname"]: each for each in json.loads(shown) if each}

    def wait_for_carrier(self, *interfaces: str) -> None:
        """Wait until frames can pass, which is a little later than the kernel says that there is a carrier."""

        def up() -> bool:
            links = self.links()
            return all(links.get(each, {}).get("operstate") == "UP" for each in interfaces or ("near", "far"))

        eventually(up, "the virtual cable comes up")

    def lost_on_the_cable(self) -> int:
        """Frames that the cable has dropped: on a busy machine its queue of some hundred is not emptied in time."""
        counted = [self.links()[each]["stats64"] for each in ("near", "far")]
        return sum(each["tx"]["dropped"] + each["rx"]["dropped"] for each in counted)

    def python(self, code: str, *arguments: str) -> Process:
        """Start Python in the namespace."""
        process = Process(["ip", "netns", "exec", self.name, sys.executable, "-u", "-c", code, *arguments])
        self._processes.append(process)
        return process

    def end(self) -> None:
        """End all processes and delete the namespace with its interfaces."""
        for process in self._processes:
            process.end()
        subprocess.run(["ip", "netns", "delete", self.name], capture_output=True, check=False)


@pytest.fixture
def namespace() -> Iterator[Namespace]:
    """A namespace with a cable, deleted afterwards."""
    # The number of a process may be that of an earlier one whose namespace remained.
    name = f"dcptest-{os.getpid()}-{time.monotonic_ns()}"
    done = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        message = f"network namespaces cannot be made here ({done.stderr.strip()}): run as root (CAP_NET_ADMIN)"
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)
    made = Namespace(name)
    try:
        made.cable()
        yield made
    finally:
        made.end()


@pytest.fixture
def inside(namespace: Namespace) -> Iterator[Namespace]:
    """This thread is inside of the namespace."""
    with entered(namespace.name):
        yield namespace
