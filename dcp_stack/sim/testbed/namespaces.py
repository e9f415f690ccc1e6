"""Network namespaces that never stay behind: each carries in its name which process made it.

A name is ``dcptb-PID-STARTED-LABEL``; STARTED is when the process began, so that a number used again is no excuse.
Everything is done by the ``ip`` of iproute2. Interfaces are made inside of the namespaces only, and go with them.
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
#: Seconds that a command of the system may take.
PATIENCE = 30.0
_NAME = re.compile(rf"({PREFIX}-(\d+)-(\d+))-\w+")


class NamespaceError(Exception):
    """The system refused something; the message says which command and why."""


def own_prefix() -> str:
    """What the names of all namespaces of this process begin with."""
    pid = os.getpid()
    return f"{PREFIX}-{pid}-{_started(pid)}"


def run(command: Sequence[str], given: str = "") -> str:
    """The output of a command; raises :class:`NamespaceError` if it fails or hangs."""
    try:
        done = subprocess.run(  # noqa: S603 - commands of ours, without a shell
            command, input=given, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    except FileNotFoundError:
        raise NamespaceError(f"{command[0]} is not installed (Debian: iproute2 and util-linux)") from None
    except subprocess.TimeoutExpired:
        raise NamespaceError(f"{' '.join(command)}: no end in {PATIENCE:g} s") from None
    if done.returncode:
        raise NamespaceError(f"{' '.join(command)}: {done.stderr.strip() or f'exit status {done.returncode}'}")
    return done.stdout


def batch(program: str, namespace: str, lines: Iterable[str]) -> None:
    """Many commands of ``ip``, ``bridge`` or ``tc`` in one namespace by one process, which is what makes it quick."""
    text = "".join(f"{line}\n" for line in lines)
    if text:
        run([program, "-n", namespace, "-batch", "-"], text)


def create(names: Iterable[str]) -> None:
    """Make namespaces, with their loopback interfaces down."""
    text = "".join(f"netns add {name}\n" for name in names)
    run(["ip", "-batch", "-"], text)


def existing(prefix: str = PREFIX) -> list[str]:
    """The namespaces of testbeds whose names begin like this."""
    found = (line.split()[0] for line in run(["ip", "netns", "list"]).splitlines() if line.strip())
    return [name for name in found if name.startswith(f"{prefix}-") and _NAME.fullmatch(name)]


def delete(names: Iterable[str]) -> None:
    """Delete namespaces with all interfaces in them, and end the processes that are still inside."""
    names = list(names)
    for number in (signal.SIGTERM, signal.SIGKILL):
        inside = [pid for name in names for pid in _pids(name)]
        if not inside:
            break
        for pid in inside:
            _kill(pid, number)
        _wait_until_gone(inside, 3.0)
    for name in names:
        # Another process may delete it as well, also between the look and the command.
        if Path("/run/netns", name).exists():
            try:
                run(["ip", "netns", "delete", name])
            except NamespaceError:
                if Path("/run/netns", name).exists():
                    raise


def sweep() -> list[str]:
    """Delete what testbeds left behind that did not live to do it themselves; the names of those."""
    left = [name for name in existing() if not _maker_lives(name)]
    delete(left)
    return left


def permitted() -> bool:
    """Whether this process may make network namespaces."""
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
    """What to put in front of a command to run it in a namespace."""
    # Not "ip netns exec", which mounts another /sys and may not do so in a user namespace.
    return [shutil.which("nsenter") or "nsenter", f"--net=/run/netns/{name}", "--"]


def _maker_lives(name: str) -> bool:
    match = _NAME.fullmatch(name)
    return match is not None and _started(int(match[2])) == int(match[3])


def _started(pid: int) -> int:
    """When a process began, in ticks since the machine did; -1 if there is none."""
    return int(_stat(pid)[19])


def _stat(pid: int) -> list[str]:
    """The fields of /proc/PID/stat from the state on (proc(5)); those of an ended process if there is none."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return ["X", *["-1"] * 49]
    # The name of the program, in parentheses, may hold anything.
    return stat.rpartition(")")[2].split()


def _pids(name: str) -> list[int]:
    try:
        return [int(pid) for pid in run(["ip", "netns", "pids", name]).split()]
    except NamespaceError:
        return []


def _kill(pid: int, number: signal.Signals) -> None:
    try:
        os.kill(pid, number)
    except OSError:
        return


def _wait_until_gone(pids: Iterable[int], patience: float) -> None:
    deadline = time.monotonic() + patience
    while time.monotonic() < deadline and any(_running(pid) for pid in pids):
        time.sleep(0.02)


def _running(pid: int) -> bool:
    return _stat(pid)[0] not in ("Z", "X")
