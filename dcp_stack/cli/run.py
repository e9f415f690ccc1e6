"""``dcp-node run``: run a node on an interface or over UDP until a signal ends it."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click
import msgspec

from dcp_codec.common.commandline import PROFILE_HELP, ExpectedError, SectionedCommand
from dcp_stack.control.places import SYSTEM, default_socket, is_answered

if TYPE_CHECKING:
    from dcp_stack.runtime.settings import Settings

log = logging.getLogger("dcp_stack.node")


@click.command(
    "run",
    cls=SectionedCommand,
    sections={
        "Settings": "config print_config profile beacon_period network_id seed",
        "Link and control": "interface link node_id control",
        "Data": "position neighbour_file record metrics",
        "Process": "daemon user log_level log_format log_file",
    },
    epilog="Exit status: 0 ended in an orderly way (SIGTERM, SIGINT, SIGHUP, or the end of input with --control "
    "stdio); 2 the node could not be started. Options override the file. See docs/dcp-node.md.",
)
@click.option("-c", "--config", metavar="FILE", help="Settings in TOML; unknown keys are refused.")
@click.option("-i", "--interface", metavar="IF", help="Ethernet interface of the node.")
@click.option(
    "--link",
    metavar="LINK",
    help="Link instead of --interface: udp[:GROUP[:PORT]], replay:FILE, or eth:IF with options.",
)
@click.option("--node-id", metavar="ID", help="Node identifier.  [default: address of IF, or random]")
@click.option("-p", "--profile", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: dcp-2.0]")
@click.option(
    "--control",
    metavar="PATH|stdio|none",
    help="Control socket, or standard input and output.  [default: dcp-node.sock in $XDG_RUNTIME_DIR; for root "
    "without one, /run/dcp/node.sock]",
)
@click.option("--beacon-period", type=float, metavar="MS", help="Beacon period, BPPAR_BEACON_PERIOD.  [default: 100]")
@click.option("--network-id", metavar="N", help="Network identifier, BPPAR_NETWORK_ID: decimal, or hex after 0x.")
@click.option(
    "--position", metavar="SOURCE", help="Source of positions: track:..., csv:FILE, capture:FILE, stdin, mavlink:..."
)
@click.option("--neighbour-file", metavar="PATH", help="Publish the neighbour table as a memory-mapped file.")
@click.option("--record", metavar="FILE.mcap|DIR/", help="Record sent and received frames; in DIR to a new file.")
@click.option("--metrics", type=click.IntRange(0, 65535), metavar="PORT", help="Serve OpenMetrics at 127.0.0.1:PORT.")
@click.option("--user", metavar="NAME", help="Change to this user once everything is open (requires root).")
@click.option("--seed", type=int, metavar="N", help="Random seed of the jitter.  [default: a new one for each start]")
@click.option(
    "--log-level",
    type=click.Choice(["debug", "info", "warning", "error"]),
    help="Least level of logged messages.  [default: info]",
)
@click.option(
    "--log-format", type=click.Choice(["text", "json"]), help="Format of the log; text: key=value.  [default: text]"
)
@click.option("--log-file", metavar="FILE", help="Append the log to this file.  [default: stderr]")
@click.option("--daemon", is_flag=True, help="Run in the background; the command ends when the node is ready.")
@click.option("--print-config", is_flag=True, help="Print the settings as TOML and end.")
def command(config: str | None, network_id: str | None, daemon: bool, print_config: bool, **flags: Any) -> int:
    """Run a node until SIGTERM or SIGINT; then it deregisters its protocols and closes the recording.

    Shells start a background command (with &) with SIGINT ignored: end such a node with 'dcp-node stop' or SIGTERM.

    \b
      dcp-node run --interface wlan0 --daemon
      dcp-node var create 7 --text hello --descr greeting
      dcp-node run --link udp --node-id 02:00:00:00:00:01 --control /tmp/node1.sock
      dcp-node run --interface wlan0 --profile cpp-2.0 --record flight.mcap
    """
    from dcp_stack.runtime.settings import load_settings, settings_text

    flags["bp.beacon_period_ms"] = _whole(flags.pop("beacon_period"))
    flags["bp.network_id"] = _number(network_id)
    settings = load_settings(config, flags)
    if print_config:
        click.echo(settings_text(settings), nl=False)
        return 0
    from dcp_stack.runtime.daemon import in_background, log_to
    from dcp_stack.runtime.privileges import made_by_root

    if daemon and settings.control == "stdio":
        raise ExpectedError("--control stdio needs standard input, which --daemon closes")
    # Otherwise open_node opens it as the user.
    if settings.log_file is not None and (settings.user is None or made_by_root(settings.log_file)):
        log_to(settings.log_file)
    if daemon:
        return in_background(lambda on_ready: _run(settings, on_ready))
    return _run(settings, lambda _line: None)


def _run(settings: Settings, on_ready: Callable[[str], None]) -> int:
    """Run the node; ``on_ready`` is called with a line that describes it once it answers requests."""
    from dcp_stack.runtime import logs
    from dcp_stack.runtime.opening import open_node

    logs.set_up(settings.log_level, settings.log_format)
    settings = _with_control(settings)

    def ready() -> None:
        log.info("running")
        where = f"control socket {settings.control}" if settings.control else "without a control socket"
        on_ready(f"node {driver.node.config.node_id.hex(':')} runs as process {os.getpid()}, {where}")

    with open_node(settings) as driver:
        driver.run(ready)
    log.info("ended")
    return 0


def _with_control(settings: Settings) -> Settings:
    """Return the settings with the default control socket, unless one is set or another node uses it."""
    if settings.control == "none":
        return msgspec.structs.replace(settings, control=None)
    if settings.control is not None:
        return settings
    path = default_socket()
    if path is None:
        log.info("no control socket: XDG_RUNTIME_DIR is not set; give one with --control PATH")
        return settings
    if is_answered(path):
        log.warning("no control socket: another node uses %s; give one with --control PATH", path)
        return settings
    if path == SYSTEM:
        # The systemd unit creates this folder; if root starts the node by hand it may be missing.
        with contextlib.suppress(OSError):
            path.parent.mkdir(mode=0o755, exist_ok=True)
    return msgspec.structs.replace(settings, control=str(path))


def _whole(value: float | None) -> float | int | None:
    """Convert a float without fraction to int, as settings expect."""
    return int(value) if value is not None and value.is_integer() else value


def _number(text: str | None) -> int | None:
    """Parse a decimal or prefixed integer; None stays None."""
    if text is None:
        return None
    try:
        return int(text, 0)
    except ValueError:
        raise click.BadParameter(
            f"{text!r} is not a number (for example 0x1111 or 4369)", param_hint="--network-id"
        ) from None
