"""Containers of a payload that the implementation loses, and the failures that follow from that.

An implementation that loses a container breaks the extraction rules (VD-RX-02 to VD-RX-04), and the cases about them
fail. Many other cases send two containers in a payload: something missing in these cases may have been in the lost
container. Whether containers are lost is found at the start of a run
(:mod:`dcp_conformance.interconnection.lost_containers`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dcp_codec.codec import Codec
from dcp_conformance.test_system.traffic import Event

OWNERS: Final = frozenset({"VD-RX-02", "VD-RX-03", "VD-RX-04"})
"""The requirements of extraction: a lost container never excuses their failures."""


def sent_several(codec: Codec, events: Iterable[Event]) -> bool:
    """Return whether the tester has sent a VarDis payload with several containers."""
    sent = (codec.salvage(each.frame[each.start :]).beacon for each in events if each.direction == "sent")
    return any(len(payload.vardis or ()) > 1 for each in sent if each is not None for payload in each.payloads)
