"""Network namespaces of testbeds. Their names identify the process that created them, so none is left for ever.

A name is ``dcptb-PID-STARTED-LABEL``. STARTED is the start time of the process, because process numbers are reused.
All functions use ``ip`` of iproute2. Interfaces exist only inside the namespaces, and are removed with them.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable
from pathlib import Path

from dcp_codec.common.processes import Held, end_all, started_at
from dcp_codec.network.namespaces import NamespaceError, batch, run

PREFIX = "dcptb"
#: Maximum time in s from SIGTERM to SIGKILL for processes in a namespace that is deleted.
_END = 3.0
_NAME = re.compile(rf"({PREFIX}-(\d+)-(\d+))-\w+")


def own_prefix() -> str:
    """Return the prefix of the names of all namespaces of this process."""
    pid = os.getpid()
    return f"{PREFIX}-{pid}-{started_at(pid)}"


def create(names: Iterable[str]) -> None:
    """Create namespaces, with their loopback interfaces down."""
    batch("ip", "", [f"netns add {name}" for name in names])


def existing(prefix: str = PREFIX) -> list[str]:
    """Return the names of testbed namespaces with this prefix."""
    found = (line.split()[0] for line in run(["ip", "netns", "list"]).splitlines() if line.strip())
    return [name for name in found if name.startswith(f"{prefix}-") and _NAME.fullmatch(name)]


def delete(names: Iterable[str]) -> None:
    """End all processes in namespaces, and delete the namespaces with their interfaces."""
    names = list(names)
    end_all(lambda: _inside(names), _END)
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


def _maker_lives(name: str) -> bool:
    """Return whether the process that created a namespace still runs."""
    match = _NAME.fullmatch(name)
    return match is not None and started_at(int(match[2])) == int(match[3])


def _inside(names: Iterable[str]) -> list[Held]:
    """Return the processes in namespaces."""
    spaces = {_identity(Path("/run/netns", name)) for name in names} - {None}
    found = []
    for path in Path("/proc").glob("[0-9]*/ns/net"):
        if _identity(path) in spaces:
            with contextlib.suppress(ProcessLookupError):
                found.append(Held(int(path.parts[2])))
    return found


def _identity(namespace: Path) -> tuple[int, int] | None:
    """Return what is unique to a namespace; None if it does not exist, or belongs to another user."""
    try:
        status = namespace.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
