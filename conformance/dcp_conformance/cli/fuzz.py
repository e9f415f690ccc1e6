"""``dcp-conformance fuzz``."""

from __future__ import annotations

import contextlib
import dataclasses
import random
import shlex
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from dcp_conformance.errors import UsageError

from .options import target_of, target_options

if TYPE_CHECKING:
    from dcp_codec.codec import Codec
    from dcp_conformance.fuzz import Artefact, Campaign, Limits
    from dcp_conformance.fuzz.coverage import Coverage
    from dcp_conformance.fuzz.steps import Target
    from dcp_conformance.target import TargetOptions

F = TypeVar("F", bound=Callable[..., Any])

EXIT_STATUS = (
    "Exit status: 0 nothing found; 1 findings; 2 wrong usage; 3 the implementation was not healthy to begin with, or "
    "did not come back; 4 the tester's own trouble; 130 stopped by Ctrl-C or SIGTERM, nothing found so far."
)
#: Tests that are written when nothing is said about how many.
_DRY_RUN = 1000
#: Seconds for minimising a finding of an implementation on the air.
_MINIMISING = 30.0
#: Exit status of what was stopped, as shells give it.
_STOPPED = 130


@click.group("fuzz", epilog=EXIT_STATUS)
def command() -> None:
    """Find inputs that break an implementation, and make them small.

    What is found is saved as an artefact (--artefacts DIR), which 'fuzz replay' does again, and 'run --artefacts DIR'
    takes as a conformance case.
    """


def campaign_options(function: F) -> F:
    """How long, how fast, what with, where to."""
    for option in reversed(
        [
            click.option(
                "--max-time", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Seconds.  [default: 60]"
            ),
            click.option("--max-cases", type=click.IntRange(1), metavar="N", help="Tests."),
            click.option("--max-findings", type=click.IntRange(1), metavar="N", help="Stop after so many findings."),
            click.option(
                "--rate", type=click.FloatRange(min=0, min_open=True), metavar="N", help="Tests in a second, at most."
            ),
            click.option(
                "--recording", type=click.Path(path_type=Path), multiple=True, metavar="FILE", help="Mutate this, too."
            ),
            click.option("--dry-run", is_flag=True, help="Write what would be sent to --out, and send nothing."),
            click.option(
                "--out", type=click.Path(path_type=Path), metavar="FILE", help="For --dry-run: .mcap, .pcap or .pcapng."
            ),
            click.option("--resume", is_flag=True, help="Go on with the campaign in --artefacts."),
            click.option(
                "--coverage",
                type=click.Path(path_type=Path),
                metavar="FILE",
                help="Write what was reached, how often, and what was not (JSON).",
            ),
            click.option("--artefacts", type=click.Path(path_type=Path), metavar="DIR", help="Where findings go."),
            click.option("--quiet", "-q", is_flag=True, help="Only the findings."),
        ]
    ):
        function = option(function)
    return function


_PROFILE = click.option("--profile", default="dcp-2.0", metavar="NAME|FILE", help="Wire profile.  [default: dcp-2.0]")
_SEED = click.option("--seed", type=int, default=1, metavar="N", help="For what is drawn by chance.  [default: 1]")


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
@campaign_options
def codec_command(parts: tuple[str, ...], **options: Any) -> int:
    """Fuzz our own functions in process.

    PARTS: beacon (decode, dissect, encode), capture (pcap, pcapng and MCAP readers), control (the control interface),
    profile and pics (loaders); all of them by default.
    """
    from dcp_conformance.fuzz.artefact import SavedTarget
    from dcp_conformance.fuzz.campaign import Campaign
    from dcp_conformance.fuzz.functions import PARTS, FunctionInputs, FunctionTarget

    if unknown := [part for part in parts if part not in PARTS]:
        raise UsageError(f"there is no part {unknown[0]!r}; there are {', '.join(PARTS)}")
    codec, rng, mutator, _ = _material(options)
    inputs = FunctionInputs(codec, rng, mutator, parts or PARTS)
    target = FunctionTarget(codec)
    try:
        saved = SavedTarget("codec", "functions in this process")
        campaign = Campaign(
            codec, target, inputs, saved, options["seed"], mutator=mutator, profile_text=_profile_text(options)
        )
        if options["engine"] == "atheris":
            from dcp_conformance.fuzz.engine import run_engine

            part = _only(parts)
            seeds = inputs.seeds(part)
            return _run(campaign, options, lambda limits: run_engine(campaign, part, options["profile"], seeds, limits))
        return _run(campaign, options)
    finally:
        target.close()


def _only(parts: tuple[str, ...]) -> str:
    """The one part for an engine that knows octets, not parts."""
    if len(parts) > 1:
        raise UsageError(f"--engine atheris fuzzes one part at a time, not {len(parts)}")
    return parts[0] if parts else "beacon"


@command.command("stack", epilog=EXIT_STATUS)
@_PROFILE
@_SEED
@click.option("--mutant", metavar="ID", help="A mutant of our node instead (see selftest).")
@click.option("--guided", is_flag=True, help="Keep inputs that reach new lines of the code (slower).")
@campaign_options
def stack_command(**options: Any) -> int:
    """Fuzz our own node in process, compared with an independent model after every step."""
    from dcp_conformance.fuzz.artefact import SavedTarget
    from dcp_conformance.fuzz.campaign import Campaign
    from dcp_conformance.fuzz.directed import Directed
    from dcp_conformance.fuzz.replaying import stack_target
    from dcp_conformance.fuzz.sequences import Sequences

    codec, rng, mutator, recorded = _material(options)
    target = stack_target(codec, options["mutant"] or "")
    reached: Counter[tuple[str, str]] = Counter()
    sequences = Directed(Sequences(codec, rng, target.own_id, mutator, recorded), reached)
    saved = SavedTarget("stack", target.name, options["mutant"] or "")
    campaign = Campaign(
        codec,
        target,
        sequences,
        saved,
        options["seed"],
        mutator=mutator,
        states=lambda: target.observer.reached,
        reached_states=reached,
        profile_text=_profile_text(options),
    )
    return _run(campaign, options)


def _live(options: dict[str, Any], *, differential: bool) -> int:
    """A campaign against an implementation that was opened as 'run' opens it."""
    from dcp_conformance.fuzz.artefact import SavedTarget
    from dcp_conformance.fuzz.batches import Batches
    from dcp_conformance.fuzz.campaign import Campaign
    from dcp_conformance.fuzz.directed import Directed
    from dcp_conformance.fuzz.live import RATE, LiveTarget, UnhealthyError
    from dcp_conformance.fuzz.replaying import stack_target
    from dcp_conformance.fuzz.sequences import Sequences
    from dcp_conformance.target import describe, open_target

    where = target_of(options)
    if not (where.foreign or where.in_process or options["own_node"]):
        raise UsageError(
            "name the interface that the implementation is on (--interface IF or --link udp[:GROUP:PORT]); nothing is "
            "sent on one that was not named. --own-node starts our own node on a link of its own, --in-process one here"
        )
    described, _ = describe(where)
    options = {**options, "profile": options["profile"] or described.profile.name}
    codec, rng, mutator, recorded = _material(options)
    size = 1 if differential else options["batch"]
    mode: Any = "differential" if differential else "live"
    if options["dry_run"]:
        drawn = Sequences(codec, rng, NOBODY, mutator, recorded)
        saved = SavedTarget(mode, "nothing")
        return _write(Campaign(codec, stack_target(codec), Batches(drawn, size), saved, options["seed"]), options)
    with open_target(where) as opened:
        opened.runner.prepare()
        target = LiveTarget(opened, rate=options["rate"] or RATE, differential=differential)
        options["rate"] = None
        # Also tells who it is: sequences are about its own identifier, too.
        try:
            target.prepare()
        except UnhealthyError as error:
            click.echo(f"dcp-conformance: {error}", err=True)
            return 3
        sequences = Sequences(codec, rng, opened.runner.session.sut_id or NOBODY, mutator, recorded)
        reached: Counter[tuple[str, str]] = Counter()
        saved = SavedTarget(mode, target.name, options=_target_words(where, own_node=options["own_node"]))
        campaign = Campaign(
            codec,
            target,
            Directed(sequences, reached) if differential else Batches(sequences, size),
            saved,
            options["seed"],
            mutator=mutator,
            reached_states=reached,
            model=None if differential else stack_target(codec),
            profile_text=_profile_text(options),
            budget=200,
            seconds=_MINIMISING,
            by_cause=not differential,
        )
        if target.control is not None and target.control.can_restart:
            campaign.fresh = target.run_afresh
        if differential:
            campaign.states = lambda: target.observer.reached if target.observer is not None else Counter()
        return _run(campaign, options)


def _target_words(where: TargetOptions, *, own_node: bool) -> str:
    """The options that reach the implementation again; its process has another number then."""
    words = shlex.split(dataclasses.replace(where, pid=None).command_line())[2:]
    return shlex.join([*words, *(["--own-node"] if own_node else [])])


_OWN_NODE = click.option("--own-node", is_flag=True, help="Our own node, as a process on a link of its own.")
#: Stands for the identifier of a node that is not known.
NOBODY = b"\x02\x00\x00\x00\x00\x01"


@command.command("live", epilog=EXIT_STATUS)
@target_options
@_OWN_NODE
@click.option(
    "--batch", type=click.IntRange(1), default=20, metavar="N", help="Sequences between looks.  [default: 20]"
)
@campaign_options
def live_command(**options: Any) -> int:
    """Fuzz an implementation on the air: does it crash, hang or go mute.

    It is asked whether it is healthy before anything is sent. With --start, --restart or --pid its process is watched
    and started again; without, the campaign ends with its death. --rate is in frames.
    """
    return _live(options, differential=False)


@command.command("differential", epilog=EXIT_STATUS)
@target_options
@_OWN_NODE
@campaign_options
def differential_command(**options: Any) -> int:
    """Compare an implementation with an independent model, round by round.

    Both get the same sequence of frames and, with an upper tester, of service calls; then summaries, values, statuses
    and the neighbour table must agree, within what the specification leaves open. --rate is in frames.
    """
    return _live(options, differential=True)


@command.command("replay", epilog=EXIT_STATUS)
@click.argument("artefacts", nargs=-1, required=True, type=click.Path(path_type=Path))
@target_options
@_OWN_NODE
@click.option("--attempts", type=click.IntRange(1), default=3, metavar="N", help="How often each.  [default: 3]")
def replay_command(artefacts: tuple[Path, ...], attempts: int, **options: Any) -> int:
    """Do findings again: fixed, failed, flaky or error for each.

    ARTEFACTS are files or folders. Those of live implementations need to be told where that is.
    """
    from dcp_conformance.fuzz.artefact import found_in
    from dcp_conformance.fuzz.replaying import replay, target_in_process

    statuses = []
    with contextlib.ExitStack() as stack:
        live = _live_target(options, stack)
        for path in found_in(list(artefacts)):
            found = replay(path, live or target_in_process, attempts=attempts)
            click.echo(f"{found.status:6} {found.path}: {found.detail}")
            statuses.append(found.status)
    if "error" in statuses:
        return 4
    return 1 if {"failed", "flaky"} & set(statuses) else 0


def _live_target(options: dict[str, Any], stack: Any) -> Callable[[Artefact], Target] | None:
    """How live artefacts reach the implementation; None if nothing was said about one."""
    target = target_of(options)
    if not (target.foreign or target.in_process or options["own_node"]):
        return None
    from dcp_conformance.fuzz.live import LiveTarget
    from dcp_conformance.fuzz.replaying import target_in_process
    from dcp_conformance.target import open_target

    opened = stack.enter_context(open_target(target))
    opened.runner.prepare()

    def made(artefact: Artefact) -> Target:
        if artefact.target.mode in ("codec", "stack"):
            return target_in_process(artefact)
        return LiveTarget(opened, differential=artefact.target.mode == "differential")

    return made


# -- what campaigns share --------------------------------------------------------------------------------------------


def _material(options: dict[str, Any]) -> tuple[Codec, random.Random, Any, list[bytes]]:
    """Codec, chance, mutator, and the beacons of recordings."""
    from dcp_spec.profile_loading import ProfileError

    from dcp_codec.codec import Codec
    from dcp_codec.mutation import Mutator, drawn_pool

    try:
        codec = Codec(options["profile"])
    except ProfileError as error:
        raise UsageError(str(error)) from None
    return codec, *_drawn(codec, options, Mutator, drawn_pool)


def _drawn(codec: Codec, options: dict[str, Any], mutator: Any, pool: Any) -> tuple[random.Random, Any, list[bytes]]:
    from dcp_conformance.fuzz.campaign import read_state
    from dcp_conformance.replay import beacons_of

    done = 0
    if options["resume"]:
        if options["artefacts"] is None:
            raise UsageError("--resume needs the folder of the campaign: --artefacts DIR")
        done = read_state(options["artefacts"]).cases
    # Going on means to draw something else than before.
    rng = random.Random(f"{options['seed']}/{done}")  # noqa: S311 - the same every time, no secret
    recorded: list[bytes] = []
    for path in options["recording"]:
        found = [heard.octets for _, heard, _ in beacons_of(path, codec)]
        if not found:
            raise UsageError(f"{path}: no frame in it is DCP in the profile {codec.profile.name}")
        recorded += found[:2000]
    return rng, mutator(codec, rng, pool(codec, rng, 200, recorded[:200])), recorded


def _profile_text(options: dict[str, Any]) -> str:
    path = Path(options["profile"])
    return path.read_text() if path.suffix == ".toml" and path.exists() else ""


def _limits(options: dict[str, Any]) -> Limits:
    from dcp_conformance.fuzz.campaign import Limits

    seconds = options["max_time"]
    if seconds is None and options["max_cases"] is None and options["max_findings"] is None:
        seconds = 60.0
    return Limits(seconds, options["max_cases"], options["max_findings"], options["rate"])


def _run(campaign: Campaign, options: dict[str, Any], run: Callable[[Limits], Any] | None = None) -> int:
    """Run a campaign, tell what happens, return the exit status. ``run``: what runs it, unless it does so itself."""
    from dcp_conformance.errors import LowerTesterError
    from dcp_conformance.fuzz.coverage import shown
    from dcp_conformance.fuzz.live import UnhealthyError

    if options["dry_run"]:
        return _write(campaign, options)
    if options["out"] is not None:
        raise UsageError("--out is for --dry-run; findings go to --artefacts DIR")
    campaign.directory = options["artefacts"]
    if options["resume"]:
        campaign.resume()
    if options.get("guided"):
        from dcp_conformance.fuzz.guidance import guide

        guide(campaign)
    quiet = options["quiet"]
    terminal = sys.stderr.isatty()

    def progress(now: Any) -> None:
        text = f"{now.cases} cases, {now.per_second:.0f}/s, {now.findings} findings, {now.seconds:.0f} s"
        if terminal:
            click.echo(f"\r{text}   ", nl=False, err=True)
        elif int(now.seconds) % 10 == 0:
            click.echo(text, err=True)

    def finding(artefact: Artefact) -> None:
        if terminal:
            click.echo("", err=True)
        kept = ", not made smaller" if not artefact.minimised else "" if artefact.confirmed else ", not seen again"
        click.echo(f"{artefact.id}: {artefact.effect.detail} ({artefact.frames} frames{kept})")
        if options["artefacts"] is not None:
            click.echo(f"  again: {artefact.command}")

    def effect(now: Any) -> None:
        if terminal:
            click.echo("", err=True)
        click.echo(f"{now.kind}: {now.detail}; making it small", err=True)

    campaign.on_progress = None if quiet else progress
    campaign.on_finding = finding
    campaign.on_effect = None if quiet else effect
    status = 0
    try:
        with _stopped_by_sigterm():
            (run or campaign.run)(_limits(options))
    except KeyboardInterrupt:
        click.echo("stopped", err=True)
        status = _STOPPED
    except UnhealthyError as error:
        click.echo(f"dcp-conformance: {error}", err=True)
        status = 3
    except LowerTesterError as error:
        click.echo(f"dcp-conformance: {error}", err=True)
        status = 4
    if terminal and not quiet:
        click.echo("", err=True)
    state = campaign.state
    if options["coverage"] is not None:
        _write_coverage(state.coverage, options["coverage"])
    if not quiet:
        for line in shown(state.coverage):
            click.echo(line)
        kinds = ", ".join(f"{name} {count}" for name, count in sorted(state.kinds.items()))
        click.echo(f"kinds: {kinds}")
        if state.again:
            click.echo(f"known findings have shown again {state.again} times")
        if state.left_out:
            avoided = ", ".join(state.avoided)
            click.echo(f"{state.left_out} frames were not sent, since they show known findings: {avoided}")
    click.echo(
        f"{state.cases} cases, {state.frames} frames, {state.seconds:.1f} s, {len(state.findings)} findings "
        f"({shlex.join(['--seed', str(campaign.seed)])})"
    )
    return 1 if state.findings else status


def _write_coverage(coverage: Coverage, path: Path) -> None:
    import msgspec

    try:
        path.write_bytes(msgspec.json.format(msgspec.json.encode(coverage), indent=1) + b"\n")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def _stopped_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end a campaign as Ctrl-C does: with everything saved, and what was started ended."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _write(campaign: Campaign, options: dict[str, Any]) -> int:
    """Write the frames of a campaign, and send nothing."""
    from dcp_codec.capture import CaptureError
    from dcp_conformance.fuzz.artefact import write_frames

    if options["out"] is None:
        raise UsageError("--dry-run writes what would be sent: say where to with --out FILE")
    steps = [step for _ in range(options["max_cases"] or _DRY_RUN) for step in campaign.generator.draw()]
    metadata = {"dcp.fuzz": {"profile": campaign.codec.profile.name, "seed": str(campaign.seed)}}
    suffix = options["out"].suffix
    try:
        frames = write_frames(options["out"], campaign.codec, steps, metadata if suffix == ".mcap" else {})
    except (CaptureError, OSError) as error:
        raise UsageError(f"{options['out']}: {error}") from None
    click.echo(f"{frames} frames written to {options['out']}; nothing was sent")
    return 0
