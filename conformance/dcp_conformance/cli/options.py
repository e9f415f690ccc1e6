"""Options shared by several subcommands."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from dcp_codec.common.commandline import ETHER_TYPE_HELP, PROFILE_HELP, path_option
from dcp_conformance.execution.selection import PLANS, Selection

if TYPE_CHECKING:
    from dcp_conformance.execution.target import TargetOptions

F = TypeVar("F", bound=Callable[..., Any])

EXIT_STATUS = (
    "Exit status: 0 everything as expected; 1 an unexpected fail or pass; 2 wrong usage, or nothing to run; "
    "3 nothing unexpected, but something inconclusive, or nothing decided at all; 4 a fault of the tester; 130 "
    "interrupted by Ctrl-C, SIGTERM or SIGHUP, with a report of the executed cases."
)


class Factor(click.FloatRange):
    """Type of options: a number above 0, up to ``most``."""

    def __init__(self, most: float) -> None:
        super().__init__(min=0, max=most, min_open=True)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; reject text that is not a number in the range."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value!r} is not a number", param, ctx)
        return number


def applied(function: F, decorators: list[Callable[[F], F]]) -> F:
    """Add options in the order in which they are shown."""
    for decorator in reversed(decorators):
        function = decorator(function)
    return function


def as_typed(*words: str) -> str:
    """Return the command ``dcp-conformance`` with these arguments, or those of the process, for reports.

    Octets that are not UTF-8 are replaced by escape sequences.
    """
    command = shlex.join(["dcp-conformance", *(words or sys.argv[1:])])
    return command.encode("utf-8", "backslashreplace").decode()


pics_option = path_option(
    "--pics", metavar="FILE", help="TOML file: claims (PICS), test parameters (PIXIT), access to the implementation."
)
expected_option = path_option("--expected", metavar="FILE", help="TOML file with expected results.")
report_option = path_option("--report-dir", metavar="DIR", help="Write the report there.")


def target_options(function: F) -> F:
    """Add the options that select the SUT and the access to it."""
    return applied(
        function,
        [
            click.option("--interface", "-i", metavar="IF", help="Ethernet interface of the tester."),
            click.option("--link", metavar="udp[:GROUP[:PORT]]", help="Link instead of --interface: UDP multicast."),
            click.option(
                "--in-process", is_flag=True, help="Test the reference node in this process, in virtual time."
            ),
            click.option(
                "-p",
                "--profile",
                metavar="NAME|FILE",
                help=PROFILE_HELP + "  [default: that of the PICS, or dcp-2.0]",
            ),
            click.option("--ether-type", metavar="HEX", callback=_ether_type, help=ETHER_TYPE_HELP),
            click.option(
                "--ut", metavar="HOW", help="Upper tester: unix:PATH, tcp:HOST:PORT, exec:COMMAND, commands:FILE."
            ),
            pics_option,
            click.option("--start", metavar="COMMAND", help="Command that starts the implementation."),
            click.option(
                "--restart", metavar="COMMAND", help="Command that restarts the implementation after a crash."
            ),
            click.option("--pid", type=int, metavar="PID", help="Process id of the implementation, to detect a crash."),
            click.option(
                "--beacon-period",
                "beacon_period_ms",
                type=Factor(1_000_000),
                metavar="MS",
                help="Beacon period of the implementation.  [default: that of the PICS, or 100; reference node: 20]",
            ),
            click.option(
                "--timing-scale",
                type=Factor(1000),
                default=1.0,
                metavar="X",
                help="Factor for all time windows.  [default: 1]",
            ),
            click.option("--seed", type=int, default=1, metavar="N", help="Random seed.  [default: 1]"),
        ],
    )


#: Sections of the help of commands that have :func:`target_options`; the names are those of ``TargetOptions``.
TARGET_SECTIONS = {
    "Implementation": "interface link in_process profile ether_type ut pics",
    "Process of the implementation": "start restart pid",
    "Times and random numbers": "beacon_period_ms timing_scale seed",
}


def selection_options(function: F) -> F:
    """Add the options that select test cases."""
    return applied(
        function,
        [
            click.argument("cases", nargs=-1),
            click.option(
                "--section",
                "-s",
                multiple=True,
                metavar="TEXT",
                help="Only cases of sections whose heading has this text.",
            ),
            click.option(
                "--exclude", "-x", multiple=True, metavar="CASE", help="Leave out these cases (identifier or glob)."
            ),
            click.option(
                "--plan",
                type=click.Choice(PLANS),
                default="full",
                help="smoke: cases that detect most known faults in 10 s; long: also cases that take minutes.  "
                "[default: full]",
            ),
        ],
    )


def _ether_type(_context: click.Context, _parameter: click.Parameter, value: str | None) -> int | None:
    if value is None:
        return None
    from dcp_codec.framing.ethertype import parse_ether_type

    try:
        return parse_ether_type(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def target_of(options: dict[str, Any]) -> TargetOptions:
    """Return the target of :func:`target_options` and of the PICS file. Raises :class:`UsageError`."""
    # Lazy import: --help does not need the modules that open targets.
    from dcp_conformance.execution.target import TargetOptions

    given = {name: options[name] for names in TARGET_SECTIONS.values() for name in names.split()}
    target = TargetOptions(**given)
    # The file says how to reach the implementation of the user; "fuzz --own-node" is about another one.
    return target if options.get("own_node") else target.with_access()


def selection_of(options: dict[str, Any]) -> Selection:
    """Return the selection given by the options of :func:`selection_options`."""
    return Selection(
        patterns=options["cases"],
        sections=options["section"],
        exclude=options["exclude"],
        plan=options["plan"],
    )
