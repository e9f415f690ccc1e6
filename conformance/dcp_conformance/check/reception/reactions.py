"""Find missing reactions of nodes that, by other reactions, show that they receive the beacons."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from dcp_conformance.check.base import Context, Seen
from dcp_conformance.check.statements import Statement

from .following import DELAYS, MOSTLY, Exposure, Kind, Proof, Station, Trial
from .links import ALONE, Inference, Link, bits, reacts, without
from .observer import Observer
from .tallies import UP, Gap, Tally
from .unrecorded import Timeline, silent_senders

#: A window of trials that are evaluated together: its length in ns, and its maximum number of trials of one node.
_WINDOW, _MOST = 20_000_000_000, 3_000
#: A reaction proves that a node hears a speaker if the others explain it with a probability below 1 - ``_SURE``.
_SURE = 0.6
#: Standard deviations between a share and its lower bound, and the minimum of this bound for any conclusion.
_CAUTIOUS, _HEARS = 3.0, 0.25
#: A missing reaction counts if the link was proved before and after it, each at most this far away (ns).
_BELIEF = 10_000_000_000
#: The same time (ns) for a link with a share below ``_STEADY``: it may fail and recover in between.
_DOUBTFUL, _STEADY = 2_500_000_000, 0.9
#: A steady link must have the share ``_AS_GOOD`` even ``_LIKELY`` standard deviations below its estimate.
_LIKELY, _AS_GOOD = 1.0, 0.8
#: A shortage is certain if its probability by chance is below ``_CHANCE``.
_CHANCE = 1e-3
#: The limit instead of ``_CHANCE`` if links fail: several missing reactions may then have one cause.
_UNSTEADY = 1e-6
#: Reactions that prove that the record was received.
_TAKEN = (Kind.TAKE_CREATE, Kind.TAKE_UPDATE, Kind.TAKE_DELETE)
#: Groups of trials with at most this share of reactions are examined for a shortage.
_SUSPICIOUS = 0.4
#: Maximum number of links (one for each pair and window) and of groups that are kept.
_LINKS = 100_000
#: Minimum number of missing reactions to certainly received records for a finding, and number of kept examples.
_PROVED, _EXAMPLES = 3, 16
_GROUPS = 65_536

Group = tuple[bytes, Kind, int | None]
"""Node, kind of reaction, and variable identifier; None for all variables."""


@dataclass(slots=True)
class Proved:
    """Missing reactions of one kind at one node to records of one variable that the node has certainly received."""

    station: Station
    kind: Kind
    var_id: int
    times: int = 0
    examples: list[tuple[Statement, Proof]] = field(default_factory=list)
    """The first records without a reaction, each with the proof of its reception."""


class Shortage(NamedTuple):
    """Missing reactions of one kind at one node."""

    station: Station
    kind: Kind
    var_id: int | None
    """The variable; None for all of them."""
    tally: Tally
    speakers: tuple[bytes, ...]
    """The nodes whose records got no reaction."""
    certain: bool
    """Whether chance is excluded; otherwise the shortage only withholds the verdict pass."""


@dataclass(slots=True)
class _Shown:
    """The reactions of a node in the whole recording."""

    hits: dict[Kind, int] = field(default_factory=dict)
    """Number of reactions by kind."""
    longest: int = 0
    """Length of the longest payload with a reaction, in octets."""
    late_half: int = 0
    """Number of reactions to records in the second half of a payload."""


class _Known(NamedTuple):
    """The speakers that a node hears in a window."""

    steady: set[int]
    """Speakers whose beacons are hardly ever lost."""
    bounds: dict[int, float]
    """Speaker -> lower bound of the share of its beacons that is heard; only speakers whose reception is certain."""
    sure: dict[int, list[int]]
    """Speaker -> the times at which reception was proved, in order."""
    heard: dict[int, int]
    """Number of a frame that the node has certainly received -> its speaker."""


class Reception:
    """Infers links and shortages. Pass each beacon to :meth:`feed` once, and call :meth:`finish` before the results."""

    def __init__(self, context: Context) -> None:
        self.observer = Observer(context, self._outcome)
        self.links: list[Link] = []
        self._trials: dict[int, list[Trial]] = {}
        """Bit of a node -> its trials in this window."""
        self._begin = 0
        self.begin = 0
        """Time of the first beacon, ns since 1970."""
        self._wall = 0
        self._walls = (0, 0)
        self._tallies: dict[Group, Tally] = {}
        self._worst: dict[Group, Tally] = {}
        self._proved: dict[tuple[bytes, Kind, int], Proved] = {}
        self.shown: dict[bytes, _Shown] = {}
        self._finished = False

    def feed(self, seen: Seen) -> None:
        """Process the next beacon of the recording."""
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
        """Evaluate the last window; further calls do nothing."""
        if not self._finished:
            self._walls = (self._walls[0], self._wall)
            self._close()
            self._finished = True

    def _outcome(self, trial: Trial) -> None:
        """Store a trial of the current window."""
        trials = self._trials.setdefault(trial.station.bit, [])
        trials.append(trial)
        if len(trials) >= _MOST:
            self._judge(self._trials.pop(trial.station.bit), self._unrecorded())

    def _close(self) -> None:
        """Evaluate the trials of the current window."""
        timeline = self._unrecorded()
        for trials in self._trials.values():
            self._judge(trials, timeline)
        self._trials.clear()
        self.observer.unrecorded.forget(self._begin)

    def _unrecorded(self) -> Timeline:
        """Return the times at which nodes may have sent beacons that the recorder missed, up to now."""
        observer = self.observer
        return observer.unrecorded.timeline(
            (each.bit, each.sent_at(each.beacons), each.sent_at(each.beacons - 1))
            for each in observer.stations.values()
        )

    # -- one node in one window ----------------------------------------------------------------------------------------

    def _judge(self, trials: list[Trial], unrecorded: Timeline) -> None:
        """Evaluate the trials of one node in one window: update the tallies of suspicious groups, and the links."""
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
            if trial.proof is not None:
                self._prove(trial, trial.proof, unrecorded)
            groups.setdefault((station.node, trial.kind, None), []).append(trial)
            groups.setdefault((station.node, trial.kind, trial.var_id), []).append(trial)
        suspects: list[tuple[Group, list[Trial]]] = []
        for key, group in groups.items():
            hits = sum(trial.hit for trial in group)
            if len(group) - hits >= 2 and hits <= _SUSPICIOUS * len(group):
                suspects.append((key, group))
            elif hits >= 2:
                # The node reacts as required now: earlier missing reactions had another cause.
                self._keep(key, self._tallies.pop(key, None))
        # A reaction that may have another cause is not evidence of reception, nor is one that the node never shows:
        # infer links from other groups, if any.
        trials = [trial for trial in trials if not trial.open_cause]
        left_out = {id(trial) for _, group in suspects for trial in group}
        rest = [_may_be_due_to(trial, unrecorded) for trial in trials if id(trial) not in left_out]
        if suspects:
            known = self._known(rest)
            for key, group in suspects:
                self._suspect(key, group, known)
        self._infer(station, rest or [_may_be_due_to(trial, unrecorded) for trial in trials])

    def _prove(self, trial: Trial, proof: Proof, unrecorded: Timeline) -> None:
        """Keep a missing reaction to a received record, unless a beacon that the recorder missed may be the reason."""
        if silent_senders(unrecorded, proof.since, proof.until) & trial.station.hears & ~trial.station.bit:
            return
        key = (trial.station.node, trial.kind, trial.var_id)
        if key in self._proved or len(self._proved) < _GROUPS:
            found = self._proved.setdefault(key, Proved(trial.station, trial.kind, trial.var_id))
            found.times += 1
            if len(found.examples) < _EXAMPLES:
                found.examples.append((trial.cause, proof))

    def _infer(self, station: Station, trials: list[Trial]) -> None:
        """Infer the links to a node in this window."""
        model = Inference(_outcomes(trials))
        for bit, share in model.shares.items():
            if len(self.links) < _LINKS:
                speaker, bound = self.observer.by_bit[bit].node, model.lower_bound(bit)
                alone = model.alone.get(bit, 0), model.alone_of.get(bit, 0)
                count, due = model.trials[bit], model.due[bit]
                self.links.append(Link(station.node, speaker, *self._walls, share, count, due, bound, *alone))

    def _known(self, others: list[Trial]) -> _Known:
        """Infer the speakers that a node hears in a window from the trials of its groups without suspicion."""
        model = Inference(_outcomes(others))
        shares = model.shares
        steady = {
            bit for bit, share in shares.items() if share >= _STEADY and model.lower_bound(bit, _LIKELY) >= _AS_GOOD
        }
        # A reaction that seems to be caused by one speaker may be caused by another one with an uncertain share.
        bounds = {bit: model.lower_bound(bit, _CAUTIOUS) for bit in shares if model.alone.get(bit, 0) >= ALONE}
        bounds = {bit: bound for bit, bound in bounds.items() if bound >= _HEARS}
        # Beacons that the node has certainly received: it took another record that only this beacon carried.
        heard = {trial.cause.frame: trial.speakers for trial in others if trial.once and trial.kind in _TAKEN}
        return _Known(steady, bounds, self._sure(others, shares), heard)

    def _suspect(self, key: Group, group: list[Trial], known: _Known) -> None:
        """Add the expected and observed reactions of a group in this window to its tally."""
        steady, bounds, sure, heard = known
        tally = self._tallies.get(key)
        if tally is None:
            if len(self._tallies) >= _GROUPS:
                return
            tally = self._tallies[key] = Tally()
        gaps: dict[tuple[int, int, bool], Gap] = {}
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
                believed = {speaker: UP}
                gap = gaps.setdefault((0, trial.cause.frame, True), Gap())
                gap.add(UP, steady=True)
            elif believed:
                best = max(believed, key=lambda bit: believed[bit])
                place = bisect_left(sure[best], trial.time)
                gap = gaps.setdefault((best, place, sure[best][place] == trial.time), Gap())
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
        """Return for each speaker the times of reactions that no other speaker explains, in order."""
        sure: dict[int, list[int]] = {}
        alone: dict[Exposure, tuple[int, ...]] = {}
        """Speakers of a trial -> those that the other speakers of the trial cannot replace."""
        for trial in trials:
            if trial.hit:
                statement = trial.exposure
                if statement not in alone:
                    alone[statement] = tuple(
                        bit for bit, _ in statement if reacts(without(statement, bit), shares) < 1 - _SURE
                    )
                for bit in alone[statement]:
                    sure.setdefault(bit, []).append(trial.time)
        for times in sure.values():
            times.sort()
        return sure

    def _keep(self, key: Group, tally: Tally | None) -> None:
        """Keep a tally if it is the least probable one of its group so far."""
        if tally is None or not tally.all_trials:
            return
        worst = self._worst.get(key)
        if worst is None or (tally.chance, -tally.all_expected) < (worst.chance, -worst.all_expected):
            self._worst[key] = tally

    def _trials_of(self, key: Group) -> int:
        """Return the number of trials in the kept tally of a group; -1 if it has none."""
        tally = self._worst.get(key)
        return -1 if tally is None else tally.all_trials

    # -- results -------------------------------------------------------------------------------------------------------

    def proved(self, least: int = _PROVED) -> list[Proved]:
        """Return the missing reactions to certainly received records, the most frequent first.

        ``least``: minimum number of times. A delete is sent a few times only, so that a single one counts.
        """
        enough = (each for each in self._proved.values() if each.times >= (each.kind is Kind.TAKE_DELETE or least))
        return sorted(enough, key=lambda each: -each.times)

    def shortages(self) -> list[Shortage]:
        """Return the missing reactions, the least probable first.

        A variable is named only if the node reacts to others. Otherwise one shortage stands for all variables.
        """
        found: list[Shortage] = []
        for (node, kind, var_id), tally in self._worst.items():
            if tally.short or tally.doubtful:
                station = self.observer.stations[node]
                names = tuple(self.observer.by_bit[bit].node for bit in bits(tally.speakers))
                certain = tally.short and tally.chance < (_CHANCE if tally.steady else _UNSTEADY)
                found.append(Shortage(station, kind, var_id, tally, names, certain))
        # Report a shortage of all variables instead of one for each, unless a single variable has all the trials.
        every = {(each.station.node, each.kind) for each in found if each.var_id is None and each.certain}
        alone = {
            (each.station.node, each.kind)
            for each in found
            if each.var_id is not None
            and each.tally.all_trials == self._trials_of((each.station.node, each.kind, None))
        }
        found = [each for each in found if each.var_id is not None or (each.station.node, each.kind) not in alone]
        kept = [each for each in found if each.var_id is None or (each.station.node, each.kind) not in every - alone]
        # Report uncertain shortages once for all variables, and only if there is no certain one.
        told = {(each.station.node, each.kind) for each in kept if each.var_id is None or each.certain}
        kept = [
            each for each in kept if each.certain or (each.var_id is None) or (each.station.node, each.kind) not in told
        ]
        single = {(each.station.node, each.kind) for each in kept if each.var_id is not None and each.certain}
        kept = [each for each in kept if each.certain or (each.station.node, each.kind) not in single]
        return sorted(kept, key=lambda each: each.tally.chance)


def _between(times: list[int] | None, time: int, belief: int) -> bool:
    """Whether ``times`` (sorted, ns) has an element before and one after ``time``, both at most ``belief`` ns away."""
    if not times:
        return False
    after = bisect_left(times, time)
    before = bisect_right(times, time)
    return after < len(times) and times[after] - time <= belief and before > 0 and time - times[before - 1] <= belief


def _by_delay(trials: list[Trial]) -> list[Trial]:
    """Return the trials with the causes of each reaction, according to when the node composes its payloads.

    If a node composes a payload immediately before it sends it, longer delays are rarer, however bad the links are. If
    most reactions are in its second beacon, it composes payloads one beacon ahead, and what it heard right before that
    beacon is not the cause.
    """
    first = sum(trial.delay == 1 for trial in trials if trial.hit)
    second = sum(trial.delay == 2 for trial in trials if trial.hit)
    if max(first, second) < DELAYS:
        return trials
    if first >= MOSTLY * second:
        return [_due_to(trial, trial.at_once) for trial in trials]
    if second >= MOSTLY * first:
        return [_due_to(trial, trial.ahead) for trial in trials]
    return trials


def _due_to(trial: Trial, causes: Exposure) -> Trial:
    """Return the trial with the numbers of beacons of ``causes``; other speakers remain possible causes."""
    if not trial.hit or not causes or causes is trial.exposure:
        return trial
    counts = dict(causes)
    return msgspec.structs.replace(
        trial, exposure=tuple((bit, counts.get(bit, count)) for bit, count in trial.exposure)
    )


def _may_be_due_to(trial: Trial, unrecorded: Timeline) -> Trial:
    """Return the trial with the nodes that may have caused the reaction by a beacon that the recorder missed."""
    if not trial.hit:
        return trial
    missed = silent_senders(unrecorded, trial.since, trial.until) & ~trial.station.bit
    if not missed:
        return trial
    others = tuple((bit, 1) for bit in bits(missed & ~trial.speakers))
    return msgspec.structs.replace(trial, exposure=tuple(sorted(trial.exposure + others)), once=False)


def _outcomes(trials: Iterable[Trial]) -> dict[Exposure, tuple[int, int]]:
    """Count trials without and with a reaction by their speakers and the numbers of their beacons."""
    outcomes: dict[Exposure, tuple[int, int]] = {}
    for trial in trials:
        missed, hit = outcomes.get(trial.exposure, (0, 0))
        outcomes[trial.exposure] = (missed, hit + 1) if trial.hit else (missed + 1, hit)
    return outcomes


def reception_of(context: Context) -> Reception:
    """Return the object that all rules of one recording share; create it on the first call."""
    found = context.shared.get(Reception)
    if not isinstance(found, Reception):
        found = context.shared[Reception] = Reception(context)
    return found
