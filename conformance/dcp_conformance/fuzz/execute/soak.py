"""One node in this process for as long as one likes: what it holds is compared with a model now and then.

A model that is told millions of damaged beacons is soon in doubt about everything. Here it begins anew with each epoch:
it adopts what the node has, hears what the node hears, and in the end both have to hold the same of every variable that
no damaged beacon has named meanwhile. What the node says is not judged: what it had to say at the beginning of an epoch
is not known.
"""

from __future__ import annotations

from dcp_codec.codec import Codec
from dcp_conformance.fuzz.steps import Effect
from dcp_conformance.oracle import Version
from dcp_conformance.oracle.knowledge import State
from dcp_conformance.reference.inprocess import EPOCH, InProcess, MakeNode, plain_node, reference_config

from .model_monitor import Observer
from .stack import difference, observer_of

#: Frames of an epoch; and of this many epochs one is compared, or the model would take more time than the node.
FRAMES, ONE_OF = 50, 10
#: ns that pass between two epochs: a second of 5,000 frames has as many beacons as always.
_PAUSE = 10_000_000


class Soak:
    """A node, and what was compared of it."""

    def __init__(
        self, codec: Codec, *, make: MakeNode = plain_node, seed: int = 1, frames: int = FRAMES, one_of: int = ONE_OF
    ) -> None:
        """``frames``: of an epoch; ``one_of``: so many epochs one is compared."""
        self.config = reference_config(codec)
        self.sut = InProcess(self.config, seed=seed, make=make)
        self.number = 0
        """Frames so far."""
        self.epochs = self.compared = 0
        """Epochs that were compared, and variables in them, each as often as it was."""
        self._frames, self._one_of = frames, one_of
        top = 1 << (8 * min(codec.profile.types.var_id.width, 2))
        self._ids = range(min(top, 256))
        self._observer: Observer | None = None

    def hears(self, octets: bytes) -> Effect | None:
        """The node receives a frame; what was wrong by then, None if nothing was."""
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
