"""Our node as a process of its own: on a virtual Ethernet where that is possible, otherwise over UDP multicast."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Literal

from dcp_codec.codec import Codec
from dcp_codec.network.namespaces import NamespaceError
from dcp_conformance.errors import ConformanceError, LowerTesterError
from dcp_conformance.lower_tester import LowerTester, open_ethernet, open_udp
from dcp_conformance.lower_tester.udp import DEFAULT_GROUP
from dcp_conformance.sut.control import SutControl
from dcp_conformance.sut.link import Switch
from dcp_conformance.sut.process import ProcessControl
from dcp_conformance.upper_tester import Reconnecting, UpperTester, open_upper
from dcp_stack.config import BPConfig, VardisConfig

from .namespace import SUT_INTERFACE, TESTER_INTERFACE, Namespace

LinkKind = Literal["auto", "ethernet", "udp"]
NODE_ID = b"\x02\x00\x00\x00\x00\x01"
#: For profiles that name no EtherType: of the range that is for local experiments (IEEE 802).
EXPERIMENTAL = 0x88B5
#: Seconds that the node may take until it answers: Python on a busy machine.
PATIENCE = 30.0
_HELLO = b'{"jsonrpc":"2.0","id":1,"method":"UT-Hello"}\n'


@dataclass(frozen=True)
class ReferenceProcess:
    """A running node, with all that a session needs."""

    lower: LowerTester
    upper: UpperTester
    control: SutControl
    about: str
    """Over what the tester and the node talk, and why, in one line for people."""


@contextlib.contextmanager
def reference_process(
    codec: Codec,
    *,
    beacon_period_ms: float = 100,
    link: LinkKind = "auto",
    profile: str | None = None,
    node_id: bytes = NODE_ID,
    options: Sequence[str] = (),
    patience: float = 5.0,
    program: Sequence[str] = ("dcp_stack.cli", "run"),
) -> Iterator[ReferenceProcess]:
    """Start our node. At the end, also after Ctrl-C and SIGTERM, remove everything that was made for it.

    ``link``: ``auto`` is Ethernet, with a fall-back to UDP; ``about`` has the reason. ``profile`` is the name or
    path of the profile, by default the name in ``codec``. ``options`` are further ones of ``dcp-node run``.
    ``patience`` is what the upper tester has, in s. ``program``: a module with the options of ``dcp-node run``, and
    arguments before them.

    Raises ``ConformanceError``: the node does not start (with its last words), or ``link="ethernet"`` is impossible.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(_ended_by_sigterm())
        directory = Path(tempfile.mkdtemp(prefix="dcp-conformance-"))
        stack.callback(shutil.rmtree, directory, ignore_errors=True)
        lower, link_options, namespace, about = _open_link(codec, link, node_id, stack)
        stack.callback(lower.close)
        path, settings = directory / "node.sock", directory / "node.toml"
        settings.write_text(_settings(beacon_period_ms), encoding="utf-8")
        representation = codec.profile.types.node_id.representation
        command = [
            *(sys.executable, "-m", *program, "--config", str(settings), *link_options),
            *("--control", str(path)),
            *("--profile", profile or codec.profile.name, "--beacon-period", f"{beacon_period_ms:g}"),
            *("--node-id", node_id.hex(":") if representation != "hex" else node_id.hex(), "--log-level", "warning"),
            *options,
        ]
        control = _NodeControl(command, path, namespace)
        stack.callback(control.close)
        control.start()
        wait_for(control, path)
        upper = control.upper = open_upper(f"unix:{path}", patience)
        stack.callback(upper.close)
        yield ReferenceProcess(lower, upper, control, about)


def _settings(beacon_period_ms: float) -> str:
    """Return timers of VarDis in their default proportion to the beacon period, and the limits of the profile.

    With a short beacon period and the usual timers, most of a run would be spent waiting for VarDis to process
    its buffer. Recommended limits of a profile are lower than those to be tested.
    """
    scale, usual = beacon_period_ms / BPConfig().beacon_period_ms, VardisConfig()
    timers = {name: getattr(usual, name) for name in ("buffer_check_period_ms", "scrubbing_period_ms")}
    lines = [f"{name} = {max(1, round(scale * value))}\n" for name, value in timers.items()]
    return "[vardis]\nrecommended = false\n" + "".join(lines)


class _NodeControl(ProcessControl):
    """As for any process; a restart is over when the node answers again."""

    def __init__(self, command: list[str], path: Path, namespace: Namespace | None) -> None:
        around = contextlib.nullcontext if namespace is None else namespace.entered
        super().__init__(start=command, around=around, ends_with_tester=True, settle=0)
        self._path = path
        self.upper: Reconnecting | None = None
        self.after_restart.append(self._reconnect)
        self.switch_link: Switch | None = None if namespace is None else _switch_of(namespace)
        """Takes the node's link up or down; None over UDP."""

    def start(self) -> None:
        """Start the node; a socket that is still there from a life before must not answer for the dead."""
        self._path.unlink(missing_ok=True)
        super().start()

    def _reconnect(self) -> None:
        wait_for(self, self._path)
        if self.upper is not None:
            self.upper.reconnect()


def _switch_of(namespace: Namespace) -> Switch:
    def switch(up: bool) -> None:
        try:
            namespace.switch(up)
        except NamespaceError as error:
            raise ConformanceError(str(error)) from None

    return switch


def wait_for(control: SutControl, path: Path) -> None:
    """Wait until the node answers a request on its Unix socket: one that only listens may still fail to start.

    Raises ``ConformanceError`` if the process ends before, or does not answer within ``PATIENCE`` s.
    """
    deadline = time.monotonic() + PATIENCE
    while not _answers(control, path, deadline):
        if control.alive() is False:
            raise ConformanceError(f"our node does not run: {control.why_dead()}")
        if time.monotonic() > deadline:
            raise ConformanceError(f"our node does not answer within {PATIENCE:g} s: is the machine that busy?")
        time.sleep(0.01)


def _answers(control: SutControl, path: Path, deadline: float) -> bool:
    """Whether the node answers on one connection, before it closes it, ends, or the deadline comes."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as trial, contextlib.suppress(OSError):
        trial.settimeout(0.1)
        trial.connect(os.fspath(path))
        trial.sendall(_HELLO)
        while control.alive() is not False and time.monotonic() < deadline:
            with contextlib.suppress(TimeoutError):
                return trial.recv(1) != b""
    return False


def _open_link(
    codec: Codec, kind: LinkKind, node_id: bytes, stack: contextlib.ExitStack
) -> tuple[LowerTester, list[str], Namespace | None, str]:
    """The tester's end, the node's options for the other end, where that is, and what to tell people."""
    link = codec.profile.link
    why = "as asked for"
    if kind == "auto" and link.transport == "udp":
        why = f"the profile {codec.profile.name} has no frames of its own on Ethernet"
    elif kind != "udp":
        try:
            # The tester also sends from addresses of other nodes, for example those of a recording.
            namespace = Namespace(node_id if _is_address(node_id) else NODE_ID)
            stack.callback(namespace.close)
            ether_type = link.ether_type or EXPERIMENTAL
            with namespace.entered():
                lower: LowerTester = open_ethernet(TESTER_INTERFACE, link, ether_type=ether_type)
        except (NamespaceError, LowerTesterError) as error:
            if kind == "ethernet":
                raise ConformanceError(f"no virtual Ethernet for our node: {error}") from None
            why = str(error)
        else:
            about = "virtual Ethernet, in a network namespace of its own"
            return lower, ["--link", f"eth:{SUT_INTERFACE},type={ether_type:#06x}"], namespace, about
    # Also where the profile names a port: what else runs there on this host must not be heard.
    port = free_port()
    about = f"UDP multicast over the loopback interface ({why})"
    return open_udp(DEFAULT_GROUP, port, link=link), ["--link", f"udp:{DEFAULT_GROUP}:{port}"], None, about


def _is_address(node_id: bytes) -> bool:
    """Return whether an interface can have the node identifier as its address: 6 octets, unicast, not all zeros."""
    return len(node_id) == 6 and not node_id[0] & 1 and any(node_id)


def free_port() -> int:
    """Return an unused UDP port: other runs keep theirs until they end."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as trial:
        trial.bind((DEFAULT_GROUP, 0))
        port: int = trial.getsockname()[1]
        return port


@contextlib.contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM unwind the stack, unless another handler is installed."""
    ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    if ours:
        signal.signal(signal.SIGTERM, _terminated)
    try:
        yield
    finally:
        if ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminated(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of handlers
    raise SystemExit(128 + number)


__all__ = ["LinkKind", "ReferenceProcess", "reference_process", "wait_for"]
