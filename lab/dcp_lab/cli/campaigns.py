"""Common parts of the campaigns of ``dcp-conformance fuzz``: options, initial state, and progress output."""

from __future__ import annotations

import random
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from dcp_conformance.cli.options import F, applied
from dcp_conformance.errors import UsageError

from dcp_codec.common.commandline import path_option, say

if TYPE_CHECKING:
    from dcp_codec.codec import Codec
    from dcp_lab.fuzz import Artefact, Campaign, Limits
    from dcp_lab.fuzz.findings.replaying import Replayed
    from dcp_lab.fuzz.generate.coverage import Coverage
    from dcp_lab.fuzz.steps import Generator

#: Default number of tests that ``--dry-run`` writes.
_DRY_RUN = 1000
#: Value of ``--coverage`` without a file.
SHOWN = ""
#: Exit status of a campaign that was stopped by a signal, as in shells.
_STOPPED = 130


def campaign_options(function: F) -> F:
    """Add the common options of campaigns: limits, rate, recordings, dry run, coverage and output."""
    return applied(
        function,
        [
            click.option(
                "--max-time",
                type=click.FloatRange(min=0, min_open=True),
                metavar="S",
                help="End after S seconds.  [default: 60, without another limit]",
            ),
            click.option("--max-cases", type=click.IntRange(1), metavar="N", help="End after N tests."),
            click.option("--max-findings", type=click.IntRange(1), metavar="N", help="End after N findings."),
            click.option(
                "--rate", type=click.FloatRange(min=0, min_open=True), metavar="N", help="Maximum tests per second."
            ),
            path_option("--recording", multiple=True, metavar="FILE", help="Also mutate the frames of this recording."),
            path_option(
                "--dry-run",
                metavar="FILE",
                help="Write the frames to a recording (.mcap, .pcap or .pcapng) instead of sending them.",
            ),
            click.option("--resume", is_flag=True, help="Continue the campaign in --artefacts."),
            click.option(
                "--coverage",
                is_flag=False,
                flag_value=SHOWN,
                metavar="[FILE]",
                help="Show the coverage of the inputs; also write it to FILE (JSON).",
            ),
            path_option("--artefacts", metavar="DIR", help="Write findings to this folder."),
            click.option("--quiet", "-q", is_flag=True, help="Show only findings."),
        ],
    )


def material(options: dict[str, Any], seed: str | None = None) -> tuple[Codec, random.Random, Any, list[bytes]]:
    """Return codec, random generator, mutator, and the beacons of the recordings.

    ``seed`` is that of one process of several; the pool of messages to mutate is the same for all processes of a
    campaign. Raise ``UsageError`` for an unusable profile or recording.
    """
    from dcp_spec.profile.loading import ProfileError
    from dcp_spec.profile.usability import refusal

    from dcp_codec.codec import Codec
    from dcp_lab.testing.mutation import Mutator, drawn_pool

    try:
        codec = Codec(options["profile"])
    except ProfileError as error:
        raise UsageError(str(error)) from None
    if (reason := refusal(codec.profile)) is not None:
        raise UsageError(reason)
    chance = _chance(options)
    recorded = _recorded(codec, options)
    pool = drawn_pool(codec, chance, 200, recorded[:200])
    if seed is not None:
        chance = random.Random(seed)  # noqa: S311 - reproducible, not a secret
    return codec, chance, Mutator(codec, chance, pool), recorded


def _chance(options: dict[str, Any]) -> random.Random:
    from dcp_lab.fuzz.campaign import read_state

    done = 0
    if options["resume"]:
        if options["artefacts"] is None:
            raise UsageError("--resume needs the folder of the campaign: --artefacts DIR")
        done = read_state(options["artefacts"]).cases
    # A resumed campaign must not repeat its earlier draws.
    return random.Random(f"{options['seed']}/{done}")  # noqa: S311 - reproducible, not a secret


def swept(options: dict[str, Any]) -> int:
    """Return the number of sweep tests that the resumed campaign has executed."""
    from dcp_lab.fuzz.campaign import read_state
    from dcp_lab.fuzz.generate.sweep import NAME

    return read_state(options["artefacts"]).kinds.get(NAME, 0) if options["resume"] else 0


def _recorded(codec: Codec, options: dict[str, Any]) -> list[bytes]:
    from dcp_conformance.execution.replay import beacons_of

    recorded: list[bytes] = []
    for path in options["recording"]:
        found = [heard.octets for _, heard, _ in beacons_of(path, codec)]
        if not found:
            raise UsageError(f"{path}: has no frame of DCP in the profile {codec.profile.name}")
        recorded += found[:2000]
    return recorded


def profile_text(options: dict[str, Any]) -> str:
    """Return the text of the user's profile file; empty for a built-in profile."""
    path = Path(options["profile"])
    return path.read_text() if path.suffix == ".toml" and path.exists() else ""


def _limits(options: dict[str, Any]) -> Limits:
    from dcp_lab.fuzz.campaign import Limits

    seconds = options["max_time"]
    if seconds is None and options["max_cases"] is None and options["max_findings"] is None:
        seconds = 60.0
    return Limits(seconds, options["max_cases"], options["max_findings"], options["rate"])


def run_campaign(campaign: Campaign, options: dict[str, Any], *, run: Callable[[Limits], Any] | None = None) -> int:
    """Run a campaign with progress output; return the exit status. ``run`` replaces ``campaign.run``."""
    from dcp_conformance.errors import LowerTesterError, WorkerError

    from dcp_codec.common.signals import ending_like_interrupts
    from dcp_lab.fuzz.execute.live import NotAliveError
    from dcp_lab.fuzz.findings.description import headline

    if options["dry_run"]:
        return write_tests(campaign.codec, campaign.generator, options)
    campaign.directory = options["artefacts"]
    if options["resume"]:
        campaign.resume()
    if campaign.directory is not None:
        from dcp_conformance.reporting import make_folder

        make_folder(campaign.directory)
    quiet = options["quiet"]
    terminal = sys.stderr.isatty()

    def progress(now: Any) -> None:
        rate = f"{now.per_second:.{0 if now.per_second >= 10 else 1}f}/s"
        text = f"{now.cases} cases, {rate}, {now.findings} findings, {now.seconds:.0f} s"
        if terminal:
            click.echo(f"\r{text}   ", nl=False, err=True)
        elif int(now.seconds) % 10 == 0:
            click.echo(text, err=True)

    def finding(artefact: Artefact) -> None:
        if terminal:
            click.echo("", err=True)
        say(headline(artefact))

    def effect(now: Any) -> None:
        if terminal:
            click.echo("", err=True)
        say(f"{now.kind}: {now.detail}; minimising it", err=True)

    campaign.on_progress = None if quiet else progress
    campaign.on_finding = finding
    campaign.on_effect = None if quiet else effect
    status = 0
    try:
        # The campaign saves its state, and ends the processes that it started.
        with ending_like_interrupts():
            (run or campaign.run)(_limits(options))
    except KeyboardInterrupt:
        click.echo("stopped", err=True)
        status = _STOPPED
    except NotAliveError as error:
        say(f"dcp-conformance: {error}", err=True)
        status = 3
    except (LowerTesterError, WorkerError) as error:
        say(f"dcp-conformance: {error}", err=True)
        status = 4
    if terminal and not quiet:
        click.echo("", err=True)
    try:
        if options["coverage"] not in (None, SHOWN):
            _write_coverage(campaign.state.coverage, Path(options["coverage"]))
    finally:
        # Also if the file cannot be written: the findings of a long campaign must not be lost.
        _print_end(campaign, quiet=quiet, coverage=options["coverage"] is not None)
    return 1 if campaign.state.findings else status


def _print_end(campaign: Campaign, *, quiet: bool, coverage: bool) -> None:
    """Print the number of executed tests and, at the end, the findings."""
    from dcp_lab.fuzz.findings.description import summary_lines
    from dcp_lab.fuzz.generate.coverage import shown

    state = campaign.state
    if coverage:
        for line in shown(state.coverage):
            click.echo(line)
        click.echo(f"sequences: {', '.join(f'{name} {count}' for name, count in sorted(state.kinds.items()))}")
    if not quiet:
        if state.again:
            click.echo(f"known findings occurred again {state.again} times")
        if state.left_out:
            click.echo(f"{state.left_out} frames were not sent, because they cause known findings:")
            for each in state.avoided:
                say(f"  {each}")
    for line in summary_lines(campaign):
        say(line)
    click.echo(
        f"{state.cases} cases, {state.frames} frames, {state.seconds:.1f} s, {len(state.findings)} findings "
        f"({shlex.join(['--seed', str(campaign.seed)])})"
    )


def _write_coverage(coverage: Coverage, path: Path) -> None:
    import msgspec

    try:
        path.write_bytes(msgspec.json.format(msgspec.json.encode(coverage), indent=1) + b"\n")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


def write_tests(codec: Codec, generator: Generator, options: dict[str, Any]) -> int:
    """Write the frames of a generator's first tests to the file of ``--dry-run``. Return the exit status."""
    from dcp_codec.capture import CaptureError
    from dcp_lab.fuzz.findings.artefact import write_frames

    path = options["dry_run"]
    steps = [step for _ in range(options["max_cases"] or _DRY_RUN) for step in generator.draw()]
    metadata = {"dcp.fuzz": {"profile": codec.profile.name, "seed": str(options["seed"])}}
    try:
        frames = write_frames(path, codec, steps, metadata if path.suffix == ".mcap" else {})
    except (CaptureError, OSError) as error:
        raise UsageError(f"{path}: {error}") from None
    click.echo(f"{frames} frames written to {path}; nothing was sent")
    return 0


def say_replayed(found: Replayed) -> None:
    """Print the result of the replay of an artefact."""
    say(f"{found.status:6} {found.path}: {found.detail}")
