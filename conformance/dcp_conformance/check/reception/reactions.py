"""Which reactions fail to come although the node shows by others that it hears."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from dcp_conformance.check.base import Context, Seen
from dcp_conformance.check.statements import Statement

from .following import Exposure, Kind, Station, Trial
from .links import Link, bits, chance, hits_alone, infer, lower_bound, reacts, without
from .observer import Observer

#: Trials are looked at together that lie within so many ns, or so many of one node.
_WINDOW, _MOST = 20_000_000_000, 3_000
#: A reaction shows that a node hears a speaker if all others explain it with a lower probability than the rest of this.
_SURE = 0.6
#: Standard deviations by which shares are taken lower than they look, and shares below which nothing is concluded.
_CAUTIOUS, _HEARS = 3.0, 0.25
#: Reactions to a speaker alone without which nothing is concluded from its beacons.
_ALONE = 2
#: For so many ns before and after such a reaction nothing is concluded but what lies between two of them.
_BELIEF = 10_000_000_000
#: The same for a link that is not heard so well: it may come and go.
_DOUBTFUL, _STEADY = 2_500_000_000, 0.9
#: So many standard deviations below its likeliest share a steady link must still have this share.
_LIKELY, _AS_GOOD = 1.0, 0.8
#: Fewer expected reactions decide nothing; of those expected at most this part may come; chance is excluded below this.
_EXPECTED, _SHARE, _CHANCE = 3.0, 0.25, 1e-3
#: The same where links fail: then what is missed together may have one cause.
_UNSTEADY = 1e-6
#: A link that was up before and after is up in between with this probability, whatever was missed meanwhile.
_UP = 0.9
#: Reactions with one delay that tell when a node composes payloads, if they are so many times those with the other one.
_DELAYS, _MOSTLY = 4, 3
_EXAMPLES = 3
_TAKEN = (Kind.TAKE_CREATE, Kind.TAKE_UPDATE, Kind.TAKE_DELETE)
#: A group of trials of which at most this part was met is looked at more closely.
_SUSPICIOUS = 0.4
#: A pass is withheld where so many reactions were expected and only this part came.
_MANY, _FEW = 5.0, 0.1
#: Links that are kept: of each pair one for each window.
_LINKS = 100_000
_GROUPS = 65_536

Group = tuple[bytes, Kind, int | None]
"""Node, kind, and variable; None for all of them."""


@dataclass(slots=True)
class _Gap:
    """The trials of a group between two reactions that show that the node hears. A link may be down in between."""

    best: float = 0.0
    silent: float = 1.0
    steady: bool = True
    hit: bool = False
    speakers: int = 0
    late_half: bool = True
    shortest: int = 1 << 31
    cause: Statement | None = None

    def add(self, expected: float, *, steady: bool) -> None:
        """A trial with this probability of a reaction; ``steady``: the link has hardly ever failed."""
        self.best = max(self.best, expected)
        self.silent *= 1.0 - expected
        self.steady = self.steady and steady

    @property
    def expected(self) -> float:
        """The probability of any reaction: many trials help as far as a link is up."""
        return max(self.best, min(1.0 - self.silent, _UP)) if self.steady else self.best


@dataclass(slots=True)
class Tally:
    """What was expected of a group and what came, since it last did what it must."""

    trials: int = 0
    """Times between two reactions that show that the node hears; all trials in between count as one."""
    hits: int = 0
    expected: float = 0.0
    silence: float = 1.0
    """The probability of no reaction in any of these trials."""
    steady: bool = True
    """Whether all links that this rests on have hardly ever failed."""
    all_trials: int = 0
    """Trials, whatever is known of them."""
    all_hits: int = 0
    all_expected: float = 0.0
    examples: list[Statement] = field(default_factory=list)
    speakers: int = 0
    late_half: bool = True
    """Whether all that was missed stood in the second half of its payload."""
    shortest: int = 1 << 31
    """The shortest payload with something that was missed."""

    def add(self, gaps: Iterable[_Gap]) -> None:
        """Count gaps; only those without any reaction show what was missed."""
        for gap in gaps:
            self.trials += 1
            self.hits += gap.hit
            self.expected += gap.expected
            self.silence *= 1.0 - gap.expected
            self.steady = self.steady and gap.steady
            if gap.cause is not None and not gap.hit:
                self.speakers |= gap.speakers
                self.late_half = self.late_half and gap.late_half
                self.shortest = min(self.shortest, gap.shortest)
                if len(self.examples) < _EXAMPLES:
                    self.examples.append(gap.cause)

    @property
    def short(self) -> bool:
        """Whether much less came than must have, with every reason to expect it."""
        return self.expected >= _EXPECTED and self.hits <= _SHARE * self.expected

    @property
    def doubtful(self) -> bool:
        """Whether much less came than must have, if links are as good all the time as they are on the average."""
        return self.all_expected >= _MANY and self.all_hits <= _FEW * self.all_expected

    @property
    def chance(self) -> float:
        """A bound of the probability that this happens to a node that does what it must."""
        if self.hits == 0:
            # No bound is needed, which would be wide where trials differ.
            return self.silence
        return chance(self.trials, self.expected, self.hits)


class Shortage(NamedTuple):
    """Reactions that did not come."""

    station: Station
    kind: Kind
    var_id: int | None
    tally: Tally
    speakers: tuple[bytes, ...]
    certain: bool
    """Whether it cannot be chance; otherwise it is only a reason not to say that all is well."""


@dataclass(slots=True)
class _Shown:
    """What a node has shown in all of the recording."""

    hits: dict[Kind, int] = field(default_factory=dict)
    longest: int = 0
    """The longest payload that it has reacted to."""
    late_half: int = 0
    """Reactions to what stood in the second half of a payload."""


class _Known(NamedTuple):
    """Whom a node hears in a window."""

    steady: set[int]
    """Speakers whose beacons have hardly ever been lost."""
    bounds: dict[int, float]
    """Speaker -> the part of its beacons that is heard at least, of those speakers of whom it is certain."""
    sure: dict[int, list[int]]
    """Speaker -> when it was shown, in order."""
    heard: dict[int, int]
    """Frame -> its speaker, of beacons that the node has heard for sure."""


class Reception:
    """Feed it every beacon once; ask for links and shortages after :meth:`finish`."""

    def __init__(self, context: Context) -> None:
        self.observer = Observer(context, self._outcome)
        self.links: list[Link] = []
        self._trials: dict[int, list[Trial]] = {}
        """Bit of a node -> its trials in this window."""
        self._begin = 0
        self.begin = 0
        """When the recording began, ns since 1970."""
        self._wall = 0
        self._walls = (0, 0)
        self._tallies: dict[Group, Tally] = {}
        self._worst: dict[Group, Tally] = {}
        self.shown: dict[bytes, _Shown] = {}
        self._finished = False

    def feed(self, seen: Seen) -> None:
        """A beacon."""
        observer = self.observer
        observer.feed(seen)
        if not self._walls[0]:
            self.begin = seen.time
            self._walls = (seen.time, seen.time)
        if observer.time - self._begin > _WINDOW:
            self._walls = (self._walls[0], seen.time)
            self._close()
            self._begin, self._walls = observer.time, (seen.time, seen.time)
        self._wall = seen.time

    def finish(self) -> None:
        """The recording has ended; further calls do nothing."""
        if not self._finished:
            self._walls = (self._walls[0], self._wall)
            self._close()
            self._finished = True

    def _outcome(self, trial: Trial) -> None:
        trials = self._trials.setdefault(trial.station.bit, [])
        trials.append(trial)
        if len(trials) >= _MOST:
            self._judge(self._trials.pop(trial.station.bit))

    def _close(self) -> None:
        for trials in self._trials.values():
            self._judge(trials)
        self._trials.clear()

    # -- one node in one window ----------------------------------------------------------------------------------------

    def _judge(self, trials: list[Trial]) -> None:
        station = trials[0].station
        trials = _by_delay(trials)
        shown = self.shown.setdefault(station.node, _Shown())
        for trial in trials:
            if trial.hit:
                shown.hits[trial.kind] = shown.hits.get(trial.kind, 0) + 1
                shown.longest = max(shown.longest, trial.length)
                shown.late_half += trial.late_half
        groups: dict[Group, list[Trial]] = {}
        for trial in trials:
            groups.setdefault((station.node, trial.kind, None), []).append(trial)
            groups.setdefault((station.node, trial.kind, trial.var_id), []).append(trial)
        suspects: list[tuple[Group, list[Trial]]] = []
        for key, group in groups.items():
            hits = sum(trial.hit for trial in group)
            if len(group) - hits >= 2 and hits <= _SUSPICIOUS * len(group):
                suspects.append((key, group))
            elif hits >= 2:
                # It does what it must: what was missed before was another matter.
                self._keep(key, self._tallies.pop(key, None))
        # Whatever a node never does shows nothing of whom it hears, as long as there is anything that it does.
        left_out = {id(trial) for _, group in suspects for trial in group}
        rest = [trial for trial in trials if id(trial) not in left_out]
        if suspects:
            known = self._known(rest)
            for key, group in suspects:
                self._suspect(key, group, known)
        self._infer(station, rest or trials)

    def _infer(self, station: Station, trials: list[Trial]) -> None:
        """Who is heard by a node, in this window."""
        outcomes = _outcomes(trials)
        inferred = infer(outcomes)
        shares = {bit: share for bit, (share, _, _) in inferred.items()}
        for bit, (share, count, due) in inferred.items():
            if len(self.links) < _LINKS:
                speaker, bound = self.observer.by_bit[bit].node, lower_bound(bit, outcomes, shares)
                alone = hits_alone(bit, outcomes)
                self.links.append(Link(station.node, speaker, *self._walls, share, count, due, bound, alone))

    def _known(self, others: list[Trial]) -> _Known:
        """Whom a node hears in a window, as all its trials that are well show it."""
        outcomes = _outcomes(others)
        shares = {bit: share for bit, (share, _, _) in infer(outcomes).items()}
        steady = {
            bit
            for bit, share in shares.items()
            if share >= _STEADY and lower_bound(bit, outcomes, shares, _LIKELY) >= _AS_GOOD
        }
        bounds = {bit: lower_bound(bit, outcomes, shares, _CAUTIOUS) for bit in shares}
        # What looks as if it were due to a speaker may be due to somebody whose part is not known well.
        bounds = {
            bit: bound for bit, bound in bounds.items() if bound >= _HEARS and hits_alone(bit, outcomes) >= _ALONE
        }
        # Beacons that the node has heard for sure: it has taken something else that was in them, and in no other.
        heard = {trial.cause.frame: trial.speakers for trial in others if trial.once and trial.kind in _TAKEN}
        return _Known(steady, bounds, self._sure(others, shares), heard)

    def _suspect(self, key: Group, group: list[Trial], known: _Known) -> None:
        """Add what was expected of a group, as what is known of the node shows it."""
        steady, bounds, sure, heard = known
        tally = self._tallies.get(key)
        if tally is None:
            if len(self._tallies) >= _GROUPS:
                return
            tally = self._tallies[key] = Tally()
        gaps: dict[tuple[int, int, bool], _Gap] = {}
        for trial in group:
            bounds_of = {bit: bounds[bit] for bit, _ in trial.exposure if bit in bounds}
            tally.all_trials += 1
            tally.all_hits += trial.hit
            tally.all_expected += reacts(trial.exposure, bounds_of)
            believed = {
                bit: bound
                for bit, bound in bounds_of.items()
                if _between(sure.get(bit), trial.time, _BELIEF if bit in steady else _DOUBTFUL)
            }
            if (speaker := heard.get(trial.cause.frame)) is not None:
                believed = {speaker: _UP}
                gap = gaps.setdefault((0, trial.cause.frame, True), _Gap())
                gap.add(_UP, steady=True)
            elif believed:
                best = max(believed, key=lambda bit: believed[bit])
                place = bisect_left(sure[best], trial.time)
                gap = gaps.setdefault((best, place, sure[best][place] == trial.time), _Gap())
                gap.add(reacts(trial.exposure, believed), steady=best in steady)
            else:
                continue
            gap.hit = gap.hit or trial.hit
            if not trial.hit:
                for bit in believed:
                    gap.speakers |= bit
                gap.late_half = gap.late_half and trial.late_half
                gap.shortest = min(gap.shortest, trial.length)
                gap.cause = gap.cause or trial.cause
        tally.add(gaps.values())
        self._keep(key, tally)

    def _sure(self, trials: Iterable[Trial], shares: dict[int, float]) -> dict[int, list[int]]:
        """When the node has shown that it hears a speaker, and nobody else in its place."""
        sure: dict[int, list[int]] = {}
        alone: dict[Exposure, tuple[int, ...]] = {}
        """Speakers of a trial -> those whom nobody else can stand for."""
        for trial in trials:
            if trial.hit:
                said = trial.exposure
                if said not in alone:
                    alone[said] = tuple(bit for bit, _ in said if reacts(without(said, bit), shares) < 1 - _SURE)
                for bit in alone[said]:
                    sure.setdefault(bit, []).append(trial.time)
        for times in sure.values():
            times.sort()
        return sure

    def _keep(self, key: Group, tally: Tally | None) -> None:
        if tally is None or not tally.all_trials:
            return
        worst = self._worst.get(key)
        if worst is None or (tally.chance, -tally.all_expected) < (worst.chance, -worst.all_expected):
            self._worst[key] = tally

    def _trials_of(self, key: Group) -> int:
        tally = self._worst.get(key)
        return -1 if tally is None else tally.all_trials

    # -- what came of it -----------------------------------------------------------------------------------------------

    def shortages(self) -> list[Shortage]:
        """What did not come, the most certain first; a variable is named where others of the node are well."""
        found: list[Shortage] = []
        for (node, kind, var_id), tally in self._worst.items():
            if tally.short or tally.doubtful:
                station = self.observer.stations[node]
                names = tuple(self.observer.by_bit[bit].node for bit in bits(tally.speakers))
                certain = tally.short and tally.chance < (_CHANCE if tally.steady else _UNSTEADY)
                found.append(Shortage(station, kind, var_id, tally, names, certain))
        # All variables together say more than each, unless it is one of them alone.
        every = {(each.station.node, each.kind) for each in found if each.var_id is None and each.certain}
        alone = {
            (each.station.node, each.kind)
            for each in found
            if each.var_id is not None
            and each.tally.all_trials == self._trials_of((each.station.node, each.kind, None))
        }
        found = [each for each in found if each.var_id is not None or (each.station.node, each.kind) not in alone]
        kept = [each for each in found if each.var_id is None or (each.station.node, each.kind) not in every - alone]
        # What is uncertain is told once, of all variables, and not beside what is certain.
        told = {(each.station.node, each.kind) for each in kept if each.var_id is None or each.certain}
        kept = [
            each for each in kept if each.certain or (each.var_id is None) or (each.station.node, each.kind) not in told
        ]
        single = {(each.station.node, each.kind) for each in kept if each.var_id is not None and each.certain}
        kept = [each for each in kept if each.certain or (each.station.node, each.kind) not in single]
        return sorted(kept, key=lambda each: each.tally.chance)


def _between(times: list[int] | None, time: int, belief: int) -> bool:
    """Whether it was shown before and after, both at most ``belief`` ns away."""
    if not times:
        return False
    after = bisect_left(times, time)
    before = bisect_right(times, time)
    return after < len(times) and times[after] - time <= belief and before > 0 and time - times[before - 1] <= belief


def _by_delay(trials: list[Trial]) -> list[Trial]:
    """The trials with what each reaction is due to, as the delays of all reactions show when payloads are composed.

    Delays of a node that composes a payload right before it sends it become rarer with their length, however bad the
    links are. If most reactions come with its second beacon, what it heard right before that is not their cause.
    """
    first = sum(trial.delay == 1 for trial in trials if trial.hit)
    second = sum(trial.delay == 2 for trial in trials if trial.hit)
    if max(first, second) < _DELAYS:
        return trials
    if first >= _MOSTLY * second:
        return [_due_to(trial, trial.at_once) for trial in trials]
    if second >= _MOSTLY * first:
        return [_due_to(trial, trial.ahead) for trial in trials]
    return trials


def _due_to(trial: Trial, causes: Exposure) -> Trial:
    """The trial with the beacons of ``causes``; who is not among those remains possible, as delays may differ."""
    if not trial.hit or not causes:
        return trial
    counts = dict(causes)
    return trial._replace(exposure=tuple((bit, counts.get(bit, count)) for bit, count in trial.exposure))


def _outcomes(trials: Iterable[Trial]) -> dict[int, tuple[int, int]]:
    outcomes: dict[Exposure, tuple[int, int]] = {}
    for trial in trials:
        missed, hit = outcomes.get(trial.exposure, (0, 0))
        outcomes[trial.exposure] = (missed, hit + 1) if trial.hit else (missed + 1, hit)
    return outcomes


def reception_of(context: Context) -> Reception:
    """What all rules of one recording share."""
    found = context.shared.get(Reception)
    if not isinstance(found, Reception):
        found = context.shared[Reception] = Reception(context)
    return found
