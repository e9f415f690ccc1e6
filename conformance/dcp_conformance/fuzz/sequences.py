"""Sequences that mean something: what one damaged beacon cannot show, because it takes a history.

Every sequence is drawn by a seeded generator and stands for itself: it begins at a node that knows nothing.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Sequence
from typing import Any, Final

from dcp_spec.constants import BP_SEQNO_MODULUS, IC_MAX_RECORDS, ICType, seqno_modulus

from dcp_codec.codec import Codec
from dcp_codec.errors import EncodeError
from dcp_codec.mutation import Mutator
from dcp_codec.mutation_values import ValidValues
from dcp_codec.values import (
    ExtendedSafetyData,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)
from dcp_conformance.forge import Block, Forge

from .steps import Call, Frame, Step, Wait

#: Ticks of a profile's clock that creation times are drawn around; anything later than 0 and far from the end.
_CREATION: Final = 1_000_000
#: Neighbours of a flood.
_FLOOD: Final = 3000
#: Services that change nothing for good, with parameters that need not make sense.
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


class Sequences:
    """Draws sequences. ``own_id`` is the identifier of the node that they are for."""

    def __init__(
        self, codec: Codec, rng: random.Random, own_id: bytes, mutator: Mutator, recorded: Sequence[bytes] = ()
    ) -> None:
        self.codec = codec
        self.rng = rng
        self.own_id = own_id
        self.mutator = mutator
        self.recorded = recorded
        self._values = ValidValues(codec, rng)
        self._forge = Forge(codec)
        profile = codec.profile
        self._limits = profile.limits
        self._network = profile.bp.network_id or 0
        self._has_network = profile.has_header_field("networkId")
        self._modulus = seqno_modulus(profile.types.var_seqno.width)
        self._top_var = min(255, (1 << (8 * profile.types.var_id.width)) - 1)
        self._creation = "creationTime" in profile.vardis.var_spec
        stamp = profile.types.timestamp
        self._latest = (1 << (8 * stamp.width - stamp.signed)) - 1
        self._seqno = 0
        self._kinds: list[tuple[float, str, Callable[[], list[Step]]]] = [
            (30, "mixed", self.mixed),
            (40, "mutated", self.mutated),
            (25, "creation-times", self.creation_times),
            (25, "sequence-wrap", self.sequence_wrap),
            (20, "delete-and-create", self.delete_and_create),
            (20, "requests", self.requests),
            (15, "two-producers", self.two_producers),
            (15, "spoofed-sender", self.spoofed_sender),
            (30, "services", self.services),
            (20, "one-payload", self.one_payload),
            (2, "garbage", self.garbage),
            (0.4, "all-variables", self.all_variables),
            (1, "largest", self.largest),
        ]
        if "timeout" in profile.vardis.var_spec:
            self._kinds.append((6, "soft-state", self.soft_state))
        if codec.report_plan is not None:
            self._kinds.append((15, "reports", self.reports))
        if recorded:
            self._kinds.append((10, "recording", self.recording))
        self._weights = list(itertools.accumulate(weight for weight, _, _ in self._kinds))
        self.last = ""
        """The kind of the last sequence."""

    def draw(self) -> list[Step]:
        """The next sequence. A flood of neighbours, which takes seconds, comes once in several thousand."""
        if self.codec.report_plan is not None and self.rng.random() < 0.0002:
            self.last = "neighbour-flood"
            return self.neighbour_flood()
        _, self.last, kind = self.rng.choices(self._kinds, cum_weights=self._weights)[0]
        return kind()

    def keep(self, steps: list[Step]) -> None:
        """Mutate the frames of this sequence, too, from now on."""
        for step in steps:
            if isinstance(step, Frame):
                self.mutator.add(step.octets)

    # -- parts -------------------------------------------------------------------------------------------------

    def node(self, number: int) -> bytes:
        """The identifier of a station."""
        layout = self.codec.profile.types.node_id
        octets = bytes((0x02, 0xDC, 0x90)) + number.to_bytes(3, "big")
        if layout.representation == "text":
            return octets.hex(":").encode()
        return octets[-layout.width :].rjust(layout.width, b"\2") if layout.width else b""

    def frame(
        self, *what: VardisRecord | Block | ExtendedSafetyData, sender: bytes | None = None, peer: int = 1
    ) -> Frame:
        """A beacon of a station; records of one kind that follow each other share a container."""
        self._seqno = (self._seqno + 1) % BP_SEQNO_MODULUS
        blocks: list[Block] = []
        run: list[VardisRecord] = []
        for each in (*what, None):
            if isinstance(each, Block | ExtendedSafetyData) or each is None:
                if run:
                    blocks.append(self._forge.vardis(*run))
                    run = []
                if each is not None:
                    blocks.append(each if isinstance(each, Block) else self._forge.srp(each))
            else:
                run.append(each)
        octets = self._forge.beacon(
            self.node(peer) if sender is None else sender,
            self._seqno,
            blocks,
            network_id=self._network if self._has_network else None,
        )
        return Frame(octets, octets, source=self._address(peer))

    def _address(self, peer: int) -> bytes:
        return bytes((0x02, 0xDC, 0x90)) + peer.to_bytes(3, "big")

    def var_id(self) -> int:
        """One of a few variables."""
        return self.rng.choice((0, 1, 1, 2, 2, 3, self._top_var))

    def value(self) -> bytes:
        """A value; lengths around the limit are favoured."""
        most = min(self._limits.max_value_length, self._values.longest_value)
        size = self.rng.choice((1, 1, 4, most - 1, most, min(most + 1, self._values.longest_value), 0))
        octets = self.rng.randbytes(size)
        return octets.replace(b"\0", b"\1") if self.codec.profile.types.value.terminated else octets

    def create(
        self, var_id: int, *, peer: int = 1, seqno: int = 0, creation: int = _CREATION, producer: bytes | None = None
    ) -> VarCreate:
        """A VarCreate that is most often acceptable."""
        rng, limits = self.rng, self._limits
        rep_cnt = rng.choice((1, 1, 2, limits.max_repetitions, min(limits.max_repetitions + 1, 255), 0))
        most = min(limits.max_description_length, self._values.longest_text)
        descr = b"d" * rng.choice((1, 4, most, min(most + 1, self._values.longest_text), 0))
        spec = VarSpec(
            var_id,
            self.node(peer) if producer is None else producer,
            rep_cnt,
            descr if rng.random() < 0.9 else b"\xff\xfe",
            creation if self._creation else None,
            0 if "timeout" in self.codec.profile.vardis.var_spec else None,
        )
        return VarCreate(spec, VarUpdate(var_id, seqno, self.value()))

    def good_create(self, var_id: int, *, timeout: int = 0, **more: Any) -> VarCreate:
        """A VarCreate that every node has to take; ``timeout`` in ms."""
        made = self.create(var_id, **more)
        until = None if made.spec.timeout is None else timeout
        spec = VarSpec(var_id, made.spec.prod_id, 2, b"good", made.spec.creation_time, until)
        return VarCreate(spec, VarUpdate(var_id, made.upd.seqno, b"good"))

    def seqno(self, around: int = 0) -> int:
        """A number that is interesting as seen from another: near it, half the circle away, or at the ends."""
        half = self._modulus // 2
        step = self.rng.choice((0, 1, 1, 2, -1, half - 1, half, half + 1, self.rng.randrange(self._modulus)))
        return (around + step) % self._modulus

    def pause(self) -> list[Step]:
        """Sometimes some time."""
        return [Wait(self.rng.choice((0.5, 1.0, 2.0)))] if self.rng.random() < 0.3 else []

    # -- kinds of sequences ------------------------------------------------------------------------------------

    def mixed(self) -> list[Step]:
        """Valid beacons, drawn one by one."""
        found: list[Step] = []
        for _ in range(self.rng.randrange(1, 6)):
            octets = self.rng.choice(self.mutator.sources).octets
            found.append(Frame(octets, octets))
            found += self.pause()
        return found

    def mutated(self) -> list[Step]:
        """A variable, and mutations that may damage it."""
        found: list[Step] = [self.frame(self.good_create(self.var_id()))] if self.rng.random() < 0.5 else []
        for _ in range(self.rng.randrange(1, 6)):
            made = self.mutator.mutate()
            found.append(Frame(made.octets, made.source, ", ".join(f"{path} {name}" for path, name in made.touched)))
            found += self.pause()
        return found

    def creation_times(self) -> list[Step]:
        """One variable created again and again, earlier, equally and later, by this and that producer."""
        var_id, found = self.var_id(), list[Step]()
        time = _CREATION
        for _ in range(self.rng.randrange(2, 6)):
            # The last of them is later, with a lower half that is earlier.
            time += self.rng.choice((0, 1, 1, -1, -1000, 256, 1000, 65_536, (1 << 32) - 500))
            time = max(0, min(time, self._latest))
            producer = self.own_id if self.rng.random() < 0.1 else None
            made = self.good_create if self.rng.random() < 0.7 else self.create
            create = made(var_id, peer=self.rng.randrange(1, 3), creation=time, seqno=self.seqno(), producer=producer)
            found.append(self.frame(create))
            if self.rng.random() < 0.2:
                found.append(self.frame(VarDelete(var_id)))
            found += self.pause()
        return found

    def sequence_wrap(self) -> list[Step]:
        """Updates, summaries and requests around the circle."""
        var_id, number = self.var_id(), self.seqno()
        found: list[Step] = [self.frame(self.good_create(var_id, seqno=number))]
        for _ in range(self.rng.randrange(2, 7)):
            other = self.seqno(number)
            record = self.rng.choice(
                (VarUpdate(var_id, other, self.value()), VarSumm(var_id, other), VarReqUpdate(var_id, other))
            )
            found.append(self.frame(record, peer=self.rng.randrange(1, 4)))
            if isinstance(record, VarUpdate) and self.rng.random() < 0.6:
                number = other
            found += self.pause()
        return found

    def delete_and_create(self) -> list[Step]:
        """A variable that comes and goes, now and then in one beacon."""
        var_id, time, found = self.var_id(), _CREATION, list[Step]()
        for _ in range(self.rng.randrange(1, 5)):
            time += self.rng.choice((1, 1, 1, 0))
            create = self.good_create(var_id, creation=time, seqno=self.seqno())
            if self.rng.random() < 0.3:
                found.append(self.frame(create, VarDelete(var_id)))
            else:
                found += [self.frame(create), *self.pause(), self.frame(VarDelete(var_id))]
            late = (
                VarUpdate(var_id, self.seqno(), b"late"),
                VarSumm(var_id, 3),
                VarReqCreate(var_id),
                VarDelete(var_id),
            )
            if self.rng.random() < 0.5:
                found.append(self.frame(self.rng.choice(late), peer=2))
            found += self.pause()
        return found

    def requests(self) -> list[Step]:
        """Requests for what is there and what is not."""
        var_id = self.var_id()
        found: list[Step] = [self.frame(self.good_create(var_id, seqno=5))] if self.rng.random() < 0.7 else []
        for _ in range(self.rng.randrange(1, 6)):
            many = self.rng.choice((1, 2, 10, 60))
            ids = [(var_id + number) % (self._top_var + 1) for number in range(many)]
            kind = self.rng.randrange(3)
            records: list[VardisRecord] = [
                VarReqCreate(each)
                if kind == 0
                else VarReqUpdate(each, self.seqno(5))
                if kind == 1
                else VarSumm(each, 5)
                for each in ids
            ]
            found.append(self.frame(*records, peer=self.rng.randrange(1, 4)))
            found += self.pause()
        return found

    def soft_state(self) -> list[Step]:
        """A variable that lives as long as there are updates of it, and other things to be heard."""
        var_id, number, time = self.var_id(), self.seqno(), _CREATION
        timeout = self.rng.choice((100, 300, 700, 1200))
        found: list[Step] = [self.frame(self.good_create(var_id, seqno=number, timeout=timeout))]
        for _ in range(self.rng.randrange(1, 5)):
            found.append(Wait(self.rng.choice((0.5, 2.0, 5.0, 11.0))))
            number, time = (number + 1) % self._modulus, time + self.rng.randrange(2)
            record = self.rng.choice(
                (
                    VarUpdate(var_id, number, b"alive"),
                    VarUpdate(var_id, number, b"alive"),
                    VarSumm(var_id, (number - 1) % self._modulus),
                    VarReqCreate(var_id),
                    VarDelete(var_id),
                    self.good_create(var_id, seqno=number, timeout=timeout, creation=time),
                )
            )
            found.append(self.frame(record, peer=self.rng.randrange(1, 3)))
        return [*found, Wait(self.rng.choice((2.0, 25.0)))]

    def two_producers(self) -> list[Step]:
        """Two stations that both think a variable is theirs."""
        var_id, found = self.var_id(), list[Step]()
        for turn in range(self.rng.randrange(2, 6)):
            peer = 1 + turn % 2
            time = _CREATION + self.rng.choice((0, peer, turn))
            record: VardisRecord = self.good_create(var_id, peer=peer, creation=time, seqno=self.seqno(turn))
            if turn and self.rng.random() < 0.5:
                record = VarUpdate(var_id, self.seqno(turn), bytes((peer,)))
            found.append(self.frame(record, peer=peer))
            found += self.pause()
        return found

    def spoofed_sender(self) -> list[Step]:
        """Beacons in the name of the node itself, of everybody and of nobody."""
        found: list[Step] = []
        width = len(self.own_id)
        for _ in range(self.rng.randrange(1, 5)):
            text = self.codec.profile.types.node_id.representation == "text"
            others = (self.own_id, self.node(1)) if text else (self.own_id, bytes(width), b"\xff" * width, self.node(1))
            what: VardisRecord | ExtendedSafetyData = self.good_create(
                self.var_id(), producer=self.rng.choice(others), seqno=self.seqno()
            )
            if self.codec.report_plan is not None and self.rng.random() < 0.4:
                report = self._values.report()
                what = ExtendedSafetyData(report.s_data, self.rng.choice(others), report.t_stamp, report.seqno)
            found.append(self.frame(what, sender=self.rng.choice(others)))
            found += self.pause()
        return found

    def reports(self) -> list[Step]:
        """State reports of a few stations, of which numbers and stamps make no sense."""
        found: list[Step] = []
        for _ in range(self.rng.randrange(1, 6)):
            found.append(self.frame(self._values.report(), peer=self.rng.randrange(1, 4)))
            found += self.pause()
        return found

    def services(self) -> list[Step]:
        """Variables of the node's own application, while others talk about them."""
        var_id, found = self.var_id(), list[Step]()
        create = {"varId": var_id, "repCnt": self.rng.choice((1, 2, 15)), "descr": "own", "value": "6f776e"}
        found.append(Call("RTDB-Create", create))
        for _ in range(self.rng.randrange(2, 6)):
            step: Step
            match self.rng.randrange(9):
                case 0 | 1:
                    step = Call("RTDB-Update", {"varId": var_id, "value": self.rng.randbytes(3).hex()})
                case 2:
                    step = Call("RTDB-Delete", {"varId": var_id})
                case 3:
                    step = Call("RTDB-Create", create)
                case 4:
                    step = Call(*self.rng.choice(_ODD_CALLS))
                case 5:
                    step = self.frame(self.good_create(var_id, creation=self.rng.choice((1, _CREATION))))
                case 6 if self.codec.report_plan is not None:
                    # A node with a report and variables sends beacons of two blocks.
                    step = Call("SRP-UpdateSafetyData", {"sData": self._safety_data()})
                case 7:
                    other = self.rng.choice((VarDelete(var_id), VarUpdate(var_id, self.seqno(), b"other")))
                    step = self.frame(other)
                case _:
                    step = self.frame(self.rng.choice((VarReqCreate(var_id), VarReqUpdate(var_id, self.seqno()))))
            found.append(step)
            found += self.pause()
        return found

    def _safety_data(self) -> dict[str, Any]:
        fields = self.codec.profile.srp.safety_data
        return {field.name: 1.5 if field.type.startswith("f") else 1 for field in fields if field.type != "opaque"}

    def one_payload(self) -> list[Step]:
        """Several records about one variable in one payload, which are not processed in the order of the payload."""
        var_id, number = self.var_id(), self.seqno()
        found: list[Step] = []
        if self.rng.random() < 0.4:
            found.append(self.frame(self.good_create(var_id, seqno=number)))
        for turn in range(self.rng.randrange(1, 4)):
            later = (number + 1) % self._modulus
            records: list[VardisRecord] = [
                self.good_create(var_id, seqno=number, creation=_CREATION + turn),
                VarUpdate(var_id, later, b"update"),
                VarUpdate(var_id, self.seqno(number), b"other"),
                VarDelete(var_id),
                VarSumm(var_id, self.seqno(number)),
                VarReqUpdate(var_id, self.seqno(number)),
                VarReqCreate(var_id),
            ]
            found.append(self.frame(*self.rng.sample(records, self.rng.randrange(2, 5))))
            found += self.pause()
        return found

    def garbage(self) -> list[Step]:
        """Dozens of mutations in a row: what counts errors, or loses something with each of them, shows it."""
        made = [self.mutator.mutate() for _ in range(60)]
        if self.rng.random() < 0.7:
            # The same again and again.
            made = [made[0]] * 60
        return [Frame(each.octets, each.source) for each in made]

    def all_variables(self) -> list[Step]:
        """Every variable that there can be, up to 256; then each is talked about."""
        found: list[Step] = []
        ids = range(self._top_var + 1)
        records = [self.good_create(each) for each in ids]
        for first in range(0, len(records), 20):
            found.append(self.frame(*records[first : first + 20]))
        found.append(Wait(2.0))
        others: list[VardisRecord] = [
            self.rng.choice((VarDelete(each), VarUpdate(each, 1, b"n"), VarReqCreate(each))) for each in ids
        ]
        others.sort(key=lambda record: type(record).__name__)
        for first in range(0, len(others), 60):
            found.append(self.frame(*others[first : first + 60]))
        return [*found, Wait(2.0)]

    def largest(self) -> list[Step]:
        """Containers and values as large as they can be."""
        found: list[Step] = []
        for kind in self.rng.sample(tuple(ICType), 3):
            octets = self._values.full(kind)
            found.append(Frame(octets, octets))
        with_most = [VarSumm(number % (self._top_var + 1), 1) for number in range(IC_MAX_RECORDS)]
        try:
            found.append(self.frame(*with_most))
        except EncodeError:
            # An area of a fixed size, or a length of one octet.
            found.append(self.frame(*with_most[:20]))
        return [*found, *self.pause()]

    def recording(self) -> list[Step]:
        """A piece of a recording, with a mutation in it."""
        start = self.rng.randrange(len(self.recorded))
        found: list[Step] = [
            Frame(octets, octets) for octets in self.recorded[start : start + self.rng.randrange(2, 8)]
        ]
        made = self.mutator.mutate()
        found.insert(self.rng.randrange(len(found) + 1), Frame(made.octets, made.source))
        return found

    def neighbour_flood(self) -> list[Step]:
        """A state report of each of thousands of stations."""
        found: list[Step] = []
        for number in range(1, _FLOOD + 1):
            report = self._values.report()
            report = ExtendedSafetyData(report.s_data, self.node(number), report.t_stamp, number)
            found.append(self.frame(report, peer=number))
        return [*found, Wait(40.0)]


class Joined:
    """Several sequences as one test, for targets where looking whether they live takes longer than a sequence."""

    def __init__(self, sequences: Sequences, size: int) -> None:
        self._sequences = sequences
        self._size = size
        self.last = "joined"

    def draw(self) -> list[Step]:
        """The next ``size`` sequences."""
        return [step for _ in range(self._size) for step in self._sequences.draw()]

    def keep(self, steps: list[Step]) -> None:
        """See :meth:`Sequences.keep`."""
        self._sequences.keep(steps)
