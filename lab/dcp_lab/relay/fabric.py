"""A network of namespaces that are connected by one relay."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Self

from dcp_codec.impairment import PERFECT, Impairment, text_of
from dcp_codec.network.namespaces import enter_command
from dcp_lab.sim.testbed import namespaces
from dcp_lab.sim.testbed.place import cable_to_hub, place_names

from .control import RelayProcess
from .messages import Partition, SetQuality, Setup, SwitchPort


class RelayFabric:
    """Namespaces with one interface each, and a relay between the other ends of their veth pairs.

    As in a testbed (``dcp_lab.sim.testbed.namespaces``) the prefix of their names identifies this process.
    :meth:`close` deletes the namespaces, unless ``keep_namespaces`` is set.
    """

    def __init__(
        self,
        prefix: str,
        addresses: Sequence[bytes],
        *,
        impairment: Impairment = PERFECT,
        seed: int = 1,
        pairs: Iterable[tuple[int, int]] | None = None,
        record: str | Path | None = None,
        profile: str = "",
    ) -> None:
        """``addresses``: MAC address (6 octets) of each station's interface. ``impairment``: that of all links.

        ``pairs``: connections (sender, receiver); None for all. ``record``: an existing directory for ``port-N.mcap``.
        ``profile``: wire profile in the metadata of the recordings.

        Raises :class:`RelayError` if the relay does not start, ``NamespaceError`` if the system refuses
        namespaces or interfaces.
        """
        self.namespaces = place_names(prefix, len(addresses))
        self.air = f"{prefix}-air"
        self._closed = False
        made = [*self.namespaces, self.air]
        try:
            namespaces.create(made)
            cable_to_hub(self.air, self.namespaces, addresses)
            setup = Setup(
                ports=tuple(f"p{number}" for number in range(len(addresses))),
                impairment=text_of(impairment),
                seed=seed,
                hears=None if pairs is None else tuple(pairs),
                record="" if record is None else str(Path(record).resolve()),
                profile=profile,
            )
            self._relay = RelayProcess(setup, enter_command(self.air))
        except BaseException:
            namespaces.delete(made)
            raise

    def set_quality(self, direction: tuple[int, int] | None, impairment: Impairment) -> None:
        """Set the impairment of one direction (sender, receiver), or with None of all directions without their own.

        Raises :class:`RelayError`, as the following methods do.
        """
        sender, receiver = direction if direction is not None else (None, None)
        self._relay.command(SetQuality(impairment=text_of(impairment), sender=sender, receiver=receiver))

    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Restrict frames to the groups; stations in no group form another one. Without groups the partition ends."""
        self._relay.command(Partition(tuple(tuple(each) for each in groups)))

    def port(self, number: int, *, up: bool) -> None:
        """Connect or disconnect a station; its interface stays up."""
        self._relay.command(SwitchPort(number, up))

    def counters(self) -> dict[str, Any]:
        """Return the counters of the relay, after :meth:`close` the last ones.

        They are ``links`` (by ``"0>1"``), ``ports`` and ``lateness_ns``.
        """
        return self._relay.counters()

    def close(self, *, keep_namespaces: bool = False) -> dict[str, Any]:
        """End the relay and delete the namespaces with all processes in them; returns the last counters."""
        found = self._relay.close()
        if not (self._closed or keep_namespaces):
            self._closed = True
            namespaces.delete([*self.namespaces, self.air])
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
