"""Network namespaces of testbeds. Their names identify the process that created them, so none is left for ever.

A name is ``dcptb-PID-STARTED-LABEL``. STARTED is the start time of the process, because process numbers are reused.
All functions use ``ip`` of iproute2. Interfaces exist only inside the namespaces, and are removed with them.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

PREFIX = "dcptb"
#: Maximum time in s for a command of the system.
PATIENCE = 30.0
_NAME = re.compile(rf"({PREFIX}-(\d+)-(\d+))-\w+")


class NamespaceError(Exception):
    """A command of the system failed; the message has the command and the reason."""


def own_prefix() -> str:
    """Return the prefix of the names of all namespaces of this process."""
    pid = os.getpid()
    return f"{PREFIX}-{pid}-{_started(pid)}"


def run(command: Sequence[str], given: str = "") -> str:
    """Run a command with the input ``given``, and return its output.

    Raises :class:`NamespaceError` if it is not installed, fails, or takes more than ``PATIENCE`` s.
    """
    try:
        done = subprocess.run(  # noqa: S603 - commands of ours, without a shell
            command, input=given, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    except FileNotFoundError:
        raise NamespaceError(f"{command[0]} is not installed (Debian: iproute2 and util-linux)") from None
    except subprocess.TimeoutExpired:
        raise NamespaceError(f"{' '.join(command)}: did not end within {PATIENCE:g} s") from None
    if done.returncode:
        raise NamespaceError(f"{' '.join(command)}: {done.stderr.strip() or f'exit status {done.returncode}'}")
    return done.stdout


def batch(program: str, namespace: str, lines: Iterable[str]) -> None:
    """Run commands of ``ip``, ``bridge`` or ``tc`` in one namespace by one process, which is faster than one each."""
    text = "".join(f"{line}\n" for line in lines)
    if text:
        run([program, "-n", namespace, "-batch", "-"], text)


def create(names: Iterable[str]) -> None:
    """Create namespaces, with their loopback interfaces down."""
    text = "".join(f"netns add {name}\n" for name in names)
    run(["ip", "-batch", "-"], text)


def existing(prefix: str = PREFIX) -> list[str]:
    """Return the names of testbed namespaces with this prefix."""
    found = (line.split()[0] for line in run(["ip", "netns", "list"]).splitlines() if line.strip())
    return [name for name in found if name.startswith(f"{prefix}-") and _NAME.fullmatch(name)]


def delete(names: Iterable[str]) -> None:
    """End all processes in namespaces, and delete the namespaces with their interfaces."""
    names = list(names)
    for number in (signal.SIGTERM, signal.SIGKILL):
        inside = [pid for name in names for pid in _pids(name)]
        if not inside:
            break
        for pid in inside:
            _kill(pid, number)
        _wait_until_gone(inside, 3.0)
    for name in names:
        # Another process may delete it concurrently, even between the check and the command.
        if Path("/run/netns", name).exists():
            try:
                run(["ip", "netns", "delete", name])
            except NamespaceError:
                if Path("/run/netns", name).exists():
                    raise


def sweep() -> list[str]:
    """Delete the namespaces of processes that have ended without doing so; returns their names."""
    left = [name for name in existing() if not _maker_lives(name)]
    delete(left)
    return left


def permitted() -> bool:
    """Return whether this process may create network namespaces."""
    name = f"{own_prefix()}-probe"
    try:
        create([name])
        run(["ip", "-n", name, "link", "add", "one", "type", "veth", "peer", "name", "two"])
    except NamespaceError:
        return False
    finally:
        if Path("/run/netns", name).exists():
            run(["ip", "netns", "delete", name])
    return True


def enter_command(name: str) -> list[str]:
    """Return the arguments that precede a command to run it in a namespace."""
    # "ip netns exec" mounts another /sys, which is not permitted in a user namespace.
    return [shutil.which("nsenter") or "nsenter", f"--net=/run/netns/{name}", "--"]


def _maker_lives(name: str) -> bool:
    """Return whether the process that created a namespace still runs."""
    match = _NAME.fullmatch(name)
    return match is not None and _started(int(match[2])) == int(match[3])


def _started(pid: int) -> int:
    """Return the start time of a process in clock ticks since boot, -1 if it does not exist."""
    return int(_stat(pid)[19])


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat from the state on (proc(5)).

    For a process that does not exist the state is ``X`` (dead) and the other fields are -1.
    """
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ["X", *["-1"] * 49]
    # The name of the program, in parentheses, may contain any character.
    return stat.rpartition(")")[2].split()


def _pids(name: str) -> list[int]:
    """Return the processes in a namespace; an empty list if it does not exist."""
    try:
        return [int(pid) for pid in run(["ip", "netns", "pids", name]).split()]
    except NamespaceError:
        return []


def _kill(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process, if it exists."""
    try:
        os.kill(pid, number)
    except OSError:
        return


def _wait_until_gone(pids: Iterable[int], patience: float) -> None:
    """Wait until all processes have ended, at most ``patience`` s."""
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline and any(_running(pid) for pid in pids):
        time.sleep(0.02)


def _running(pid: int) -> bool:
    """Return whether a process exists and is not a zombie."""
    return _stat(pid)[0] not in ("Z", "X")
