"""Findings in words: differences of fields, moments of a recording, and what a finding means for the network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec

from dcp_codec.values import VarSpec

#: What generally follows for a network from the findings of a rule.
CONSEQUENCES: Final[Mapping[str, str]] = {
    "CK_BP_FORMAT": "Receivers drop these beacons, or read other values than the sender means.",
    "CK_BP_SIZE": "Bearers with this limit do not carry these beacons.",
    "CK_BP_SEQNO": "Receivers cannot tell lost beacons from repeated ones.",
    "CK_BP_PERIOD": "Values of this node arrive later than its neighbours expect, or take more of the channel.",
    "CK_UWB_BROADCAST": "Other nodes may not receive these beacons.",
    "CK_BP_SENDER": "Receivers take the beacons for those of another node.",
    "CK_DATA_ORDER": "Other implementations read other numbers.",
    "CK_DATA_PACKED": "Other implementations read other numbers, or drop the report.",
    "CK_SRP_OWN": "Receivers keep a position for a node that is somewhere else.",
    "CK_SRP_LENGTH": "Receivers drop these state reports: they do not know where the node is.",
    "CK_SRP_SEQNO": "Receivers cannot tell a new position from an old one.",
    "CK_VD_ORDER": "Receivers may process a summary before the creation that it needs.",
    "CK_VD_PAYLOAD": "Receivers of one beacon disagree about the newest value.",
    "CK_VD_RECORDS": "Receivers ignore these records: the variable does not arrive.",
    "CK_VD_SEQNO": "Nodes that hear only this one fall back to an older value.",
    "CK_VD_VALUE": "Nodes act on different values of the same variable, and no later summary shows it.",
    "CK_VD_SPEC": "Nodes have different attributes of the same variable, until it is created again.",
    "CK_VD_DELETED": "A deleted variable stays alive at some nodes.",
    "CK_VD_REPEAT": "Repetitions take room in beacons from values that are new.",
    "CK_VD_REQUEST": "Requests that nobody needs take room in beacons, and so do their answers.",
    "CK_VD_ANSWER_UPDATE": "A node that has missed a value keeps the old one.",
    "CK_VD_ANSWER_CREATE": "A node that has missed a creation never gets the variable.",
    "CK_VD_TAKES_UPDATE": "The node goes on with an old value.",
    "CK_VD_TAKES_CREATE": "The node, and those that hear only this one, never get the variable.",
    "CK_VD_TAKES_DELETE": "The deleted variable stays alive at this node, which may bring it back to others.",
    "CK_VD_ASK_UPDATE": "A value that the node has missed never arrives there.",
    "CK_VD_ASK_CREATE": "A variable that the node has missed never arrives there.",
    "CK_VD_TEACH": "A neighbour with an old value learns of the newer one from nobody, or late.",
    "CK_VD_BACKED": "Others ask for a value that the node does not send.",
    "CK_NET_AGREES": "Applications at this node act on another value than the producer has.",
    "CK_VD_ENDLESS": "The requests and their answers take room in beacons, and the variable does not arrive.",
    "CK_NET_SILENT": "Neighbours keep what they last heard of this protocol.",
    "CK_SRP_VALUES": "Applications get positions or times that mean nothing.",
}
_NAMES: Final = {"prod_id": "prodId", "rep_cnt": "repCnt", "creation_time": "creationTime", "var_id": "varId"}


def differences(before: msgspec.Struct, after: msgspec.Struct) -> str:
    """The fields that differ, by the names of the specification: ``timeout 0 -> 1, repCnt 2 -> 3``."""
    found = [
        f"{_NAMES.get(field, field)} {shown(getattr(before, field), field)} -> {shown(getattr(after, field), field)}"
        for field in before.__struct_fields__
        if getattr(before, field) != getattr(after, field)
    ]
    return ", ".join(found) or "nothing that differs"


def spec_text(spec: VarSpec) -> str:
    """A VarSpec in one line."""
    fields = (field for field in spec.__struct_fields__ if field != "var_id" and getattr(spec, field) is not None)
    return ", ".join(f"{_NAMES.get(field, field)} {shown(getattr(spec, field), field)}" for field in fields)


def shown(value: Any, field: str = "") -> str:
    """A value of a field for people."""
    if isinstance(value, bytes):
        if field == "prod_id" and len(value) <= 8:
            return value.hex(":")
        return repr(value.decode("utf-8", "backslashreplace"))
    return "none" if value is None else str(value)


def moment(seconds: float) -> str:
    """A moment of a recording, from seconds since its first frame: ``at +12.345 s``."""
    return f"at {seconds:+.3f} s"
