"""A foreign-like implementation for tests, and the real ``dcp-conformance run`` against it.

    with foreign(faults=["crashes-on-short-frame"], adapter_after=0.5, call_delay=0.05) as target:
        run = target.run("TC_BP_RX_BI_24", "TC_BP_FMT_BV_02")
        assert run.status == 1
        assert run.verdict("TC_BP_RX_BI_24") == "fail"

What can be chosen is in :class:`~.switches.Switches`, with its defaults:

* faults: ``faults`` (names in ``faults.FAULTS``: crashes-on-empty-vardis, crashes-on-overrun, crashes-on-short-frame,
  crashes-on-clear-buffer, never-answers, no-requests-for-summaries, no-creates, magic-swapped, length-with-header,
  one-payload-more, block-length-with-header, garbage-srp; or any mutant of the self-test, as M-BP-HDR-02-swapped),
  ``death`` (aborts, exits, hangs), ``death_delay``;
* node: ``profile``, ``node_id``, ``beacon_period_ms`` (20), ``buffer_check_period_ms``, ``poll_ms`` (one payload per
  poll), ``network_id``, ``ether_type``, ``own_variable`` (beacons from the start);
* processes: ``launcher`` (ends, stays, detaches), ``start_delay``, ``srp`` (none, process, child), ``adapter``,
  ``adapter_after`` (0, 0.5, 1 s after the daemon; -0.5: before it; None: outlives it), ``adapter_delay``;
* adapter: ``call_delay``, ``reset``, ``hides``, ``tells``, ``without_daemon`` (error, silence, status),
  ``while_inactive`` and ``transmit_while_inactive`` (conforming, status, error).

Cases that cause the crashes: TC_BP_RX_BV_04-vardis (crashes-on-empty-vardis), TC_BP_RX_BI_13-* (crashes-on-overrun),
TC_BP_RX_BI_24 and TC_BP_RX_BI_26-* (crashes-on-short-frame), TC_BP_QM_BV_11 (crashes-on-clear-buffer, the case passes).
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest

from dcp_codec.common.processes import started_at

from ..ports import own_port
from .switches import Switches

HERE = Path(__file__).parent
#: Seconds that a run of a few cases may take on a busy machine.
PATIENCE = 600.0
#: The interfaces of the tester and of the implementation.
INTERFACES = ("near", "far")
#: The installed command, with the Python of the test.
_COMMAND = "from dcp_conformance.cli import main; main()"


class Run:
    """Output and results of one ``dcp-conformance run``."""

    def __init__(self, done: subprocess.CompletedProcess[str], folder: Path, seconds: float) -> None:
        self.status = done.returncode
        self.out = done.stdout
        self.err = done.stderr
        self.seconds = seconds
        self.folder = folder
        """The report."""
        path = folder / "results.json"
        self.results: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        """Contents of results.json; empty if it is missing."""

    @property
    def text(self) -> str:
        """All that the terminal showed."""
        return self.out + self.err

    @property
    def cases(self) -> list[dict[str, Any]]:
        """The results of cases, in order."""
        return list(self.results.get("cases", ()))

    def of(self, case_id: str) -> list[dict[str, Any]]:
        """All results of one case: a repeated one has several."""
        return [each for each in self.cases if each["id"] == case_id]

    def verdict(self, case_id: str) -> str:
        """The verdict of a case that was run once; fails the test otherwise."""
        found = self.of(case_id)
        assert len(found) == 1, f"{case_id}: {len(found)} results\n{self.text}"
        return str(found[0]["verdict"])

    def failed_requirements(self, case_id: str | None = None) -> set[str]:
        """The requirements that failed checks name, of one case or of all."""
        return {
            requirement
            for case in self.cases
            if case_id is None or case["id"] == case_id
            for check in case.get("checks", ())
            if check["verdict"] == "fail"
            for requirement in check.get("requirements", ())
        }


class Foreign:
    """The implementation, not started yet: the tester starts it."""

    def __init__(self, switches: Switches, namespace: str | None, options: list[str]) -> None:
        self.switches = switches
        self.namespace = namespace
        self.folder = Path(switches.folder)
        self.link_options = options
        """The tester's end of the link."""
        self._runs = 0
        switches.save(self._settings)

    @property
    def _settings(self) -> Path:
        return self.folder / "switches.json"

    @property
    def start(self) -> str:
        """The command for ``--start``."""
        return shlex.join([sys.executable, str(HERE / "launcher.py"), str(self._settings)])

    @property
    def ut(self) -> str:
        """The argument for ``--ut``."""
        return f"unix:{self.switches.adapter_socket}"

    def change(self, **changes: Any) -> None:
        """Other switches from the next start on."""
        self.switches = dataclasses.replace(self.switches, **changes)
        self.switches.save(self._settings)

    def command(self, *words: object, start: bool = True, ut: bool = True) -> list[str]:
        """``dcp-conformance WORDS[0]`` with what names this implementation, then the other words.

        The profile is the tester's default unless the words have ``--profile``.
        """
        name, *others = map(str, words)
        command = [*self._inside(), sys.executable, "-c", _COMMAND, name, *self.link_options]
        command += ["--beacon-period", f"{self.switches.beacon_period_ms}"] if name == "run" else []
        command += ["--start", self.start] if start else []
        command += ["--ut", self.ut] if ut and self.switches.adapter else []
        return [*command, *others]

    def run(self, *words: object, start: bool = True, ut: bool = True, patience: float = PATIENCE) -> Run:
        """Run these cases (and options) with a report, to the end."""
        self._runs += 1
        folder = self.folder / f"report{self._runs}"
        command = self.command("run", "--report-dir", folder, *words, start=start, ut=ut)
        begun = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, timeout=patience, check=False)
        return Run(done, folder, time.monotonic() - begun)

    @contextlib.contextmanager
    def running(self, *words: object) -> Iterator[subprocess.Popen[str]]:
        """As :meth:`run`, as a process that a test can signal; ended afterwards. The report is in ``report0``."""
        command = self.command("run", "--report-dir", self.folder / "report0", *words)
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            try:
                yield process
            finally:
                if process.poll() is None:
                    process.kill()

    @contextlib.contextmanager
    def started(self) -> Iterator[None]:
        """Started by the test and not by the tester (``start=False``), until its adapter or daemon serves."""
        command = [*self._inside(), *shlex.split(self.start)]
        with subprocess.Popen(command, start_new_session=True) as process:
            try:
                wanted = self.switches.adapter_socket if self.switches.adapter else self.switches.daemon_socket
                deadline = time.monotonic() + PATIENCE
                while not Path(wanted).exists():
                    assert process.poll() in (None, 0), "the foreign implementation did not start"
                    assert time.monotonic() < deadline, "the foreign implementation does not serve"
                    time.sleep(0.01)
                yield
            finally:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGTERM)

    def _inside(self) -> list[str]:
        return ["ip", "netns", "exec", self.namespace] if self.namespace is not None else []

    def processes(self) -> list[tuple[str, int]]:
        """Name and number of every process of the implementation that was ever started."""
        path = self.switches.process_file
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [(line.split()[0], int(line.split()[1])) for line in lines]

    def starts(self) -> int:
        """Number of starts of the implementation."""
        return sum(name == "launcher" for name, _ in self.processes())

    def alive(self, name: str) -> bool:
        """Whether the process that was started last under this name runs."""
        pid = self.switches.pid_of(name)
        return pid is not None and started_at(pid) is not None

    def end(self) -> None:
        """End what still runs."""
        for _, pid in self.processes():
            # Numbers are used again: only what runs one of these programs is ours.
            with contextlib.suppress(OSError):
                words = Path(f"/proc/{pid}/cmdline").read_bytes()
                if os.fsencode(self._settings) in words:
                    os.kill(pid, signal.SIGKILL)


@contextlib.contextmanager
def foreign(*, link: Literal["udp", "ethernet"] = "udp", **switches: Any) -> Iterator[Foreign]:
    """A foreign-like implementation with these switches (:class:`~.switches.Switches`)."""
    switches = {name: tuple(value) if isinstance(value, list) else value for name, value in switches.items()}
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="dcp-foreign-"))
        namespace = None
        if link == "ethernet":
            namespace = stack.enter_context(_namespace())
            ether_type = switches.get("ether_type")
            spec = f"eth:{INTERFACES[1]}" + ("" if ether_type is None else f",type={ether_type:#06x}")
            options = ["--interface", INTERFACES[0]]
        else:
            spec = f"udp:239.73.126.77:{own_port()}"
            options = ["--link", spec]
        target = Foreign(Switches(link=spec, folder=folder, **switches), namespace, options)
        stack.callback(target.end)
        yield target


@contextlib.contextmanager
def _namespace() -> Iterator[str]:
    """A network namespace with a virtual cable between ``near`` and ``far``, deleted afterwards."""
    name = f"dcpforeign-{os.getpid()}-{time.monotonic_ns()}"
    done = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        message = f"network namespaces cannot be made here ({done.stderr.strip()}): run as root (CAP_NET_ADMIN)"
        if os.environ.get("DCP_REQUIRE_TOOLS") == "1":
            pytest.fail(message, pytrace=False)
        pytest.skip(message)
    near, far = INTERFACES
    try:
        lines = [f"link add {near} type veth peer name {far}"]
        for each in INTERFACES:
            # Without an address the kernel has nothing to say on the interface by itself.
            lines += [f"link set {each} addrgenmode none", f"link set {each} up"]
        lines.append("link set lo up")
        text = "".join(f"{line}\n" for line in lines)
        subprocess.run(["ip", "-n", name, "-batch", "-"], input=text, text=True, check=True, capture_output=True)
        yield name
    finally:
        subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)
