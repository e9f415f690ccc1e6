"""A node with its control interface, in virtual time and without sockets."""

from __future__ import annotations

import json
import random
from typing import Any

from dcp_codec import Codec
from dcp_stack.config import NodeConfig
from dcp_stack.control.server import ControlServer, ControlSession
from dcp_stack.effects import SendBeacon
from dcp_stack.node import Node

WALL = 1_700_000_000_000_000_000
MS = 1_000_000
OWN = bytes.fromhex("020000000001")


class Rig:
    """One node, any number of clients."""

    def __init__(self, profile: str = "dcp-2.0", **config: Any) -> None:
        self.codec = Codec(profile)
        if self.codec.report_plan is None:
            config.setdefault("srp", None)
        self.node = Node(NodeConfig(node_id=OWN, codec=self.codec, **config), rng=random.Random(1), now=0, wall=WALL)
        self.now = 0
        self.node.start(0, WALL)
        self.server = ControlServer(self.node)
        self.sent: list[bytes] = []

    @property
    def wall(self) -> int:
        return WALL + self.now

    def client(self) -> Client:
        return Client(self, self.server.open())

    def settle(self) -> None:
        """Handle effects as a driver does after any input."""
        effects = self.node.take_effects()
        self.sent += [each.octets for each in effects if isinstance(each, SendBeacon)]
        self.server.indicate(effects, now=self.now, wall=self.wall)

    def hear(self, octets: bytes) -> None:
        self.node.handle_frame(octets, now=self.now, wall=self.wall)
        self.settle()

    def run(self, milliseconds: int) -> None:
        """Let time pass."""
        end = self.now + milliseconds * MS
        while (due := self.node.poll_timeout()) is not None and due <= end:
            self.now = max(self.now, due)
            self.node.handle_timeout(self.now, self.wall)
            self.settle()
        self.now = end


class Client:
    """A client of the control interface."""

    def __init__(self, rig: Rig, session: ControlSession) -> None:
        self.rig = rig
        self.session = session
        self.told: list[dict[str, Any]] = []

    def feed(self, data: bytes) -> list[Any]:
        """Feed octets and return the answers, as messages."""
        answers = self.session.feed(data, now=self.rig.now, wall=self.rig.wall)
        self.rig.settle()
        assert not answers or answers.endswith(b"\n")
        return [json.loads(line) for line in answers.splitlines()]

    def say(self, message: Any) -> list[Any]:
        return self.feed(json.dumps(message).encode() + b"\n")

    def ask(self, method: str, /, **params: Any) -> Any:
        """The response to a request; notifications on the way are put aside."""
        answers = self.say({"jsonrpc": "2.0", "id": 1, "method": method, "params": params})
        self.told += [each for each in answers if "method" in each]
        found = [each for each in answers if "method" not in each]
        assert len(found) == 1, answers
        assert found[0]["id"] == 1
        return found[0]

    def call(self, method: str, /, **params: Any) -> dict[str, Any]:
        """The result of a method."""
        answer = self.ask(method, **params)
        assert "result" in answer, answer
        return answer["result"]

    def error(self, method: str, /, **params: Any) -> dict[str, Any]:
        """The error of a method."""
        answer = self.ask(method, **params)
        assert "error" in answer, answer
        return answer["error"]

    def notifications(self) -> list[dict[str, Any]]:
        """Everything told since the last look."""
        self.told += self.feed(b"")
        told, self.told = self.told, []
        return told
