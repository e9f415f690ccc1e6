"""Copies of an implementation on this machine, each alone with what its programs share: links, /tmp, shared memory.

The process of a worker moves into network, IPC and mount namespaces of its own, and everything that it starts is in
them. They disappear with the last process in them. Linux only, root only; nothing on the machine is changed.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

from dcp_codec.network.namespaces import CLONE_NEWIPC, CLONE_NEWNET, CLONE_NEWNS, NamespaceError, batch, run, unshare
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.target import TargetOptions

_SHARED_MEMORY = "/dev/shm"  # noqa: S108 - it is mounted, not written to
_TEMPORARY = "/tmp"  # noqa: S108 - as above


class Cable(NamedTuple):
    """A pair of virtual Ethernet interfaces: the tester's, and that of the implementation."""

    tester: str
    tester_address: str
    sut: str
    sut_address: str
    mtu: int


def cable_of(options: TargetOptions) -> Cable:
    """Return the cable that has a counterpart for each copy of the implementation.

    Raises :class:`UsageError` if the options or this machine do not permit copies.
    """
    if options.start is None or options.interface is None or options.pid is not None:
        raise UsageError("--jobs: only an implementation that --start starts at --interface can run several times")
    if os.geteuid() != 0:
        raise UsageError("--jobs: only root can make the namespaces in which copies of the implementation are tested")
    name = options.interface
    try:
        tester = _shown(name)
        if tester.get("linkinfo", {}).get("info_kind") != "veth" or "link" not in tester:
            raise UsageError(
                f"--jobs: {name} is not one of two virtual interfaces in this namespace, so that it cannot be copied: "
                "use --jobs 1, or make a pair: ip link add dcp-sut type veth peer name dcp-tester"
            )
        sut = _shown(tester["link"])
    except NamespaceError as error:
        raise UsageError(f"--jobs: {error}") from None
    return Cable(name, tester["address"], sut["ifname"], sut["address"], tester["mtu"])


def enter(cable: Cable, shared: Path | None) -> None:
    """Move this process into namespaces of its own in which the cable is new, and /tmp and /dev/shm are private.

    Files in /tmp can be read as before. ``shared``: a folder in which changes are not private. Raises
    :class:`NamespaceError`.
    """
    unshare(CLONE_NEWNET | CLONE_NEWIPC | CLONE_NEWNS)
    run(["mount", "--make-rprivate", "/"])
    kept = -1 if shared is None else os.open(shared, os.O_PATH | os.O_CLOEXEC)
    run(["mount", "-t", "tmpfs", "tmpfs", _SHARED_MEMORY])
    changed, work = f"{_SHARED_MEMORY}/changed", f"{_SHARED_MEMORY}/work"
    for each in (changed, work):
        Path(each).mkdir()
    where = f"lowerdir={_TEMPORARY},upperdir={changed},workdir={work}"
    run(["mount", "-t", "overlay", "overlay", "-o", where, _TEMPORARY])
    if shared is not None:
        # The link of the descriptor leads to the folder below the overlay, its path to that in it.
        run(["mount", "--no-canonicalize", "--bind", f"/proc/{os.getpid()}/fd/{kept}", str(shared.resolve())])
        os.close(kept)
    # The overlay keeps its folders in the file system that this one hides.
    run(["mount", "-t", "tmpfs", "tmpfs", _SHARED_MEMORY])
    lines = [
        "link set lo up",
        f"link add {cable.sut} address {cable.sut_address} mtu {cable.mtu} type veth "
        f"peer name {cable.tester} address {cable.tester_address} mtu {cable.mtu}",
    ]
    for name in (cable.sut, cable.tester):
        lines += [f"link set {name} addrgenmode none", f"link set {name} up"]
    batch("ip", "", lines)


def _shown(name: str) -> dict[str, Any]:
    """Return what the system knows of an interface. Raises :class:`NamespaceError`."""
    found: list[dict[str, Any]] = json.loads(run(["ip", "-json", "-details", "link", "show", "dev", name]))
    return found[0]
