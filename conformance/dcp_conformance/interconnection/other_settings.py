"""Other settings that an implementation may have than the tester, and questions with these settings."""

from __future__ import annotations

from collections import Counter
from typing import Final

from dcp_spec.profile.loading import profile_names

from dcp_codec.codec import Codec, get_codec
from dcp_codec.errors import DecodeError
from dcp_codec.values import VarSumm
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.lower_tester import ListensToAllTypes, LowerTester

#: Source address and sender identifier of questions.
ASKER = bytes.fromhex("02dc90000001")
#: Network identifiers that are tried when nothing is heard, beside those of the built-in profiles.
_NETWORKS: Final = (0, 1, 2, 3, 0x00FF, 0x0100, 0x1111, 0x1234, 0xFFFF)
#: EtherTypes that are tried when nothing is heard, beside those of the built-in profiles: the local experimental ones.
_ETHER_TYPES: Final = (0x88B5, 0x88B6)


def question(codec: Codec, number: int, network_id: int | None = None) -> bytes:
    """A beacon with the summary of a variable that does not exist: VarDis requests it (VD-PS-01).

    ``network_id``: by default that of the profile.
    """
    builder = FrameBuilder(codec)
    layout = codec.profile.types.node_id
    if layout.representation == "text":
        sender = ASKER.hex(":").encode()
    else:
        sender = ASKER[-layout.width :].rjust(layout.width, b"\x02")
    highest = (1 << (8 * codec.profile.types.var_id.width)) - 1
    block = builder.vardis(VarSumm(number % (highest + 1), 1))
    seqno = number + codec.profile.behaviour.first_beacon_seqno
    return builder.beacon(sender, seqno, [block], network_id=network_id)


def network_ids(codec: Codec, without: int | None) -> list[int]:
    """Network identifiers to try, but for ``without``; none where the header of the profile has no such field."""
    if not codec.profile.has_header_field("networkId"):
        return []
    top = 1 << (8 * codec.profile.types.network_id.width)
    known = (get_codec(name).profile.bp.network_id for name in profile_names())
    numbers = dict.fromkeys((*(each for each in known if each is not None), *_NETWORKS))
    return [each for each in numbers if each < top and each != without]


def other_ether_type(lower: LowerTester, codec: Codec, source: bytes, duration: int) -> str:
    """Listen to other EtherTypes for ``duration`` ns, and ask in them. What to change if beacons come; else empty.

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
    """Whether octets are a beacon of the profile, or of another one."""
    for each in (codec, *map(get_codec, profile_names())):
        if each.profile.bp.header:
            try:
                each.decode(octets)
            except DecodeError:
                continue
            return True
    return False
