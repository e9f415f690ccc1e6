"""The basic interconnection test (ISO/IEC 9646): how implementation and tester reach each other.

A healthy implementation gets one question and gives one answer. One that does not answer gets other kinds of stimulus,
through the link and then through the upper tester. If nothing can be understood, the usual mistakes are tried: another
profile, network identifier, EtherType or node identifier.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, QueueingMode
from dcp_spec.profile_loading import BUILTIN_PROFILES

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec, get_codec
from dcp_codec.errors import DecodeError
from dcp_codec.guess import SAMPLE, Guess, guess

from .bench import Bench
from .clients import ACTIVATE, CLIENT, DEREGISTER, RECEIVED, BPClient, indications, until
from .contact import BrokenRule, Contact, Question, Stimulus, stimuli
from .errors import UpperTesterError
from .forge import Block
from .header_rules import Violation, judge
from .heard import Heard, var_id_of
from .lower import HearsEveryType
from .probe import doubt, question
from .results import Mark
from .traffic import Event

#: Attempts with the first question, and with each further kind of stimulus: frames get lost.
_ATTEMPTS: Final = 3
_FURTHER: Final = 2
#: Beacon periods to wait for an answer.
_PERIODS: Final = 8.0
#: Beacon periods to wait for any beacon without VarDis.
_SILENCE: Final = 20.0
#: Network identifiers that are tried when nothing is heard, beside those of the built-in profiles.
_NETWORKS: Final = (0, 1, 2, 3, 0x00FF, 0x0100, 0x1111, 0x1234, 0xFFFF)
#: EtherTypes that are tried when nothing is heard, beside those of the built-in profiles: the local experimental ones.
_ETHER_TYPES: Final = (0x88B5, 0x88B6)
#: Frames that are judged octet by octet.
_JUDGED: Final = 8
#: Profiles whose scores are below this explain nothing.
_EXPLAINED: Final = 0.3


def make_contact(bench: Bench) -> Contact:
    """Find out how the implementation can be reached; see the module. Stops no case and records no check.

    Raises ``LowerTesterError``.
    """
    return _Test(bench).run()


class _Test:
    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._tried: set[Stimulus] = set()
        self._answered: set[Stimulus] = set()
        self._trouble = ""

    def run(self) -> Contact:
        """The whole test."""
        bench = self._bench
        if bench.pics.vardis is False:
            if bench.beacons(1, _SILENCE):
                return self._contact()
        elif self._ask("summary", _ATTEMPTS):
            return self._contact()
        suspicion = _suspicion(bench)
        if not suspicion:
            self._try_other_stimuli()
            suspicion = _suspicion(bench)
        if suspicion:
            return self._contact(suspicion, mistaken=True)
        if bench.heard or _misnamed(bench) is not None:
            return self._contact(self._what_it_tells())
        if self._activated():
            return self._contact("BP is inactive until BP-MGMT-Activate is called", inactive=True)
        if suspicion := _look_elsewhere(bench):
            return self._contact(suspicion, mistaken=True)
        return self._contact(self._silence())

    def _contact(self, suspicion: str = "", *, mistaken: bool = False, inactive: bool = False) -> Contact:
        bench = self._bench
        return Contact(
            frames=len(bench.heard),
            beacons=sum(not each.header_problems for each in bench.heard),
            answered=frozenset(self._answered),
            unanswered=frozenset(self._tried - self._answered),
            violations=tuple(_broken_rules(bench, vardis="summary" not in self._answered)),
            suspicion=suspicion,
            mistaken=mistaken,
            odd="" if "summary" in self._answered else _odd_answer(bench),
            inactive=inactive,
            trouble=self._trouble,
        )

    # -- stimuli -------------------------------------------------------------------------------------------------------

    def _ask(self, kind: Question, attempts: int = _FURTHER) -> bool:
        """Try a stimulus on the link; whether it is answered."""
        bench = self._bench
        if kind == "summary" and not bench.has_unknown_ids():
            return False
        self._tried.add(kind)
        if any(bench.ask(kind, _PERIODS) for _ in range(attempts)):
            self._answered.add(kind)
            return True
        return False

    def _try_other_stimuli(self) -> None:
        bench = self._bench
        if bench.pics.vardis is not False:
            self._ask("create")
            self._ask("request")
        if bench.session.upper is None:
            return
        try:
            self._through_the_upper_tester(bench.session.upper.methods)
        except UpperTesterError as error:
            self._trouble = str(error)

    def _through_the_upper_tester(self, methods: frozenset[str]) -> None:
        if methods.issuperset(CLIENT):
            self._play_client()
        if "RTDB-Create" in methods and self._bench.has_unknown_ids():
            self._create_variable()
        if not self._bench.profile.srp.record or self._bench.pics.srp is False:
            return
        if "SRP-NeighbourTable" in methods:
            self._tried.add("report")
            if self._report():
                self._answered.add("report")
        if "SRP-UpdateSafetyData" in methods:
            self._update_state()

    def _play_client(self) -> None:
        """A client protocol: what arrives for it is indicated, what it submits comes in a beacon."""
        bench = self._bench
        client = BPClient(bench, QueueingMode.ONCE)
        if not client.register().ok:
            return
        try:
            self._tried |= {"payload", "transmit"}
            peer = bench.peer()
            peer.send(Block(client.prot_id, b"\x01"))
            if until(bench, lambda: bool(indications(bench, RECEIVED, client.prot_id)), _PERIODS):
                self._answered.add("payload")
            payload = client.payload(4)
            if client.transmit(payload, must=False).ok and client.until_sent(payload, _PERIODS):
                self._answered.add("transmit")
        finally:
            bench.call(DEREGISTER, protId=client.prot_id)

    def _create_variable(self) -> None:
        """A variable of the implementation's application comes in a beacon."""
        bench = self._bench
        var_id = bench.own_var_id()
        if not bench.call("RTDB-Create", varId=var_id, repCnt=1, descr="tester", value="01").ok:
            return
        self._tried.add("variable")
        if bench.until_instruction(ICType.CREATE_VARIABLES, var_id, _PERIODS) is not None:
            self._answered.add("variable")

    def _update_state(self) -> None:
        """Safety data that are handed down come in a beacon."""
        bench = self._bench
        layout = bench.profile.srp.safety_data
        if any(each.type == "opaque" for each in layout):
            return
        if not bench.call("SRP-UpdateSafetyData", sData={each.name: 1 for each in layout}).ok:
            return
        self._tried.add("state")
        if bench.until(lambda heard: heard.report is not None, _PERIODS):
            self._answered.add("state")

    def _activated(self) -> bool:
        """Whether BP answers as soon as it is activated. What was found before stays as it is."""
        bench, upper = self._bench, self._bench.session.upper
        if self._trouble or upper is None or ACTIVATE not in upper.methods:
            return False
        try:
            if not bench.call(ACTIVATE).ok:
                return False
        except UpperTesterError as error:
            self._trouble = str(error)
            return False
        return bool(bench.beacons(1, _PERIODS)) if bench.pics.vardis is False else bench.ask("summary", _PERIODS)

    def _report(self) -> bool:
        bench = self._bench
        peer = bench.peer()
        peer.send(bench.report(peer.node_id, 1))
        bench.wait(2)
        told = bench.call("SRP-NeighbourTable").result.get("neighbours")
        listed = (
            [str(each.get("nodeId", "")) for each in told if isinstance(each, dict)] if isinstance(told, list) else []
        )
        return peer.node_id.hex() in [each.replace(":", "").lower() for each in listed]

    # -- in words ------------------------------------------------------------------------------------------------------

    def _silence(self) -> str:
        """Nothing was heard, and no usual mistake explains it."""
        bench = self._bench
        where = "is it running, on this link, with this EtherType or port?"
        upper = bench.session.upper
        if self._trouble:
            return f"nothing was heard, and the upper tester does not answer ({self._trouble}): {where}"
        if upper is not None:
            return f"nothing was heard, though the upper tester answers: is {bench.lower.name} its link? {where}"
        return f"nothing was heard: {where}"

    def _what_it_tells(self) -> str:
        """Something was heard and not all is well; no mistake of the tester's settings explains it."""
        heard = self._bench.heard
        if not any(not each.header_problems for each in heard):
            return f"none of {len(heard)} frames of it is a beacon of the profile {self._bench.profile.name}"
        return ""


# -- rules of the octets -----------------------------------------------------------------------------------------------


def _broken_rules(bench: Bench, *, vardis: bool) -> Iterable[BrokenRule]:
    """What frames of the implementation break, each requirement once.

    What is wrong in client payloads is for cases to find, except in those of VarDis if ``vardis``.
    """
    found: dict[str, BrokenRule] = {}
    events = {each.number: each for each in bench.traffic.events if each.number}
    for heard, each in _violations(bench):
        event = events.get(heard.number)
        inside = ".srp" in each.path or (".vardis" in each.path and not vardis)
        if each.requirement and not inside and each.requirement not in found and event is not None:
            mark = Mark(heard.number, event.start + each.offset, each.length, each.path)
            found[each.requirement] = BrokenRule(each.requirement, each.expected, each.observed, mark)
    return found.values()


def _violations(bench: Bench) -> Iterator[tuple[Heard, Violation]]:
    """Frames with what they break; first what only shows in comparison."""
    if (misnamed := _misnamed(bench)) is not None and bench.session.sut_id is not None:
        yield misnamed, _at(bench, misnamed, "bp.senderId", "BP-HDR-03", bench.session.sut_id.hex(":"))
    if (renumbered := _renumbered(bench)) is not None:
        heard, block = renumbered
        right = f"{BP_PROTID_VARDIS:#06x} for VarDis"
        yield heard, _at(bench, heard, f"payloads[{block}].protocolId", "BP-HDR-11", right)
        # What stands in blocks with the wrong number breaks the rules of another protocol.
        return
    network_id = bench.parameter("BPPAR_NETWORK_ID")
    for heard in _sampled(bench.heard):
        source = heard.source if bench.profile.link.transport == "ethernet" else None
        broken = judge(heard.octets, bench.codec, network_id=network_id, source=source)
        outside = [each for each in broken if ".srp" not in each.path and ".vardis" not in each.path]
        # Where blocks begin in the wrong place, nothing is known of what is in them.
        for each in outside or broken:
            yield heard, each


def _sampled(heard: Sequence[Heard]) -> Sequence[Heard]:
    """Frames to judge: the first ones, and later ones, which may hold other blocks. To judge a bad frame takes long."""
    half = _JUDGED // 2
    return heard if len(heard) <= _JUDGED else [*heard[:half], *heard[half :: len(heard) // half][:half]]


def _at(bench: Bench, heard: Heard, path: str, requirement: str, right: str) -> Violation:
    """A field with the wrong octets; ``right`` is what it should say."""
    field = bench.codec.dissect(heard.octets).root.find(path)
    place = (0, 0) if field is None else (field.offset, field.length)
    octets = heard.octets[place[0] : sum(place)].hex()
    return Violation(requirement, f"{path.rpartition('.')[2]} is {right}", f"its octets are {octets}", *place, path)


def _misnamed(bench: Bench) -> Heard | None:
    """A beacon of the implementation under another name: its own one backwards, or sent from its address."""
    own = bench.session.sut_id
    if own is None or bench.heard:
        return None
    ethernet = bench.profile.link.transport == "ethernet"
    for heard in bench.others:
        if heard.sender == own[::-1] or (ethernet and heard.source == own and heard.sender is not None):
            return heard
    return None


def _renumbered(bench: Bench) -> tuple[Heard, int] | None:
    """A beacon in which VarDis answers under another protocolId, and the number of the block; None if there is none."""
    asked = {var_id for _, var_id in stimuli(bench.codec, bench.traffic.events, ())}
    for heard in bench.heard:
        for number, (prot_id, octets) in enumerate(heard.blocks):
            if prot_id == BP_PROTID_VARDIS:
                continue
            try:
                containers = bench.codec.decode_containers(octets)
            except DecodeError:
                continue
            if any(var_id_of(record) in asked for container in containers for record in container.records):
                return heard, number
    return None


def _odd_answer(bench: Bench) -> str:
    """A record about a variable that the tester has summarised, and that is no request for it; empty if none came."""
    asked = {var_id for kind, var_id in stimuli(bench.codec, bench.traffic.events, bench.made) if kind == "summary"}
    for heard in bench.heard:
        for each in heard.instructions():
            if each.var_id in asked and each.kind is not ICType.REQUEST_VARCREATES:
                return f"a {each.kind.label} record of variable {each.var_id}"
    return ""


# -- mistakes ----------------------------------------------------------------------------------------------------------


def _suspicion(bench: Bench) -> str:
    """Which setting of the tester explains the frames that were heard; empty if none does."""
    frames = [each for each in bench.traffic.events if each.direction in ("heard", "other")]
    if not frames:
        return ""
    payloads = [(each.wall, each.frame[each.start :]) for each in frames]
    return _other_profile(bench, payloads) or _other_network(bench) or _other_node(bench, frames)


def _other_profile(bench: Bench, payloads: Sequence[tuple[int, bytes]]) -> str:
    ranked = _ranked(bench.codec, payloads)
    ours = max((each.score for each in ranked.candidates if each.profile.name == bench.profile.name), default=0.0)
    if ranked.best.score < _EXPLAINED or not doubt(ranked.best.score, ours):
        return ""
    return f"its frames look like {ranked}; try --profile {ranked.best.profile.name}"


def _ranked(codec: Codec, payloads: Sequence[tuple[int, bytes]]) -> Guess:
    others = [get_codec(name) for name in BUILTIN_PROFILES if name != codec.profile.name]
    frames = [Frame(number, wall, octets, len(octets)) for number, (wall, octets) in enumerate(payloads[:SAMPLE], 1)]
    return guess(frames, profiles=[codec, *others], framed=False)


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
    if bench.heard or not bench.others or bench.session.sut_id is None or _misnamed(bench) is not None:
        return ""
    senders = Counter(each.who for each in frames)
    listed = ", ".join(f"{who} ({count} frames)" for who, count in senders.most_common(4))
    from_pics = bench.pixit.node_id is not None
    source = "[pixit] node_id" if from_pics else "UT-Hello"
    advice = "give its own node identifier there" if from_pics else "is that the implementation's own?"
    return f"frames came from {listed}, none from {bench.session.sut_id.hex(':')} of {source}: {advice}"


def _look_elsewhere(bench: Bench) -> str:
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
    bench.beacons(1, _PERIODS)
    if not bench.heard and not bench.others and bench.profile.has_header_field("networkId"):
        var_id = bench.unknown_ids(1)[0] if bench.has_unknown_ids() else 0
        for network_id in _networks(bench):
            peer = bench.peer()
            peer.send(peer.summary(var_id, 1), network_id=network_id)
        bench.beacons(1, _PERIODS)
    return _suspicion(bench)


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
    for frame in lower.overhear(asked, round(_PERIODS * bench.period)):
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
