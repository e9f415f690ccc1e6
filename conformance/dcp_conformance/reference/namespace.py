"""A network namespace with a virtual Ethernet for one run. It disappears with the last process that uses it.

Root makes it beside the own one and enters it for moments only. Others need a user namespace for it, from which there
is no way back: for them the rest of the run is in there. Linux only; nothing on the machine is changed.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

SUT_INTERFACE, TESTER_INTERFACE = "dcp-sut", "dcp-tester"

# Of <linux/sched.h>.
_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000
#: Seconds that a command of the system may take.
_PATIENCE = 30.0


class NamespaceError(Exception):
    """There can be no such network here; the message is the reason."""


class Namespace:
    """A network namespace with the interfaces ``SUT_INTERFACE`` and ``TESTER_INTERFACE``, cabled together."""

    def __init__(self, sut_address: bytes) -> None:
        """``sut_address`` is the address of the implementation's interface. Raises :class:`NamespaceError`."""
        if not hasattr(os, "fork") or not Path("/proc/self/ns/net").exists():
            raise NamespaceError("this system has no network namespaces")
        if shutil.which("ip") is None:
            raise NamespaceError("the command ip is not installed (Debian: iproute2)")
        self._outside = os.open("/proc/self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
        self._inside = -1
        self._libc = ctypes.CDLL(None, use_errno=True)
        try:
            self._make(sut_address)
        except BaseException:
            self.close()
            raise

    def _make(self, sut_address: bytes) -> None:
        alone = os.geteuid() != 0
        if alone and len(list(Path("/proc/self/task").iterdir())) > 1:
            raise NamespaceError("only root can make a network namespace in a process with several threads")
        uid, gid = os.geteuid(), os.getegid()
        self._unshare(_CLONE_NEWNET | (_CLONE_NEWUSER if alone else 0))
        self._inside = os.open("/proc/self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
        try:
            if alone:
                self._be_root(uid, gid)
            self._cable(sut_address)
        finally:
            # From a user namespace there is no way back.
            if not alone:
                self._enter(self._outside)
        if alone:
            os.close(self._outside)
            self._outside = -1

    def _be_root(self, uid: int, gid: int) -> None:
        """Be root in the user namespace, so that programs started from here keep its rights."""
        try:
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/uid_map").write_text(f"0 {uid} 1")
            Path("/proc/self/gid_map").write_text(f"0 {gid} 1")
        except OSError as error:
            raise NamespaceError(f"the user namespace has no users ({error.strerror})") from None

    def _cable(self, sut_address: bytes) -> None:
        lines = [f"link add {SUT_INTERFACE} address {sut_address.hex(':')} type veth peer name {TESTER_INTERFACE}"]
        for name in (SUT_INTERFACE, TESTER_INTERFACE):
            # Without an address the kernel has nothing to say on the interface by itself.
            lines += [f"link set {name} addrgenmode none", f"link set {name} up"]
        _ip(lines, "a virtual cable cannot be made")

    def switch(self, up: bool) -> None:
        """Take the implementation's interface up or down. Raises :class:`NamespaceError`."""
        with self.entered():
            _ip([f"link set {SUT_INTERFACE} {'up' if up else 'down'}"], "the interface cannot be switched")

    @contextlib.contextmanager
    def entered(self) -> Iterator[None]:
        """Enter the namespace: sockets and processes that are made inside the block stay in it."""
        if self._outside < 0:
            yield
            return
        self._enter(self._inside)
        try:
            yield
        finally:
            self._enter(self._outside)

    def close(self) -> None:
        """Let go of it; it ends with the last process and socket in it."""
        for descriptor in (self._inside, self._outside):
            if descriptor >= 0:
                os.close(descriptor)
        self._inside = self._outside = -1

    def _unshare(self, flags: int) -> None:
        if self._libc.unshare(flags):
            reason = os.strerror(ctypes.get_errno())
            raise NamespaceError(f"a network namespace cannot be made here ({reason}); as root it can")

    def _enter(self, descriptor: int) -> None:
        if self._libc.setns(descriptor, _CLONE_NEWNET):
            raise NamespaceError(f"a network namespace cannot be entered ({os.strerror(ctypes.get_errno())})")


def _ip(lines: list[str], what: str) -> None:
    """Carry out commands of ``ip``. Raises :class:`NamespaceError`, which says ``what`` has failed."""
    try:
        done = subprocess.run(
            ["ip", "-batch", "-"],  # noqa: S607 - wherever the system has it
            input="".join(f"{line}\n" for line in lines),
            capture_output=True,
            text=True,
            check=False,
            timeout=_PATIENCE,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NamespaceError(f"ip cannot be run: {error}") from None
    if done.returncode:
        raise NamespaceError(f"{what}: {done.stderr.strip().splitlines()[0]}")
