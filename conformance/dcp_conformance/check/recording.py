"""From a file to a verdict."""

from __future__ import annotations

import itertools
import statistics
from pathlib import Path

import msgspec
from dcp_spec.profile_loading import ProfileError

from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.codec import Codec
from dcp_codec.commandline import say
from dcp_codec.ethertype import parse_ether_type
from dcp_codec.frames import with_ether_type
from dcp_codec.framing import OtherTraffic, locate
from dcp_codec.guess import Guess, guess, sample
from dcp_conformance.errors import UsageError
from dcp_conformance.heard import Heard
from dcp_conformance.pics import Pics
from dcp_conformance.results import RunResult

from .judge import Judge

#: Frames from which the beacon period is taken, and intervals of a sender that this needs.
_LOOKED_AT, _ENOUGH = 5_000, 10


def judge_recording(
    path: Path,
    profile: str | None,
    pics: Pics,
    *,
    ether_type: str | None = None,
    command: str = "",
    period_known: bool = False,
) -> tuple[RunResult, Codec]:
    """Judge one recording; also the codec it was read with.

    ``period_known``: the beacon period of ``pics`` is that of the network; otherwise the recording shows it.

    Raises :class:`UsageError`: no such file, no capture, no such profile, nothing in it that looks like DCP.
    """
    codec, notes = _codec(path, profile or pics.pixit.profile, ether_type)
    if not period_known:
        pics = _with_period(pics, _period(path, codec))
    try:
        with open_capture(path) as reader:
            # As text that a report can hold: names of files are octets.
            name = path.name.encode("utf-8", "backslashreplace").decode()
            judge = Judge(codec, pics, recording=name, path=str(path), command=command, period_known=period_known)
            for frame in reader:
                judge.feed(frame)
            notes += [problem.message for problem in reader.problems]
    except CaptureError as error:
        raise UsageError(str(error)) from None
    if not judge.frames:
        raise UsageError(f"{path}: none of its {judge.other} frames is DCP in the profile {codec.profile.name}")
    return judge.result(notes), codec


def _period(path: Path, codec: Codec) -> float | None:
    """The longest beacon period of any sender in ms, as the beginning shows it; None if it does not."""
    last: dict[bytes, Heard] = {}
    intervals: dict[bytes, list[float]] = {}
    try:
        with open_capture(path) as reader:
            for frame in itertools.islice(reader, _LOOKED_AT):
                framing = locate(frame.data, codec.profile.link)
                if isinstance(framing, OtherTraffic):
                    continue
                octets = frame.data[framing.start : framing.end]
                heard = Heard(codec, frame.number, frame.time_ns, frame.time_ns, octets, framing.src or b"")
                who = heard.sender or heard.source
                before = last.get(who)
                last[who] = heard
                if before is not None and (before.seqno is None or heard.seqno == before.seqno + 1):
                    intervals.setdefault(who, []).append((heard.time - before.time) / 1e6)
    except CaptureError as error:
        raise UsageError(str(error)) from None
    return max((statistics.median(each) for each in intervals.values() if len(each) >= _ENOUGH), default=None)


def _with_period(pics: Pics, period: float | None) -> Pics:
    if period is None or period <= 0:
        return pics
    return msgspec.structs.replace(pics, pixit=msgspec.structs.replace(pics.pixit, beacon_period_ms=period))


def _codec(path: Path, profile: str | None, ether_type: str | None) -> tuple[Codec, list[str]]:
    """The codec to read a recording with, and what there is to say about the choice."""
    try:
        number = None if ether_type is None else parse_ether_type(ether_type)
    except ValueError as error:
        raise UsageError(f"--ether-type: {error}") from None
    if profile is None:
        found = _guessed(path, number)
        doubt = [] if found.certain else [f"the profile was guessed: {found}"]
        _warn(path, found)
        return Codec(msgspec.structs.replace(found.best.profile, link=found.best.link)), doubt
    try:
        codec = Codec(profile)
    except ProfileError as error:
        raise UsageError(str(error)) from None
    if number is None:
        return codec, []
    link = with_ether_type(codec.profile.link, number)
    return Codec(msgspec.structs.replace(codec.profile, link=link)), []


def guessed_profile(path: Path) -> str:
    """The name of the profile that explains a recording best. Raises :class:`UsageError`."""
    found = _guessed(path)
    _warn(path, found)
    return found.best.profile.name


def _warn(path: Path, found: Guess) -> None:
    """A verdict on octets that the profile does not explain is worth nothing: say so, also without a report."""
    if found.warning is not None:
        say(f"{path}: {found.warning}: name one with --profile, or see dcp-codec guess {path}", err=True)


def _guessed(path: Path, ether_type: int | None = None) -> Guess:
    """What the profile of a recording is, with the link it was found on."""
    try:
        with open_capture(path) as reader:
            first, _ = sample(iter(reader), ether_type=ether_type)
            damage = "; ".join(problem.message for problem in reader.problems)
    except CaptureError as error:
        raise UsageError(str(error)) from None
    if not first:
        raise UsageError(f"{path}: there are no frames in it" + (f": {damage}" if damage else ""))
    found = guess(first, ether_type=ether_type)
    if not found.best.frames:
        where = "the EtherTypes and ports of the built-in profiles" if ether_type is None else f"0x{ether_type:04x}"
        raise UsageError(f"{path}: no frames to tell the profile by under {where}; dcp-codec stats shows what there is")
    return found
