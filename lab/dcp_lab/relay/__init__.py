"""A relay between virtual Ethernet interfaces: applies the impairment of each link to frames, in user space.

netem and classifiers are modules that many kernels lack. They support neither scheduled outages nor corruption that
excludes headers, and do not report which frames they lost. The relay provides all of this, with the decisions of
``dcp_codec.impairment``.
"""

from __future__ import annotations

from .air import RelayAir, needs_relay
from .control import RelayError
from .fabric import RelayFabric

__all__ = ["RelayAir", "RelayError", "RelayFabric", "needs_relay"]
