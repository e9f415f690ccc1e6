"""Make the elements of sequences: beacons of simulated stations, and boundary values."""

from __future__ import annotations

import itertools
import random
from typing import Final

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, BP_SEQNO_MODULUS, ICType, seqno_modulus

from dcp_codec.codec import Codec
from dcp_codec.values import Beacon, Container, ExtendedSafetyData, Payload, VarCreate, VardisRecord
from dcp_lab.fuzz.steps import Frame, Step, Wait
from dcp_lab.testing.draws import Draws
from dcp_lab.testing.mutation_values import ValidValues

from .samples import Samples

#: Base of creation times, in ticks of the profile's clock; far from both ends of the range.
CREATION: Final = 1_000_000


class Parts(Samples):
    """Factory of random records, and of beacons with them, for a profile."""

    def __init__(self, codec: Codec, rng: random.Random) -> None:
        super().__init__(codec)
        self.rng = rng
        self._chance = Draws(rng)
        self._values = ValidValues(codec, rng)
        self._seqno = 0
        profile = codec.profile
        self._ic_types = {kind: self._numbers[kind.label] for kind in ICType}
        self._top_var = min(255, (1 << (8 * profile.types.var_id.width)) - 1)
        self._modulus = seqno_modulus(profile.types.var_seqno.width)
        half = self._modulus // 2
        self._near = (0, 1, 1, 2, -1, half - 1, half, half + 1)
        limits, longest = profile.limits, self._values.longest_value
        most = min(limits.max_value_length, longest)
        self._value_sizes = (1, 1, 4, most - 1, most, min(most + 1, longest), 0)
        longest = self._values.longest_text
        most = min(limits.max_description_length, longest)
        self._texts = [b"d" * size for size in (1, 4, most, min(most + 1, longest), 0)]
        most = limits.max_repetitions
        self._repetitions = (1, 1, 2, most, min(most + 1, 255), 0)

    def frame(self, *records: VardisRecord, sender: bytes | None = None, peer: int = 1) -> Frame:
        """Return a beacon of a station; consecutive records of one kind share a container."""
        ic_types, filled = self._ic_types, self._made.filled
        runs = itertools.groupby(records, lambda record: record.IC_TYPE)
        containers = tuple([Container(ic_types[kind], tuple(map(filled, run))) for kind, run in runs])
        return self._beacon(Payload(BP_PROTID_VARDIS, containers), sender, peer)

    def report_frame(self, report: ExtendedSafetyData, *, sender: bytes | None = None, peer: int = 1) -> Frame:
        """Return a beacon of a station with a state report."""
        return self._beacon(Payload(BP_PROTID_SRP, report), sender, peer)

    def _beacon(self, payload: Payload, sender: bytes | None, peer: int) -> Frame:
        self._seqno = (self._seqno + 1) % BP_SEQNO_MODULUS
        header = self._made.header(self.node(peer) if sender is None else sender, self._seqno)
        octets = self.codec.encode(Beacon(header, (payload,)))
        return Frame(octets, octets, source=self.address(peer))

    def var_id(self) -> int:
        """Return one of a few variable identifiers."""
        return self._chance.one_of((0, 1, 1, 2, 2, 3, self._top_var))

    def value(self) -> bytes:
        """Return a random value; lengths near the limit are more likely."""
        octets = self.rng.randbytes(self._chance.one_of(self._value_sizes))
        return octets.replace(b"\0", b"\1") if self.codec.profile.types.value.terminated else octets

    def create(
        self,
        var_id: int,
        *,
        good: bool = True,
        timeout: int = 0,
        peer: int = 1,
        seqno: int = 0,
        creation: int = CREATION,
        producer: bytes | None = None,
    ) -> VarCreate:
        """Return a VarCreate: a valid one, or one with random attributes that are mostly valid; ``timeout`` in ms."""
        # Random numbers are drawn for a valid one as well, so that seeds keep producing the same sequences.
        rep_cnt, descr, value = self._attributes()
        if good:
            rep_cnt, descr, value = 2, b"good", b"good"
        producer = self.node(peer) if producer is None else producer
        return self._made.create(self._made.spec(var_id, producer, rep_cnt, descr, creation, timeout), seqno, value)

    def _attributes(self) -> tuple[int, bytes, bytes]:
        """Return random repetitions, description and value."""
        rep_cnt = self._chance.one_of(self._repetitions)
        descr = self._chance.one_of(self._texts)
        return rep_cnt, descr if self.rng.random() < 0.9 else b"\xff\xfe", self.value()

    def seqno(self, around: int = 0) -> int:
        """Return a sequence number near ``around``, half of the number range away from it, or anywhere."""
        anywhere = self._chance.below(self._modulus)
        step = self._chance.one_of((*self._near, anywhere))
        return (around + step) % self._modulus

    def pause(self) -> list[Step]:
        """Return a wait with a probability of 30 %."""
        return [Wait(self._chance.one_of((0.5, 1.0, 2.0)))] if self.rng.random() < 0.3 else []
