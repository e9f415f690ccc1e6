"""Generate meaningful sequences, for faults that need several messages.

Each sequence is drawn by a seeded generator and is independent of others: it starts in the initial state of a node.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Sequence
from typing import Any, Final

from dcp_spec.constants import IC_MAX_RECORDS, ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import EncodeError
from dcp_codec.values import (
    ExtendedSafetyData,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)
from dcp_lab.fuzz.steps import Call, Frame, Step, Wait
from dcp_lab.testing.mutation import Mutator

from .elements import CREATION, Parts

#: Number of neighbours of a flood.
_FLOOD: Final = 3000
#: Service calls, most with invalid parameters, that do not change the state of the node permanently.
_ODD_CALLS: Final[tuple[tuple[str, dict[str, Any]], ...]] = (
    ("RTDB-Read", {"varId": -1}),
    ("RTDB-Read", {"varId": "0"}),
    ("RTDB-Create", {}),
    ("RTDB-Update", {"varId": 1 << 70, "value": "00"}),
    ("RTDB-Update", {"varId": 0, "value": "zz"}),
    ("RTDB-Delete", {"varId": 3.5}),
    ("RTDB-DescribeDatabase", {"x": 1}),
    ("SRP-UpdateSafetyData", {"sData": {}}),
    ("SRP-UpdateSafetyData", {"sData": None}),
    ("BP-TransmitPayload", {"protocolId": 2, "payload": "00" * 2000}),
    ("BP-RegisterProtocol", {}),
    ("BP-QueryNumberBufferedPayloads", {"protocolId": 1 << 16}),
    ("UT-Nothing", {}),
)


class Sequences(Parts):
    """Generator of sequences. ``own_id``: identifier of the tested node. ``recorded``: frames of recordings."""

    def __init__(
        self, codec: Codec, rng: random.Random, own_id: bytes, mutator: Mutator, recorded: Sequence[bytes] = ()
    ) -> None:
        super().__init__(codec, rng)
        self.own_id = own_id
        self.mutator = mutator
        self.recorded = recorded
        stamp = codec.profile.types.timestamp
        self._latest = (1 << (8 * stamp.width - stamp.signed)) - 1
        self._kinds: list[tuple[float, str, Callable[[], list[Step]]]] = [
            (30, "mixed", self.mixed),
            (40, "mutated", self.mutated),
            (120, "records", self.records),
            (15, "spoofed-sender", self.spoofed_sender),
            (30, "services", self.services),
            (2, "garbage", self.garbage),
            (0.4, "all-variables", self.all_variables),
            (1, "largest", self.largest),
        ]
        if codec.report_plan is not None:
            self._kinds.append((15, "reports", self.reports))
        if recorded:
            self._kinds.append((10, "recording", self.recording))
        self._weights = list(itertools.accumulate(weight for weight, _, _ in self._kinds))
        self.kinds: tuple[str, ...] = ()
        """The kind of the last sequence."""

    def draw(self) -> list[Step]:
        """Return the next sequence. A flood of neighbours, which takes seconds, is one in 5000 sequences."""
        if self.codec.report_plan is not None and self.rng.random() < 0.0002:
            self.kinds = ("neighbour-flood",)
            return self.neighbour_flood()
        _, name, kind = self.rng.choices(self._kinds, cum_weights=self._weights)[0]
        self.kinds = (name,)
        return kind()

    def keep(self, steps: list[Step]) -> None:
        """Add the frames of this sequence to those that are mutated."""
        for step in steps:
            if isinstance(step, Frame):
                self.mutator.add(step.octets)

    # -- kinds of sequences ------------------------------------------------------------------------------------

    def mixed(self) -> list[Step]:
        """Send random valid beacons."""
        found: list[Step] = []
        for _ in range(1 + self._chance.below(5)):
            octets = self._chance.one_of(self.mutator.sources).octets
            found.append(Frame(octets, octets))
            found += self.pause()
        return found

    def mutated(self) -> list[Step]:
        """Create a variable, and send mutated frames."""
        found: list[Step] = [self.frame(self.create(self.var_id()))] if self.rng.random() < 0.5 else []
        for _ in range(1 + self._chance.below(5)):
            made = self.mutator.mutate()
            found.append(Frame(made.octets, made.source, ", ".join(f"{path} {name}" for path, name in made.touched)))
            found += self.pause()
        return found

    def records(self) -> list[Step]:
        """Send records of all kinds about one variable: its states, numbers near wrap-around, two producers."""
        var_id, number, time, found = self.var_id(), self.seqno(), CREATION, list[Step]()
        if self.rng.random() < 0.7:
            found.append(self.frame(self.create(var_id, seqno=number, timeout=self._chance.one_of((0, 0, 300)))))
        for _ in range(2 + self._chance.below(5)):
            # The last value is later, but its lower 32 bits are smaller.
            time += self._chance.one_of((0, 1, 1, -1, 256, 65_536, (1 << 32) - 500))
            time = max(0, min(time, self._latest))
            good = self.rng.random() < 0.7
            peer, producer = 1 + self._chance.below(2), self.own_id if self.rng.random() < 0.1 else None
            many = range(self._chance.one_of((1, 1, 2, 60)))
            about: list[VardisRecord] = [
                self.create(var_id, good=good, peer=peer, creation=time, seqno=self.seqno(), producer=producer),
                VarDelete(var_id),
                VarUpdate(var_id, (number + 1) % self._modulus, self.value()),
                VarUpdate(var_id, self.seqno(number), self.value()),
                *(VarSumm((var_id + each) % (self._top_var + 1), self.seqno(number)) for each in many),
                VarReqUpdate(var_id, self.seqno(number)),
                VarReqCreate(var_id),
            ]
            found.append(self.frame(*self.rng.sample(about, 1 + self._chance.below(3)), peer=1 + self._chance.below(3)))
            found += self.pause()
        return [*found, Wait(12.0)] if self.rng.random() < 0.05 else found

    def spoofed_sender(self) -> list[Step]:
        """Send beacons with the identifier of the node itself, the broadcast address, or zeros."""
        found: list[Step] = []
        width = len(self.own_id)
        for _ in range(1 + self._chance.below(4)):
            text = self.codec.profile.types.node_id.representation == "text"
            others = (self.own_id, self.node(1)) if text else (self.own_id, bytes(width), b"\xff" * width, self.node(1))
            create = self.create(self.var_id(), producer=self._chance.one_of(others), seqno=self.seqno())
            if self.codec.report_plan is not None and self.rng.random() < 0.4:
                report = self._values.report()
                report = ExtendedSafetyData(report.s_data, self._chance.one_of(others), report.t_stamp, report.seqno)
                found.append(self.report_frame(report, sender=self._chance.one_of(others)))
            else:
                found.append(self.frame(create, sender=self._chance.one_of(others)))
            found += self.pause()
        return found

    def reports(self) -> list[Step]:
        """Send state reports of a few stations with random sequence numbers and time stamps."""
        found: list[Step] = []
        for _ in range(1 + self._chance.below(5)):
            found.append(self.report_frame(self._values.report(), peer=1 + self._chance.below(3)))
            found += self.pause()
        return found

    def services(self) -> list[Step]:
        """Call services about a variable while other stations send records about it."""
        var_id, found = self.var_id(), list[Step]()
        create = {"varId": var_id, "repCnt": self._chance.one_of((1, 2, 15)), "descr": "own", "value": "6f776e"}
        whose = self.rng.random()
        if whose < 0.7:
            found.append(Call("RTDB-Create", create))
        elif whose < 0.9:
            # A variable of another producer: the services that change it must be refused.
            found.append(self.frame(self.create(var_id)))
        for _ in range(2 + self._chance.below(4)):
            step: Step
            match self._chance.below(10):
                case 0 | 1:
                    step = Call("RTDB-Update", {"varId": var_id, "value": self.rng.randbytes(3).hex()})
                case 2:
                    step = Call("RTDB-Delete", {"varId": var_id})
                case 3:
                    step = Call("RTDB-Create", create)
                case 4:
                    step = Call(*self._chance.one_of(_ODD_CALLS))
                case 5:
                    step = self.frame(self.create(var_id, creation=self._chance.one_of((1, CREATION))))
                case 6 if self.codec.report_plan is not None:
                    # A node with safety data and variables sends beacons of two blocks.
                    step = Call("SRP-UpdateSafetyData", {"sData": self._safety_data()})
                case 7:
                    other = self._chance.one_of((VarDelete(var_id), VarUpdate(var_id, self.seqno(), b"other")))
                    step = self.frame(other)
                case 8:
                    step = Call("RTDB-Read", {"varId": var_id})
                case _:
                    step = self.frame(self._chance.one_of((VarReqCreate(var_id), VarReqUpdate(var_id, self.seqno()))))
            found.append(step)
            found += self.pause()
        return found

    def _safety_data(self) -> dict[str, Any]:
        fields = self.codec.profile.srp.safety_data
        return {field.name: 1.5 if field.type.startswith("f") else 1 for field in fields if field.type != "opaque"}

    def garbage(self) -> list[Step]:
        """Send 60 mutated frames in succession, for faults of error counters and for leaks."""
        made = [self.mutator.mutate() for _ in range(60)]
        if self.rng.random() < 0.7:
            # Repeat one frame.
            made = [made[0]] * 60
        return [Frame(each.octets, each.source) for each in made]

    def all_variables(self) -> list[Step]:
        """Create all possible variables, up to 256, then send a record about each."""
        found: list[Step] = []
        ids = range(self._top_var + 1)
        records = [self.create(each) for each in ids]
        for first in range(0, len(records), 20):
            found.append(self.frame(*records[first : first + 20]))
        found.append(Wait(2.0))
        others: list[VardisRecord] = [
            self._chance.one_of((VarDelete(each), VarUpdate(each, 1, b"n"), VarReqCreate(each))) for each in ids
        ]
        others.sort(key=lambda record: type(record).__name__)
        for first in range(0, len(others), 60):
            found.append(self.frame(*others[first : first + 60]))
        return [*found, Wait(2.0)]

    def largest(self) -> list[Step]:
        """Send containers and values of maximum size."""
        found: list[Step] = []
        for kind in self.rng.sample(tuple(ICType), 3):
            octets = self._values.full(kind)
            found.append(Frame(octets, octets))
        with_most = [VarSumm(number % (self._top_var + 1), 1) for number in range(IC_MAX_RECORDS)]
        try:
            found.append(self.frame(*with_most))
        except EncodeError:
            # The profile has an area of fixed size, or a length field of one octet.
            found.append(self.frame(*with_most[:20]))
        return [*found, *self.pause()]

    def recording(self) -> list[Step]:
        """Send a part of a recording with one mutated frame inserted."""
        start = self._chance.below(len(self.recorded))
        found: list[Step] = [
            Frame(octets, octets) for octets in self.recorded[start : start + 2 + self._chance.below(6)]
        ]
        made = self.mutator.mutate()
        found.insert(self._chance.below(len(found) + 1), Frame(made.octets, made.source))
        return found

    def neighbour_flood(self) -> list[Step]:
        """Send a state report of each of 3000 stations."""
        found: list[Step] = []
        for number in range(1, _FLOOD + 1):
            report = self._values.report()
            report = ExtendedSafetyData(report.s_data, self.node(number), report.t_stamp, number)
            found.append(self.report_frame(report, peer=number))
        return [*found, Wait(40.0)]
