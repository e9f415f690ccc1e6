"""Shared parts of the subcommands: options, opening of input, choice of the profile, messages about problems."""

from __future__ import annotations

import os
import shlex
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
from dcp_spec.profile.definition import Link
from dcp_spec.profile.loading import ProfileError

from dcp_codec.capture import FORMATS, CaptureError, CaptureReader, Frame, open_capture
from dcp_codec.codec import Codec, get_codec
from dcp_codec.common.commandline import ETHER_TYPE_HELP, UNUSABLE, ExpectedError, F, expected
from dcp_codec.framing.ethertype import parse_ether_type
from dcp_codec.framing.frames import FrameDissector, with_ether_type

from . import main

if TYPE_CHECKING:
    from dcp_codec.analysis.guess import Guess
    from dcp_codec.network.live import LiveReader

MALFORMED = 1


#: Write a message to stderr, so that piped output stays undisturbed.
note = main.note


def ether_type(_ctx: click.Context, _param: click.Parameter, value: str | None) -> int | None:
    """Parse an EtherType; see :mod:`dcp_codec.framing.ethertype` for the rule."""
    try:
        return None if value is None else parse_ether_type(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def ether_type_option(help: str = ETHER_TYPE_HELP) -> Callable[[F], F]:
    """Return the option ``--ether-type``."""
    return click.option("--ether-type", callback=ether_type, metavar="HEX", help=help)


def profile_options(function: F) -> F:
    """Add the options ``--profile`` and ``--ether-type``."""
    function = ether_type_option()(function)
    return click.option(
        "-p",
        "--profile",
        default="auto",
        show_default=True,
        metavar="NAME|FILE|auto",
        help="Wire profile: a name ('dcp-codec profiles' lists them), a TOML file, or auto to detect it.",
    )(function)


def recording_format(text: str = "Format of the output.  [default: by the suffix of --out]") -> Callable[[F], F]:
    """Return the option ``--format`` of a recording that the command writes; ``text`` is its help."""
    return click.option("-f", "--format", "form", type=click.Choice(sorted(FORMATS)), help=text)


def load_codec(profile: str) -> Codec:
    """Return the codec of a named profile or profile file."""
    with expected(ProfileError):
        return get_codec(profile)


def link_of(codec: Codec, ether_type: int | None) -> Link:
    """Return the EtherType or UDP port of beacons: the profile's, or the EtherType that the user gave."""
    link = codec.profile.link
    return link if ether_type is None else with_ether_type(link, ether_type)


def dissector_of(profile: str, ether_type: int | None) -> FrameDissector:
    """Return the dissector of a named profile or profile file."""
    codec = load_codec(profile)
    return FrameDissector(codec, link_of(codec, ether_type))


def dissector_of_guess(found: Guess) -> FrameDissector:
    """Return the dissector of the profile that was guessed."""
    return FrameDissector(get_codec(found.best.profile.name), found.best.link, found.warning)


class InputError(ExpectedError):
    """One input cannot be read; other inputs may be readable."""


def each_file(files: Sequence[str], do: Callable[[str], int]) -> int:
    """Call ``do`` for every file and continue after one that cannot be read; return the worst exit status."""
    status = 0
    for name in files:
        try:
            status = max(status, do(name))
        except InputError as error:
            note(str(error))
            status = max(status, error.status)
    return status


@contextmanager
def open_input(name: str) -> Iterator[CaptureReader]:
    """Open a capture file, or standard input for ``-``."""
    try:
        with open_capture(sys.stdin.buffer if name == "-" else Path(name)) as reader:
            yield reader
    except CaptureError as error:
        raise InputError(str(error)) from None


def note_guess(name: str, found: Guess) -> None:
    """Report which profile was guessed, and whether the guess is weak."""
    note(f"{name}: profile {found}")
    if found.warning is not None:
        note(f"{name}: {found.warning}: dcp-codec guess {shlex.quote(name)} shows what it does not explain")


def choose(
    profile: str, ether_type: int | None, frames: Iterator[Frame], name: str
) -> tuple[FrameDissector, Iterator[Frame]]:
    """Return the dissector for a recording, and an iterator over all its frames (the first ones decide on the
    profile).
    """
    if profile != "auto":
        return dissector_of(profile, ether_type), frames
    from dcp_codec.analysis.guess import guess, sample

    first, frames = sample(frames, ether_type=ether_type)
    found = guess(first, ether_type=ether_type)
    note_guess(name, found)
    return dissector_of_guess(found), frames


def report_capture_problems(reader: CaptureReader, name: str) -> int:
    """Report the problems of a capture file itself; return the exit status for them."""
    for problem in reader.problems:
        note(f"{name}: {problem.message}")
    return UNUSABLE if reader.problems else 0


@contextmanager
def interruptible(target: str | Path) -> Iterator[None]:
    """While a whole file is written, end on SIGTERM as on Ctrl-C: report it, and leave no partial file."""

    def stop(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    except KeyboardInterrupt:
        note(f"interrupted; {target} was not written" if str(target) != "-" else "interrupted")
        raise
    finally:
        signal.signal(signal.SIGTERM, before)


def malformed_note(name: str, malformed: int, beacons: int) -> None:
    """Report the number of malformed DCP frames; if all are malformed, suggest another profile."""
    hint = "" if malformed < beacons else f"; another --profile? dcp-codec guess {shlex.quote(name)} ranks them"
    note(f"{name}: {malformed} of {beacons} DCP frames are malformed{hint}")


def no_beacons_note(name: str, frames: int, others: dict[str, int], link: Link) -> None:
    """Report that none of the ``frames`` is DCP and suggest options, or that the file has no frames.

    ``others`` counts the frames by kind, as far as the kind is known.
    """
    if not frames:
        note(f"{name}: no DCP frames: the file has no frames")
        return
    listed = ", ".join(f"{kind} ({count})" for kind, count in list(others.items())[:6]) or f"{frames} other frames"
    wanted = f"UDP port {link.udp_port}" if link.transport == "udp" else f"EtherType 0x{link.ether_type:04x}"
    note(f"{name}: no DCP frames under {wanted}; there is: {listed}. Try --ether-type N or another --profile.")


@contextmanager
def progress(reader: CaptureReader, name: str, *, show: bool = True) -> Iterator[Callable[[], None]]:
    """Show a progress bar on stderr for long files on a terminal; yields the function to call after every frame."""
    size = reader.size
    if not show or not sys.stderr.isatty() or size is None or size < 4_000_000:
        yield lambda: None
        return
    with progress_bar(os.path.basename(name), size) as update:  # noqa: PTH119 - may be "-"
        calls = 0

        def advance() -> None:
            nonlocal calls
            calls += 1
            if not calls % 512:
                update(completed=reader.position)

        yield advance


@contextmanager
def progress_bar(name: str, size: int | None) -> Iterator[Callable[..., None]]:
    """Show a progress bar of octets on stderr; yields the function that updates it, which is that of rich."""
    from rich.console import Console
    from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
        yield partial(bar.update, bar.add_task(name, total=size))


@contextmanager
def listening(interface: str, link: Link | None) -> Iterator[LiveReader]:
    """Open an interface for reading until a signal ends it; then report the frames that were lost."""
    from dcp_codec.network.live import LiveError, LiveReader

    with expected(LiveError), LiveReader(interface, link) as reader:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: reader.close())
        yield reader
        if reader.dropped:
            note(f"{interface}: the kernel dropped {reader.dropped} frames that were not read in time")


def use_colour(choice: str) -> bool:
    """Return whether to colour standard output: as asked, or on a terminal unless NO_COLOR is set."""
    if choice != "auto":
        return choice == "always"
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR")


class Output:
    """Standard output, written in large pieces if it is not a terminal."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._size = 0
        self._immediate = sys.stdout.isatty()

    def write(self, text: str) -> None:
        """Write one or more whole lines (without the last line feed)."""
        self._lines.append(text)
        self._size += len(text)
        if self._immediate or self._size > 1 << 16:
            self.flush()

    def flush(self) -> None:
        """Write all buffered output now."""
        if self._lines:
            sys.stdout.write("\n".join(self._lines) + "\n")
            self._lines.clear()
            self._size = 0
        sys.stdout.flush()
