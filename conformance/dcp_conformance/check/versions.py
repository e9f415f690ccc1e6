"""Recordings with an uncertain profile or with two versions: withhold verdicts, or split the frames by version."""

from __future__ import annotations

import msgspec

from dcp_codec.analysis.guess import Guess
from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec
from dcp_codec.framing.locate import OtherTraffic, locate
from dcp_conformance.definitions.results import CaseResult, Check, RunResult, summarise
from dcp_conformance.definitions.verdict import Verdict


def weakness(guess: Guess, path: object) -> str:
    """Return why a guess is too weak for verdicts and what the user can do; empty if it is strong enough."""
    best = guess.best
    if not guess.weak:
        return ""
    others = ", ".join(each.profile.name for each in guess.tied)
    return (
        f"no verdicts: the profile {best.profile.name} is a weak guess ({best.counts}"
        f"{f'; {others} explain as much' if others else ''}). Name the profile with --profile; "
        f"'dcp-codec guess {path}' shows how well each one fits; if none fits, describe the format in a TOML profile"
    )


def undecided(run: RunResult, why: str) -> RunResult:
    """Return the run with each verdict replaced by inconclusive; observations (info) are kept."""
    cases = tuple(_undecided(case, why) for case in run.cases)
    return msgspec.structs.replace(
        run, cases=cases, requirements={}, declared={}, summary=summarise(cases), notes=(why, *run.notes)
    )


def _undecided(case: CaseResult, why: str) -> CaseResult:
    """Replace pass, fail and inconclusive by inconclusive with the reason ``why``."""
    if case.verdict not in (Verdict.PASS, Verdict.FAIL, Verdict.INCONCLUSIVE):
        return case
    check = Check(Verdict.INCONCLUSIVE, case.requirements, why)
    kept = tuple(each for each in case.checks if each.verdict is Verdict.INFO)
    return msgspec.structs.replace(case, verdict=Verdict.INCONCLUSIVE, reason=why, checks=(check, *kept))


class Versions:
    """Assigns the frames of a recording with two versions to one of two codecs."""

    def __init__(self, first: Codec, second: Codec) -> None:
        """Frames that fit neither codec, from a station without other frames, belong to ``first``."""
        self.codecs = (first, second)
        self._stations: dict[bytes, list[int]] = {}

    def of(self, frame: Frame) -> int:
        """Return the index of the codec for a frame, 0 or 1.

        If both codecs or none decode it without errors, the one with more frames of its station is taken.
        """
        sound: list[bool] = []
        source = b""
        for codec in self.codecs:
            framing = locate(frame.data, codec.profile.link)
            if isinstance(framing, OtherTraffic):
                sound.append(False)
                continue
            source = framing.src or b""
            salvaged = codec.salvage(frame.data[framing.start : framing.end])
            sound.append(salvaged.beacon is not None and not salvaged.problems)
        counts = self._stations.get(source)
        if counts is None:
            if len(self._stations) >= 4096:
                return 0 if sound[0] or not sound[1] else 1
            counts = self._stations[source] = [0, 0]
        counts[0] += sound[0]
        counts[1] += sound[1]
        if sound[0] != sound[1]:
            return 0 if sound[0] else 1
        return 1 if counts[1] > counts[0] else 0
