"""Find the fewest faults that explain a set of failed cases.

Each fault of the dictionary predicts failures. The model of a case is a noisy OR: it fails if at least one of the
assumed faults makes it fail or, rarely, for a reason outside the dictionary. The greedy search adds the fault that
raises the likelihood of the observed verdicts most, and removes a fault that later ones have made superfluous. Each
further fault must raise the log likelihood by a minimum, so that few faults are preferred to many (minimum description
length).

In a case that a fault makes fail, the observation speaks for the fault if it is the same as at a node with this fault
(:mod:`.observation`), and much less if it differs or was not recorded there. One case with another observation is too
little to assume a fault.

A case in which nothing else failed than that the implementation ended or stopped answering shows no wrong behaviour.
Only faults that crash a node can explain it, and they explain only cases that the implementation did not survive.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping

from dcp_conformance.definitions.case import DECLARED, DENIED, SANITY
from dcp_conformance.definitions.results import CaseResult, Check, Diagnosis, Probable
from dcp_conformance.definitions.survival import SURVIVAL, bad_checks, did_not_survive, only_died
from dcp_conformance.definitions.verdict import Verdict

from .dictionary import Dictionary, Fault
from .observation import observations

#: Probability that a case fails if it failed in the self-test with an assumed fault, if it was inconclusive there, and
#: if no assumed fault concerns it.
_FAILS, _UNDECIDED, _NOISE = 0.93, 0.03, 0.003
#: Probability that a case fails with another observation than in the self-test with an assumed fault.
_DIFFERS = 0.25
#: Probability that a case does not pass, if it was inconclusive in the self-test with an assumed fault.
_PREVENTED = 0.5
#: Log likelihood that a further fault must add; difference of log likelihoods below which explanations are equal.
_PRICE, _EQUAL = 5.0, 0.7
#: Maximum number of faults in a diagnosis, and of alternatives to each.
_MOST, _ALTERNATIVES = 24, 4
#: Minimum share of the failures expected with a fault that must have been observed.
_LEAST = 0.5


def explain(
    results: Iterable[CaseResult], dictionary: Dictionary, *, observed: Mapping[str, frozenset[str]] | None = None
) -> Diagnosis:
    """Return the probable faults that explain the failed cases of a run.

    ``observed`` has the digests of what was observed in each failed case; by default they are computed from its checks.

    Only the verdicts fail, pass and info are evidence; cases with another verdict are ignored. So are the cases about
    deviations that the profile or the PICS declares: they fail without any behaviour of the implementation.
    """
    failed: dict[str, CaseResult] = {}
    passed: set[str] = set()
    for result in results:
        if result.id in (DECLARED, DENIED):
            continue
        if result.verdict is Verdict.FAIL:
            failed[result.id] = result
        elif result.verdict in (Verdict.PASS, Verdict.INFO):
            passed.add(result.id)
    passed -= failed.keys()
    if observed is None:
        observed = {name: observations(result) for name, result in failed.items()}
    search = _Search(dictionary, failed, passed, observed)
    chosen = search.run()
    explained = {case for fault in chosen for case in search.explained_by(fault)}
    found = [search.probable(fault, chosen) for fault in chosen]
    found.sort(key=lambda each: (-len(each.explains), each.fault))
    return Diagnosis(
        faults=tuple(found),
        failed=len(failed),
        unexplained=tuple(case for case in failed if case not in explained and not only_died(failed[case])),
        ended=tuple(case for case in failed if case not in explained and only_died(failed[case])),
        stated=next((check for check in bad_checks(failed[SANITY]) if check.shown), None) if SANITY in failed else None,
    )


class _Search:
    """Greedy search for the most likely set of faults of one run."""

    def __init__(
        self,
        dictionary: Dictionary,
        failed: Mapping[str, CaseResult],
        passed: set[str],
        observed: Mapping[str, frozenset[str]],
    ) -> None:
        self._failed, self._passed, self._observed = failed, passed, observed
        self._crashed = {name for name, result in failed.items() if did_not_survive(result)}
        """Failed cases that a fault can explain that crashes a node."""
        self._behaved = {name for name, result in failed.items() if not only_died(result)}
        """Failed cases that any other fault can explain."""
        self._chances: dict[str, dict[str, float]] = {}
        """By fault, by decided case: probability that the fault makes it fail (failed cases), or not pass (passed)."""
        self._faults: dict[str, Fault] = {}
        for fault in dictionary.faults:
            relevant = self._relevant(fault)
            alike = self._alike(fault)
            chances = {
                case: _DIFFERS if case in failed and case not in alike else _FAILS
                for case in fault.fails & (relevant | passed)
            }
            chances.update((case, _UNDECIDED) for case in fault.undecided & relevant)
            chances.update((case, _PREVENTED) for case in fault.undecided & passed)
            # A fault none of whose expected failures was observed cannot explain anything.
            if relevant & fault.fails:
                self._faults[fault.id] = fault
                self._chances[fault.id] = chances
        self._common = Counter(case for fault in dictionary.faults for case in fault.fails)
        """By case: how many faults of the dictionary make it fail."""
        self._survives: dict[str, float] = {}
        """By case: the probability that it does not fail with the chosen faults; 1 - _NOISE for cases without entry."""

    def _relevant(self, fault: Fault) -> set[str]:
        """Return the failed cases that a fault of this kind can explain."""
        return self._crashed if fault.crashes else self._behaved

    def _alike(self, fault: Fault) -> set[str]:
        """Return the failed cases in which the observation is the same as with the fault."""
        expected = fault.fails & self._relevant(fault)
        if fault.crashes:
            return set(expected)
        known: dict[str, set[str]] = {}
        for case, digest in fault.observed:
            known.setdefault(case, set()).add(digest)
        return {case for case in expected if known.get(case, set()) & self._observed[case]}

    def run(self) -> list[Fault]:
        """Return the most likely set of faults, in the order in which they were chosen."""
        chosen: list[str] = []
        while len(chosen) < _MOST:
            rest = (name for name in self._chances if name not in chosen and self._plausible(name))
            gains = {name: gain for name in rest if (gain := self._gain(name)) > _PRICE}
            if not gains:
                break
            least = max(gains.values()) - _EQUAL
            likely = (name for name, gain in gains.items() if gain >= least)
            chosen.append(max(likely, key=lambda name: (self._decided(name), gains[name], name)))
            self._assume(chosen)
            chosen = self._without_superfluous(chosen)
        return [self._faults[name] for name in chosen]

    def _plausible(self, name: str) -> bool:
        """Return whether at least the share ``_LEAST`` of the decided cases that the fault makes fail did fail."""
        fault = self._faults[name]
        hits, misses = len(fault.fails & self._relevant(fault)), len(fault.fails & self._passed)
        return hits >= _LEAST * (hits + misses)

    def _decided(self, name: str) -> float:
        """Return the share of the cases that the fault makes fail whose verdicts are known: few in a selection."""
        fault = self._faults[name]
        return len(fault.fails & (self._relevant(fault) | self._passed)) / len(fault.fails)

    def _gain(self, name: str) -> float:
        """Return by how much this fault raises the log likelihood of the observed verdicts."""
        gain = 0.0
        for case, chance in self._chances[name].items():
            before = self._survives.get(case, 1 - _NOISE)
            after = before * (1 - chance)
            gain += math.log((1 - after) / (1 - before)) if case in self._failed else math.log(after / before)
        return gain

    def _assume(self, chosen: Iterable[str]) -> None:
        """Compute the probabilities of survival for these faults."""
        self._survives = {}
        for name in chosen:
            for case, chance in self._chances[name].items():
                self._survives[case] = self._survives.get(case, 1 - _NOISE) * (1 - chance)

    def _without_superfluous(self, chosen: list[str]) -> list[str]:
        """Return the chosen faults without those whose failures the faults chosen later explain as well."""
        for name in chosen[:-1]:
            others = [each for each in chosen if each != name]
            self._assume(others)
            if self._gain(name) <= _PRICE:
                return self._without_superfluous(others) if len(others) > 1 else others
        self._assume(chosen)
        return chosen

    def explained_by(self, fault: Fault) -> list[str]:
        """Return the failed cases that the fault makes fail."""
        explained = fault.fails & self._relevant(fault)
        return [case for case in self._failed if case in explained]

    def probable(self, fault: Fault, chosen: list[Fault]) -> Probable:
        """Describe a chosen fault: its cases, equally likely alternatives, and the case that shows it best."""
        explains = self.explained_by(fault)
        others = [each for each in chosen if each is not fault]
        elsewhere = {case for each in others for case in self.explained_by(each)}
        alone = [case for case in explains if case not in elsewhere]
        self._assume(each.id for each in others)
        gain = self._gain(fault.id)
        equal = sorted(
            (name for name in self._chances if self._faults[name] not in chosen and gain - self._gain(name) <= _EQUAL),
            key=lambda name: (-self._gain(name), name),
        )
        decided = self._relevant(fault) | self._passed
        shown = self._best(fault, alone or explains)
        check = _decisive(self._failed[shown], fault) if shown else None
        return Probable(
            fault=fault.id,
            requirements=fault.requirements,
            what=_described(fault, [self._failed[case] for case in explains]),
            explains=tuple(explains),
            alone=tuple(alone),
            share=len(explains) / len(self._failed),
            missing=tuple(sorted(fault.fails & self._passed)),
            expected=len(fault.fails & decided),
            alike=len(self._alike(fault)),
            named=sum(_names(self._failed[case], fault) for case in explains),
            sole=len(chosen) == 1 and self._behaved | self._crashed <= set(explains),
            signature=len(fault.fails),
            alternatives=tuple(self._faults[name].what for name in equal[:_ALTERNATIVES]),
            case=shown,
            check=check,
            mark=check.frames[0] if check is not None and check.frames else None,
            rerun=self._failed[shown].rerun if shown else "",
        )

    def _best(self, fault: Fault, explains: Iterable[str]) -> str:
        """Return the case that shows the fault best, or an empty string.

        Preferred is a case whose failed check names a requirement of the fault, which few other faults make fail, whose
        check cites a frame, and which is short.
        """

        def rank(name: str) -> tuple[bool, bool, int, bool, int, str]:
            result = self._failed[name]
            check = _decisive(result, fault)
            named = check is not None and not set(check.requirements).isdisjoint(fault.requirements)
            frames = check is not None and bool(check.frames)
            shown = check is not None and check.shown
            return (not named, not shown, self._common[name], not frames, len(result.evidence), name)

        return min(explains, key=rank, default="")


def _names(result: CaseResult, fault: Fault) -> bool:
    """Return whether a failed check of the case names a requirement of the fault."""
    named = {each for check in result.checks if check.verdict is Verdict.FAIL for each in check.requirements}
    return not named.isdisjoint(fault.requirements)


def _described(fault: Fault, explains: Iterable[CaseResult]) -> str:
    """Return the sentence of a fault; of one that crashes a node, with the word for how the implementation ended."""
    if not fault.crashes:
        return fault.what
    ways = {_way(result.death) for result in explains}
    return fault.what.replace("crashes", ways.pop() if len(ways) == 1 else "ends or hangs", 1)


def _way(death: str) -> str:
    if death.startswith("fell silent"):
        return "hangs"
    return "ends" if "exit status" in death else "crashes"


def _decisive(result: CaseResult, fault: Fault) -> Check | None:
    """Return the failed check that names a requirement of the fault, preferably with a frame; else the first one.

    Only a fault that crashes a node is shown by a check of survival.
    """
    bad = [check for check in result.checks if check.verdict is Verdict.FAIL]
    kind = [check for check in bad if check.expected.startswith(SURVIVAL) == fault.crashes]
    bad = kind or bad
    named = [check for check in bad if not set(check.requirements).isdisjoint(fault.requirements)]
    return next(iter([*(check for check in named if check.frames), *named, *bad]), None)
