"""Beaconing Protocol: the schema of a bearer payload (dcp-bp.md, "Data Types" and "Packet Format")."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import construct as cs

from dcp_spec.constants import BP_MAGIC_NO, BP_VERSION
from dcp_spec.profile.definition import IntType, Profile
from dcp_spec.profile.rules import header_size as header_size  # of the beacon, and asked for here

from .combinators import Choice, Counted, CountOf, Expect, Field, Filler, Record, Sized, SizeOf, UntilEnd
from .scalars import integer, members, node_id


def header(profile: Profile, payloads: Any) -> Record:
    """``BPHeaderT``. ``payloads`` is the member of the beacon that length and numPayloads speak of."""
    types = profile.types
    if profile.bp.length_means == "header-size":
        length: Any = Expect(
            integer(types.bp_length), header_size(profile), reason="bad-length", requirement="BP-HDR-06"
        )
    else:
        length = SizeOf(
            integer(types.bp_length), of="_.payloads", target=payloads, nonzero=True, requirement="BP-RX-03"
        )
    fields = (
        Field(
            "version",
            Expect(integer(IntType(width=1)), BP_VERSION, reason="bad-version", requirement="BP-RX-01"),
            requirement="BP-HDR-01",
            doc="protocol version, 0x01 in every version of the specification so far",
        ),
        Field(
            "magicNo",
            Expect(integer(types.magic_no), BP_MAGIC_NO, reason="bad-magic", requirement="BP-RX-02"),
            requirement="BP-HDR-02",
            doc="distinguishes beacons from other traffic",
        ),
        Field("senderId", node_id(types.node_id), requirement="BP-HDR-03", role="node-id", doc="sender of the beacon"),
        ##= BP-HDR-05
        Field(
            "networkId",
            integer(types.network_id),
            requirement="BP-HDR-04",
            role="network-id",
            doc="network of the sender",
        ),
        Field(
            "length",
            length,
            requirement="BP-HDR-06",
            unit="octets",
            doc="length of all payload blocks with their headers",
        ),
        Field(
            "numPayloads",
            CountOf(integer(IntType(width=1)), of="_.payloads", requirement="BP-RX-04"),
            requirement="BP-HDR-07",
            doc="number of payload blocks",
        ),
        Field(
            "seqno",
            integer(types.bp_seqno),
            requirement="BP-HDR-08",
            role="seqno",
            doc="counter of the sender's beacons",
        ),
    )
    return Record("BPHeader", *members(profile.bp.header, fields), requirement="BP-HDR-10")


def payload_block(profile: Profile, clients: Mapping[int, tuple[str, Any]]) -> Record:
    """One ``BPPayloadHeaderT`` and its client payload; unknown protocols keep their octets as ``data``."""
    types = profile.types
    content = Choice(
        "protocolId",
        clients,
        default=("data", cs.GreedyBytes),
        requirement="BP-RX-08",
    )
    fields = (
        Field("protocolId", integer(types.protocol_id), requirement="BP-HDR-11", doc="client protocol"),
        Field(
            "length",
            SizeOf(integer(types.bp_length), of="content", target=content),
            requirement="BP-HDR-11",
            unit="octets",
            doc="length of the client payload without this header",
        ),
    )
    block = members(profile.bp.payload_header, fields)
    block.append(
        Field(
            "content",
            Sized("length", content, reason="block-overrun", requirement="BP-RX-09"),
            requirement="BP-FMT-01",
            doc="payload of the client protocol",
        )
    )
    if profile.bp.payload_area:
        block.append(
            Field(
                "area",
                Filler(profile.bp.payload_area, "length"),
                role="opaque",
                doc="unused rest of the fixed area",
            )
        )
    return Record("Payload", *block, requirement="BP-RX-09")


def beacon(profile: Profile, clients: Mapping[int, tuple[str, Any]]) -> Record:
    """A whole bearer payload. Octets after it are padding of the bearer (BP-RX-14)."""
    block = payload_block(profile, clients)
    if not profile.bp.header:
        ##= BP-FMT-03
        return Record("Beacon", Field("payloads", UntilEnd(block, nonempty=True), doc="payload blocks"))
    if "length" in profile.bp.header and profile.bp.length_means == "blocks":
        payloads: Any = UntilEnd(block, count="bp.numPayloads", requirement="BP-HDR-07")
        ##= BP-RX-14
        region: Any = Sized("bp.length", payloads, reason="beacon-overrun", requirement="BP-RX-15")
    else:
        payloads = region = Counted("bp.numPayloads", block)
    ##= UWB-04
    return Record(
        "Beacon",
        Field("bp", header(profile, payloads), doc="beacon header"),
        Field("payloads", region, doc="payload blocks"),
    )
