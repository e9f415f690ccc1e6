"""The links of a testbed by a relay, with the impairments that the kernel cannot provide."""

from __future__ import annotations

from collections.abc import Sequence

from dcp_codec.network.namespaces import NamespaceError, run
from dcp_lab.sim.scenario.definition import LinkQuality, Scenario, SetLink
from dcp_lab.sim.testbed import namespaces

from .fabric import RelayFabric


class RelayAir:
    """The Ethernet of one scenario, with one relay between all nodes. See ``dcp_lab.sim.testbed.fabric.Air``."""

    def __init__(self, scenario: Scenario, prefix: str, addresses: Sequence[bytes]) -> None:
        """``addresses``: of the nodes' interfaces. Raises ``NamespaceError``, and ``RelayError`` without a relay."""
        self._pairs = {
            each for a, b in scenario.topology.pairs(scenario.nodes) for each in ((a, b), (b, a))
        }  # fmt: skip
        self._fabric = RelayFabric(
            prefix, addresses, impairment=scenario.link.impairment(), seed=scenario.seed, pairs=sorted(self._pairs)
        )
        self.namespaces = self._fabric.namespaces
        for link in scenario.links:
            for direction in link.directions:
                self.set_quality(direction, link.quality)

    def set_quality(self, direction: tuple[int, int] | None, quality: LinkQuality) -> None:
        """Change the quality from one node to another, or (None) of all links that have none of their own.

        Raises ``RelayError`` if the relay has ended, as ``partition`` does.
        """
        if direction is None or direction in self._pairs:
            self._fabric.set_quality(direction, quality.impairment())

    def partition(self, groups: Sequence[Sequence[int]]) -> None:
        """Restrict frames to the groups; nodes in no group form another one. Without groups the partition ends."""
        self._fabric.partition(groups)

    def close(self) -> None:
        """End the relay. The testbed deletes the namespaces."""
        self._fabric.close(keep_namespaces=True)


def needs_relay(scenario: Scenario) -> bool:
    """Return whether the kernel cannot provide a quality that a scenario uses.

    The testbed uses the kernel neither for bursts nor for corruption. Without netem (a module that many kernels lack)
    the kernel can only lose frames; with netem, delayed frames cannot be reordered as well.
    """
    qualities = [scenario.link, *(link.quality for link in scenario.links)]
    qualities += [event.quality for event in scenario.events if isinstance(event, SetLink)]
    if all(each.only_loses for each in qualities):
        return False
    if any(each.quality().has_memory or (each.reorder and (each.delay_ms or each.jitter_ms)) for each in qualities):
        return True
    return not _has_netem()


def _has_netem() -> bool:
    """Return whether the kernel has netem, by a trial in a temporary namespace."""
    name = f"{namespaces.own_prefix()}-netem"
    namespaces.create([name])
    try:
        run(["tc", "-n", name, "qdisc", "add", "dev", "lo", "root", "netem", "delay", "1ms"])
    except NamespaceError:
        return False
    finally:
        namespaces.delete([name])
    return True
