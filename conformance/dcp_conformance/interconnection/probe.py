"""A first draft of a PICS: by listening to an implementation, and asking it what it is.

Only what was seen or told is stated. Everything else stays unset, with a question for people who know.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, BP_SEQNO_MODULUS

from dcp_codec.analysis.guess import Guess
from dcp_codec.codec import Codec
from dcp_codec.values import Beacon
from dcp_conformance.definitions.node_id import node_id_octets
from dcp_conformance.definitions.pics import DEFAULT_PROFILE, UNKNOWN_PROFILE, Capabilities, Pics, Target, Testing
from dcp_conformance.frames.envelopes import blocks_in, counted, nearest, sound
from dcp_conformance.frames.header_faults import explanation
from dcp_conformance.frames.header_rules import judge
from dcp_conformance.lower_tester import Arrival, LowerTester
from dcp_conformance.test_system.session import Session
from dcp_conformance.test_system.sut_properties import PIXIT
from dcp_conformance.upper_tester import Answer, UpperTester

from .findings import prepare
from .settings import ASKER, EXPLAINED, doubtful, network_ids, other_ether_type, question, ranked_by, score_of

#: ns for which other EtherTypes are listened to.
_OVERHEAR = 2_000_000_000
#: ns between questions in beacons.
_ASK_EVERY = 10_000_000
#: Least number of intervals for a mean period, and most missing sequence numbers that count as losses.
_ENOUGH, _MOST_LOST = 10, 5
#: Beacons that are closer together, in ms, do not come by a beacon period.
_LEAST_PERIOD = 1.0
#: Standard deviation of intervals, as a fraction of their mean, above which jitter is assumed to be intended.
_JITTER = 0.02
#: Frames that are judged octet by octet.
_LOOKED_AT = 100

#: Where PIXIT values come from, if the implementation tells its parameters.
PIXIT_OF = {"BPPAR_BEACON_PERIOD": "beacon_period_ms", "BPPAR_NETWORK_ID": "network_id", **PIXIT}
_GREATER_THAN_ZERO = frozenset({"beacon_period_ms", "neighbour_timeout_ms", "scrubbing_period_ms"})


class Period(NamedTuple):
    """How far apart the beacons of one sender are, in ms."""

    mean: float
    deviation: float
    intervals: int
    """The number of intervals."""

    @property
    def margin(self) -> float:
        """Half of the 95 % confidence interval of the mean, as for independent intervals."""
        return 1.96 * self.deviation / math.sqrt(self.intervals)

    def __str__(self) -> str:
        return (
            f"{self.mean:.2f} ms (95 % confidence: ±{self.margin:.2f} ms, {self.intervals} intervals, "
            f"standard deviation {self.deviation:.2f} ms)"
        )


class Draft(msgspec.Struct):
    """The PICS so far. ``remarks`` that begin with a key of the file give the source of its value."""

    sut: dict[str, Any] = {}
    pics: dict[str, Any] = {}
    pixit: dict[str, Any] = {}
    remarks: list[str] = []

    def set(self, table: str, key: str, value: Any, why: str) -> None:
        """Set a key, unless a better source has set it."""
        if key not in getattr(self, table):
            getattr(self, table)[key] = value
            self.remarks.append(f"{table}.{key}: {why}")

    def finished(self) -> Pics:
        """The file."""
        return Pics(sut=Target(**self.sut), pics=Capabilities(**self.pics), pixit=Testing(**self.pixit))


def draft(
    lower: LowerTester,
    upper: UpperTester | None,
    codec_candidates: Sequence[Codec],
    seconds: float,
    *,
    ask: bool = True,
    asked_for: str | None = None,
    asking: Sequence[Codec] | None = None,
) -> tuple[Pics, list[str]]:
    """Receive frames for this number of seconds, and query the upper tester if there is one.

    ``codec_candidates`` are the profiles that the implementation may speak. ``asked_for`` is chosen if several explain
    the received frames equally well (None: no preference). If none explains them, the nearest is proposed by headers
    and block lists alone. If none has these either, the profile of the draft is :data:`UNKNOWN_PROFILE`, which no run
    accepts. ``asking``: the profiles of questions in beacons, by default all candidates. ``ask``: if no VarDis payload
    is received in the first quarter of the time, the tester sends summaries of unknown variables, so that the
    implementation has a reason to send.

    Raises ``LowerTesterError`` and ``UpperTesterError``.
    """
    found = Draft()
    node_id = _introduce(found, upper)
    arrivals = _listen(lower, codec_candidates if asking is None else asking, seconds, ask, found)
    codec = _profile(found, upper, codec_candidates, arrivals, asked_for)
    if codec is not None and arrivals:
        _derive_settings(found, codec, arrivals, node_id)
        if ask:
            _how_fast(found, codec, lower, upper)
    if not arrivals:
        elsewhere = other_ether_type(lower, codec_candidates[0], ASKER, _OVERHEAR) if ask else ""
        found.remarks.append(
            f"nothing was heard on {lower.name} in {seconds:g} s: "
            + (elsewhere or "is the implementation running, on this link, with this EtherType or port?")
        )
    return found.finished(), found.remarks


# -- asking ----------------------------------------------------------------------------------------------------


def _introduce(found: Draft, upper: UpperTester | None) -> bytes | None:
    """Take what UT-Hello reports. Return the node identifier."""
    if upper is None:
        found.remarks.append("there is no upper tester: claims about services remain undecided")
        return None
    about = upper.about
    for key in ("name", "version"):
        if isinstance(about.get(key), str) and about[key]:
            found.set("sut", key, about[key], "as UT-Hello says")
    for method in ("BP-GetParameters", "SRP-GetParameters", "VD-GetParameters"):
        if method in upper.methods:
            _take_parameters(found, method, upper.call(method, {}))
    if "BP-SetParameter" in upper.methods:
        found.set("pics", "runtime_parameters", True, "BP-SetParameter is among its methods")
    for key, prefix in (("srp", "SRP-"), ("vardis", "RTDB-")):
        if any(method.startswith(prefix) for method in upper.methods):
            found.set("pics", key, True, f"methods of {prefix}* are among those that UT-Hello lists")
    node_id = about.get("nodeId")
    if not isinstance(node_id, str):
        return None
    try:
        octets = node_id_octets(node_id)
    except ValueError as error:
        found.remarks.append(f"UT-Hello says a nodeId that cannot be used: {error}")
        return None
    found.set("pixit", "node_id", node_id, "as UT-Hello says")
    return octets


def _take_parameters(found: Draft, method: str, answer: Answer) -> None:
    told = answer.result.get("parameters")
    if not answer.ok or not isinstance(told, dict):
        found.remarks.append(f"{method} is answered with {answer} and no parameters")
        return
    for name, key in PIXIT_OF.items():
        value = told.get(name)
        if value is None or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if value < 0 or (value == 0 and key in _GREATER_THAN_ZERO):
            found.remarks.append(f"{method} says {name} = {value}, which makes no sense and is not taken over")
            continue
        if key.endswith("_ms") or isinstance(value, int):
            found.set("pixit", key, value, f"{name}, as {method} says")


# -- listening -------------------------------------------------------------------------------------------------


def _listen(lower: LowerTester, codecs: Sequence[Codec], seconds: float, ask: bool, found: Draft) -> list[Arrival]:
    begun = lower.now()
    end = begun + round(seconds * 1e9)
    arrivals: list[Arrival] = []
    quiet_until = begun + round(seconds * 1e9 / 4)
    while (arrival := lower.receive(quiet_until)) is not None:
        arrivals.append(arrival)
    if not ask or any(blocks_in(codec, each)[BP_PROTID_VARDIS] for codec in codecs for each in arrivals):
        while (arrival := lower.receive(end)) is not None:
            arrivals.append(arrival)
        return arrivals
    what = "no VarDis payload was heard, and it" if arrivals else "it was silent, and"
    found.remarks.append(f"{what} has been asked for variables in beacons to hear {'one' if arrivals else 'it at all'}")
    # An implementation that sends is asked in its own layout only.
    codecs = [each for each in codecs if arrivals and 2 * sound(each, arrivals) > len(arrivals)] or codecs
    number, elsewhere = 0, False
    while lower.now() < end:
        for codec in codecs:
            lower.send(question(codec, number), ASKER)
        # An implementation that has not answered for half of the time may be in another network.
        elsewhere = elsewhere or (not arrivals and 2 * lower.now() > begun + end)
        for codec in codecs if elsewhere else ():
            networks = network_ids(codec, codec.profile.bp.network_id)
            for network_id in networks[number % len(networks) :][:1] if networks else ():
                lower.send(question(codec, number, network_id), ASKER)
        number += 1
        until = min(end, lower.now() + _ASK_EVERY)
        while (arrival := lower.receive(until)) is not None:
            arrivals.append(arrival)
    if elsewhere and arrivals:
        found.remarks.append("it did not answer in the usual network, and answered a question in another one")
    return arrivals


def _profile(
    found: Draft, upper: UpperTester | None, codecs: Sequence[Codec], arrivals: Sequence[Arrival], asked_for: str | None
) -> Codec | None:
    """Return the profile that UT-Hello names, otherwise the most likely one; ``asked_for`` decides between equals."""
    told = upper.about.get("profile") if upper is not None else None
    by_name = {codec.profile.name: codec for codec in codecs}
    ranked = ranked_by(codecs, ((each.wall, each.octets) for each in arrivals)) if arrivals else None
    if isinstance(told, str) and told in by_name:
        found.set("pixit", "profile", told, "as UT-Hello says")
        if ranked is not None and doubtful(ranked, told):
            found.remarks.append(f"UT-Hello says that the profile is {told}, but its frames look like {ranked}")
        return by_name[told]
    if ranked is None:
        return None
    if ranked.best.explained < EXPLAINED:
        return _unexplained(found, ranked, by_name, arrivals, asked_for)
    likely = {each.profile.name: each for each in (ranked.best, *ranked.tied)}
    name = next((each for each in (asked_for, DEFAULT_PROFILE) if each in likely), ranked.best.profile.name)
    others = [each for each in likely if each != name]
    text = f"a guess from {len(arrivals)} frames: {likely[name].counts}"
    if others:
        text += f"; {', '.join(others)} would explain them as well: is {name} right?"
    if asked_for is not None and name != asked_for and asked_for in by_name:
        score = score_of(ranked, asked_for)
        text += f"; {asked_for} explains them less well ({score:.2f}, and {ranked.best.score:.2f} for {name})"
    found.set("pixit", "profile", name, text)
    return by_name[name]


def _unexplained(
    found: Draft, ranked: Guess, by_name: Mapping[str, Codec], arrivals: Sequence[Arrival], asked_for: str | None
) -> Codec | None:
    """Nothing decodes: the profile that has headers and block lists of most frames, else the one asked for (or the
    usual one) if a known fault in its headers explains the frames, else none.
    """
    frames = arrivals[:_LOOKED_AT]
    fitting = {each.profile.name: sound(by_name[each.profile.name], frames) for each in ranked.candidates}
    most = max(fitting.values(), default=0)
    if 2 * most > len(frames):
        likely = [name for name, count in fitting.items() if count == most]
        name = asked_for if asked_for in likely else nearest(likely, by_name, frames)
        others = [each for each in likely if each != name]
        text = f"a guess: headers and block lists of {most} of {len(frames)} frames are those of {name}, but of the "
        text += f"blocks {counted(by_name[name], frames)}"
        if others:
            text += f"; the headers are also those of {', '.join(others)}: which one is it?"
        found.set("pixit", "profile", name, text)
        return by_name[name]
    codec = by_name.get(asked_for or DEFAULT_PROFILE)
    if codec is not None:
        faults = [explanation(each.octets, codec, codec.profile.bp.network_id, each.source) for each in frames]
        known = [each for each in faults if each is not None]
        if 2 * len(known) > len(frames):
            text = f"its headers break {known[0].requirements}: {known[0].observed} (expected {known[0].expected})"
            why = "asked for" if asked_for is not None else f"assumed, since nearly all of it is {codec.profile.name}"
            found.set("pixit", "profile", codec.profile.name, f"{why}; {text}")
            return codec
    text = f"none of the profiles explains what was heard; the best of them is {ranked}"
    found.set("pixit", "profile", UNKNOWN_PROFILE, f"{text}. Which wire profile is it? A run takes no unknown one")
    return None


def _derive_settings(found: Draft, codec: Codec, arrivals: Sequence[Arrival], node_id: bytes | None) -> None:
    """Derive settings from the beacons of the implementation."""
    senders: dict[bytes, list[tuple[Arrival, Beacon]]] = {}
    broken: list[Arrival] = []
    for arrival in arrivals:
        salvaged = codec.salvage(arrival.octets)
        if salvaged.problems:
            broken.append(arrival)
        beacon = salvaged.beacon
        if beacon is None or not salvaged.clear:
            continue
        sender = beacon.bp.sender_id if beacon.bp is not None else arrival.source
        senders.setdefault(sender, []).append((arrival, beacon))
    if broken:
        rules = Counter(
            f"{each.requirement}: {each.observed}"
            for arrival in broken[:_LOOKED_AT]
            for each in judge(arrival.octets, codec, source=arrival.source)
        )
        listed = "; ".join(f"{text} ({count} times)" for text, count in rules.most_common(5))
        found.remarks.append(f"{len(broken)} of {len(arrivals)} frames cannot be read to their end: {listed}")
        if sound(codec, arrivals):
            found.remarks.append(f"of the blocks {counted(codec, arrivals)}")
    if not senders:
        found.remarks.append(f"none of {len(arrivals)} frames is a beacon of {codec.profile.name}")
        return
    if len(senders) > 1:
        listed = ", ".join(f"{each.hex(':')} ({len(beacons)} beacons)" for each, beacons in senders.items())
        found.remarks.append(f"several senders were heard: {listed}")
    if node_id is None and len(senders) == 1 and codec.profile.bp.header:
        node_id = next(iter(senders))
        found.set("pixit", "node_id", node_id.hex(":"), "the only sender that was heard")
    if node_id is None or not codec.profile.bp.header:
        if len(senders) > 1:
            found.remarks.append("which of the senders is the implementation? Set pixit.node_id, and probe again")
            return
        node_id = next(iter(senders))
    if node_id not in senders:
        found.remarks.append(f"no beacon of {node_id.hex(':')}, which is what it says to be, was heard")
        return
    _derive_from_contents(found, [beacon for _, beacon in senders[node_id]])
    _derive_period(found, senders[node_id])


def _how_fast(found: Draft, codec: Codec, lower: LowerTester, upper: UpperTester | None) -> None:
    """How long reactions take: a remark, not a key, since each run measures it, too."""
    session = Session(codec, lower, upper, found.finished())
    if session.pics.pixit.node_id is not None:
        session.sut_id = node_id_octets(session.pics.pixit.node_id)
    elif codec.profile.bp.header:
        # It is unknown which sender's answers count.
        return
    if prepare(session):
        found.remarks.append(f"reactions are waited for {session.known.reaction}; each run measures this again")
    else:
        found.remarks.append("it answers no question in beacons, from which its reaction time would be measured")


def _derive_from_contents(found: Draft, beacons: Sequence[Beacon]) -> None:
    total, seen = len(beacons), Counter[str]()
    networks: Counter[int] = Counter()
    for beacon in beacons:
        if beacon.bp is not None and beacon.bp.network_id is not None:
            networks[beacon.bp.network_id] += 1
        protocols = Counter(payload.protocol_id for payload in beacon.payloads)
        # A pattern that the profile declares not to be a report does not indicate SRP.
        seen["srp"] += any(each.protocol_id == BP_PROTID_SRP and each.own_report is None for each in beacon.payloads)
        seen["vardis"] += BP_PROTID_VARDIS in protocols
        seen["multiple_payloads"] += max(protocols.values(), default=0) > 1
        for payload in beacon.payloads:
            if payload.protocol_id == BP_PROTID_VARDIS and isinstance(payload.content, tuple):
                kinds = Counter(container.ic_type for container in payload.content)
                if max(kinds.values(), default=0) > 1:
                    seen["several_containers"] += 1
                    break
    for key, count in seen.items():
        if count:
            found.set("pics", key, True, f"seen in {count} of {total} beacons")
    if len(networks) == 1:
        found.set("pixit", "network_id", next(iter(networks)), f"seen in all of {total} beacons")
    elif networks:
        found.remarks.append(f"its beacons have several network identifiers: {', '.join(map(str, networks))}")


def _derive_period(found: Draft, beacons: Sequence[tuple[Arrival, Beacon]]) -> None:
    period = measured_period(beacons)
    if period is None or period.mean < _LEAST_PERIOD:
        found.remarks.append(f"{len(beacons)} beacons are too few to measure the beacon period")
        return
    told = found.pixit.get("beacon_period_ms")
    if told is None:
        found.set("pixit", "beacon_period_ms", rounded(period), f"measured: {period}")
    else:
        found.remarks.append(f"the beacon period was measured as {period}; it says {told:g} ms")
    if period.deviation > _JITTER * period.mean:
        fraction = period.deviation / period.mean
        found.set("pics", "jitter", True, f"intervals vary by {fraction:.1%} of their mean (standard deviation)")
    else:
        found.remarks.append("the intervals between beacons hardly vary, which does not show that there is no jitter")


def measured_period(beacons: Sequence[tuple[Arrival, Beacon]]) -> Period | None:
    """The mean interval between the beacons of one sender; None if there are too few.

    Where sequence numbers show that a few beacons were lost, their intervals are counted. Intervals far from the median
    are left out: nothing is sent where there is nothing to send, and a tester can be late.
    """
    intervals: list[float] = []
    for (before, first), (after, second) in itertools.pairwise(beacons):
        step = 1
        if first.bp is not None and second.bp is not None:
            step = (second.bp.seqno - first.bp.seqno) % BP_SEQNO_MODULUS
        if 1 <= step <= _MOST_LOST:
            intervals.append((after.time - before.time) / step / 1e6)
    if not intervals:
        return None
    median = statistics.median(intervals)
    usual = [each for each in intervals if abs(each - median) <= median / 2]
    if len(usual) < _ENOUGH:
        return None
    return Period(statistics.fmean(usual), statistics.stdev(usual), len(usual))


def rounded(period: Period) -> float:
    """The roundest number of ms that the measurement leaves open."""
    for unit in (100, 50, 10, 5, 1):
        near = round(period.mean / unit) * unit
        if near and abs(period.mean - near) <= max(period.margin, 0.01 * period.mean):
            return float(near)
    return round(period.mean, 2)
