"""A network namespace with a virtual Ethernet for one run. It disappears with the last process that uses it.

Root makes it beside the own one and enters it for moments only. Others need a user namespace for it, from which there
is no way back: for them the rest of the run is in there. Linux only; nothing on the machine is changed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from dcp_codec.network.namespaces import (
    CLONE_NEWNET,
    CLONE_NEWUSER,
    OWN,
    NamespaceError,
    batch,
    entered,
    returning,
    unshare,
)

SUT_INTERFACE, TESTER_INTERFACE = "dcp-sut", "dcp-tester"


class Namespace:
    """A network namespace with the interfaces ``SUT_INTERFACE`` and ``TESTER_INTERFACE``, cabled together."""

    def __init__(self, sut_address: bytes) -> None:
        """``sut_address`` is the address of the implementation's interface. Raises :class:`NamespaceError`."""
        if not hasattr(os, "fork") or not Path("/proc/self/ns/net").exists():
            raise NamespaceError("this system has no network namespaces")
        if shutil.which("ip") is None:
            raise NamespaceError("the command ip is not installed (Debian: iproute2)")
        alone = os.geteuid() != 0
        if alone and len(list(Path("/proc/self/task").iterdir())) > 1:
            raise NamespaceError("only root can make a network namespace in a process with several threads")
        self._inside = -1
        """The namespace; -1: this process is in it, since there is no way back from a user namespace."""
        uid, gid = os.geteuid(), os.getegid()
        with contextlib.nullcontext() if alone else returning():
            unshare(CLONE_NEWNET | (CLONE_NEWUSER if alone else 0))
            if alone:
                self._be_root(uid, gid)
            self._cable(sut_address)
            if not alone:
                self._inside = os.open(OWN, os.O_RDONLY | os.O_CLOEXEC)

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
        with contextlib.nullcontext() if self._inside < 0 else entered(f"/proc/self/fd/{self._inside}"):
            yield

    def close(self) -> None:
        """Let go of it; it ends with the last process and socket in it."""
        if self._inside >= 0:
            os.close(self._inside)
        self._inside = -1


def _ip(lines: list[str], what: str) -> None:
    """Carry out commands of ``ip``. Raises :class:`NamespaceError`, which says ``what`` has failed."""
    try:
        batch("ip", "", lines)
    except NamespaceError as error:
        raise NamespaceError(f"{what}: {str(error).splitlines()[0]}") from None
