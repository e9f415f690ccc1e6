"""Texts for findings: differences between fields, times in a recording, and consequences for the network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec

from dcp_codec.values import VarSpec, attributes

#: Rule -> the general consequence of its findings for a network.
CONSEQUENCES: Final[Mapping[str, str]] = {
    "CK_BP_FORMAT": "Receivers drop these beacons, or decode other values than the sender encoded.",
    "CK_BP_SIZE": "A bearer with this limit does not carry these beacons.",
    "CK_BP_SEQNO": "Receivers cannot distinguish lost beacons from repeated ones.",
    "CK_BP_PERIOD": "Values of this node arrive later than its neighbours expect, or it uses more of the channel.",
    "CK_UWB_BROADCAST": "Other nodes may not receive these beacons.",
    "CK_BP_SENDER": "Receivers attribute the beacons to another node.",
    "CK_DATA_ORDER": "Other implementations decode different numbers.",
    "CK_DATA_PACKED": "Other implementations decode different numbers, or drop the report.",
    "CK_SRP_OWN": "Receivers store a wrong position for a node.",
    "CK_SRP_LENGTH": "Receivers drop these state reports and do not know the position of the node.",
    "CK_SRP_SEQNO": "Receivers cannot distinguish a new position from an old one.",
    "CK_VD_ORDER": "Receivers may process a summary before the creation that it needs.",
    "CK_VD_PAYLOAD": "Receivers of one beacon disagree about the newest value.",
    "CK_VD_RECORDS": "Receivers ignore these records and do not get the variable.",
    "CK_VD_SEQNO": "Nodes that hear only this one fall back to an older value.",
    "CK_VD_VALUE": "Nodes act on different values of the same variable, and no later summary reveals it.",
    "CK_VD_SPEC": "Nodes have different attributes of the same variable until it is created again.",
    "CK_VD_DELETED": "A deleted variable continues to exist at some nodes.",
    "CK_VD_REPEAT": "Unneeded repetitions use beacon space that new values need.",
    "CK_VD_REQUEST": "Unneeded requests and their answers use beacon space.",
    "CK_VD_ANSWER_UPDATE": "A node that has missed a value keeps the old one.",
    "CK_VD_ANSWER_CREATE": "A node that has missed a creation never gets the variable.",
    "CK_VD_TAKES_UPDATE": "The node keeps an old value.",
    "CK_VD_TAKES_CREATE": "The node, and nodes that hear only this one, never get the variable.",
    "CK_VD_TAKES_DELETE": "The deleted variable continues to exist at this node, which may restore it at others.",
    "CK_VD_ASK_UPDATE": "The node never gets a value that it has missed.",
    "CK_VD_ASK_CREATE": "The node never gets a variable that it has missed.",
    "CK_VD_TEACH": "A neighbour with an old value gets the newer one late or never.",
    "CK_VD_BACKED": "Other nodes request a value that the node does not send.",
    "CK_NET_AGREES": "Applications at this node use another value than the producer's.",
    "CK_VD_ENDLESS": "The requests and their answers use beacon space, and the variable does not arrive.",
    "CK_NET_SILENT": "Neighbours keep the last data that they received with this protocol.",
    "CK_SRP_VALUES": "Applications get meaningless positions or times.",
}
_NAMES: Final = {"prod_id": "prodId", "rep_cnt": "repCnt", "creation_time": "creationTime", "var_id": "varId"}


def differences(before: msgspec.Struct, after: msgspec.Struct) -> str:
    """Return the fields that differ, with the specification's names: ``timeout 0 -> 1, repCnt 2 -> 3``."""
    found = [
        f"{_NAMES.get(field, field)} {shown(getattr(before, field), field)} -> {shown(getattr(after, field), field)}"
        for field in attributes(before)
        if getattr(before, field) != getattr(after, field)
    ]
    return ", ".join(found) or "no difference"


def spec_text(spec: VarSpec) -> str:
    """Return the fields of a VarSpec except varId, in one line."""
    fields = (field for field in attributes(spec) if field != "var_id" and getattr(spec, field) is not None)
    return ", ".join(f"{_NAMES.get(field, field)} {shown(getattr(spec, field), field)}" for field in fields)


def shown(value: Any, field: str = "") -> str:
    """Return the value of a field as text: octets as quoted UTF-8, a producer as colon-separated hex."""
    if isinstance(value, bytes):
        if field == "prod_id" and len(value) <= 8:
            return value.hex(":")
        return repr(value.decode("utf-8", "backslashreplace"))
    return "none" if value is None else str(value)


def moment(seconds: float) -> str:
    """Return a time in a recording, given in seconds since its first frame, as ``at +12.345 s``."""
    return f"at {seconds:+.3f} s"
