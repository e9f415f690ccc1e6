"""``dcp-conformance fuzz``."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dcp_codec.common.commandline import PROFILE_HELP, say
from dcp_conformance.errors import UsageError

from .campaigns import campaign_options, jobs_option, material, no_jobs, profile_text, run_campaign, swept, write_tests
from .options import target_of, target_options

if TYPE_CHECKING:
    from dcp_conformance.execution.target import TargetOptions
    from dcp_conformance.fuzz import Artefact, Campaign
    from dcp_conformance.fuzz.steps import Target

EXIT_STATUS = (
    "Exit status: 0 nothing found; 1 findings; 2 wrong usage; 3 the implementation was not healthy at the start, "
    "or did not answer after a restart; 4 a fault of the tester; 130 stopped by Ctrl-C or SIGTERM without a finding."
)
#: Time limit in seconds for minimising a finding of a live implementation.
_MINIMISING = 60.0
#: Number of sequences of a sweep in one comparison with the model, which begins with a reset or restart.
_SWEPT_AT_ONCE = 40


@click.group("fuzz", epilog=EXIT_STATUS)
def command() -> None:
    """Find inputs that break an implementation, and minimise them.

    Each finding is saved as an artefact (--artefacts DIR). 'fuzz replay' repeats it, and 'run --artefacts DIR' executes
    it as a conformance case.
    """


_PROFILE = click.option(
    "-p", "--profile", default="dcp-2.0", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: dcp-2.0]"
)
_SEED = click.option("--seed", type=int, default=1, metavar="N", help="Random seed.  [default: 1]")


@command.command("codec", epilog=EXIT_STATUS)
@click.argument("parts", nargs=-1)
@_PROFILE
@_SEED
@click.option("--guided", is_flag=True, help="Keep inputs that reach new lines of the code (slower).")
@click.option(
    "--engine",
    type=click.Choice(["own", "atheris"]),
    default="own",
    help="atheris: libFuzzer, guided by branches, for one part (extra atheris).  [default: own]",
)
@jobs_option
@campaign_options
def codec_command(parts: tuple[str, ...], **options: Any) -> int:
    """Fuzz our own functions in process.

    PARTS: beacon (decode, dissect, encode), capture (pcap, pcapng and MCAP readers), control (the control interface),
    profile and pics (loaders); all of them by default.
    """
    from dcp_conformance.fuzz.execute.functions import PARTS, FunctionInputs

    if options["coverage"] in PARTS:
        raise UsageError(f"--coverage {options['coverage']}: this would be the name of a file; put --coverage last")
    if unknown := [part for part in parts if part not in PARTS]:
        raise UsageError(f"unknown part {unknown[0]!r}; the parts are {', '.join(PARTS)}")
    if options["engine"] == "own":
        make = partial(codec_campaign, parts or PARTS, options)
        with make() as campaign:
            return run_campaign(campaign, options, make=make)
    if options["jobs"] > 1:
        raise UsageError("--engine atheris uses one process: leave out --jobs")
    from dcp_conformance.fuzz.execute.atheris_engine import run_engine

    part = _only(parts)
    with codec_campaign((part,), options) as campaign:
        assert isinstance(campaign.generator, FunctionInputs)
        seeds = campaign.generator.seeds(part)
        return run_campaign(
            campaign, options, run=lambda limits: run_engine(campaign, part, options["profile"], seeds, limits)
        )


@contextlib.contextmanager
def codec_campaign(parts: tuple[str, ...], options: dict[str, Any], seed: str | None = None) -> Iterator[Campaign]:
    """Return the campaign of ``fuzz codec``; ``seed`` is that of a worker."""
    from dcp_conformance.fuzz.campaign import Campaign
    from dcp_conformance.fuzz.execute.functions import FunctionInputs, FunctionTarget
    from dcp_conformance.fuzz.findings.artefact import SavedTarget

    codec, rng, mutator, _ = material(options, seed)
    inputs = FunctionInputs(codec, rng, mutator, parts)
    target = FunctionTarget(codec)
    try:
        saved = SavedTarget("codec", "functions in this process")
        yield Campaign(
            codec, target, inputs, saved, options["seed"], mutator=mutator, profile_text=profile_text(options)
        )
    finally:
        target.close()


def _only(parts: tuple[str, ...]) -> str:
    """Return the only selected part, for an engine that processes octets without parts."""
    if len(parts) > 1:
        raise UsageError(f"--engine atheris fuzzes one part at a time, not {len(parts)}")
    return parts[0] if parts else "beacon"


@command.command("stack", epilog=EXIT_STATUS)
@_PROFILE
@_SEED
@click.option("--mutant", metavar="ID", help="Fuzz a mutant of the reference node instead (see selftest).")
@click.option("--guided", is_flag=True, help="Keep inputs that reach new lines of the code (slower).")
@jobs_option
@campaign_options
def stack_command(**options: Any) -> int:
    """Fuzz the reference node in process.

    After every step the node is compared with an independent model.
    """
    make = partial(stack_campaign, options)
    with make() as campaign:
        return run_campaign(campaign, options, make=make)


@contextlib.contextmanager
def stack_campaign(options: dict[str, Any], seed: str | None = None) -> Iterator[Campaign]:
    """Return the campaign of ``fuzz stack``; ``seed`` is that of a worker."""
    from dcp_conformance.fuzz.campaign import Campaign
    from dcp_conformance.fuzz.findings.artefact import SavedTarget
    from dcp_conformance.fuzz.findings.replaying import stack_target
    from dcp_conformance.fuzz.generate.directed import Directed
    from dcp_conformance.fuzz.generate.sequence_batches import Lifetimes
    from dcp_conformance.fuzz.generate.sequences import Sequences
    from dcp_conformance.fuzz.generate.sweep import SweepFirst

    codec, rng, mutator, recorded = material(options, seed)
    target = stack_target(codec, options["mutant"] or "")
    reached: Counter[tuple[str, str]] = Counter()
    directed = Directed(Sequences(codec, rng, target.own_id, mutator, recorded), reached)
    # Each worker executes the whole sweep, which takes a tenth of a second.
    sequences = SweepFirst(directed, codec, done=swept(options))
    saved = SavedTarget("stack", target.name, options["mutant"] or "")
    yield Campaign(
        codec,
        target,
        Lifetimes(sequences),
        saved,
        options["seed"],
        mutator=mutator,
        states=lambda: target.observer.reached,
        reached_states=reached,
        profile_text=profile_text(options),
        own_id=target.own_id,
    )


def _live(options: dict[str, Any], *, differential: bool) -> int:
    """Run a campaign against an SUT that is opened as by ``dcp-conformance run``; return the exit status."""
    from dcp_conformance.execution.target import describe, open_target
    from dcp_conformance.fuzz.campaign import Campaign
    from dcp_conformance.fuzz.execute.live import RATE, LiveTarget, NotAliveError
    from dcp_conformance.fuzz.findings.artefact import SavedTarget
    from dcp_conformance.fuzz.findings.replaying import stack_target
    from dcp_conformance.fuzz.generate.directed import Directed
    from dcp_conformance.fuzz.generate.sequence_batches import Batches
    from dcp_conformance.fuzz.generate.sequences import Sequences
    from dcp_conformance.fuzz.generate.sweep import SweepFirst

    where = target_of(options)
    if not (where.foreign or where.in_process or options["own_node"]):
        raise UsageError(
            "name the interface of the implementation (--interface IF or --link udp[:GROUP:PORT]); other "
            "interfaces are not used. --own-node starts the reference node on a separate link, --in-process one here"
        )
    described, _ = describe(where)
    options = {**options, "profile": options["profile"] or described.profile.name}
    codec, rng, mutator, recorded = material(options)
    size = 1 if differential else options["batch"]
    mode: Any = "differential" if differential else "live"
    if options["dry_run"]:
        drawn = SweepFirst(Sequences(codec, rng, NOBODY, mutator, recorded), codec)
        saved = SavedTarget(mode, "nothing")
        return write_tests(Campaign(codec, stack_target(codec), Batches(drawn, size), saved, options["seed"]), options)
    with open_target(where) as opened:
        opened.runner.prepare()
        target = LiveTarget(opened, rate=options["rate"] or RATE, differential=differential)
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
        reached: Counter[tuple[str, str]] = Counter()
        saved = SavedTarget(mode, target.name, options=_target_words(where, own_node=options["own_node"]))
        campaign = Campaign(
            codec,
            target,
            SweepFirst(Directed(sequences, reached), codec, done=done, size=_SWEPT_AT_ONCE)
            if differential
            else Batches(SweepFirst(sequences, codec, done=done), size),
            saved,
            options["seed"],
            mutator=mutator,
            reached_states=reached,
            model=None if differential else stack_target(codec),
            profile_text=profile_text(options),
            budget=200,
            seconds=_MINIMISING,
            by_cause=True,
            own_id=own_id,
        )
        if target.control is not None and target.control.can_restart:
            campaign.fresh = target.run_after_restart
        if differential:
            campaign.states = lambda: target.observer.reached if target.observer is not None else ()
        return run_campaign(campaign, options)


def _target_words(where: TargetOptions, *, own_node: bool) -> str:
    """Return the options that reach the implementation again, without its process id, which will differ."""
    words = shlex.split(dataclasses.replace(where, pid=None).command_line())[2:]
    return shlex.join([*words, *(["--own-node"] if own_node else [])])


_OWN_NODE = click.option("--own-node", is_flag=True, help="Start the reference node as a process on a separate link.")
#: Placeholder for an unknown node identifier.
NOBODY = b"\x02\x00\x00\x00\x00\x01"


@command.command("live", epilog=EXIT_STATUS)
@target_options
@_OWN_NODE
@click.option(
    "--batch",
    type=click.IntRange(1),
    default=20,
    metavar="N",
    help="Number of sequences between two checks.  [default: 20]",
)
@no_jobs
@campaign_options
def live_command(**options: Any) -> int:
    """Find inputs that crash or hang a live implementation.

    An implementation that stops sending is reported, too.

    Before the campaign the implementation must answer. With --start or --restart it is restarted after a crash;
    without them the campaign ends at the first one. --rate is in frames per second (default 500).
    """
    return _live(options, differential=False)


@command.command("differential", epilog=EXIT_STATUS)
@target_options
@_OWN_NODE
@no_jobs
@campaign_options
def differential_command(**options: Any) -> int:
    """Compare an implementation with a model.

    The model is independent of the reference node. Both get the same sequence of frames and, with an upper tester, of
    service calls. Then summaries, values, statuses and the neighbour table must agree, except where the specification
    leaves a choice. --rate is in frames per second (default 500).
    """
    return _live(options, differential=True)


@command.command(
    "replay",
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

    ARTEFACTS are files or folders. For artefacts of a live implementation, give its link and upper tester.
    """
    from dcp_conformance.fuzz.findings.artefact import found_in
    from dcp_conformance.fuzz.findings.replaying import replay, target_in_process

    statuses = []
    with contextlib.ExitStack() as stack:
        live = _live_target(options, stack)
        for path in found_in(list(artefacts)):
            found = replay(path, live or target_in_process, attempts=attempts)
            say(f"{found.status:6} {found.path}: {found.detail}")
            statuses.append(found.status)
    if "error" in statuses:
        return 4
    return 1 if {"failed", "flaky"} & set(statuses) else 0


def _live_target(options: dict[str, Any], stack: Any) -> Callable[[Artefact], Target] | None:
    """Return a function that opens the target of an artefact; None if no option names an SUT."""
    target = target_of(options)
    if not (target.foreign or target.in_process or options["own_node"]):
        return None
    from dcp_conformance.execution.target import open_target
    from dcp_conformance.fuzz.execute.live import LiveTarget
    from dcp_conformance.fuzz.findings.replaying import target_in_process

    opened = stack.enter_context(open_target(target))
    opened.runner.prepare()

    def made(artefact: Artefact) -> Target:
        if artefact.target.mode in ("codec", "stack"):
            return target_in_process(artefact)
        return LiveTarget(opened, differential=artefact.target.mode == "differential")

    return made
