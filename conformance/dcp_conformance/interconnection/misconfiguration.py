"""Settings of the tester that do not fit the implementation: another profile, network, EtherType or node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Final

from dcp_spec.profile.loading import BUILTIN_PROFILES

from dcp_codec.codec import Codec, get_codec
from dcp_codec.errors import DecodeError
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.lower_tester import HearsEveryType
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.traffic import Event

from .probe import question
from .profile_ranking import EXPLAINED, doubtful, ranked_with

#: Beacon periods to wait for an answer.
PERIODS: Final = 8.0
#: Network identifiers that are tried when nothing is heard, beside those of the built-in profiles.
_NETWORKS: Final = (0, 1, 2, 3, 0x00FF, 0x0100, 0x1111, 0x1234, 0xFFFF)
#: EtherTypes that are tried when nothing is heard, beside those of the built-in profiles: the local experimental ones.
_ETHER_TYPES: Final = (0x88B5, 0x88B6)


def misnamed(bench: Bench) -> ReceivedBeacon | None:
    """A beacon of the implementation under another name: its own one backwards, or sent from its address."""
    own = bench.session.sut_id
    if own is None or bench.heard:
        return None
    ethernet = bench.profile.link.transport == "ethernet"
    for heard in bench.others:
        if heard.sender == own[::-1] or (ethernet and heard.source == own and heard.sender is not None):
            return heard
    return None


def suspect(bench: Bench) -> str:
    """Which setting of the tester explains the frames that were heard; empty if none does."""
    frames = [each for each in bench.traffic.events if each.direction in ("heard", "other")]
    if not frames:
        return ""
    payloads = [(each.wall, each.frame[each.start :]) for each in frames]
    return _other_profile(bench, payloads) or _other_network(bench) or _other_node(bench, frames)


def _other_profile(bench: Bench, payloads: Sequence[tuple[int, bytes]]) -> str:
    ranked = ranked_with(bench.codec, payloads)
    if ranked.best.explained < EXPLAINED or not doubtful(ranked, bench.profile.name):
        return ""
    return f"its frames look like {ranked}; try --profile {ranked.best.profile.name}"


def _other_network(bench: Bench) -> str:
    """All beacons carry another network identifier than the tester's."""
    if not bench.profile.has_header_field("networkId"):
        return ""
    ours = bench.parameter("BPPAR_NETWORK_ID")
    beacons = [each.beacon for each in bench.heard if each.beacon is not None and each.beacon.bp is not None]
    theirs = Counter(each.bp.network_id for each in beacons if each.bp is not None)
    if not theirs or ours in theirs:
        return ""
    number = theirs.most_common(1)[0][0]
    told = bench.session.parameters.get("BPPAR_NETWORK_ID")
    if told == ours:
        # It says one number and sends another: a fault of its own (BP-HDR-04).
        return ""
    return f"its beacons carry networkId {number}, the tester uses {ours}: give [pixit] network_id = {number}"


def _other_node(bench: Bench, frames: Sequence[Event]) -> str:
    """Others were heard, but nobody with the identifier of the implementation."""
    if bench.heard or not bench.others or bench.session.sut_id is None or misnamed(bench) is not None:
        return ""
    senders = Counter(each.who for each in frames)
    listed = ", ".join(f"{who} ({count} frames)" for who, count in senders.most_common(4))
    from_pics = bench.pixit.node_id is not None
    source = "[pixit] node_id" if from_pics else "UT-Hello"
    advice = "give its own node identifier there" if from_pics else "is that the implementation's own?"
    return f"frames came from {listed}, none from {bench.session.sut_id.hex(':')} of {source}: {advice}"


def look_elsewhere(bench: Bench) -> str:
    """Nothing is heard: ask in other ways. Which setting of the tester explains the answer; empty if none comes."""
    return _told_by_hello(bench) or _asked_otherwise(bench) or _other_ether_type(bench)


def _told_by_hello(bench: Bench) -> str:
    upper = bench.session.upper
    told = upper.about.get("profile") if upper is not None else None
    if not isinstance(told, str) or not told or told == bench.profile.name:
        return ""
    return f"UT-Hello says that its profile is {told}, the tester speaks {bench.profile.name}: try --profile {told}"


def _asked_otherwise(bench: Bench) -> str:
    """Ask in every built-in profile, then for other networks."""
    for number, name in enumerate(BUILTIN_PROFILES):
        codec = get_codec(name)
        if name != bench.profile.name:
            bench.transmit(question(codec, number), bench.peer().address)
    bench.beacons(1, PERIODS)
    if not bench.heard and not bench.others and bench.profile.has_header_field("networkId"):
        var_id = bench.unknown_ids(1)[0] if bench.has_unknown_ids() else 0
        for network_id in _networks(bench):
            peer = bench.peer()
            peer.send(peer.summary(var_id, 1), network_id=network_id)
        bench.beacons(1, PERIODS)
    return suspect(bench)


def _networks(bench: Bench) -> list[int]:
    """Network identifiers to try, without the tester's own."""
    top = 1 << (8 * bench.profile.types.network_id.width)
    known = (get_codec(name).profile.bp.network_id for name in BUILTIN_PROFILES)
    numbers = dict.fromkeys((*(each for each in known if each is not None), *_NETWORKS))
    return [each for each in numbers if each < top and each != bench.parameter("BPPAR_NETWORK_ID")]


def _other_ether_type(bench: Bench) -> str:
    """Listen to, and ask in, other EtherTypes, where the link has any."""
    lower = bench.lower
    if not isinstance(lower, HearsEveryType):
        return ""
    known = (get_codec(name).profile.link.ether_type for name in BUILTIN_PROFILES)
    numbers = dict.fromkeys((*(each for each in known if each is not None), *_ETHER_TYPES))
    octets = question(bench.codec, 0)
    source = bench.peer().address
    asked = [b"\xff" * 6 + source + each.to_bytes(2, "big") + octets for each in numbers if each != lower.ether_type]
    found: Counter[int] = Counter()
    for frame in lower.overhear(asked, round(PERIODS * bench.period)):
        if _is_beacon(bench.codec, frame[14:]):
            found[int.from_bytes(frame[12:14], "big")] += 1
    if not found:
        return ""
    number, count = found.most_common(1)[0]
    return (
        f"{count} beacons came in frames with EtherType {number:#06x}, the tester listens to {lower.ether_type:#06x}: "
        f"give --ether-type {number:#06x}"
    )


def _is_beacon(codec: Codec, octets: bytes) -> bool:
    """Whether octets are a beacon of the profile, or of another one."""
    for each in (codec, *map(get_codec, BUILTIN_PROFILES)):
        if each.profile.bp.header:
            try:
                each.decode(octets)
            except DecodeError:
                continue
            return True
    return False
