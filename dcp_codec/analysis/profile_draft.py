"""Draft a profile from a recording: the nearest built-in one, and lines for the unexplained parts.

The draft is checked against the recording, and the parts that it does not explain are returned with it. Octets show the
length of a field, but seldom its meaning: comments in the draft name what it leaves open.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence

import msgspec
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import profile_from

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec

from .guess import Candidate, Guess, guess
from .shortfall import Shortfall, shortfalls

#: Rounds of drafting: each removes shortfalls that hid the next one of the same payload.
_ROUNDS = 8


class Draft(msgspec.Struct, frozen=True):
    """A drafted profile: its ``text`` (TOML with comments) and the result of its check.

    ``decoded`` of ``frames`` decode with it, ``before`` with the profile that it ``extends``; ``left`` lists the
    shortfalls of both.
    """

    name: str
    text: str
    extends: str
    profile: Profile
    decoded: int
    before: int
    frames: int
    left: tuple[Shortfall, ...]


def draft_profile(name: str, frames: Sequence[Frame], source: str, *, ether_type: int | None = None) -> Draft:
    """Draft the profile ``name`` from ``frames`` of the recording ``source``.

    Raises ValueError if no frame resembles a beacon.
    """
    found = guess(frames, ether_type=ether_type)
    best = found.best
    if not best.frames or not best.score:
        raise ValueError("no frame looks like a beacon of any version; dcp-codec stats shows what the file holds")
    lines: list[str] = []
    if best.profile.link != best.link and best.link.ether_type is not None:
        lines += ["[link]", f"ether_type = {best.link.ether_type:#06x}", ""]
    codec = Codec(best.profile)
    drafted: list[Shortfall] = []
    for _ in range(_ROUNDS):
        missing = shortfalls(codec, frames, best.link)
        new = [each for each in missing if each.advice and each.advice[0] == "[srp]" and each not in drafted][:1]
        if not new or any(each.advice[0] == "[srp]" for each in drafted):
            break
        drafted += new
        lines += [f"# {new[0].text}, first in frame {new[0].frame}.", *new[0].advice, ""]
        codec = Codec(_parsed(name, best.profile.name, lines))
    left = shortfalls(codec, frames, best.link)
    after = guess(frames, profiles=[codec], ether_type=ether_type).best
    text = "\n".join(_text(name, source, found, after, lines, left)) + "\n"
    profile = _parsed(name, best.profile.name, lines)
    return Draft(name, text, best.profile.name, profile, after.decoded, best.decoded, best.frames, tuple(left))


def _parsed(name: str, base: str, lines: Sequence[str]) -> Profile:
    text = "\n".join([f'extends = "{base}"', f"name = {_quoted(name)}", *lines])
    return profile_from(tomllib.loads(text), name)


def _quoted(text: str) -> str:
    """Return a basic string of TOML, whose syntax is that of JSON."""
    return msgspec.json.encode(text).decode()


def _text(
    name: str, source: str, found: Guess, after: Candidate, lines: Sequence[str], left: Sequence[Shortfall]
) -> list[str]:
    best = found.best
    printable = "".join(each if each.isprintable() else "?" for each in source)
    out = [
        f"# Draft of a wire profile, made from {printable}.",
        f"# {after.decoded} of {after.frames} sampled frames decode with it, {best.decoded} with {best.profile.name}.",
        "# Every key: docs/profile-reference.md. What is not stated here is taken over from the profile it extends.",
    ]
    if found.tied:
        names = ", ".join(each.profile.name for each in found.tied)
        out.append(f"# The recording explains these as well, so extends could name one of them: {names}.")
    out += [
        f'extends = "{best.profile.name}"',
        f"name = {_quoted(name)}",
        f"title = {_quoted(f'{name}, drafted from a recording')}",
        "",
        *lines,
    ]
    if not lines:
        out.append(
            f"# Nothing had to be changed: {best.profile.name} describes all lengths and types of the recording."
        )
    for each in left:
        out.append(f"# Not explained yet: {each.text}, first in frame {each.frame}.")
        out += [f"#   {line}" for line in each.advice]
    for doubt in after.doubts:
        out.append(f"# Doubtful: {doubt}.")
    if any(line.startswith("record = [{") for line in lines):
        out += [
            "# If you know the fields of the SRP payload, replace the opaque octets, for example by",
            '#   record = ["sData", "nodeId", "tStamp", "seqno"]',
            '#   safety_data = [{ name = "x", type = "f64", unit = "m", role = "position.x" }]',
        ]
    return out
