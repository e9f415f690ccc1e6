"""``dcp-conformance fuzz``."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from dcp_conformance.cli.options import TARGET_SECTIONS, target_of, target_options
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import SectionedCommand, path_option, say

from .campaigns import (
    campaign_options,
    material,
    profile_text,
    run_campaign,
    say_replayed,
    swept,
    write_tests,
)

if TYPE_CHECKING:
    from dcp_conformance.execution.target import TargetOptions

    from dcp_lab.fuzz import Artefact
    from dcp_lab.fuzz.steps import Target

EXIT_STATUS = (
    "Exit status: 0 nothing found; 1 findings; 2 wrong usage; 3 the implementation was not healthy at the start, "
    "or did not answer after a restart; 4 a fault of the tester; 130 stopped by Ctrl-C or SIGTERM without a finding."
)
#: Time limit in seconds for minimising a finding of a live implementation.
_MINIMISING = 60.0


@click.group("fuzz", epilog=EXIT_STATUS)
def command() -> None:
    """Find inputs that break an implementation, and minimise them.

    Each finding is saved as an artefact (--artefacts DIR). 'fuzz replay' repeats it, and 'run --artefacts DIR' executes
    it as a conformance case.
    """


def _live(options: dict[str, Any]) -> int:
    """Run a campaign against an SUT that is opened as by ``dcp-conformance run``; return the exit status."""
    from dcp_conformance.execution.target import describe, open_target, say_contradictions

    from dcp_lab.fuzz.campaign import Campaign
    from dcp_lab.fuzz.execute.live import RATE, LiveTarget, NotAliveError
    from dcp_lab.fuzz.findings.artefact import SavedTarget
    from dcp_lab.fuzz.generate.sequence_batches import Batches
    from dcp_lab.fuzz.generate.sequences import Sequences
    from dcp_lab.fuzz.generate.sweep import SweepFirst

    where = target_of(options)
    if not (where.foreign or where.in_process or options["own_node"]):
        raise UsageError(
            "name the interface of the implementation (--interface IF or --link udp[:GROUP:PORT]); other "
            "interfaces are not used. --own-node starts the reference node on a separate link, --in-process one here"
        )
    described, _ = describe(where)
    options = {**options, "profile": options["profile"] or described.profile.name}
    codec, rng, mutator, recorded = material(options)
    size = options["batch"]
    if options["dry_run"]:
        drawn = SweepFirst(Sequences(codec, rng, NOBODY, mutator, recorded), codec)
        return write_tests(codec, Batches(drawn, size), options)
    with open_target(where) as opened:
        opened.runner.prepare()
        say_contradictions(opened.runner, functools.partial(say, err=True))
        target = LiveTarget(opened, rate=options["rate"] or RATE)
        options["rate"] = None
        # This also determines the node identifier, which the sequences use.
        try:
            target.prepare()
        except NotAliveError as error:
            say(f"dcp-conformance: {error}", err=True)
            return 3
        own_id = opened.runner.session.sut_id or NOBODY
        sequences = Sequences(codec, rng, own_id, mutator, recorded)
        done = swept(options)
        saved = SavedTarget("live", target.name, options=_target_words(where, own_node=options["own_node"]))
        campaign = Campaign(
            codec,
            target,
            Batches(SweepFirst(sequences, codec, done=done), size),
            saved,
            options["seed"],
            mutator=mutator,
            profile_text=profile_text(options),
            budget=200,
            seconds=_MINIMISING,
            by_cause=True,
        )
        if target.control is not None and target.control.can_restart:
            campaign.fresh = target.run_after_restart
        return run_campaign(campaign, options)


def _target_words(where: TargetOptions, *, own_node: bool) -> str:
    """Return the options that reach the implementation again, without its process id, which will differ."""
    words = shlex.split(dataclasses.replace(where, pid=None).command_line())[2:]
    return shlex.join([*words, *(["--own-node"] if own_node else [])])


_OWN_NODE = click.option("--own-node", is_flag=True, help="Start the reference node as a process on a separate link.")
#: Placeholder for an unknown node identifier.
NOBODY = b"\x02\x00\x00\x00\x00\x01"


@command.command(
    "live",
    cls=SectionedCommand,
    epilog=EXIT_STATUS,
    sections={
        **TARGET_SECTIONS,
        "Campaign": "own_node batch max_time max_cases max_findings rate recording resume",
        "Output": "artefacts coverage dry_run quiet",
    },
)
@target_options
@_OWN_NODE
@click.option(
    "--batch",
    type=click.IntRange(1),
    default=20,
    metavar="N",
    help="Number of sequences between two checks.  [default: 20]",
)
@campaign_options
def live_command(**options: Any) -> int:
    """Find inputs that crash or hang a live implementation.

    An implementation that stops sending is reported, too.

    Before the campaign the implementation must answer. With --start or --restart it is restarted after a crash;
    without them the campaign ends at the first one. --rate is in frames per second (default 500).
    """
    return _live(options)


@command.command(
    "model",
    cls=SectionedCommand,
    epilog=EXIT_STATUS,
    sections={**TARGET_SECTIONS, "Search": "own_node sequences steps database", "Output": "coverage artefacts"},
)
@target_options
@_OWN_NODE
@click.option(
    "--sequences", type=click.IntRange(1), metavar="N", help="Number of sequences.  [default: 2000, on a link 40]"
)
@click.option("--steps", type=click.IntRange(1), default=12, metavar="N", help="Steps of a sequence.  [default: 12]")
@click.option("--database", default="", metavar="DIR", help="Folder of Hypothesis's examples, which are tried first.")
@click.option("--coverage", is_flag=True, help="Show the reached pairs of state and event.")
@path_option("--artefacts", metavar="DIR", help="Write the counterexample to this folder.")
def model_command(**options: Any) -> int:
    """Search for a sequence in which an implementation does what the model of a node forbids.

    Hypothesis draws the sequences: services, beacons of neighbours, parameters, activity and time. The shortest
    counterexample is shown as a table: each step, what was allowed, and what came. The same seed gives the same
    sequences. --in-process searches in virtual time.
    """
    from dcp_lab.fuzz.execute.model import run_search

    where = target_of(options)
    if not (where.foreign or where.in_process or options["own_node"]):
        raise UsageError("name the implementation (--interface IF or --link udp), --own-node, or --in-process")
    words = _target_words(where, own_node=options["own_node"])
    return run_search(
        where,
        words,
        sequences=options["sequences"] or (2000 if where.in_process else 40),
        steps=options["steps"],
        database=options["database"],
        coverage=options["coverage"],
        directory=options["artefacts"],
    )


@command.command(
    "replay",
    cls=SectionedCommand,
    sections={**TARGET_SECTIONS, "Replay": "own_node attempts"},
    epilog="Exit status: 0 every finding is fixed; 1 a finding failed again, or is flaky; 2 wrong usage; 4 a finding "
    "could not be repeated, or a fault of the tester.",
)
@click.argument("artefacts", nargs=-1, required=True, type=click.Path(path_type=Path))
@target_options
@_OWN_NODE
@click.option(
    "--attempts",
    type=click.IntRange(1),
    default=3,
    metavar="N",
    help="Number of attempts for each finding.  [default: 3]",
)
def replay_command(artefacts: tuple[Path, ...], attempts: int, **options: Any) -> int:
    """Repeat findings, and print the result of each.

    The result is fixed, failed, flaky or error.

    ARTEFACTS are files or folders. Give the link and the upper tester of the implementation.
    """
    from dcp_lab.fuzz.findings.artefact import found_in
    from dcp_lab.fuzz.findings.replaying import replay_all

    with contextlib.ExitStack() as stack:
        target = _live_target(options, stack)
        return replay_all(found_in(list(artefacts)), target, attempts=attempts, on_result=say_replayed)


def _live_target(options: dict[str, Any], stack: contextlib.ExitStack) -> Callable[[Artefact], Target]:
    """Return a function that opens the target of an artefact; it raises ``UsageError`` if no option names an SUT."""
    from dcp_conformance.execution.target import open_target, say_contradictions

    from dcp_lab.fuzz.execute.live import LiveTarget

    target = target_of(options)
    opened = None
    if target.foreign or target.in_process or options["own_node"]:
        opened = stack.enter_context(open_target(target))
        opened.runner.prepare()
        say_contradictions(opened.runner, functools.partial(say, err=True))

    def made(artefact: Artefact) -> Target:
        if artefact.target.mode == "model":
            from dcp_lab.fuzz.execute.model import ModelTarget
            from dcp_lab.fuzz.findings.counterexample import steps_of

            return ModelTarget(opened, artefact.profile, steps_of(artefact), in_process=target.in_process)
        if artefact.target.mode in ("codec", "stack"):
            raise UsageError(f"artefact {artefact.id} is of our own code in process: use dcp-selftest fuzz replay")
        if opened is None:
            raise UsageError(
                f"artefact {artefact.id} is of a live implementation: say where it is (--interface IF or --link udp)"
            )
        return LiveTarget(opened)

    return made
