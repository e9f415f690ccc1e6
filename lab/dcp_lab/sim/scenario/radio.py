"""The table ``[radio]`` of a scenario."""

from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path
from typing import Any

import msgspec

from dcp_stack.virtual.radio import Radio, RadioError, load_model


class RadioTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A radio common to all nodes, in simulations only."""

    bit_rate: float = 0.0
    """Bit/s; 0: the octets of a frame take no time to transmit."""
    preamble_us: float = 0.0
    """Time in us that the transmission of each frame takes in addition."""
    bit_error_rate: float = 0.0
    """Probability that a bit is wrong; a frame of n octets survives with (1 - bit_error_rate)^(8 n)."""
    loss: tuple[tuple[float, float], ...] = ()
    """Pairs of distance in m and loss, ascending, with linear interpolation."""
    model: str | None = None
    """The class of a user's :class:`~dcp_stack.virtual.radio.Model`: ``module:Class`` or ``FILE.py:Class``."""
    options: dict[str, Any] = {}
    """Keyword arguments of this class."""

    def radio(self, *, with_model: bool = True) -> Radio:
        """Return the radio for the simulated medium.

        Raises :class:`RadioError` (a ValueError) for values out of range, and for a model that cannot be loaded.
        """
        if self.options and self.model is None:
            raise RadioError("options: they are those of a model, which is missing")
        return Radio(
            bit_rate=self.bit_rate,
            preamble=round(self.preamble_us * 1000),
            bit_error_rate=self.bit_error_rate,
            losses=self.loss,
            model=load_model(self.model, self.options) if self.model is not None and with_model else None,
        )

    def model_sha256(self) -> str | None:
        """Return a hash of the source file and the class of the model, None without a model or a file of it."""
        place, _, name = (self.model or "").rpartition(":")
        if place and not place.endswith(".py"):
            spec = importlib.util.find_spec(place)
            place = "" if spec is None or spec.origin is None else spec.origin
        if not Path(place).is_file():
            return None
        return hashlib.sha256(Path(place).read_bytes() + name.encode()).hexdigest()


def located(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a table of a scenario file whose model is relative to ``folder``, if the file is there."""
    model = table.get("model")
    if isinstance(model, str) and (folder / model.rpartition(":")[0]).is_file():
        return {**table, "model": str(folder / model)}
    return table
