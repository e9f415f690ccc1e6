"""``dcp-selftest fuzz``: our own code in process, by one or several processes."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from dcp_conformance.errors import UsageError
from dcp_lab.cli.campaigns import campaign_options, material, profile_text, run_campaign, say_replayed, swept

from dcp_codec.common.commandline import PROFILE_HELP

if TYPE_CHECKING:
    from dcp_lab.fuzz import Campaign

    from dcp_selftest.fuzz.worker import Make

EXIT_STATUS = (
    "Exit status: 0 nothing found; 1 findings; 2 wrong usage; 4 a fault of the tester; 130 stopped by Ctrl-C or "
    "SIGTERM without a finding."
)


@click.group("fuzz", epilog=EXIT_STATUS)
def command() -> None:
    """Find inputs that break the reference node or functions of ours in this process, and minimise them.

    Each finding is saved as an artefact (--artefacts DIR). 'fuzz replay' repeats it.
    """


class _Jobs(click.IntRange):
    """Parse a number of processes; ``auto`` means one for each processor available to this process."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return len(os.sched_getaffinity(0)) if value == "auto" else super().convert(value, param, ctx)


_JOBS = click.option(
    "--jobs",
    "-j",
    type=_Jobs(1, 256),
    default=1,
    metavar="N|auto",
    help="Number of concurrent processes; auto: one for each processor.  [default: 1]",
)
_GUIDED = click.option("--guided", is_flag=True, help="Keep inputs that reach new lines of the code (slower).")
_PROFILE = click.option(
    "-p", "--profile", default="dcp-2.0", metavar="NAME|FILE", help=PROFILE_HELP + "  [default: dcp-2.0]"
)
_SEED = click.option("--seed", type=int, default=1, metavar="N", help="Random seed.  [default: 1]")


@command.command("codec", epilog=EXIT_STATUS)
@click.argument("parts", nargs=-1)
@_PROFILE
@_SEED
@_GUIDED
@click.option(
    "--engine",
    type=click.Choice(["own", "atheris"]),
    default="own",
    help="atheris: libFuzzer, guided by branches, for one part (pip install atheris).  [default: own]",
)
@_JOBS
@campaign_options
def codec_command(parts: tuple[str, ...], **options: Any) -> int:
    """Fuzz our own functions in process.

    PARTS: beacon (decode, dissect, encode), capture (pcap, pcapng and MCAP readers), control (the control interface),
    profile and pics (loaders); all of them by default.
    """
    from dcp_selftest.fuzz.functions import PARTS, FunctionInputs

    if options["coverage"] in PARTS:
        raise UsageError(f"--coverage {options['coverage']}: this would be the name of a file; put --coverage last")
    if unknown := [part for part in parts if part not in PARTS]:
        raise UsageError(f"unknown part {unknown[0]!r}; the parts are {', '.join(PARTS)}")
    if options["engine"] == "own":
        make = partial(codec_campaign, parts or PARTS, options)
        with make() as campaign:
            return _run(campaign, options, make)
    if options["jobs"] > 1:
        raise UsageError("--engine atheris uses one process: leave out --jobs")
    from dcp_selftest.fuzz.atheris_engine import run_engine

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
    from dcp_lab.fuzz.campaign import Campaign
    from dcp_lab.fuzz.findings.artefact import SavedTarget

    from dcp_selftest.fuzz.functions import FunctionInputs, FunctionTarget

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
@click.option("--mutant", metavar="ID", help="Fuzz a mutant of the reference node instead.")
@_GUIDED
@_JOBS
@campaign_options
def stack_command(**options: Any) -> int:
    """Find inputs that crash, hang or silence the reference node in process.

    'dcp-conformance fuzz model --in-process' compares it with the model of a node.
    """
    make = partial(stack_campaign, options)
    with make() as campaign:
        return _run(campaign, options, make)


@contextlib.contextmanager
def stack_campaign(options: dict[str, Any], seed: str | None = None) -> Iterator[Campaign]:
    """Return the campaign of ``fuzz stack``; ``seed`` is that of a worker."""
    from dcp_lab.fuzz.campaign import Campaign
    from dcp_lab.fuzz.findings.artefact import SavedTarget
    from dcp_lab.fuzz.generate.sequences import Sequences
    from dcp_lab.fuzz.generate.sweep import SweepFirst

    from dcp_selftest.fuzz.lifetimes import Lifetimes
    from dcp_selftest.fuzz.targets import stack_target

    codec, rng, mutator, recorded = material(options, seed)
    target = stack_target(codec, options["mutant"] or "")
    # Each worker executes the whole sweep, which takes a tenth of a second.
    sequences = SweepFirst(Sequences(codec, rng, target.own_id, mutator, recorded), codec, done=swept(options))
    saved = SavedTarget("stack", target.name, options["mutant"] or "")
    yield Campaign(
        codec,
        target,
        Lifetimes(sequences),
        saved,
        options["seed"],
        mutator=mutator,
        profile_text=profile_text(options),
    )


def _run(campaign: Campaign, options: dict[str, Any], make: Make) -> int:
    """Run a campaign, by several processes with ``--jobs``; ``make`` creates it in a worker. Return the exit status."""
    # Do not start workers without a test.
    jobs = min(options["jobs"], options["max_cases"] or options["jobs"])
    if options["dry_run"] and options["jobs"] > 1:
        raise UsageError("--dry-run writes the frames of one process: leave out --jobs")
    if jobs > 1:
        from dcp_selftest.fuzz.workers import run_in_workers

        run = partial(run_in_workers, campaign, make, jobs, guided=options["guided"])
        return run_campaign(campaign, options, run=run)
    if options["guided"]:
        from dcp_selftest.fuzz.guidance import guide

        guide(campaign)
    return run_campaign(campaign, options)


@command.command(
    "replay",
    epilog="Exit status: 0 every finding is fixed; 1 a finding failed again, or is flaky; 2 wrong usage; 4 a finding "
    "could not be repeated, or a fault of the tester.",
)
@click.argument("artefacts", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--attempts",
    type=click.IntRange(1),
    default=3,
    metavar="N",
    help="Number of attempts for each finding.  [default: 3]",
)
def replay_command(artefacts: tuple[Path, ...], attempts: int) -> int:
    """Repeat findings in our own code, and print the result of each.

    The result is fixed, failed, flaky or error. ARTEFACTS are files or folders.
    """
    from dcp_lab.fuzz.findings.artefact import found_in
    from dcp_lab.fuzz.findings.replaying import replay_all

    from dcp_selftest.fuzz.targets import target_in_process

    return replay_all(found_in(list(artefacts)), target_in_process, attempts=attempts, on_result=say_replayed)
