"""Beacons of made-up networks, as long as a benchmark needs them: a normal one, and one under attack.

The normal network is a bus without losses: every node hears every beacon at once, sends new values as often as the
variable's repCnt says, and summarises what it holds. That is what a recording of a real flight looks like to a reader,
at the cost of encoding. The attacked one has a further station that forges creations, requests and summaries of all
variables.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_codec.framing.envelope import Envelope
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)

BEGIN = 1_750_000_000_000_000_000
PERIOD = 100_000_000
SUMMARIES, UPDATES, REQ_UPDATES, REQ_CREATES, CREATES = 1, 2, 3, 4, 5
#: Summaries of a beacon, values and creations of a beacon, at most.
_SUMMARIES, _NEWS = 20, 8


class _Variable(NamedTuple):
    spec: VarSpec
    update: VarUpdate


class Flight:
    """A network of ``nodes`` nodes with ``variables`` variables, each updated every ``every`` beacon periods."""

    def __init__(self, codec: Codec, nodes: int = 30, variables: int = 50, *, every: int = 10, seed: int = 1) -> None:
        self.codec = codec
        self.nodes = [bytes([2, 0, 0, 0, 0, number + 1]) for number in range(nodes)]
        self._every, self._rng = every, random.Random(seed)
        self._envelope = Envelope(codec.profile.link)
        self._numbers = codec.profile.vardis.container_types.by_name()
        self._variables: dict[int, _Variable] = {}
        for var_id in range(variables):
            spec = VarSpec(var_id, self.nodes[var_id % nodes], 2, b"v%d" % var_id, BEGIN + var_id, 0)
            self._variables[var_id] = _Variable(spec, VarUpdate(var_id, 0, bytes(8)))
        #: Records that each node still has to send: kind and variable, and how often.
        self._news: list[deque[tuple[int, int, int]]] = [deque() for _ in self.nodes]
        for news in self._news:
            news.extend((CREATES, var_id, 2) for var_id in self._variables)
        self._turn = [0] * nodes

    def frames(self, count: int) -> Iterator[Frame]:
        """The first ``count`` frames."""
        for number in range(count):
            turn, node = divmod(number, len(self.nodes))
            if node == 0:
                self._update(turn)
            now = BEGIN + turn * PERIOD + node * (PERIOD // len(self.nodes)) + self._rng.randrange(1_000_000)
            yield self.frame(number + 1, now, self.nodes[node], turn, self._said(node))

    def frame(self, number: int, now: int, node: bytes, seqno: int, containers: tuple[Container, ...]) -> Frame:
        """A beacon with a state report."""
        data = self.codec.safety_data_type(*(float(each) for each in range(len(self.codec.profile.srp.safety_data))))
        report = ExtendedSafetyData(data, node, now - 1_000_000, seqno)
        payloads = (Payload(1, report), Payload(2, containers))
        octets = self.codec.encode(Beacon(BPHeader(node, seqno, 0), payloads))
        frame = self._envelope.frame(octets, node)
        return Frame(number, now, frame, len(frame))

    def _update(self, turn: int) -> None:
        for var_id, variable in self._variables.items():
            if turn > 20 and (turn + var_id) % self._every == 0:
                number = (variable.update.seqno + 1) % 256
                value = number.to_bytes(8, "big")
                self._variables[var_id] = variable._replace(update=VarUpdate(var_id, number, value))
                for news in self._news:
                    news.append((UPDATES, var_id, 2))

    def _said(self, node: int) -> tuple[Container, ...]:
        news, kept = self._news[node], []
        creates: dict[int, VarCreate] = {}
        updates: dict[int, VarUpdate] = {}
        for _ in range(min(_NEWS, len(news))):
            kind, var_id, left = news.popleft()
            variable = self._variables[var_id]
            if kind == CREATES:
                creates[var_id] = VarCreate(variable.spec, variable.update)
            else:
                updates[var_id] = variable.update
            if left > 1:
                kept.append((kind, var_id, left - 1))
        news.extend(kept)
        begin, many = self._turn[node], len(self._variables)
        self._turn[node] = (begin + _SUMMARIES) % max(many, 1)
        known = [self._variables[(begin + each) % many].update for each in range(min(_SUMMARIES, many))]
        listed = [
            (CREATES, tuple(creates.values())),
            (SUMMARIES, tuple(VarSumm(each.var_id, each.seqno) for each in known)),
            (UPDATES, tuple(each for var_id, each in updates.items() if var_id not in creates)),
        ]
        return tuple(Container(kind, records) for kind, records in listed if records)


class Attack(Flight):
    """The same network, and after every second beacon one of a station that forges."""

    def frames(self, count: int) -> Iterator[Frame]:
        """The first ``count`` frames."""
        attacker, rng, number = bytes([2, 0, 0, 0, 0, 0xFE]), random.Random(7), 0
        for honest in super().frames(count):
            number += 1
            yield _renumbered(honest, number)
            if number >= count:
                return
            if honest.number % 2:
                continue
            number += 1
            yield self.frame(number, honest.time_ns + 1000, attacker, number, self._forged(rng, honest.time_ns))
            if number >= count:
                return

    def _forged(self, rng: random.Random, now: int) -> tuple[Container, ...]:
        creates = []
        for var_id in rng.sample(range(256), 12):
            spec = VarSpec(var_id, rng.choice(self.nodes), 15, b"forged", now + rng.randrange(1000), 0)
            creates.append(VarCreate(spec, VarUpdate(var_id, rng.randrange(256), rng.randbytes(8))))
        asked = rng.sample(range(256), 30)
        return (
            Container(CREATES, tuple(creates)),
            Container(SUMMARIES, tuple(VarSumm(each, rng.randrange(256)) for each in rng.sample(range(256), 20))),
            Container(REQ_UPDATES, tuple(VarReqUpdate(each, rng.randrange(256)) for each in asked)),
            Container(REQ_CREATES, tuple(VarReqCreate(each) for each in asked)),
        )


def _renumbered(frame: Frame, number: int) -> Frame:
    return Frame(number, frame.time_ns, frame.data, frame.orig_len)
