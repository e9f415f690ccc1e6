"""Network namespaces: entering them, and commands of the system (iproute2, util-linux) in them."""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

#: Maximum time in s for a command of the system.
PATIENCE = 30.0
# Of <linux/sched.h>.
CLONE_NEWUSER, CLONE_NEWNET, CLONE_NEWIPC, CLONE_NEWNS = 0x10000000, 0x40000000, 0x08000000, 0x00020000
#: The namespace of this thread.
OWN = "/proc/thread-self/ns/net"


class NamespaceError(Exception):
    """The system refuses a namespace, or a command failed; the message has the command and the reason."""


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
    """Run commands of ``ip``, ``bridge`` or ``tc`` by one process, which is faster than one for each.

    ``namespace``: the name of that in which they are run; empty: that of this thread. Raises :class:`NamespaceError`.
    """
    text = "".join(f"{line}\n" for line in lines)
    if text:
        run([program, *(["-n", namespace] if namespace else []), "-batch", "-"], text)


def enter_command(name: str) -> list[str]:
    """Return the arguments that precede a command to run it in a namespace."""
    # "ip netns exec" mounts another /sys, which is not permitted in a user namespace.
    return [shutil.which("nsenter") or "nsenter", f"--net=/run/netns/{name}", "--"]


def unshare(flags: int) -> None:
    """Move this thread into new namespaces. Raises :class:`NamespaceError`."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(flags):
        reason = os.strerror(ctypes.get_errno())
        raise NamespaceError(f"a namespace cannot be made here ({reason}); as root it can")


@contextlib.contextmanager
def returning() -> Iterator[None]:
    """Return at the end of the block to the network namespace of its begin. Raises :class:`NamespaceError`."""
    with Path(OWN).open("rb") as outside:
        try:
            yield
        finally:
            _enter(outside)


@contextlib.contextmanager
def entered(namespace: str) -> Iterator[None]:
    """Enter a network namespace: sockets and processes that are created within the block stay in it.

    ``namespace``: its name, or the path of a descriptor. Raises :class:`NamespaceError`, ``OSError`` if there is none.
    """
    with Path("/run/netns", namespace).open("rb") as inside, returning():
        _enter(inside)
        yield


def _enter(namespace: IO[bytes]) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.setns(namespace.fileno(), CLONE_NEWNET):
        raise NamespaceError(f"a network namespace cannot be entered ({os.strerror(ctypes.get_errno())})")
