"""Which profile do the frames of an implementation speak for?"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from dcp_spec.profile.loading import profile_names

from dcp_codec.analysis.guess import SAMPLE, Guess, guess
from dcp_codec.capture import Frame
from dcp_codec.codec import Codec, get_codec

#: A profile in which no block can be read of more than this share of the frames explains nothing.
EXPLAINED: Final = 0.3
#: Maximum difference in score between the best and the chosen profile that raises no doubt about the choice.
_CLOSE: Final = 0.05


def ranked_by(codecs: Sequence[Codec], frames: Iterable[tuple[int, bytes]]) -> Guess:
    """The ranking of profiles by the first frames: when each came, in ns since 1970, and its bearer payload."""
    sample = [Frame(number, *each, len(each[1])) for number, each in zip(range(1, SAMPLE + 1), frames, strict=False)]
    return guess(sample, profiles=list(codecs), framed=False)


def ranked_with(codec: Codec, frames: Iterable[tuple[int, bytes]]) -> Guess:
    """As :func:`ranked_by`, of all built-in profiles and that of ``codec``."""
    others = [get_codec(name) for name in profile_names() if name != codec.profile.name]
    return ranked_by([codec, *others], frames)


def score_of(ranked: Guess, name: str) -> float:
    """The score of a profile, 0..1; 0 if it is not in the ranking."""
    return max((each.score for each in ranked.candidates if each.profile.name == name), default=0.0)


def doubtful(ranked: Guess, name: str) -> bool:
    """Whether a ranking speaks against a profile; also if none explains anything."""
    best = ranked.best
    return best.score - score_of(ranked, name) > _CLOSE or best.explained < EXPLAINED
