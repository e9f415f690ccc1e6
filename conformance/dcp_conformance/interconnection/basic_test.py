"""The basic interconnection test (ISO/IEC 9646): how implementation and tester reach each other.

A healthy implementation gets one question and gives one answer. One that does not answer gets other kinds of stimulus,
through the link and then through the upper tester. If nothing can be understood, the usual mistakes are tried: another
profile, network identifier, EtherType or node identifier.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Final, Literal

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, ICType, QueueingMode

from dcp_codec.errors import DecodeError
from dcp_conformance.definitions.results import Mark
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.header_rules import Violation, judge
from dcp_conformance.frames.received import ReceivedBeacon, var_id_of
from dcp_conformance.test_steps.bp_clients import (
    ACTIVATE,
    CLIENT,
    DEREGISTER,
    RECEIVED,
    BPClient,
    header_octets,
    indications,
    until,
    unused_protocol_id,
)
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.known import Question

from .contact import Contact, Stimulus, stimuli
from .layouts import stores_reports
from .settings import PERIODS, first_suspects, look_elsewhere, misnamed, suspect

#: Attempts with the first question, and with each further kind of stimulus: frames get lost.
_ATTEMPTS: Final = 3
_FURTHER: Final = 2
#: Beacon periods to wait for any beacon without VarDis.
_SILENCE: Final = 20.0
_LOOP: Final = (
    "it processes a block only if another one follows: its loop over the blocks probably ends at the length in the "
    "header, which lacks the header itself, as the pseudo-code in dcp-bp.md, Receive Path (index < bearerlen), has it "
    "by a misprint; the blocks end at length plus the size of the header"
)
#: Frames that are judged octet by octet.
_JUDGED: Final = 8


def make_contact(bench: Bench) -> Contact:
    """Find out how the implementation can be reached; see the module. Stops no case and records no check.

    Raises ``LowerTesterError``.
    """
    test = _Test(bench)
    contact = test.run()
    explained = contact.good or contact.mistaken or contact.inactive
    # An implementation that began to send during the test may have missed the first questions.
    return _Test(bench).run() if test.began_late and not explained else contact


class _Test:
    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._tried: set[Stimulus] = set()
        self._answered: set[Stimulus] = set()
        self._trouble = ""
        self._silent = False
        """Nothing at all was heard until the first question had failed."""

    @property
    def began_late(self) -> bool:
        """Whether the first frame came after the first question had been given up."""
        return self._silent and bool(self._bench.heard or self._bench.receiver.others)

    def run(self) -> Contact:
        """The whole test."""
        bench = self._bench
        if bench.sut.pics.vardis is False:
            if bench.beacons(1, _SILENCE):
                return self._contact()
        elif self._ask("summary", _ATTEMPTS):
            return self._contact()
        self._silent = not (bench.heard or bench.receiver.others)
        suspicion = _suspect(bench)
        if not suspicion:
            self._try_other_stimuli()
            suspicion = _suspect(bench)
        if suspicion:
            return self._contact(suspicion, mistaken=True)
        if self._ends_too_early():
            return self._contact(_LOOP, loses_last=True)
        if bench.heard or misnamed(bench) is not None:
            return self._contact(self._unexplained_frames())
        if self._activated():
            return self._contact("BP is inactive until BP-MGMT-Activate is called", inactive=True)
        if suspicion := look_elsewhere(bench):
            return self._contact(suspicion, mistaken=True)
        return self._contact(self._silence())

    def _contact(
        self, suspicion: str = "", *, mistaken: bool = False, inactive: bool = False, loses_last: bool = False
    ) -> Contact:
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
            loses_last=loses_last,
            trouble=self._trouble,
        )

    # -- stimuli -------------------------------------------------------------------------------------------------------

    def _ask(self, kind: Question, attempts: int = _FURTHER) -> bool:
        """Try a stimulus on the link; whether it is answered."""
        bench = self._bench
        if kind == "summary" and not bench.identifiers.has_unknown_ids():
            return False
        self._tried.add(kind)
        if any(bench.probes.ask(kind, PERIODS) for _ in range(attempts)):
            self._answered.add(kind)
            return True
        return False

    def _try_other_stimuli(self) -> None:
        bench = self._bench
        if bench.sut.pics.vardis is not False:
            self._ask("create")
            self._ask("request")
        if bench.session.upper is None:
            return
        try:
            self._through_the_upper_tester(bench.session.upper.methods)
        except UpperTesterError as error:
            self._trouble = str(error)

    def _ends_too_early(self) -> bool:
        """Return whether a summary is answered only if a block of an unregistered protocol follows it.

        The length in the header lacks the header. As a bound of offsets from the begin of a beacon, it ends too early.
        """
        bench = self._bench
        if bench.sut.pics.vardis is False or not bench.profile.has_header_field("length"):
            return False
        for _ in range(_FURTHER):
            if not bench.identifiers.has_unknown_ids():
                return False
            var_id, peer = bench.unknown_id(), bench.peer()
            filler = Block(unused_protocol_id(bench), bytes(2 * header_octets(bench)))
            peer.send(bench.builder.vardis(peer.summary(var_id, 1)), filler)
            if bench.until_instruction(ICType.REQUEST_VARCREATES, var_id, PERIODS) is not None:
                return True
        return False

    def _through_the_upper_tester(self, methods: frozenset[str]) -> None:
        if methods.issuperset(CLIENT):
            self._play_client()
        if "RTDB-Create" in methods and self._bench.identifiers.has_unknown_ids():
            self._create_variable()
        if not self._bench.profile.srp.is_report or self._bench.sut.pics.srp is False:
            return
        if "SRP-NeighbourTable" in methods:
            self._tried.add("report")
            if stores_reports(self._bench):
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
            if until(bench, lambda: bool(indications(bench, RECEIVED, client.prot_id)), PERIODS):
                self._answered.add("payload")
            payload = client.payload(4)
            if client.transmit(payload, must=False).ok and client.until_sent(payload, PERIODS):
                self._answered.add("transmit")
        finally:
            bench.call(DEREGISTER, protId=client.prot_id)

    def _create_variable(self) -> None:
        """A variable of the implementation's application comes in a beacon."""
        bench = self._bench
        var_id = bench.identifiers.own_var_id()
        if not bench.call("RTDB-Create", varId=var_id, repCnt=1, descr="tester", value="01").ok:
            return
        self._tried.add("variable")
        if bench.until_instruction(ICType.CREATE_VARIABLES, var_id, PERIODS) is not None:
            self._answered.add("variable")

    def _update_state(self) -> None:
        """Check that submitted safety data are sent in a beacon."""
        bench = self._bench
        layout = bench.profile.srp.safety_data
        if any(each.type == "opaque" for each in layout):
            return
        if not bench.call("SRP-UpdateSafetyData", sData={each.name: 1 for each in layout}).ok:
            return
        self._tried.add("state")
        if bench.until(lambda heard: heard.report is not None, PERIODS):
            self._answered.add("state")

    def _activated(self) -> bool:
        """Check whether BP answers after its activation. Earlier results do not change."""
        bench, upper = self._bench, self._bench.session.upper
        if self._trouble or upper is None or ACTIVATE not in upper.methods:
            return False
        try:
            if not bench.call(ACTIVATE).ok:
                return False
        except UpperTesterError as error:
            self._trouble = str(error)
            return False
        return (
            bool(bench.beacons(1, PERIODS)) if bench.sut.pics.vardis is False else bench.probes.ask("summary", PERIODS)
        )

    # -- in words ------------------------------------------------------------------------------------------------------

    def _silence(self) -> str:
        """Nothing was heard, and no usual mistake explains it."""
        bench = self._bench
        where = "is it running, on this link, with this EtherType or port?"
        if bench.session.can_restart:
            where += " (if it needs longer to start: access.start_timeout in the PICS file)"
        upper = bench.session.upper
        if self._trouble:
            return f"nothing was heard, and the upper tester does not answer ({self._trouble}): {where}"
        if upper is not None:
            suspects = first_suspects(bench)
            link = f"is {bench.lower.name} its link? {where}"
            return f"nothing was heard, though the upper tester answers; {suspects}; {link}"
        return f"nothing was heard: {where}"

    def _unexplained_frames(self) -> str:
        """Something was heard and not all is well; no mistake of the tester's settings explains it."""
        heard = self._bench.heard
        if not any(not each.header_problems for each in heard):
            return f"none of {len(heard)} frames of it is a beacon of the profile {self._bench.profile.name}"
        return ""


# -- rules of the octets -----------------------------------------------------------------------------------------------


def _broken_rules(bench: Bench, *, vardis: bool) -> Iterable[tuple[Violation, Mark]]:
    """Return the rules that frames of the implementation violate, each requirement once.

    What is wrong in client payloads is for cases to find, except in those of VarDis if ``vardis``.
    """
    found: dict[str, tuple[Violation, Mark]] = {}
    events = {each.number: each for each in bench.traffic.events if each.number}
    for heard, each in _violations(bench):
        event = events.get(heard.number)
        inside = ".srp" in each.path or (".vardis" in each.path and not vardis)
        if each.requirement and not inside and each.requirement not in found and event is not None:
            mark = Mark(heard.number, event.start + each.offset, each.length, each.path)
            found[each.requirement] = each, mark
    return found.values()


def _violations(bench: Bench) -> Iterator[tuple[ReceivedBeacon, Violation]]:
    """Frames with what they break; first what only shows in comparison."""
    if (wrong := misnamed(bench)) is not None and bench.session.sut_id is not None:
        yield wrong, _at(bench, wrong, "bp.senderId", "BP-HDR-03", bench.session.sut_id.hex(":"))
    if (renumbered := _renumbered(bench)) is not None:
        heard, block = renumbered
        right = f"{BP_PROTID_VARDIS:#06x} for VarDis"
        yield heard, _at(bench, heard, f"payloads[{block}].protocolId", "BP-HDR-11", right)
        # The content of blocks with a wrong protocol identifier violates rules of another protocol.
        return
    if (turned := _swapped_number(bench)) is not None:
        heard, block, number = turned
        yield heard, _at(bench, heard, f"payloads[{block}].protocolId", "DATA-01", f"{number:#06x}, not swapped")
        return
    network_id = bench.sut.parameter("BPPAR_NETWORK_ID")
    for heard in _sampled(bench.heard):
        source = heard.source if bench.profile.link.transport == "ethernet" else None
        broken = judge(heard.octets, bench.codec, network_id=network_id, source=source)
        outside = [each for each in broken if ".srp" not in each.path and ".vardis" not in each.path]
        # Where blocks begin in the wrong place, nothing is known of what is in them.
        for each in outside or broken:
            yield heard, each


def _sampled(heard: Sequence[ReceivedBeacon]) -> Sequence[ReceivedBeacon]:
    """Frames to judge: the first ones, and later ones, which may hold other blocks. To judge a bad frame takes long."""
    half = _JUDGED // 2
    return heard if len(heard) <= _JUDGED else [*heard[:half], *heard[half :: len(heard) // half][:half]]


def _at(bench: Bench, heard: ReceivedBeacon, path: str, requirement: str, right: str) -> Violation:
    """A field with the wrong octets; ``right`` is what it should say."""
    field = bench.codec.dissect(heard.octets).root.find(path)
    place = (0, 0) if field is None else (field.offset, field.length)
    octets = heard.octets[place[0] : sum(place)].hex()
    return Violation(requirement, f"{path.rpartition('.')[2]} is {right}", f"its octets are {octets}", *place, path)


def _suspect(bench: Bench) -> str:
    """Which setting of the tester explains the frames; none does if the answer came in a block with a wrong number."""
    return "" if _renumbered(bench) is not None else suspect(bench)


def _renumbered(bench: Bench) -> tuple[ReceivedBeacon, int] | None:
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


def _swapped_number(bench: Bench) -> tuple[ReceivedBeacon, int, int] | None:
    """A beacon with a block for SRP or VarDis whose number has swapped octets, the number of the block, and the right
    protocolId; None if there is none, or if any block has the right number.
    """
    width = bench.profile.types.protocol_id.width
    order: Literal["big", "little"] = "little" if bench.profile.types.protocol_id.byte_order == "little" else "big"
    turned = {
        int.from_bytes(each.to_bytes(width, order)[::-1], order): each for each in (BP_PROTID_SRP, BP_PROTID_VARDIS)
    }
    blocks = [(heard, place, number) for heard in bench.heard for place, (number, _) in enumerate(heard.blocks)]
    if any(number in (BP_PROTID_SRP, BP_PROTID_VARDIS) for _, _, number in blocks):
        return None
    return next(((heard, place, turned[number]) for heard, place, number in blocks if number in turned), None)


def _odd_answer(bench: Bench) -> str:
    """Return a record about a variable that the tester has summarised, except a request for it; empty if none came."""
    asked = {
        var_id
        for kind, var_id in stimuli(bench.codec, bench.traffic.events, bench.identifiers.created)
        if kind == "summary"
    }
    for heard in bench.heard:
        for each in heard.instructions():
            if each.var_id in asked and each.kind is not ICType.REQUEST_VARCREATES:
                return f"a {each.kind.label} record of variable {each.var_id}"
    return ""
