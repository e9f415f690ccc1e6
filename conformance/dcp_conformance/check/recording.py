"""From a file to a verdict."""

from __future__ import annotations

from pathlib import Path

import msgspec
from dcp_spec.profile_loading import ProfileError

from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.codec import Codec
from dcp_codec.frames import with_ether_type
from dcp_codec.guess import guess, sample
from dcp_conformance.errors import UsageError
from dcp_conformance.pics import Pics
from dcp_conformance.results import RunResult

from .judge import Judge


def judge_recording(
    path: Path, profile: str | None, pics: Pics, *, ether_type: str | None = None, command: str = ""
) -> tuple[RunResult, Codec]:
    """Judge one recording; also the codec it was read with.

    Raises :class:`UsageError`: no such file, no capture, no such profile, nothing in it that looks like DCP.
    """
    codec = _codec(path, profile or pics.pixit.profile, ether_type)
    try:
        with open_capture(path) as reader:
            judge = Judge(codec, pics, recording=path.name, command=command)
            for frame in reader:
                judge.feed(frame)
            problems = [problem.message for problem in reader.problems]
    except CaptureError as error:
        raise UsageError(str(error)) from None
    if not judge.frames:
        raise UsageError(f"{path}: none of its {judge.other} frames is DCP in the profile {codec.profile.name}")
    return judge.result(problems), codec


def _codec(path: Path, profile: str | None, ether_type: str | None) -> Codec:
    try:
        codec = Codec(profile) if profile is not None else _guessed(path)
    except ProfileError as error:
        raise UsageError(str(error)) from None
    if ether_type is None:
        return codec
    try:
        link = with_ether_type(codec.profile.link, int(ether_type, 0))
    except ValueError:
        raise UsageError(f"--ether-type {ether_type!r} is no number; write 0x4953 or 18771") from None
    return Codec(msgspec.structs.replace(codec.profile, link=link))


def guessed_profile(path: Path) -> str:
    """The name of the profile that explains a recording best. Raises :class:`UsageError`."""
    return _guessed(path).profile.name


def _guessed(path: Path) -> Codec:
    """The codec of that profile, with the link it was found on."""
    try:
        with open_capture(path) as reader:
            first, _ = sample(iter(reader))
    except CaptureError as error:
        raise UsageError(str(error)) from None
    best = guess(first).best
    if not best.frames:
        raise UsageError(f"{path}: there are no frames to tell the profile by; name it (--profile)")
    return Codec(msgspec.structs.replace(best.profile, link=best.link))
