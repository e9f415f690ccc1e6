"""One BP entity in virtual time; what it sends is decoded again by the codec of its profile."""

from __future__ import annotations

import random
from typing import Any

from dcp_spec.constants import QueueingMode
from dcp_spec.profile.rules import header_size
from dcp_spec.status import BPStatus

from dcp_codec import get_codec
from dcp_codec.codec import Codec
from dcp_codec.values import Beacon, BPHeader, Payload
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.config import BPConfig, NodeConfig
from dcp_stack.effects import Dropped, Effect, PayloadReceived, PayloadTransmitted, SendBeacon

MS = 1_000_000
WALL = 1_700_000_000_000_000_000
ME = bytes.fromhex("020000000001")
OTHER = bytes.fromhex("020000000002")

DROPTAIL = QueueingMode.QUEUE_DROPTAIL
DROPHEAD = QueueingMode.QUEUE_DROPHEAD
QUEUE = QueueingMode.QUEUE
ONCE = QueueingMode.ONCE
REPEAT = QueueingMode.REPEAT

VERSIONS = ("1.0", "1.1", "1.2", "1.3", "2.0")
SINCE_1_1 = VERSIONS[1:]
SINCE_1_2 = VERSIONS[2:]
PROFILES = (
    *(f"dcp-{version}" for version in VERSIONS),
    "cpp-1.2",
    "cpp-1.3",
    "cpp-2.0",
    "sim-1.0",
    "sim-2.0",
    "student-2024",
)
OK = BPStatus.OK


class Rig:
    """A BP with everything it emitted. ``tick`` goes to the next deadline; time never moves by itself."""

    def __init__(
        self,
        version: str = "2.0",
        *,
        profile: str = "",
        codec: Codec | None = None,
        seed: int = 1,
        node_id: bytes = ME,
        readings: dict[str, str] | None = None,
        **settings: Any,
    ) -> None:
        self.codec = codec or get_codec(profile or f"dcp-{version}")
        self.config = NodeConfig(node_id=node_id, codec=self.codec, bp=BPConfig(**settings), readings=readings or {})
        self.now = 5 * MS
        self.effects: list[Effect] = []
        self.bp = BeaconingProtocol(
            self.config, rng=random.Random(seed), emit=self.effects.append, now=self.now, wall=WALL
        )

    @property
    def header(self) -> int:
        """Octets of the header."""
        return header_size(self.codec.profile)

    # -- services

    def register(self, prot_id=7, mode=ONCE, *, size=100, entries=2, several=False, name="client", wall=WALL):
        return self.bp.register(prot_id, name, size, mode, entries, several, now=self.now, wall=wall)

    def submit(self, payload, prot_id=7):
        return self.bp.transmit_payload(prot_id, payload, now=self.now).status

    def number(self, prot_id=7):
        confirm = self.bp.query_number_buffered(prot_id)
        assert confirm.status is OK
        return confirm.number

    # -- transmission

    def tick(self, late=0):
        """Let the next beacon be prepared; returns its payloads as (protocol id, octets), None without a beacon."""
        sent = self.beacon(late)
        return None if sent is None else [(block.protocol_id, block.content) for block in sent.payloads]

    def beacon(self, late=0) -> Beacon | None:
        """As :meth:`tick`, returns the beacon."""
        due = self.bp.poll_timeout()
        assert due is not None
        self.now = max(self.now, due + late)
        before = len(self.effects)
        self.bp.handle_timeout(self.now, WALL + self.now)
        sent = [effect for effect in self.effects[before:] if isinstance(effect, SendBeacon)]
        assert len(sent) <= 1
        return self.codec.decode_envelope(sent[0].octets)[0] if sent else None

    def contents(self, count, prot_id=7):
        """The payloads of a client in the next ``count`` beacons, None for a beacon without one or no beacon."""
        found = []
        for _ in range(count):
            blocks = [octets for protocol, octets in self.tick() or () if protocol == prot_id]
            assert len(blocks) <= 1
            found.append(blocks[0] if blocks else None)
        return found

    def sent(self):
        return [effect for effect in self.effects if isinstance(effect, SendBeacon)]

    def transmitted(self):
        return [effect for effect in self.effects if isinstance(effect, PayloadTransmitted)]

    # -- reception

    def builder(self, *blocks, seqno=0, sender=OTHER, network=None):
        """The bearer payload with blocks of (protocol id, octets), in the layout of the profile."""
        own = self.bp.parameters().get("BPPAR_NETWORK_ID")
        header = BPHeader(sender, seqno, own if network is None else network) if self.header else None
        return self.codec.encode_envelope(Beacon(header, tuple(Payload(*block) for block in blocks)))

    def field(self, name):
        """Where a header field is in a bearer payload."""
        widths = {"version": 1, "magicNo": 2, "senderId": 6, "networkId": 2, "length": 2, "numPayloads": 1, "seqno": 4}
        start = 0
        for field in self.codec.profile.bp.header:
            if field == name:
                return slice(start, start + widths[name])
            start += widths[field]
        raise KeyError(name)

    def patch(self, octets, name, value):
        """The same octets with one header field overwritten."""
        place = self.field(name)
        raw = value if isinstance(value, bytes) else value.to_bytes(place.stop - place.start, "big")
        return octets[: place.start] + raw + octets[place.stop :]

    def receive(self, octets):
        """Hand a bearer payload over; returns what was delivered as (protocol id, octets) and why the rest was not."""
        before = len(self.effects)
        self.bp.handle_beacon(octets, now=self.now, wall=WALL + self.now)
        got = self.effects[before:]
        assert all(isinstance(effect, PayloadReceived | Dropped) for effect in got)
        delivered = [(effect.protocol_id, effect.payload) for effect in got if isinstance(effect, PayloadReceived)]
        return delivered, [effect for effect in got if isinstance(effect, Dropped)]

    def reasons(self, octets):
        """As :meth:`receive` for what must not be delivered: only the reasons."""
        delivered, dropped = self.receive(octets)
        assert delivered == []
        return [effect.reason for effect in dropped]
