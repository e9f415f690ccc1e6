"""Find the parts of frames that a profile does not explain, and draft lines for a user-defined profile.

Every malformed frame is read as far as possible (:mod:`dcp_codec.views.salvage`), and its problems are counted by
payload. SRP payloads of a wrong length come with the lines of TOML that describe them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.definition import Link, Profile

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError, Problem
from dcp_codec.framing.locate import OtherTraffic, locate

_CLIENTS = {int(BP_PROTID_SRP): "SRP", int(BP_PROTID_VARDIS): "VarDis"}
#: Number of listed shortfalls; the first ones explain most.
_LISTED = 5


class Shortfall(msgspec.Struct, frozen=True):
    """One part of the frames that a profile does not explain: ``count`` of ``of`` payloads or frames have it.

    ``text`` is a sentence, ``advice`` the lines of a profile that would explain it (empty if the octets do not
    suffice), ``frame`` the first frame.
    """

    text: str
    count: int
    of: int
    frame: int
    advice: tuple[str, ...] = ()


class _Found:
    def __init__(self) -> None:
        self.frames = 0
        self.blocks: Counter[int] = Counter()
        self.bad: Counter[tuple[str, str, str]] = Counter()
        self.first: dict[tuple[str, str, str], int] = {}
        self.lengths: dict[int, Counter[int]] = {}
        self.types: Counter[int] = Counter()

    def note(self, where: str, problem: Problem, frame: int) -> None:
        key = (where, problem.reason, problem.requirement or "")
        self.bad[key] += 1
        self.first.setdefault(key, frame)


def shortfalls(codec: Codec, frames: Iterable[Frame], link: Link | None = None) -> list[Shortfall]:
    """Return the shortfalls of ``codec`` for ``frames``, the most frequent first; empty if it decodes all of them."""
    found = _Found()
    for frame in frames:
        place = locate(frame.data, link or codec.profile.link)
        if isinstance(place, OtherTraffic):
            continue
        found.frames += 1
        _examine(codec, frame, frame.data[place.start : place.end], found)
    listed = [_shortfall(codec.profile, found, key, count) for key, count in found.bad.most_common(_LISTED)]
    return sorted(listed, key=lambda each: -each.count)


def _examine(codec: Codec, frame: Frame, octets: bytes, found: _Found) -> None:
    try:
        envelope, _ = codec.decode_envelope(octets)
    except DecodeError as error:
        found.note("", error.problem, frame.number)
        return
    for payload in envelope.payloads:
        number, content = payload.protocol_id, payload.content
        assert isinstance(content, bytes)
        if number not in _CLIENTS or (number == BP_PROTID_SRP and codec.srp_plan is None):
            continue
        found.blocks[number] += 1
        found.lengths.setdefault(number, Counter())[len(content)] += 1
        try:
            if number == BP_PROTID_SRP:
                codec.decode_srp(content)
            else:
                codec.decode_containers(content)
        except DecodeError as error:
            found.note(_CLIENTS[number], error.problem, frame.number)
            if error.problem.reason == "unknown-type" and error.problem.available is not None:
                found.types[error.problem.available] += 1


def _shortfall(profile: Profile, found: _Found, key: tuple[str, str, str], count: int) -> Shortfall:
    where, reason, requirement = key
    frame = found.first[key]
    cited = f" [{requirement}]" if requirement else ""
    if not where:
        text = f"the header or the block list is wrong ({reason}{cited}) in {count} of {found.frames} frames"
        return Shortfall(text, count, found.frames, frame)
    number = next(key for key, name in _CLIENTS.items() if name == where)
    of = found.blocks[number]
    if where == "SRP" and reason in ("wrong-length", "leftover", "truncated"):
        return _wrong_length(profile, found.lengths[number], count, of, frame)
    if reason == "unknown-type" and found.types:
        types = ", ".join(f"{kind} ({many})" for kind, many in found.types.most_common(5))
        first = found.types.most_common(1)[0][0]
        advice = (
            "[[vardis.own_containers]]",
            f'name = "OWN-{first}"',
            f"number = {first}",
            'record = ["varId"]  # the fields of one record: docs/profile-reference.md',
        )
        text = f"VarDis has container types that the profile does not know, in {count} of {of} payloads: {types}"
        return Shortfall(text, count, of, frame, advice)
    return Shortfall(f"{where} is wrong ({reason}{cited}) in {count} of {of} payloads", count, of, frame)


def _wrong_length(profile: Profile, lengths: Counter[int], count: int, of: int, frame: int) -> Shortfall:
    size, many = lengths.most_common(1)[0]
    wanted = profile.srp.record_size
    expected = "" if wanted is None else f"; the profile has {wanted}"
    if len(lengths) == 1 and 0 < size <= 0xFFFF:
        text = f"SRP is {size} octets in {many} of {of} payloads{expected}"
        return Shortfall(text, count, of, frame, opaque_report(size))
    listed = ", ".join(f"{length} octets in {times}" for length, times in lengths.most_common(4))
    text = f"SRP has {len(lengths)} lengths in {of} payloads ({listed}){expected}"
    return Shortfall(text, count, of, frame, opaque_report(None))


def opaque_report(size: int | None) -> tuple[str, ...]:
    """Return the lines of a profile whose SRP payloads are ``size`` octets without known fields; None: of any size."""
    if size is None:
        return ("[srp]", "record = []", "record_size = 0", "safety_data = []")
    return ("[srp]", f'record = [{{ name = "unknown", opaque = {size} }}]', f"record_size = {size}", "safety_data = []")
