"""``dcp-conformance replay``."""

from __future__ import annotations

import dataclasses
import functools
import time
from pathlib import Path
from typing import Any

import click
import msgspec

from dcp_codec.common.commandline import SectionedCommand, say
from dcp_conformance.definitions.node_id import node_id_octets
from dcp_conformance.errors import UsageError

from .options import EXIT_STATUS, TARGET_SECTIONS, as_typed, report_option, target_of, target_options

#: Duration of a replay in seconds above which a warning is printed.
_LONG = 600


@click.command(
    "replay",
    cls=SectionedCommand,
    epilog=EXIT_STATUS,
    sections={"Replay": "node speed no_services report_dir", **TARGET_SECTIONS},
)
@click.argument("capture", type=click.Path(path_type=Path), metavar="FILE")
@target_options
@click.option("--node", metavar="ID", help="Recorded node whose part the implementation takes.")
@click.option(
    "--speed",
    type=click.FloatRange(min=0),
    default=1.0,
    metavar="X",
    help="Speed; 2: twice as fast, 0: without pauses.  [default: 1]",
)
@click.option("--no-services", is_flag=True, help="Do not repeat the service calls of the node's applications.")
@report_option
def command(capture: Path, **options: Any) -> int:
    """Replay the recording FILE to an implementation, and judge its reactions.

    The implementation takes the part of one recorded node. The tester sends the frames of all others and, with an upper
    tester, repeats the service calls of that node's applications. An independent model of the specification judges the
    reactions, and the final state is compared with that of the recorded node.
    """
    from dcp_conformance.definitions.outcome import assemble, exit_status
    from dcp_conformance.definitions.results import timestamp
    from dcp_conformance.execution.replay import Replay, choose_node, decided, recorded_nodes
    from dcp_conformance.execution.target import describe, open_target, require_answer
    from dcp_conformance.reporting import make_folder, write_report

    from .display import print_summary

    node = _node_id(options["node"])
    target_options = target_of(options)
    if target_options.profile is None and target_options.pics is None:
        from dcp_conformance.check.recording import guessed_profile

        target_options = dataclasses.replace(target_options, profile=guessed_profile(capture))
    codec, _ = describe(target_options)
    if not target_options.foreign:
        # The reference node gets the identifier of the node whose part it takes.
        chosen = node or choose_node(recorded_nodes(capture, codec), None)
        target_options = dataclasses.replace(target_options, node_id=chosen)
        if target_options.beacon_period_ms is None:
            target_options = dataclasses.replace(target_options, beacon_period_ms=100.0)
        node = chosen
    replay = Replay(capture, node, speed=options["speed"], services=not options["no_services"])
    begun, started = time.monotonic(), timestamp()
    again = as_typed()
    report = options["report_dir"]
    if report is not None:
        make_folder(report)
    with open_target(target_options) as target:
        target.runner.prepare()
        require_answer(target.runner, functools.partial(say, err=True))
        replay.take_part(codec, target.runner.session.sut_id)
        _warn_of_length(replay.cast.seconds, options["speed"])
        cases = [target.runner.run(case) for case in replay.cases()]
        run = assemble(
            codec.profile,
            target.pics,
            [decided(msgspec.structs.replace(case, rerun=again)) for case in cases],
            kind="replay",
            sut=target.runner.about(),
            started=started,
            duration=time.monotonic() - begun,
            command=again,
            notes=(f"it took the part of {replay.node.hex(':')} of the recording", *target.runner.notes),
        )
    page = str(write_report(run, report, codec)) if report is not None else ""
    print_summary(run, report=page)
    return exit_status(cases)


def _warn_of_length(seconds: float, speed: float) -> None:
    """Warn if the replay will take very long."""
    if speed and seconds / speed > _LONG:
        minutes = round(seconds / speed / 60)
        text = f"the replay takes {minutes // 60} h {minutes % 60} min; --speed 0 replays without the pauses"
        say(f"dcp-conformance: {text}", err=True)


def _node_id(text: str | None) -> bytes | None:
    if text is None:
        return None
    try:
        return node_id_octets(text)
    except ValueError as error:
        raise UsageError(f"--node: {error}") from None
