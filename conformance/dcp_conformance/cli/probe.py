"""``dcp-conformance probe``."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import SectionedCommand, out_option, say
from dcp_codec.common.printable import plain
from dcp_conformance.errors import UsageError

from .options import TARGET_SECTIONS, target_of, target_options

if TYPE_CHECKING:
    from dcp_conformance.execution.target import TargetOptions


@click.command(
    "probe",
    cls=SectionedCommand,
    sections={"Probe": "check_adapter seconds passive out", **TARGET_SECTIONS},
    epilog="Exit status: 0 a frame or answer was received, or the adapter keeps to the contract; 1 the adapter breaks "
    "it; 2 wrong usage, or a file that cannot be written; 3 neither frame nor answer was received, or no profile "
    "explains the frames; 4 a fault of the tester.",
)
@target_options
@click.option(
    "--seconds",
    type=click.FloatRange(0.5, 3600),
    default=10.0,
    metavar="S",
    help="Duration of listening.  [default: 10]",
)
@click.option(
    "--check-adapter",
    is_flag=True,
    help="Walk through the methods of the upper tester (--ut), and show which are there and keep to the contract.",
)
@click.option("--passive", is_flag=True, help="Only listen: do not ask a silent implementation for variables.")
@out_option("FILE", "Write the PICS to this file.  [default: standard output]")
def command(*, seconds: float, check_adapter: bool, passive: bool, out: Path | None, **options: Any) -> int:
    """Draft the PICS and PIXIT of an implementation by observation and queries.

    Observed and reported values are filled in with the reason. Every other entry is a comment with a question for you.
    """
    import msgspec
    from dcp_spec.profile.loading import profile_names

    from dcp_codec.codec import Codec
    from dcp_conformance.definitions.pics import UNKNOWN_PROFILE, Access
    from dcp_conformance.definitions.pics_file import write_pics
    from dcp_conformance.execution.target import describe, open_lower
    from dcp_conformance.interconnection.probe import draft
    from dcp_conformance.upper_tester.opening import open_upper

    target = target_of(options)
    if check_adapter:
        return _check_adapter(target.ut, target)
    if not target.foreign:
        raise UsageError(
            "give the link of the implementation: --interface IF for Ethernet, --link udp[:GROUP:PORT] for UDP"
        )
    codec, _ = describe(target)
    chosen = target.profile is not None or target.pics is not None
    candidates = [codec, *(Codec(name) for name in profile_names() if name != codec.profile.name)]
    # If the user has named the profile, do not send frames of other profiles.
    asking = [codec] if chosen else None
    upper = None
    with contextlib.ExitStack() as stack:
        lower = stack.enter_context(contextlib.closing(open_lower(target, codec)))
        if target.ut is not None:
            upper = stack.enter_context(contextlib.closing(open_upper(target.ut, starting=False)))
        asked_for = codec.profile.name if chosen else None
        pics, remarks = draft(lower, upper, candidates, seconds, ask=not passive, asked_for=asked_for, asking=asking)
    # The draft also has the options of this command, so that a run needs only the file.
    access = Access(**{name: getattr(target, name) for name in Access.__struct_fields__})
    write_pics(msgspec.structs.replace(pics, access=access), out, remarks)
    if out is not None:
        for remark in remarks:
            say(remark, err=True)
    if pics.pixit.profile == UNKNOWN_PROFILE:
        click.echo("no profile explains the received frames: set pixit.profile before a run", err=True)
        return 3
    heard = not any(remark.startswith("nothing was heard") for remark in remarks)
    return 0 if heard or upper is not None else 3


def _check_adapter(ut: str | None, target: TargetOptions) -> int:
    """Print what the upper tester has and keeps to; return the exit status."""
    from dcp_conformance.execution.target import describe
    from dcp_conformance.upper_tester.examination import Examination, table
    from dcp_conformance.upper_tester.opening import open_upper

    if ut is None:
        raise UsageError("--check-adapter needs the upper tester: --ut unix:PATH, tcp:HOST:PORT or exec:COMMAND")
    # The link is not used.
    codec, _ = describe(replace(target, ut=None, start=None, stop=None, restart=None, pid=None))
    with contextlib.closing(open_upper(ut, starting=False)) as upper:
        found = Examination(upper, codec.profile, whole=True).walk()
    for method, outcome, what in table(found):
        click.echo(f"{method:<34}{outcome:<14}{plain(what)}".rstrip())
    count = Counter(each.outcome for each in found)
    click.echo(
        f"{len(found)} methods and notifications: {count['right']} keep to the contract, {count['wrong']} do not, "
        f"{count['absent']} are absent. The contract: conformance/UPPER-TESTER.md"
    )
    return 1 if count["wrong"] else 0
