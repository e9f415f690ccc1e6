"""Variants whose upper tester lacks methods, is slow or answers differently, or whose PICS denies capabilities."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

import msgspec
from dcp_conformance.definitions.pics import Capabilities, Testing
from dcp_conformance.reference.surroundings import Setup, UpperTesting
from dcp_conformance.upper_tester import Answer
from dcp_spec.constants import SpecVersion
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import load_profile

from dcp_stack.bp.clients import ClientList
from dcp_stack.bp.queue import Client
from dcp_stack.config import BPConfig
from dcp_stack.control.methods import METHODS

from .variant import Variant, derived, has_srp, setup, slow, without

_V = SpecVersion
OPTIONAL = tuple(name for name, method in METHODS.items() if method.optional)
GETTERS = tuple(name for name in METHODS if name.endswith("-GetParameters"))
SETTERS = tuple(name for name in METHODS if name.endswith("-SetParameter"))
_CONTRACT = "UPPER-TESTER.md, Methods"
_NEEDED_ONLY = "an upper tester may be incomplete: docs/dcp-conformance.md"


def _lacking(*methods: str, **more: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, upper=without(*methods), **more)


def _without_each() -> Iterator[Variant]:
    for name in METHODS:
        if name == "UT-Hello":
            continue
        why = _CONTRACT if name in OPTIONAL else _NEEDED_ONLY
        explains = {"VD-GetParameters": (ASSUMED_VALUE,), "UT-Reset": (_REPORTS_REPEATED,)}.get(name, ())
        yield Variant(f"V-UT-no-{name}", f"has an upper tester without {name}", why, _lacking(name), explains=explains)


def _slow() -> Iterator[Variant]:
    for delay in (50, 250, 500):
        yield Variant(
            f"V-UT-slow-{delay}",
            f"has an upper tester that takes {delay} ms for each call",
            "the contract has no time limit for answers",
            lambda profile, delay=delay: setup(profile, upper=slow(delay)),  # type: ignore[misc]
            explains=(
                TOO_SLOW_FOR_A_GAP,
                *((_TOO_SLOW_TO_COUNT,) if delay >= 250 else ()),
                *((_TOO_SLOW,) if delay >= 250 else ()),
            ),
        )


def _upper(testing: UpperTesting, **more: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, upper=testing, **more)


# -- answers -----------------------------------------------------------------------------------------------------------


def _answering(change: Callable[[str, dict[str, Any], Answer], Answer], **more: Any) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, upper=UpperTesting(answers=change), **more)


_SPEC_FIELDS = ("varId", "prodId", "repCnt", "descr", "creationTime", "timeout", "descrHex")


def _specs_only(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """List only the fields of VarSpecT for each variable."""
    del params
    if method != "RTDB-DescribeDatabase" or "variables" not in answer.result:
        return answer
    listed = [{name: each[name] for name in _SPEC_FIELDS if name in each} for each in answer.result["variables"]]
    return msgspec.structs.replace(answer, result={**answer.result, "variables": listed})


def _no_statistics(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """List neighbours without their statistics."""
    del params
    if method != "SRP-NeighbourTable" or "neighbours" not in answer.result:
        return answer
    fields = ("nodeId", "sData", "tStamp", "seqno", "receptionTime")
    listed = [{name: each[name] for name in fields if name in each} for each in answer.result["neighbours"]]
    return msgspec.structs.replace(answer, result={**answer.result, "neighbours": listed})


def _further_members(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Add a parameter that is computed from the others, and a member with the name of the method."""
    del params
    if answer.code is not None:
        return answer
    result: dict[str, Any] = {**answer.result, "vendorNote": method}
    reported = answer.result.get("parameters")
    if isinstance(reported, dict):
        numbers = [value for value in reported.values() if isinstance(value, int | float)]
        result["parameters"] = {**reported, "VENDOR-DERIVED": sum(numbers)}
    return msgspec.structs.replace(answer, result=result)


def _underscores(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Spell the status with underscores, as 1.0 does."""
    del method, params
    return msgspec.structs.replace(answer, status=answer.status.replace("-", "_"))


def _ascii_names(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Reject the registration of a client protocol whose name is not ASCII."""
    if method == "BP-RegisterProtocol" and not str(params.get("name", "")).isascii():
        return Answer(code=-32602, message="name: only ASCII characters can be expressed")
    return answer


def _silent_refusals(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Confirm the rejection of a parameter value with OK."""
    del params
    if method.endswith("-SetParameter") and answer.code == -32001:
        protocol = {"BP": "BP", "SR": "SRP", "VD": "VARDIS"}[method[:2]]
        return Answer(status=f"{protocol}-STATUS-OK", result={"status": f"{protocol}-STATUS-OK"})
    return answer


def _unconfirmed(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Answer BP-TransmitPayload with OK in every case, as an adapter does for an implementation without confirm."""
    del params
    if method == "BP-TransmitPayload" and answer.code is None:
        return Answer(status="BP-STATUS-OK", result={"status": "BP-STATUS-OK"})
    return answer


def _whole_records(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """List complete records of type BPClientProtocol, as 1.0 does."""
    del params
    if method != "BP-ListRegisteredProtocols" or "protocols" not in answer.result:
        return answer
    listed = [{**each, "queue": [], "bufferOccupied": False, "bufferEntry": ""} for each in answer.result["protocols"]]
    return msgspec.structs.replace(answer, result={**answer.result, "protocols": listed})


# -- capabilities ------------------------------------------------------------------------------------------------------


class OneForEachClient(ClientList):
    """Puts at most one payload of a client into a beacon, also with allowMultiplePayloads."""

    def insert(self, client: Client) -> None:
        client.several = False
        super().insert(client)


def _pics(**capabilities: bool) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, pics=Capabilities(**capabilities))


def _denied(name: str) -> Variant:
    spoken = name.replace("_", " ")
    return Variant(
        f"V-PICS-no-{name.replace('_', '-')}",
        f"does not support {spoken}, and its PICS denies it",
        "optional",
        _pics(**{name: False}),
    )


#: The optional capabilities of a PICS; srp and vardis are those of the module ``entities``.
_CAPABILITIES = tuple(
    name
    for name in Capabilities.__struct_fields__
    if name not in ("srp", "vardis", "payload_transmitted_indication", "runtime_parameters")
)


def _one_container(profile: Profile) -> Profile:
    behaviour = msgspec.structs.replace(profile.behaviour, containers_per_type="one")
    return msgspec.structs.replace(profile, behaviour=behaviour)


def _only_the_text(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Answer with the members of the specification only."""
    for change in (_specs_only, _no_statistics):
        answer = change(method, params, answer)
    return answer


def _only_the_text_unconfirmed(method: str, params: dict[str, Any], answer: Answer) -> Answer:
    """Answer with the members of the specification only, and do not confirm BP-TransmitPayload."""
    return _unconfirmed(method, params, _only_the_text(method, params, answer))


def _deny_all(profile: str) -> Setup:
    version = load_profile(profile).spec_version
    # The confirm of BP-TransmitPayload is optional since 1.2.
    confirm_is_optional = version >= _V.V1_2
    names = [name for name in _CAPABILITIES if name != "transmit_payload_confirm" or confirm_is_optional]
    answers = _only_the_text_unconfirmed if confirm_is_optional else _only_the_text
    denied = Capabilities(**dict.fromkeys(names, False))
    return setup(
        derived(profile, _one_container),
        part=OneForEachClient,
        bp=BPConfig(jitter=0.0),
        readings={"X21": "refuse-locally"},
        pics=denied,
        upper=UpperTesting(answers=answers, without=frozenset(SETTERS)),
    )


#: Without a reset the unused identifiers of variables run out.
_USED_UP = r"identifiers used up: .* A reset frees them"
#: If a limit is unknown, cases are inconclusive and name the entry of the PIXIT that would define it.
ASSUMED_VALUE: Final = r"was taken to be .*\(pixit\."
#: Up to 1.2 state reports of earlier cases are repeated until a reset.
_REPORTS_REPEATED = r"^TC_BP_HDR_BV_(09|12): no beacon during the pause"
#: A call takes a twelfth of the timeout of neighbours or more.
_TOO_SLOW = r"^TC_(SRP_NT_TI_0[245]|DCP_KEEP_BO_02): entries of the neighbours"
#: Up to 1.1 BP cannot be deactivated while payloads are submitted.
TOO_SLOW_FOR_A_GAP = r"between two beacons: a beacon in between in each attempt; calls take up to \d+ ms"
#: A call takes longer than the first beacons after it.
_TOO_SLOW_TO_COUNT = r"^TC_VD_CRE_BV_08: .*: calls take so long that it may be sent before them"

VARIANTS = (
    *_without_each(),
    *_slow(),
    Variant("V-UT-no-optional", "has no optional method", _CONTRACT, _lacking(*OPTIONAL)),
    Variant("V-UT-no-get", "has an upper tester that cannot read parameters", _NEEDED_ONLY, _lacking(*GETTERS),
        explains=(ASSUMED_VALUE,)),
    Variant("V-UT-no-set", "has an upper tester that cannot set parameters", "BP-PAR-01", _lacking(*SETTERS)),
    Variant("V-UT-no-get-no-set", "has an upper tester that can neither read nor set parameters", "BP-PAR-01",
        _lacking(*GETTERS, *SETTERS), explains=(ASSUMED_VALUE,)),
    Variant("V-UT-no-reset", "has neither UT-Reset nor a restart", "PIXIT reset = none",
        _lacking("UT-Reset", can_restart=False), explains=(_USED_UP, _REPORTS_REPEATED)),
    Variant("V-UT-restart", "is restarted before each case", "PIXIT reset = restart",
        _lacking("UT-Reset", pixit=Testing(reset="restart"))),
    Variant("V-UT-none", "has no upper tester", "docs/dcp-conformance.md", _upper(UpperTesting(there=False)),
        explains=(_USED_UP, ASSUMED_VALUE)),
    Variant("V-UT-none-no-restart", "has no upper tester and no restart", "docs/dcp-conformance.md",
        _upper(UpperTesting(there=False), can_restart=False), explains=(_USED_UP, ASSUMED_VALUE)),
    Variant("V-UT-one-connection", "has an upper tester with one connection",
        "an upper tester that is a command has one connection", _upper(UpperTesting(one_connection=True))),
    Variant("V-UT-specs-only", "lists only a VarSpecT for each variable", "VD-DDB-03", _answering(_specs_only)),
    Variant("V-UT-specs-only-denied", "lists only a VarSpecT for each variable, and its PICS denies further fields",
        "VD-DDB-03", _answering(_specs_only, pics=Capabilities(describe_extra_fields=False)), since=_V.V1_0),
    Variant("V-UT-no-statistics", "has no statistics of neighbours, and its PICS denies them", "SRP-NT-04",
        _answering(_no_statistics, pics=Capabilities(neighbour_statistics=False)), where=has_srp),
    Variant("V-UT-further-members", "adds members to its answers, among them a derived parameter",
        "UPPER-TESTER.md: an implementation may add members", _answering(_further_members)),
    Variant("V-UT-underscores", "spells statuses with underscores", "X07", _answering(_underscores)),
    Variant("V-UT-ascii-names", "accepts only ASCII names of client protocols",
        "dcp-data-types.md: String is system-dependent", _answering(_ascii_names)),
    Variant("V-UT-silent-refusals", "rejects a parameter value but confirms it with OK", "BP-PAR-07",
        _answering(_silent_refusals, pics=Capabilities(parameter_feedback=False))),
    Variant("V-UT-unconfirmed", "does not confirm BP-TransmitPayload, and its PICS denies it", "BP-TXP-08",
        _answering(_unconfirmed, pics=Capabilities(transmit_payload_confirm=False)), since=_V.V1_2),
    Variant("V-UT-whole-records", "lists complete records of client protocols", "BP-LST-02 in 1.0",
        _answering(_whole_records), until=_V.V1_0),
    *map(_denied, ("triggered_beacons", "srp_seqno_filter")),
    Variant("V-PICS-deny-all", "has no optional capability, and its PICS denies all of them",
        "BP-QM-08, VD-DDB-03, X21", _deny_all, since=_V.V1_1),
    Variant("V-PICS-one-payload", "never puts several payloads of one client into a beacon, and its PICS denies it",
        "BP-QM-08", lambda profile: setup(profile, part=OneForEachClient, pics=Capabilities(multiple_payloads=False)),
        since=_V.V1_1),
    Variant("V-PICS-one-payload-silent",
        "never puts several payloads of one client into a beacon; its PICS does not declare it", "BP-QM-08",
        lambda profile: setup(profile, part=OneForEachClient), since=_V.V1_1),
)  # fmt: skip
