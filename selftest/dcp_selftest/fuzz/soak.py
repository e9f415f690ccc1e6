"""Run one node in this process for a long time, and periodically compare its database with a model.

A model that processes millions of damaged beacons becomes uncertain about every variable. Therefore a new model is made
for each epoch: it adopts the database of the node and receives the same frames. At the end of the epoch both must agree
on every variable that no damaged beacon of the epoch named. The beacons of the node are not judged, because the model
does not know the queues of the node at the beginning of the epoch.
"""

from __future__ import annotations

from dcp_conformance.fuzz.execute.model_monitor import Observer
from dcp_conformance.fuzz.execute.stack import difference, observer_of
from dcp_conformance.fuzz.steps import Effect
from dcp_conformance.oracle import Version
from dcp_conformance.oracle.knowledge import State
from dcp_conformance.reference.inprocess import InProcess, MakeNode, plain_node, reference_config

from dcp_codec.codec import Codec
from dcp_stack.virtual.world import EPOCH

#: Frames in an epoch; one of this many epochs is compared, because the model takes more time than the node.
FRAMES, ONE_OF = 50, 10
#: Virtual time between two epochs in ns, so that 5,000 frames take one second and beacons are sent at the normal rate.
_PAUSE = 10_000_000


class Soak:
    """A node that receives frames, and the comparisons with its model."""

    def __init__(
        self, codec: Codec, *, make: MakeNode = plain_node, seed: int = 1, frames: int = FRAMES, one_of: int = ONE_OF
    ) -> None:
        """``frames``: number of frames in an epoch; ``one_of``: every n-th epoch is compared."""
        self.config = reference_config(codec)
        self.sut = InProcess(self.config, seed=seed, make=make)
        self.number = 0
        """Number of frames so far."""
        self.epochs = self.compared = 0
        """Number of compared epochs, and of compared variables in all of them."""
        self._frames, self._one_of = frames, one_of
        top = 1 << (8 * min(codec.profile.types.var_id.width, 2))
        self._ids = range(min(top, 256))
        self._observer: Observer | None = None

    def hears(self, octets: bytes) -> Effect | None:
        """Deliver a frame to the node. Returns an effect that was detected after it, or None."""
        sut = self.sut
        if not self.number % (self._frames * self._one_of):
            self._observer = self._adopted()
        self.number += 1
        if self._observer is not None:
            self._observer.hears(octets, sut.now, self.number)
        sut.deliver(octets)
        if self.number % self._frames == 0 and not sut.died:
            different = self._compared()
            if different is not None:
                return Effect("state", different, self.number)
            sut.advance(sut.now + _PAUSE)
            sut.arrivals.clear()
        return Effect("raised", sut.died, self.number) if sut.died else None

    def _adopted(self) -> Observer:
        observer, vardis = observer_of(self.config), self.sut.node.vardis
        for var_id in self._ids:
            entry = vardis.entry(var_id)
            if entry is not None:
                state: State = "deleted" if entry.is_deleted else "alive"
                version = Version(entry.t_stamp - EPOCH, state, entry.spec, entry.seqno, entry.value)
                observer.oracle.adopt(var_id, version)
        return observer

    def _compared(self) -> str | None:
        observer, self._observer = self._observer, None
        if observer is None:
            return None
        certain = observer.certain(self._ids, self.sut.now)
        self.epochs += 1
        self.compared += len(certain)
        return difference(self.sut.node.vardis, certain, self.config.node_id)


__all__ = ["FRAMES", "ONE_OF", "Soak"]
