"""``dcp-codec decode``: show the decoded beacons."""

from __future__ import annotations

import re
import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from typing import Any, Protocol

import click

from dcp_codec.capture import Frame
from dcp_codec.common.commandline import ExpectedError, SectionedCommand, choice_option, output_format
from dcp_codec.framing.frames import DissectedFrame, FrameDissector
from dcp_codec.framing.locate import OtherTraffic

from .common import (
    MALFORMED,
    Output,
    choose,
    dissector_of,
    dissector_of_guess,
    each_file,
    listening,
    load_codec,
    malformed_note,
    no_beacons_note,
    note,
    note_guess,
    open_input,
    profile_options,
    progress,
    report_capture_problems,
    use_colour,
)
from .filters import FrameRange, condition, selection_options
from .lines import CsvRenderer, JsonlRenderer, ListRenderer
from .tree import TreeRenderer

#: Number of malformed frames that are also listed on stderr, where a pipe does not hide them.
_NAMED = 5


#: The profile of live traffic is decided by this number of beacons, or after this number of frames.
_FIRST_BEACONS, _FIRST_FRAMES = 3, 100


class _Renderer(Protocol):
    def render(self, frame: DissectedFrame) -> str: ...


@click.command(
    "decode",
    cls=SectionedCommand,
    sections={
        "Input": "hex_text interface profile ether_type",
        "Selection": "where frames start end errors_only count",
        "Output": "form hexdump clock color",
    },
    epilog="FILE is an MCAP, pcap or pcapng recording, or - for standard input. Exit status: 0 all good, 1 malformed "
    "DCP frames were seen, 2 wrong usage or input that could not be read to its end.",
)
@click.argument("files", nargs=-1, metavar="FILE...")
@click.option("--hex", "hex_text", metavar="HEX", help="Decode these octets: a whole Ethernet frame or a bare beacon.")
@click.option(
    "-i", "--interface", metavar="IF", help="Decode the frames on this Ethernet interface until Ctrl-C (needs scapy)."
)
@profile_options
@output_format(
    *("tree", "list", "csv", "jsonl"),
    help="Output: a tree of fields, one line per frame, one row per record, or one JSON object per frame.",
)
@selection_options
@click.option("--errors-only", is_flag=True, help="Only malformed beacons.")
@click.option("-c", "--count", type=click.IntRange(min=1), metavar="N", help="End after N shown frames.")
@click.option("--hexdump/--no-hexdump", default=True, show_default=True, help="Show the octets below each tree.")
@choice_option("--time", "clock", of=["utc", "epoch", "relative"], help="Times in the list.")
@choice_option("--color", of=["auto", "always", "never"], help="Colour the output; auto: on a terminal.")
def command(
    files: tuple[str, ...],
    hex_text: str | None,
    interface: str | None,
    profile: str,
    ether_type: int | None,
    **options: Any,
) -> int:
    """Show every beacon, state report and variable instruction of recordings, and all errors in them.

    Without --profile the wire profile is detected and reported on stderr.
    """
    given = bool(files) + (hex_text is not None) + (interface is not None)
    if given != 1:
        raise click.UsageError("give recordings, or --hex HEX, or --interface IF (exactly one of them)")
    run = _Run(profile, ether_type, options)
    if hex_text is not None:
        return run.hex(hex_text)
    if interface is not None:
        return run.live(interface)
    return each_file(files, lambda name: 0 if run.enough else run.file(name))


class _Run:
    def __init__(self, profile: str, ether_type: int | None, options: dict[str, Any]) -> None:
        self.profile = profile
        self.ether_type = ether_type
        self.options = options
        self.output = Output()
        self.range = FrameRange(options["frames"], options["start"], options["end"])
        self.shown = 0
        self._heading_done = False

    @property
    def enough(self) -> bool:
        """Return whether --count frames were shown."""
        limit = self.options["count"]
        return limit is not None and self.shown >= limit

    def renderer(self, dissector: FrameDissector) -> _Renderer:
        form = self.options["form"]
        colour = use_colour(self.options["color"])
        columns = shutil.get_terminal_size().columns
        if form == "jsonl":
            return JsonlRenderer()
        if form == "list":
            return ListRenderer(
                width=columns if sys.stdout.isatty() else None,
                colour=colour,
                time=self.options["clock"],
                origin=lambda: self.range.origin,
            )
        if form == "csv":
            renderer = CsvRenderer(dissector.codec)
            if not self._heading_done:
                self.output.write(renderer.heading())
                self._heading_done = True
            return renderer
        width = columns if sys.stdout.isatty() else 120
        return TreeRenderer(width=width, colour=colour, hexdump=self.options["hexdump"])

    def file(self, name: str) -> int:
        """Decode one recording; return its exit status."""
        with open_input(name) as reader:
            dissector, frames = choose(self.profile, self.ether_type, iter(reader), name)
            show = not sys.stdout.isatty()
            with progress(reader, name, show=show) as advance:
                status = self.frames(dissector, frames, name, advance)
            return max(status, report_capture_problems(reader, name))

    def frames(self, dissector: FrameDissector, frames: Iterator[Frame], name: str, advance: Any) -> int:
        renderer, before = self.renderer(dissector), self.shown
        wanted = condition(self.options["where"], dissector.codec)
        others: Counter[str] = Counter()
        beacons, malformed = 0, 0
        examples: list[str] = []
        try:
            for frame in frames:
                advance()
                included = self.range.includes(frame)
                found = dissector.dissect(frame)
                if isinstance(found, OtherTraffic):
                    others[f"0x{found.ether_type:04x}" if found.ether_type is not None else found.reason] += 1
                    continue
                beacons += 1
                errors = found.dissection.errors
                if not included or (self.options["errors_only"] and not errors):
                    continue
                if wanted is not None and not wanted(found):
                    continue
                if errors:
                    malformed += 1
                    if malformed <= _NAMED:
                        examples.append(f"{name}: frame {frame.number}: {errors[0]}")
                self.output.write(renderer.render(found))
                self.shown += 1
                if self.enough:
                    break
        finally:
            self.output.flush()
        for example in examples:
            note(example)
        if malformed:
            malformed_note(name, malformed, beacons)
        if not beacons:
            no_beacons_note(name, others.total(), dict(others.most_common()), dissector.link)
        elif self.shown == before:
            note(f"{name}: none of {beacons} DCP frames matches the options")
        return MALFORMED if malformed else 0

    def hex(self, text: str) -> int:
        """Decode the octets given on the command line."""
        cleaned = re.sub(r"0x|[\s:,-]", "", text)
        try:
            octets = bytes.fromhex(cleaned)
        except ValueError:
            raise ExpectedError(f"--hex: {text[:60]!r} is not a string of hex octets") from None
        if not octets:
            raise ExpectedError("--hex: no octets to decode")
        from dcp_codec.analysis.guess import guess, looks_bare

        names = () if self.profile == "auto" else (self.profile,)
        if names:
            load_codec(self.profile)
        frame = Frame(number=1, time_ns=0, data=octets, orig_len=len(octets))
        is_bare = looks_bare(octets, names) if names else looks_bare(octets)
        note("--hex: taken as a " + ("bare beacon" if is_bare else "whole Ethernet frame"))
        if names:
            dissector = dissector_of(self.profile, self.ether_type)
        else:
            found = guess([frame], framed=not is_bare, ether_type=self.ether_type)
            note(f"--hex: profile {found}")
            dissector = dissector_of_guess(found)
        result = dissector.dissect_bare(frame) if is_bare else dissector.dissect(frame)
        if isinstance(result, OtherTraffic):
            kind = (
                "shorter than an Ethernet header"
                if result.ether_type is None
                else f"EtherType 0x{result.ether_type:04x} at octet 12"
            )
            raise ExpectedError(f"--hex: no DCP frame: {kind}; try --ether-type N or another --profile")
        self.output.write(self.renderer(dissector).render(result))
        self.output.flush()
        return MALFORMED if result.dissection.errors else 0

    def live(self, interface: str) -> int:
        """Decode live traffic until interrupted or --count frames were shown."""
        link = None if self.profile == "auto" else dissector_of(self.profile, self.ether_type).link
        with listening(interface, link) as reader:
            note(f"{interface}: listening; Ctrl-C ends")
            return self._live_frames(reader, interface)

    def _live_frames(self, reader: Any, interface: str) -> int:
        class Flushing(Output):
            def write(self, text: str) -> None:
                super().write(text)
                self.flush()

        self.output = Flushing()
        if self.profile != "auto":
            return self.frames(dissector_of(self.profile, self.ether_type), iter(reader), interface, lambda: None)
        # Live traffic cannot be read ahead for long: the first beacons decide, whatever other frames precede them.
        from dcp_codec.analysis.guess import guess

        frames = iter(reader)
        first: list[Frame] = []
        found = guess(first, ether_type=self.ether_type)
        while found.best.decoded < _FIRST_BEACONS and len(first) < _FIRST_FRAMES:
            frame = next(frames, None)
            if frame is None:
                break
            first.append(frame)
            found = guess(first, ether_type=self.ether_type)
        frames = chain(first, frames)
        note_guess(interface, found)
        return self.frames(dissector_of_guess(found), frames, interface, lambda: None)
