"""Lines of five nodes with producers at the ends and one faulty node in the middle: recordings with ground truth."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from typing import Any, NamedTuple

from dcp_conformance.reference.inprocess import MakeNode

from dcp_codec.capture import Frame
from dcp_codec.codec import Codec
from dcp_selftest.mutants import all_mutants
from dcp_selftest.mutants.mutant import node_with
from dcp_selftest.recordings.networks import MS, SECOND, MixedNetwork, Other, identifier
from dcp_stack.config import BPConfig, SRPConfig, VardisConfig
from dcp_stack.control.client import ServiceError
from dcp_stack.vardis.receive import Receiver
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.topology import Line

PROFILE = "dcp-2.0"
NODES = [identifier(PROFILE, index) for index in range(5)]
#: The faulty node, and the links as an option of ``check``.
FAULTY, LINKS = 2, "00:00-00:01-00:02-00:03-00:04"
#: The variables whose numbers are compared with the databases.
VARIABLES = (1, 5, 14, 16)


class _Stuck(Receiver):
    """From number 21 of variable 1 on, no update is stored."""

    def _update(self, record: Any, offset: int, now: int, wall: int) -> None:
        if record.var_id != 1 or record.seqno <= 20:
            super()._update(record, offset, now, wall)


class _OneDirection(Receiver):
    """Updates of variable 5, which come from the right, are never stored."""

    def _update(self, record: Any, offset: int, now: int, wall: int) -> None:
        if record.var_id != 5:
            super()._update(record, offset, now, wall)


class _OneDeletion(Receiver):
    """The delete of variable 14 is ignored, the other records of the frame are not."""

    def _delete(self, record: Any, offset: int) -> None:
        if record.var_id != 14:
            super()._delete(record, offset)


class _Silent(Receiver):
    """Requests are never answered."""

    def _request_update(self, record: Any, offset: int) -> None:
        """Ignore a request."""

    def _request_create(self, record: Any, offset: int) -> None:
        """Ignore a request."""


def _with(receiver: type[Receiver]) -> MakeNode:
    kind = node_with(receiver)
    return lambda config, rng, now, wall: kind(config, rng=rng, now=now, wall=wall)


FAULTS: dict[str, Callable[[], MakeNode]] = {
    "stuck": lambda: _with(_Stuck),
    "one direction": lambda: _with(_OneDirection),
    "one deletion": lambda: _with(_OneDeletion),
    "silent": lambda: _with(_Silent),
    "first container": lambda: all_mutants()["M-VD-RX-04-first-only"].make,
    "no deletions": lambda: all_mutants()["M-VD-PD-04-ignored"].make,
}


class Recording(NamedTuple):
    """A recording with its ground truth."""

    frames: tuple[Frame, ...]
    begin: int
    """Time of second 0 by the recorder's clock, ns since 1970."""
    numbers: dict[tuple[int, int, int], int | None]
    """(second, node, variable) -> number of the value in the database of the node; None without the variable."""


def recorded(fault: str = "", loss: float = 0.0, seconds: int = 40) -> tuple[Frame, ...]:
    """Return the frames of :func:`record_line`."""
    return record_line(fault, loss, seconds).frames


@cache
def record_line(fault: str = "", loss: float = 0.0, seconds: int = 40) -> Recording:
    """Record a line; without a fault all nodes are reference nodes.

    Node 0 produces variable 1, node 4 variable 5, both with an update every 0.7 s up to number 50. Variables 14 and 16
    are deleted in the payload that creates 43 and 45.
    """
    codec = Codec(PROFILE)
    others = {FAULTY: Other(FAULTS[fault]())} if fault else {}
    network = MixedNetwork(
        5, codec, others, seed=1, topology=Line(), quality=Quality(loss=loss), bp=BPConfig(), srp=SRPConfig(),
        vardis=VardisConfig(),
    )  # fmt: skip
    frames: list[Frame] = []
    begin = network.wall

    class _Recorder:
        def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
            del wall, outgoing
            data = b"\xff" * 6 + source + (codec.profile.link.ether_type or 0).to_bytes(2, "big") + octets
            frames.append(Frame(len(frames) + 1, network.wall, data, len(data)))

    network.watchers.append(_Recorder())
    for index in range(5):
        network.at(37 * index * MS, partial(network.start, index))

    def create(node: int, variable: int, copies: int = 1) -> None:
        network.ask(
            node, "RTDB-Create", varId=variable, repCnt=copies, descr=f"v{variable}", value="00000000"
        )  # fmt: skip

    def replace(node: int, old: int, new: int) -> None:
        network.ask(node, "RTDB-Delete", varId=old)
        create(node, new, 2)

    for node, variable in ((0, 1), (4, 5)):
        network.at(1500 * MS + node * 50 * MS, partial(create, node, variable))
        for number in range(1, 51):
            ask = partial(network.ask, node, "RTDB-Update", varId=variable, value=f"{number:02x}" * 4)
            network.at(2000 * MS + node * 60 * MS + number * 700 * MS, ask)
    for old, node in ((14, 0), (16, 4)):
        network.at((3000 + 500 * old) * MS, partial(create, node, old, 2))
        network.at((6000 + 500 * old) * MS, partial(replace, node, old, old + 29))
    network.at((seconds - 2) * SECOND, lambda: network.ask(0, "RTDB-Delete", varId=1))
    numbers: dict[tuple[int, int, int], int | None] = {}

    def read(second: int) -> None:
        for node in range(5):
            for variable in VARIABLES:
                value: str | None = None
                with suppress(ServiceError):
                    value = network.request(node, "RTDB-Read", varId=variable).get("value")
                # The value is the number, four times.
                numbers[second, node, variable] = int(value[:2], 16) if value else None

    for second in range(2, seconds):
        network.at(second * SECOND, partial(read, second))
    network.run_until(seconds * SECOND)
    return Recording(tuple(frames), begin, numbers)
