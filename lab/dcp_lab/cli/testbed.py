"""``dcp-node testbed``: node processes in separate network namespaces, on a virtual Ethernet."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import click

from dcp_codec.common.commandline import PROFILE_HELP, ExpectedError, path_option
from dcp_stack.cli.common import Seconds, note

from .simulate import NOT_MET, scenario_of

#: Environment variable that is set for the copy of this command in a user namespace.
_INSIDE = "DCP_TESTBED_INSIDE"
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


class _InterruptedError(BaseException):
    """A signal that ends the testbed."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@click.command(
    "testbed",
    epilog="Exit status: 0 all expectations are met, 1 one is not, 2 wrong usage, an invalid scenario or no "
    "privilege to create network namespaces, 128 + N ended by signal N.",
)
@click.argument("nodes", required=False, type=click.IntRange(1, 200), metavar="[N]")
@click.option("--scenario", metavar="FILE", help="Scenario with events and expectations (docs/scenarios.md).")
@click.option("--topology", metavar="bus|line|grid[:COLUMNS]|FILE", help="Nodes that are neighbours.  [default: bus]")
@click.option("-p", "--profile", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: dcp-2.0]")
@click.option("--loss", type=click.FloatRange(0, 1), metavar="P", help="Share of frames lost at each receiver.")
@click.option(
    "--duration", type=Seconds(0, 86_400, min_open=True), metavar="S", help="Duration in seconds.  [default: 30]"
)
@click.option("--seed", type=int, metavar="N", help="Random seed.  [default: 1]")
@click.option(
    "--links",
    type=click.Choice(["auto", "kernel", "relay"]),
    default="auto",
    show_default=True,
    help="Carry frames by the kernel (bridges, netem), or by a relay, which can also corrupt frames and lose bursts.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@path_option(
    "--keep",
    metavar="DIR",
    help="Keep recordings (node-N.mcap), logs, settings and control sockets in DIR.",
    file_okay=False,
)
def command(
    scenario: str | None, duration: float | None, links: str, as_json: bool, keep: Path | None, **options: Any
) -> int:
    """Start N nodes, each a process in a network namespace with one interface, and run a scenario on them.

    While it runs, 'dcp-node ... --control DIR/node-0.sock' controls the nodes. Afterwards everything is removed except
    the files of --keep. Needs root, or a system that allows user namespaces.
    """
    from dcp_codec.network.namespaces import NamespaceError
    from dcp_lab.relay import RelayAir, RelayError, needs_relay
    from dcp_lab.sim.scenario.definition import ScenarioError
    from dcp_lab.sim.scenario.report import lines
    from dcp_lab.sim.testbed.fabric import Fabric
    from dcp_lab.sim.testbed.testbed import StartError, Testbed

    played = scenario_of(scenario, duration=30.0 if duration is None and scenario is None else duration, **options)
    if played.nodes > 200:
        raise ExpectedError(f"a testbed runs each node as a process, at most 200 nodes, not {played.nodes}")
    _get_rights()
    directory = _directory(keep)
    try:
        relay = links == "relay" or (links == "auto" and needs_relay(played))
        make_air = RelayAir if relay else Fabric
        with _signals(), Testbed(played, directory, keep=keep is not None, make_air=make_air) as testbed:
            if keep is not None:
                note(f"control sockets are {directory}/node-*.sock")
            report = testbed.run(note)
    except (ScenarioError, NamespaceError, RelayError, StartError) as error:
        raise ExpectedError(f"testbed: {error}") from None
    except _InterruptedError as stop:
        note(f"ended by {signal.Signals(stop.number).name}; the testbed is removed")
        return 128 + stop.number
    finally:
        if keep is None:
            shutil.rmtree(directory, ignore_errors=True)
    click.echo(json.dumps(report.plain(), indent=2) if as_json else "\n".join(lines(report)))
    return 0 if report.met else NOT_MET


def _directory(keep: Path | None) -> Path:
    """Return the folder of the testbed: ``keep``, created if necessary, or a temporary one."""
    if keep is None:
        return Path(tempfile.mkdtemp(prefix="dcp-testbed-"))
    try:
        keep.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExpectedError(f"{keep}: {error.strerror}") from None
    # Absolute, because the settings files of the nodes contain it.
    return keep.absolute()


@contextlib.contextmanager
def _signals() -> Iterator[None]:
    """Turn the first signal into an exception, so that the testbed is removed; ignore further ones."""

    def interrupt(number: int, _frame: FrameType | None) -> None:
        for each in _SIGNALS:
            signal.signal(each, signal.SIG_IGN)
        raise _InterruptedError(number)

    before = {each: signal.signal(each, interrupt) for each in _SIGNALS}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _get_rights() -> None:
    """Return if namespaces can be created; otherwise run this command again in a user namespace, or raise."""
    from dcp_lab.sim.testbed.namespaces import permitted

    if permitted():
        return
    if shutil.which("ip") is None:
        raise ExpectedError("testbed: ip is not installed (Debian: iproute2)")
    unshare = shutil.which("unshare")
    # No PID namespace: it would need another process in between, which would receive the signals.
    flags = ["--user", "--map-root-user", "--net", "--mount"]
    possible = unshare is not None and not os.environ.get(_INSIDE)
    if possible and subprocess.run([unshare or "", *flags, "true"], capture_output=True, check=False).returncode == 0:  # noqa: S603
        # ip keeps its namespaces in /run, which belongs to root: mount a private one.
        script = 'mount -t tmpfs none /run && exec "$@"'
        inner = ["sh", "-c", script, "sh", sys.executable, "-m", "dcp_stack.cli", *sys.argv[1:]]
        os.environ[_INSIDE] = "1"
        sys.stdout.flush()
        os.execv(unshare or "", ["unshare", *flags, "--", *inner])  # noqa: S606
    raise ExpectedError(
        "testbed: network namespaces cannot be created: run as root, or allow users to have namespaces "
        "(sysctl user.max_user_namespaces, kernel.unprivileged_userns_clone or "
        "kernel.apparmor_restrict_unprivileged_userns=0)"
    )
