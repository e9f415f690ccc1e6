"""Rank profiles by how well they explain the frames of a recording.

The version octet does not determine the layout, so every profile is tried. A frame counts fully if it decodes and its
values are plausible: time stamps near the time of the recording, coordinates that are numbers, readable descriptions. A
frame of which only some blocks decode counts a little, by their share: an implementation may send one block that no
profile has. Profiles that explain the frames equally well cannot be distinguished by this recording; they are reported
as one tie.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import Any

import msgspec
from dcp_spec.constants import BP_MAGIC_NO
from dcp_spec.profile.definition import Link, Profile
from dcp_spec.profile.loading import profile_names

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec, get_codec
from dcp_codec.errors import DecodeError
from dcp_codec.framing.frames import with_ether_type
from dcp_codec.framing.locate import OtherTraffic, bare, locate
from dcp_codec.plan.tree import Rest
from dcp_codec.values import Beacon, ExtendedSafetyData, SafetyData, VarCreate

#: Number of frames that are examined, and of frames that are searched for them: a recorder may have run for long before
#: the first beacon.
SAMPLE = 400
_SEARCHED = 20_000
#: Order of preference among profiles that explain a recording equally well.
_PREFERENCE = ("cpp-2.0", "dcp-2.0", "cpp-1.3", "dcp-1.3", "dcp-1.2", "cpp-1.2", "dcp-1.1", "dcp-1.0", "sim-1.0")
_MAGIC = BP_MAGIC_NO.to_bytes(2, "big")
_YEAR = 365 * 86_400
_EARLIEST = 946_684_800  # 2000: the clock of an older recording was not set
_ERA = 1_735_689_600  # 2025: about when the known implementations were in use, for octets without a time of recording
#: Scores that differ by less are equal: they come from equal evidence.
_SAME = 1e-9
#: The best profile is certain if its score exceeds the next one by more than this.
_CERTAIN = 0.5
_LIKELY = 0.1


class Candidate(msgspec.Struct, frozen=True):
    """Result for one profile: ``score`` 0..1, ``decoded`` of ``frames`` without error.

    ``which`` are the indices, from 0, of the decoded frames among the examined ones. ``in_part`` counts frames with an
    error of which at least one block decodes; it is estimated if more than :data:`LOOKED_AT` have errors.
    """

    profile: Profile
    link: Link
    score: float
    decoded: int
    frames: int
    doubts: tuple[str, ...] = ()
    which: frozenset[int] = frozenset()
    in_part: int = 0

    @property
    def explained(self) -> float:
        """Return the share of frames, 0..1, of which at least one block decodes."""
        return (self.decoded + self.in_part) / self.frames if self.frames else 0.0

    @property
    def counts(self) -> str:
        """Describe the number of decoded frames."""
        text = f"{self.decoded} of {self.frames} sampled frames decode"
        return f"{text}, {self.in_part} more in part" if self.in_part else text


class Guess(msgspec.Struct, frozen=True):
    """The ranking, best first. ``tied`` are the candidates that explain the frames as well as the best."""

    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        """Return the chosen candidate."""
        return self.candidates[0]

    @property
    def tied(self) -> tuple[Candidate, ...]:
        """Return the other candidates that have the score of the best by the same frames."""
        best = self.best
        return tuple(c for c in self.candidates[1:] if best.score - c.score < _SAME and c.which == best.which)

    @property
    def besides(self) -> tuple[Candidate, int] | None:
        """Return the candidate that decodes most of the frames that the best does not, and their number.

        Such frames indicate a network of several versions. None if no candidate decodes more than a hundredth of the
        frames.
        """
        best = self.best
        more = [(candidate, len(candidate.which - best.which)) for candidate in self.candidates[1:]]
        candidate, many = max(more, key=lambda each: each[1], default=(best, 0))
        return (candidate, many) if many > best.frames / 100 else None

    @property
    def certain(self) -> bool:
        """Return whether no other profile comes near, and no frames have another version."""
        return bool(self.best.frames) and not self.tied and self.besides is None and self.certainty > _CERTAIN

    @property
    def certainty(self) -> float:
        """Return the lead of the best over the first candidate that explains the frames less well, 0..1."""
        others = [c.score for c in self.candidates if self.best.score - c.score >= _SAME]
        return self.best.score - others[0] if others else 0.0

    @property
    def weak(self) -> bool:
        """Return whether most of the recording is unexplained, or another layout explains it nearly as well."""
        if not self.best.frames:
            return False
        return self.best.score < 0.5 or (not self.tied and self.certainty <= _LIKELY)

    @property
    def warning(self) -> str | None:
        """Return a warning for commands that continue with a weak guess; None for a good one."""
        if not self.weak:
            return None
        return f"profile {self.best.profile.name} is a weak guess, and the output may be wrong ({self.best.counts})"

    def as_json(self) -> dict[str, Any]:
        """Return the members ``profile``, ``certain``, ``weak``, ``tied`` and ``text``, for the output of commands."""
        return {
            "profile": self.best.profile.name,
            "certain": self.certain,
            "weak": self.weak,
            "tied": [candidate.profile.name for candidate in self.tied],
            "text": str(self),
        }

    def __str__(self) -> str:
        best = self.best
        if not best.frames:
            return f"{best.profile.name} (a guess: no frames to decide by)"
        sure = "certain" if self.certainty > _CERTAIN else "likely" if self.certainty > _LIKELY else "a weak guess"
        if self.tied:
            sure = "one of several"
        elif best.score < 0.5:
            sure = "a weak guess"
        text = f"{best.profile.name} ({sure}: {best.counts}"
        if self.tied:
            text += f"; not distinguishable here from {', '.join(c.profile.name for c in self.tied)}"
        if self.besides:
            other, many = self.besides
            text += f"; {many} others decode as {other.profile.name}: decode each version with --profile"
        return text + ")"


def sample(
    frames: Iterable[Frame], limit: int = SAMPLE, *, ether_type: int | None = None
) -> tuple[list[Frame], Iterator[Frame]]:
    """Return the first ``limit`` frames that may be DCP, and an iterator over all frames again.

    If none of the first 20 000 frames may be DCP, the first ``limit`` frames are returned. ``ether_type`` is that of
    the beacons, if known.
    """
    iterator = iter(frames)
    links = _links(ether_type)
    seen: list[Frame] = []
    likely: list[Frame] = []
    for frame in islice(iterator, max(limit, _SEARCHED)):
        seen.append(frame)
        if _has_magic(frame) or any(not isinstance(locate(frame.data, link), OtherTraffic) for link in links):
            likely.append(frame)
            if len(likely) == limit:
                break
    return likely or seen[:limit], chain(seen, iterator)


def _links(ether_type: int | None) -> list[Link]:
    """Return the EtherTypes and UDP ports of all built-in profiles."""
    links = {get_codec(name).profile.link: None for name in profile_names()}
    if ether_type is not None:
        links |= {with_ether_type(link, ether_type): None for link in links if link.transport == "ethernet"}
    return list(links)


def guess(
    frames: Sequence[Frame],
    *,
    profiles: Sequence[str | Codec] | None = None,
    framed: bool = True,
    ether_type: int | None = None,
) -> Guess:
    """Rank ``profiles`` (names or codecs; None: the built-in ones) for ``frames``.

    ``framed`` false: the frames are bare bearer payloads.
    """
    likely = ether_type if ether_type is not None else _ether_type_of(frames) if framed else None
    codecs = [each if isinstance(each, Codec) else get_codec(each) for each in profiles or profile_names()]
    candidates = [_judge(codec, frames, framed, likely) for codec in codecs]
    rank = {name: place for place, name in enumerate(_PREFERENCE)}
    candidates.sort(key=lambda c: (-round(c.score, 9), rank.get(c.profile.name, len(rank))))
    return Guess(tuple(candidates))


def looks_bare(octets: bytes, profiles: Sequence[str] | None = None) -> bool:
    """Return whether ``octets`` are more likely a bearer payload than a whole Ethernet frame."""
    frame = Frame(number=1, time_ns=0, data=octets, orig_len=len(octets))
    as_bare = guess([frame], profiles=profiles, framed=False).best.score
    as_framed = guess([frame], profiles=profiles, framed=True).best.score
    if as_bare == as_framed:
        return octets[1:3] == _MAGIC or octets[0:2] == _MAGIC
    return as_bare > as_framed


def _ether_type_of(frames: Sequence[Frame]) -> int | None:
    """Return the EtherType whose frames carry the magic number, if there is exactly one."""
    found = {frame.data[12] << 8 | frame.data[13] for frame in frames if _has_magic(frame)}
    return found.pop() if len(found) == 1 else None


def _has_magic(frame: Frame) -> bool:
    """Return whether the magic number is at the position of some version's beacon, after any EtherType."""
    return _MAGIC in (frame.data[14:16], frame.data[15:17])


def _judge(codec: Codec, frames: Sequence[Frame], framed: bool, ether_type: int | None) -> Candidate:
    link = codec.profile.link
    if ether_type is not None and link.transport == "ethernet":
        link = with_ether_type(link, ether_type)
    total, damaged = 0, 0
    shares: list[float] = []
    hints: list[float] = []
    parts = 0
    which: set[int] = set()
    evidence: list[float] = []
    doubts: dict[str, None] = {}
    for index, frame in enumerate(frames):
        place = locate(frame.data, link) if framed else bare(frame.data)
        if isinstance(place, OtherTraffic):
            continue
        total += 1
        octets = frame.data[: place.end]
        try:
            beacon, _ = codec.decode_from(octets, place.start)
        except DecodeError:
            damaged += 1
            if damaged > LOOKED_AT:
                continue
            share, part = _share(codec, octets, place.start)
            if part is None:
                hints.append(share)
                continue
            parts += 1
            shares.append(share)
            beacon = part
        else:
            if not beacon.payloads:
                continue
            which.add(index)
        found = list(_evidence(codec.profile, beacon, frame.time_ns))
        if found:
            evidence.append(min(weight for weight, _ in found))
            doubts.update(dict.fromkeys(doubt for weight, doubt in found if weight < _DOUBTFUL))
    # Plausibility is weighed separately from decoding: most beacons have no value that could be implausible.
    plausible = sum(evidence) / len(evidence) if evidence else 1.0
    if not which and not shares:
        # Resemblance only counts if nothing else does: it must not break a tie.
        shares = hints
    partly = damaged * sum(shares) / max(1, parts + len(hints))
    score = (len(which) + partly) / total * (0.3 + 0.7 * plausible) if total else 0.0
    in_part = round(damaged * parts / (parts + len(hints))) if parts else 0
    return Candidate(codec.profile, link, score, len(which), total, tuple(doubts), frozenset(which), in_part)


#: Malformed frames that are examined in detail, which is slow; the others count as similar to these.
LOOKED_AT = 40
#: Maximum score of a frame of which no block decodes, and of one of which some do. Both are much below that of a
#: decoded frame, because the right layout explains all of it. A header that breaks a rule halves the score.
_HINT, _PART, _BAD_HEADER = 0.1, 0.3, 0.5


def _share(codec: Codec, octets: bytes, start: int) -> tuple[float, Beacon | None]:
    """Return the share of a malformed frame that the profile explains, 0..1, and its readable part if that has a
    block.
    """
    found = codec.salvage(octets[start:])
    beacon = found.beacon
    if beacon is None or not found.clear:
        if {each.reason for each in found.problems} & {"bad-magic", "bad-version"}:
            return 0.0, None
        return _HINT * _known(codec, octets, start), None
    bad = {each.payload for each in found.damaged}
    sound = len(beacon.payloads) - len(bad)
    header = any(each.path.startswith("bp.") for each in found.problems)
    if not sound:
        # Only BP's part is readable; how much of a wrong layout fits by chance is not evidence.
        return _HINT * (_BAD_HEADER if header else 1.0), None
    share = _HINT + (_PART - _HINT) * sound / len(beacon.payloads)
    return share * (_BAD_HEADER if header else 1.0), beacon


def _known(codec: Codec, octets: bytes, start: int) -> float:
    """Return the share of a malformed frame that still has a meaning; a high share suggests mere damage."""
    found = codec.dissect(octets, start=start)
    named = sum(
        field.length
        for field in found.root.walk()
        if not field.children and not isinstance(field.layout, Rest) and field.value is not None
    )
    return min(1.0, named / max(1, len(octets) - start))


#: Evidence with less weight than this is reported to the user.
_DOUBTFUL = 0.5


def _evidence(profile: Profile, beacon: Beacon, time_ns: int) -> Iterator[tuple[float, str]]:
    """Yield the plausibility of each value of a beacon (1 plausible, 0 not), with the doubt to report."""
    for payload in beacon.payloads:
        content = payload.content
        if isinstance(content, ExtendedSafetyData):
            yield _time_weight(profile, content.t_stamp, time_ns), "time stamps of state reports are far from any clock"
            yield float(_plausible_numbers(content.s_data)), "safety data holds numbers that no position has"
        elif isinstance(content, tuple):
            for record in chain.from_iterable(container.records for container in content):
                if isinstance(record, VarCreate):
                    yield from _create_evidence(profile, record, time_ns)


def _create_evidence(profile: Profile, create: VarCreate, time_ns: int) -> Iterator[tuple[float, str]]:
    stamp = create.spec.creation_time
    if stamp is not None:
        yield _time_weight(profile, stamp, time_ns), "creation times are far from any clock"
    yield float(create.spec.var_id == create.upd.var_id), "the two identifiers in a VarCreate differ"
    try:
        readable = create.spec.descr.decode().isprintable()
    except UnicodeDecodeError:
        readable = False
    yield float(readable), "descriptions are not readable text"


def _time_weight(profile: Profile, stamp: int, time_ns: int) -> float:
    """Return the plausibility of a time stamp: 1 within a day of the recording, less with distance, 0 beyond ten
    years.
    """
    layout = profile.types.timestamp
    seconds = stamp / layout.per_second
    if layout.epoch_ns is None:
        return float(0 <= seconds < _YEAR)
    seconds += layout.epoch_ns / 1e9
    recorded = time_ns / 1e9
    days = abs(seconds - (recorded if recorded > _EARLIEST else _ERA)) / 86_400
    if days > 3650:
        return 0.0
    # Both byte orders of one stamp can be plausible; the nearer time is more likely.
    return 1.0 if days <= 1 else 1.0 - 0.05 * math.log10(days)


def _plausible_numbers(data: SafetyData) -> bool:
    values: list[Any] = list(data.as_dict().values())
    return all(
        math.isfinite(value) and (value == 0 or 1e-30 < abs(value) < 1e12)
        for value in values
        if isinstance(value, float)
    )
