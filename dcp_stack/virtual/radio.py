"""A radio for the simulated medium: airtime and overlap, losses by length and distance, and models of users.

A transmission takes its airtime, and arrives at the end of it. Two transmissions that overlap in time are both lost at
the stations that are in range of both senders, and at the senders themselves, which do not receive while they send.
A station sends its frames in succession, and does not listen before it sends. Propagation takes no time.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
import random
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, Protocol

from .medium import Arrival, SimulatedMedium
from .quality import PERFECT, Quality
from .topology import Positions


class RadioError(ValueError):
    """A radio has invalid parameters, or a user's model cannot be loaded or used."""


class Transmission(NamedTuple):
    """A frame that is transmitted from ``start`` to ``end`` (virtual ns)."""

    sender: int
    octets: bytes
    start: int
    end: int


class OnAir(NamedTuple):
    """A transmission, and those that overlap it so far; the list grows until its end."""

    transmission: Transmission
    overlapping: list[Transmission]


class Reception(NamedTuple):
    """A transmission at one station in range. Distances are in m, and None without positions.

    ``overlapping``: other transmissions at the same time that reach the receiver, or are its own, each with the
    distance of its sender.
    """

    transmission: Transmission
    receiver: int
    distance: float | None
    overlapping: tuple[tuple[Transmission, float | None], ...]


class Model(Protocol):
    """A user's model of the radio. The medium draws the random numbers, so that equal seeds give equal runs."""

    def loss(self, reception: Reception) -> float:
        """Return the probability (0..1) that the receiver does not get the frame; called at the end of the frame."""
        ...


class Radio:
    """The losses of a radio: those by length, by distance and of a model are independent of each other."""

    def __init__(
        self,
        *,
        bit_rate: float = 0.0,
        preamble: int = 0,
        bit_error_rate: float = 0.0,
        losses: Sequence[tuple[float, float]] = (),
        model: Model | None = None,
    ) -> None:
        """``bit_rate`` in bit/s (0: octets take no time), ``preamble`` in ns for each frame.

        ``bit_error_rate``: probability that a bit of a frame is wrong, which loses the frame. ``losses``: pairs of
        distance (m) and loss, ascending, with linear interpolation between them and the nearest value outside. A
        ``model`` also decides about overlapping transmissions, which are lost without one. Raises
        :class:`RadioError` for values out of range.
        """
        if not 0 <= bit_rate < math.inf:
            raise RadioError(f"bit_rate: must be finite and at least 0 bit/s, not {bit_rate:g}")
        if preamble < 0:
            raise RadioError(f"preamble: must be at least 0, not {preamble} ns")
        if not 0 <= bit_error_rate <= 1:
            raise RadioError(f"bit_error_rate: {bit_error_rate:g} is not within 0..1")
        for distance, loss in losses:
            if not 0 <= distance < math.inf or not 0 <= loss <= 1:
                raise RadioError(f"loss: [{distance:g}, {loss:g}] is not a distance of at least 0 m and a loss in 0..1")
        self._distances = [distance for distance, _ in losses]
        self._losses = [loss for _, loss in losses]
        if any(after <= before for before, after in zip(self._distances, self._distances[1:], strict=False)):
            raise RadioError("loss: the distances must ascend")
        self._bit_rate, self._preamble = bit_rate, preamble
        self._bit_error_rate = bit_error_rate
        self.model = model

    def airtime(self, octets: int) -> int:
        """Return the duration of a frame with this number of octets in ns."""
        return self._preamble + (round(octets * 8e9 / self._bit_rate) if self._bit_rate else 0)

    def distance_loss(self, distance: float | None) -> float:
        """Return the loss at a distance in m; 0 without a table or without a distance."""
        if distance is None or not self._distances:
            return 0.0
        after = bisect_right(self._distances, distance)
        if after in (0, len(self._distances)):
            return self._losses[max(after - 1, 0)]
        left, right = self._distances[after - 1 : after + 1]
        low, high = self._losses[after - 1 : after + 1]
        return low + (high - low) * (distance - left) / (right - left)

    def loss(self, reception: Reception) -> float:
        """Return the probability of a loss. Raises :class:`RadioError` if the model raises or returns another value."""
        model = 0.0 if self.model is None else self._model_loss(self.model, reception)
        bits = 8 * len(reception.transmission.octets)
        kept = (1 - self._bit_error_rate) ** bits * (1 - self.distance_loss(reception.distance)) * (1 - model)
        return 1 - kept

    @staticmethod
    def _model_loss(model: Model, reception: Reception) -> float:
        at = f"node {reception.receiver}, {reception.transmission.end / 1e9:.6f} s: {type(model).__name__}.loss"
        try:
            found = model.loss(reception)
        except Exception as error:
            raise RadioError(f"{at} raised {type(error).__name__}: {error}") from error
        if not isinstance(found, int | float) or not 0 <= found <= 1:
            raise RadioError(f"{at} returned {found!r}, which is not a probability in 0..1")
        return found


class RadioMedium(SimulatedMedium):
    """A simulated medium with a radio; losses and delays of the connections apply as well."""

    def __init__(self, stations: int, radio: Radio, quality: Quality = PERFECT, **options: Any) -> None:
        """``options``: those of :class:`~dcp_stack.virtual.medium.Medium`."""
        super().__init__(stations, quality, **options)
        self._radio = radio
        self._on_air: list[OnAir] = []
        """The transmissions that have not ended, in the order of sending."""
        self._draws = [random.Random(f"{self._seed}/radio/{index}") for index in range(stations)]  # noqa: S311 - as above
        self._places = self.topology if isinstance(self.topology, Positions) else None

    def carried_to(self, sender: int) -> tuple[int, ...]:
        """Return the stations that can receive from ``sender`` now, without those at which the distance loses all."""
        lossy = self._radio.distance_loss
        return tuple(each for each in super().carried_to(sender) if lossy(self._distance(sender, each)) < 1)

    def broadcast(self, sender: int, octets: bytes, now: int) -> None:
        """See :meth:`Medium.broadcast`. The transmission starts ``now``, or when the last one of ``sender`` ends."""
        self._on_air = [each for each in self._on_air if each.transmission.end > now]
        start = max([now, *(sent.end for sent, _ in self._on_air if sent.sender == sender)])
        new = OnAir(Transmission(sender, octets, start, start + self._radio.airtime(len(octets))), [])
        for other, overlapping in self._on_air:
            if other.start < new.transmission.end and start < other.end:
                overlapping.append(new.transmission)
                new.overlapping.append(other)
        self._on_air.append(new)
        super().broadcast(sender, octets, now)

    def _schedule(self, time: int, now: int, sender: int, receivers: tuple[int, ...], octets: bytes) -> None:
        on_air = self._on_air[-1]
        time = max(time, now) + on_air.transmission.end - now
        self.queue.push(time, Arrival(time, sender, receivers, octets, now, on_air))

    def land(self, flight: Arrival) -> Arrival | None:
        """Return the arrival at the receivers that the radio reaches."""
        sent: Transmission = flight.on_air.transmission
        others = [(each, {each.sender, *self.neighbours(each.sender)}) for each in flight.on_air.overlapping]
        draw, heard = self._draws[flight.sender].random, []
        for receiver in flight.receivers:
            overlapping = [each for each, reached in others if receiver in reached]
            if receiver in self._off:
                heard.append(receiver)
            elif overlapping and self._radio.model is None:
                self.counters.overlapped += 1
            else:
                disturbers = tuple([(each, self._distance(each.sender, receiver)) for each in overlapping])
                reception = Reception(sent, receiver, self._distance(flight.sender, receiver), disturbers)
                if (loss := self._radio.loss(reception)) and draw() < loss:
                    self.counters.lost += 1
                else:
                    heard.append(receiver)
        return super().land(flight._replace(receivers=tuple(heard)))

    def _distance(self, sender: int, receiver: int) -> float | None:
        return None if self._places is None else self._places.distance(sender, receiver)


def load_model(name: str, options: Mapping[str, Any]) -> Model:
    """Return the model of the class ``module:Class`` or ``path/to/file.py:Class``, made with ``options``.

    Executes the module. Raises :class:`RadioError`.
    """
    place, colon, attribute = name.rpartition(":")
    if not (colon and place and attribute.isidentifier()):
        raise RadioError(f"{name!r} is neither module:Class nor FILE.py:Class")
    try:
        module = _module(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    except RadioError:
        raise
    except Exception as error:
        raise RadioError(f"{place} cannot be imported: {type(error).__name__}: {error}") from error
    made = getattr(module, attribute, None)
    if made is None:
        raise RadioError(f"{place} has no class {attribute}")
    try:
        model = made(**options)
    except Exception as error:
        raise RadioError(f"{attribute} cannot be made with these options: {type(error).__name__}: {error}") from error
    if not callable(getattr(model, "loss", None)):
        raise RadioError(f"{attribute} has no method loss(reception)")
    found: Model = model
    return found


def _module(path: Path) -> ModuleType:
    """Execute a file as a module, which is not registered: two files may have the same name."""
    if not path.is_file():
        raise RadioError(f"there is no file {path}")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
