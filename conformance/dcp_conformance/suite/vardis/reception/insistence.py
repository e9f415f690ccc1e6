"""dcp-vardis.md: Receive Path: the same stimulus again and again, senders of damaged payloads, unusual values.

What an implementer may add and the specification does not have: a limit of requests or answers, senders that are
ignored, comparisons of a part of an identifier or of a number.
"""

from __future__ import annotations

from collections.abc import Sequence

from dcp_spec.constants import BP_PROTID_VARDIS, ICType, SpecVersion

from dcp_codec.values import VardisRecord
from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.frames.received import var_id_of
from dcp_conformance.suite.bp.beacons.receive import check_processed
from dcp_conformance.suite.vardis.composition.summaries import summarises
from dcp_conformance.test_steps.full_payloads import settable
from dcp_conformance.test_steps.pacing import paced
from dcp_conformance.test_steps.services import OK, binary_identifiers, create_request
from dcp_conformance.test_steps.variable_queries import own_id
from dcp_conformance.test_system.bench import Bench

_CREATE, _UPDATE, _DELETE = ICType.CREATE_VARIABLES, ICType.UPDATES, ICType.DELETE_VARIABLES
_ASK_UPDATE, _ASK_CREATE = ICType.REQUEST_VARUPDATES, ICType.REQUEST_VARCREATES
_ROUNDS, _DAMAGED = 10, 12
_VALUE, _DESCRIPTION = "VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_DESCRIPTION_LENGTH"
_DAY = 86_400

_Stimulus = tuple[VardisRecord, ICType, str]
"""A record, the kind of the record that answers it, and the requirement."""


@case(
    "TC_VD_AGAIN_BV_01",
    f"VarDis reacts to each of {_ROUNDS} equal stimuli",
    requirements="VD-PS-01 VD-PU-01 VD-PS-04 VD-PS-03 VD-PU-06 VD-RC-03 VD-RU-04 VD-RU-01 VD-RC-01",
    stimulus=(
        f"{_ROUNDS} times, each after the reactions to the one before: in one beacon a summary and an update of "
        "unknown "
        "variables, requests for unknown ones (since 1.1), newer and older summaries, an older update, and requests "
        "for known ones"
    ),
    expect="each time a request, the newer value or the variable",
    window=40,
)
def again(bench: Bench) -> None:
    peer, known = bench.peer(), bench.identifiers.var_ids(5)
    bench.learn(peer, *(peer.create(each, value=b"v", descr=b"d", seqno=5) for each in known))
    unknown = bench.identifiers.unknown_ids(4 if bench.features.rerequest_unknown else 2)
    stimuli: list[_Stimulus] = [
        (peer.update(unknown[1], 7, b"w"), _ASK_CREATE, "VD-PU-01"),
        (peer.update(known[0], 4, b"w"), _UPDATE, "VD-PU-06"),
        (peer.summary(unknown[0], 7), _ASK_CREATE, "VD-PS-01"),
        (peer.summary(known[1], 9), _ASK_UPDATE, "VD-PS-04"),
        (peer.summary(known[2], 3), _UPDATE, "VD-PS-03"),
        (peer.request_create(known[3]), _CREATE, "VD-RC-03"),
        (peer.request_update(known[4], 4), _UPDATE, "VD-RU-04"),
    ]
    if bench.features.rerequest_unknown:
        stimuli.append((peer.request_create(unknown[2]), _ASK_CREATE, "VD-RC-01"))
        stimuli.append((peer.request_update(unknown[3], 7), _ASK_CREATE, "VD-RU-01"))
    # One kind after the other, as in a payload.
    stimuli.sort(key=lambda each: type(each[0]).__name__)
    for number in range(_ROUNDS):
        start = peer.stimulate(*(record for record, _, _ in stimuli))

        bench.until(lambda _, since=start: not _left(bench, stimuli, since))  # type: ignore[misc]
        bench.beacons(1, 1.5)
        left = _left(bench, stimuli, start)
        for record, kind, requirement in left:
            bench.some(None, f"a {kind.label} record after {record}, sent for the {number + 1}th time", requirement)
        if left:
            return
    bench.passed(f"reactions to each of {_ROUNDS} equal stimuli")


def _left(bench: Bench, stimuli: Sequence[_Stimulus], since: int) -> list[_Stimulus]:
    """Return the stimuli without a reaction since a mark."""
    return [each for each in stimuli if not bench.instructions(each[1], var_id_of(each[0]), since)]


_DAMAGES = {
    "unknown-type": b"\x63\x01\x00",
    "no-records": b"\x01\x00",
    "cut-off": b"\x01\x05\x00",
    "random": bytes(167 * place % 251 for place in range(40)),
}


@case(
    "TC_VD_ROB_BO_01",
    f"A payload is processed after {_DAMAGED} payloads with errors from the same sender ({{variant}})",
    requirements="VD-ROB-01",
    stimulus=(
        f"{_DAMAGED} payloads with this error ({{variant}}) of a neighbour; then the summary of an unknown variable"
    ),
    expect="a request for the variable",
    window=10,
    variants=_DAMAGES,
)
def after_errors(bench: Bench, octets: bytes) -> None:
    peer, var_id = bench.peer(), bench.unknown_id()
    for _ in paced(bench, range(_DAMAGED)):
        peer.send(Block(BP_PROTID_VARDIS, octets))
    start = peer.stimulate(peer.summary(var_id, 1))
    check_processed(bench, [var_id], start, "a payload after damaged ones of its sender")


# -- unusual values ----------------------------------------------------------------------------------------------------


@case(
    "TC_VD_CRT_BV_06",
    "A creation replaces the stored one however much later it is ({variant})",
    requirements="VD-PC-01 VD-PC-07 VD-PC-09",
    stimulus="a variable is created; then again with a creationTime that is later by {variant}; then it is deleted",
    expect="the second VarCreate is forwarded unchanged, and the variable is summarised",
    window=12,
    needs=Needs(SpecVersion.V2_0),
    variants={"two-days": 2 * _DAY, "ten-years": 3_650 * _DAY, "the-highest-bit": None},
)
def much_later(bench: Bench, seconds: int | None) -> None:
    peer, name, stamp = bench.peer(), bench.var_id(), bench.profile.types.timestamp
    highest, first = (1 << (8 * stamp.width - stamp.signed)) - 1, bench.records.creation_time()
    middle = 1 << (8 * stamp.width - 1)
    if seconds is None and (stamp.signed or first >= middle):
        bench.verdicts.not_applicable("the highest bit of a creationTime is its sign, or is already set")
    if seconds is None:
        first, later = middle - 1, middle
    else:
        later = min(first + (seconds or 1) * stamp.per_second, highest)
    bench.learn(peer, peer.create(name, value=b"v", creation_time=first))
    second = peer.create(name, value=b"w", descr=b"second", creation_time=later)
    peer.send(second)
    bench.equal(bench.until_instruction(_CREATE, name), second, "the VarCreate that is forwarded")
    if summarises(bench) is None:
        bench.some(bench.until_instruction(ICType.SUMMARIES, name, 16), "a summary of the new creation", "VD-PC-09")
    peer.send(peer.delete(name))
    bench.until_instruction(_DELETE, name)


@case(
    "TC_VD_ID_BV_03",
    "A producer whose identifier differs in one octet from the own one is another node (octet {variant})",
    requirements="VD-PC-03 VD-PU-03 VD-PC-09 DATA-04",
    stimulus="VarCreate and VarUpdate of a variable whose producer differs in octet {variant} from the implementation",
    expect="both are forwarded",
    window=10,
    needs=Needs(when=binary_identifiers),
    variants={f"{place}": place for place in range(6)},
)
def nearly_own(bench: Bench, place: int) -> None:
    own = own_id(bench)
    if place >= len(own):
        bench.verdicts.not_applicable(f"node identifiers have {len(own)} octets")
    producer = own[:place] + bytes([own[place] ^ 0x5A]) + own[place + 1 :]
    peer, name = bench.peer(), bench.var_id()
    create = peer.create(name, producer=producer, value=b"v")
    peer.send(create)
    bench.equal(bench.until_instruction(_CREATE, name), create, "the VarCreate that is forwarded", "VD-PC-03 VD-PC-09")
    update = peer.update(name, 1, b"w")
    peer.send(update)
    bench.equal(bench.until_instruction(_UPDATE, name), update, "the VarUpdate that is forwarded", "VD-PU-03")


# -- long values -------------------------------------------------------------------------------------------------------


def _long(bench: Bench) -> str | None:
    """Return why values of 128 octets are impossible, or None; for ``Needs.when``."""
    most = bench.sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE")
    if settable(bench) and most >= 400:
        return None
    if min(bench.sut.parameter(_VALUE), bench.sut.longest_description) >= 128:
        return None
    return "values and descriptions of 128 octets are not accepted, and the maximum lengths cannot be set"


def _lengths(bench: Bench, length: int) -> int:
    """Set both maximum lengths, if they can be set; return the length to use."""
    if not settable(bench):
        return min(length, bench.sut.bound(_VALUE), bench.sut.longest_description)
    # A VarCreate must fit into a payload.
    spare = bench.sut.bound("VARDISPAR_MAX_PAYLOAD_SIZE") - 64
    length = min(length, spare // 2)
    for name in (_VALUE, _DESCRIPTION):
        bench.must("VD-SetParameter", name=name, value=length)
    return length


def _text(length: int, first: int) -> bytes:
    return bytes(0x41 + (first + place) % 26 for place in range(length))


@case(
    "TC_VD_LEN_BV_04",
    "Values and descriptions of up to {variant} octets are received, stored and forwarded",
    requirements="VD-PC-04 VD-PC-05 VD-PU-04 VD-PU-07 VD-TYP-06",
    stimulus="the maximum lengths are set to {variant}, if possible; a VarCreate and a VarUpdate with these lengths",
    expect="both are forwarded unchanged, also when the variable is requested",
    window=16,
    needs=Needs(SpecVersion.V1_1, when=_long),
    alone="it sets parameters of VarDis, if it can",
    variants={"128": 128, "200": 200, "255": 255},
)
def long_received(bench: Bench, length: int) -> None:
    length = _lengths(bench, length)
    peer, name = bench.peer(), bench.var_id()
    create = peer.create(name, value=_text(length, 0), descr=_text(length, 3), exact=True)
    peer.send(create)
    bench.equal(bench.until_instruction(_CREATE, name), create, "the VarCreate", "VD-PC-04 VD-PC-05 VD-TYP-06")
    update = peer.update(name, 1, _text(length, 7), exact=True)
    peer.send(update)
    bench.equal(bench.until_instruction(_UPDATE, name), update, "the VarUpdate", "VD-PU-04 VD-PU-07")
    start = peer.stimulate(peer.request_create(name))
    bench.until_instruction(_CREATE, name)
    found = bench.instructions(_CREATE, name, start)[:1]
    bench.some(found, "a VarCreate when the variable is requested", "VD-RC-03")
    for each in found:
        bench.answered((each.record.spec, each.record.upd), (create.spec, update), "VarCreate", "VD-TYP-06", "VD-PU-07")


@case(
    "TC_VD_LEN_BV_05",
    "Values and descriptions of up to {variant} octets can be created, updated and read",
    requirements="VD-CRE-04 VD-CRE-05 VD-UPD-05 VD-REA-04",
    stimulus="the maximum lengths are set to {variant}, if possible; RTDB-Create, RTDB-Update and RTDB-Read",
    expect="VARDIS-STATUS-OK each time; a VarCreate and a VarUpdate with these lengths; the value that was set",
    window=16,
    needs=Needs(SpecVersion.V1_1, ut=("RTDB-Create", "RTDB-Update", "RTDB-Read"), when=_long),
    alone="it sets parameters of VarDis, if it can",
    variants={"128": 128, "200": 200, "255": 255},
)
def long_created(bench: Bench, length: int) -> None:
    length = _lengths(bench, length)
    name, value, other = bench.identifiers.own_var_id(), _text(length, 0), _text(length, 7)
    descr = _text(length, 3)
    request = create_request(bench, name, value=value, descr=descr.decode(), exact=True)
    bench.expect_status(OK, "RTDB-Create", "VD-CRE-04", "VD-CRE-05", **request)
    bench.excuses.relies_on("VarCreate")
    made = bench.until_instruction(_CREATE, name)
    bench.equal(made and (made.spec.descr, made.upd.value), (descr, value), "description and value", "VD-CRE-04")
    bench.expect_status(OK, "RTDB-Update", "VD-UPD-05", varId=name, value=other.hex())
    answer = bench.must("RTDB-Read", varId=name)
    bench.answered(answer.result.get("value"), other.hex(), "value", "VD-REA-04", "VD-UPD-08")
    update = bench.until_instruction(_UPDATE, name)
    bench.equal(update and update.value, other, "value of the VarUpdate", "VD-UPD-10")
