"""A relay between virtual Ethernet interfaces: forwards frames through the impairment of each link, in user space.

The kernel's netem and classifiers are modules that many kernels lack, and they know nothing of outages by schedule,
corruption that spares headers, or which frame they took. The relay does all of it, with the decisions of
``dcp_codec.impairment``.
"""

from __future__ import annotations

from .air import RelayAir, needs_relay
from .control import RelayError
from .fabric import INTERFACE, RelayFabric

__all__ = ["INTERFACE", "RelayAir", "RelayError", "RelayFabric", "needs_relay"]
