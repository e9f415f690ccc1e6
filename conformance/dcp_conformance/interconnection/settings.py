"""Settings of the tester that do not fit the implementation: another profile, network, EtherType or node."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Final

from dcp_spec.profile.loading import profile_names

from dcp_codec.analysis.guess import SAMPLE, Guess, guess
from dcp_codec.capture import Frame
from dcp_codec.codec import Codec, get_codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import VarSumm
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.lower_tester import ListensToAllTypes, LowerTester
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.traffic import Event

#: Beacon periods to wait for an answer.
PERIODS: Final = 8.0
#: Source address and sender identifier of questions.
ASKER = bytes.fromhex("02dc90000001")
#: Network identifiers that are tried when nothing is heard, beside those of the built-in profiles.
_NETWORKS: Final = (0, 1, 2, 3, 0x00FF, 0x0100, 0x1111, 0x1234, 0xFFFF)
#: EtherTypes that are tried when nothing is heard, beside those of the built-in profiles: the local experimental ones.
_ETHER_TYPES: Final = (0x88B5, 0x88B6)
#: A profile in which no block can be read of more than this share of the frames explains nothing.
EXPLAINED: Final = 0.3
#: Maximum difference in score between the best and the chosen profile that raises no doubt about the choice.
_CLOSE: Final = 0.05


# -- which setting explains what was heard -----------------------------------------------------------------------------


def misnamed(bench: Bench) -> ReceivedBeacon | None:
    """Return a beacon of the implementation under another name: its own one backwards, or sent from its address."""
    own = bench.session.sut_id
    if own is None or bench.heard:
        return None
    ethernet = bench.profile.link.transport == "ethernet"
    for heard in bench.receiver.others:
        if heard.sender == own[::-1] or (ethernet and heard.source == own and heard.sender is not None):
            return heard
    return None


def suspect(bench: Bench) -> str:
    """Return which setting of the tester explains the frames that were heard; empty if none does."""
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
    """Explain that all beacons carry another network identifier than the tester's."""
    if not bench.profile.has_header_field("networkId"):
        return ""
    ours = bench.sut.parameter("BPPAR_NETWORK_ID")
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
    """Explain silence if beacons were received, but none with the identifier of the implementation."""
    if bench.heard or not bench.receiver.others or bench.session.sut_id is None or misnamed(bench) is not None:
        return ""
    senders = Counter(each.who for each in frames)
    listed = ", ".join(f"{who} ({count} frames)" for who, count in senders.most_common(4))
    from_pics = bench.sut.pixit.node_id is not None
    source = "[pixit] node_id" if from_pics else "UT-Hello"
    advice = "give its own node identifier there" if from_pics else "is that the implementation's own?"
    return f"frames came from {listed}, none from {bench.session.sut_id.hex(':')} of {source}: {advice}"


def look_elsewhere(bench: Bench) -> str:
    """Ask in other ways, since nothing is heard; return which setting explains the answer, empty if none comes."""
    return (
        _profile_of_hello(bench)
        or _asked_otherwise(bench)
        or other_ether_type(bench.lower, bench.codec, bench.peer().address, round(PERIODS * bench.period))
    )


def _profile_of_hello(bench: Bench) -> str:
    upper = bench.session.upper
    if upper is None:
        return ""
    told = upper.about.get("profile")
    if not isinstance(told, str) or not told:
        return _other_version(bench, upper.about.get("specVersion"))
    if told == bench.profile.name:
        return ""
    return f"UT-Hello says that its profile is {told}, the tester speaks {bench.profile.name}: try --profile {told}"


def _other_version(bench: Bench, told: object) -> str:
    """Explain silence if UT-Hello names a version of the specification for which there are other profiles."""
    version = ".".join(told.split(".")[:2]) if isinstance(told, str) else ""
    fitting = [name for name in profile_names() if str(get_codec(name).profile.spec_version) == version]
    if not fitting or bench.profile.spec_version == version:
        return ""
    return (
        f"UT-Hello reports specification {told}, the tester's profile {bench.profile.name} is of "
        f"{bench.profile.spec_version}: try --profile {' or '.join(fitting)}"
    )


def _asked_otherwise(bench: Bench) -> str:
    """Ask in every built-in profile, then for other networks."""
    for number, name in enumerate(profile_names()):
        codec = get_codec(name)
        if name != bench.profile.name:
            bench.transmission.send(question(codec, number), bench.peer().address)
    bench.beacons(1, PERIODS)
    if not bench.heard and not bench.receiver.others and bench.profile.has_header_field("networkId"):
        var_id = bench.identifiers.unknown_ids(1)[0] if bench.identifiers.has_unknown_ids() else 0
        for network_id in network_ids(bench.codec, bench.sut.parameter("BPPAR_NETWORK_ID")):
            peer = bench.peer()
            peer.send(peer.summary(var_id, 1), network_id=network_id)
        bench.beacons(1, PERIODS)
    return suspect(bench)


def first_suspects(bench: Bench) -> str:
    """List the settings to compare first if an upper tester answers and no frame is received."""
    upper, profile = bench.session.upper, bench.profile
    about = upper.about if upper is not None else {}
    told = bench.session.parameters.get("BPPAR_NETWORK_ID")
    compared = [
        (f"the wire profile is {profile.name}", about.get("profile")),
        (f"its specification is {profile.spec_version}", about.get("specVersion")),
    ]
    if profile.has_header_field("networkId"):
        compared.append((f"the network identifier is {bench.sut.parameter('BPPAR_NETWORK_ID')}", told))
    listed = [f"{ours} (it says {theirs if theirs not in (None, '') else 'nothing'})" for ours, theirs in compared]
    return f"for the tester {', '.join(listed)}: is that so? ('dcp-conformance probe' finds them by trying)"


# -- questions with other settings -------------------------------------------------------------------------------------


def question(codec: Codec, number: int, network_id: int | None = None) -> bytes:
    """Return a beacon with the summary of a variable that does not exist: VarDis requests it (VD-PS-01).

    ``network_id``: by default that of the profile.
    """
    builder = FrameBuilder(codec)
    sender = codec.profile.types.node_id.of(ASKER)
    highest = (1 << (8 * codec.profile.types.var_id.width)) - 1
    block = builder.vardis(VarSumm(number % (highest + 1), 1))
    seqno = number + codec.profile.behaviour.first_beacon_seqno
    return builder.beacon(sender, seqno, [block], network_id=network_id)


def network_ids(codec: Codec, without: int | None) -> list[int]:
    """Return network identifiers to try, but for ``without``; none if the header of the profile has no such field."""
    if not codec.profile.has_header_field("networkId"):
        return []
    top = 1 << (8 * codec.profile.types.network_id.width)
    known = (get_codec(name).profile.bp.network_id for name in profile_names())
    numbers = dict.fromkeys((*(each for each in known if each is not None), *_NETWORKS))
    return [each for each in numbers if each < top and each != without]


def other_ether_type(lower: LowerTester, codec: Codec, source: bytes, duration: int) -> str:
    """Listen to other EtherTypes for ``duration`` ns, and ask in them; return what to change if beacons come.

    Raises ``LowerTesterError``.
    """
    if not isinstance(lower, ListensToAllTypes):
        return ""
    known = (get_codec(name).profile.link.ether_type for name in profile_names())
    numbers = dict.fromkeys((*(each for each in known if each is not None), *_ETHER_TYPES))
    octets = question(codec, 0)
    asked = [b"\xff" * 6 + source + each.to_bytes(2, "big") + octets for each in numbers if each != lower.ether_type]
    found: Counter[int] = Counter()
    for frame in lower.exchange_all_types(asked, duration):
        if _is_beacon(codec, frame[14:]):
            found[int.from_bytes(frame[12:14], "big")] += 1
    if not found:
        return ""
    number, count = found.most_common(1)[0]
    return (
        f"{count} beacons came in frames with EtherType {number:#06x}, the tester listens to {lower.ether_type:#06x}: "
        f"give --ether-type {number:#06x}"
    )


def _is_beacon(codec: Codec, octets: bytes) -> bool:
    """Return whether octets are a beacon of the profile, or of another one."""
    for each in (codec, *map(get_codec, profile_names())):
        if each.profile.bp.header:
            try:
                each.decode(octets)
            except DecodeError:
                continue
            return True
    return False


# -- the profile that frames speak for ---------------------------------------------------------------------------------


def ranked_by(codecs: Sequence[Codec], frames: Iterable[tuple[int, bytes]]) -> Guess:
    """Return the ranking of profiles by the first frames: when each came, in ns since 1970, and its bearer payload."""
    sample = [Frame(number, *each, len(each[1])) for number, each in zip(range(1, SAMPLE + 1), frames, strict=False)]
    return guess(sample, profiles=list(codecs), framed=False)


def ranked_with(codec: Codec, frames: Iterable[tuple[int, bytes]]) -> Guess:
    """Return the same as :func:`ranked_by`, of all built-in profiles and that of ``codec``."""
    others = [get_codec(name) for name in profile_names() if name != codec.profile.name]
    return ranked_by([codec, *others], frames)


def score_of(ranked: Guess, name: str) -> float:
    """Return the score of a profile, 0..1; 0 if it is not in the ranking."""
    return max((each.score for each in ranked.candidates if each.profile.name == name), default=0.0)


def doubtful(ranked: Guess, name: str) -> bool:
    """Return whether a ranking speaks against a profile; also if none explains anything."""
    best = ranked.best
    return best.score - score_of(ranked, name) > _CLOSE or best.explained < EXPLAINED
