"""A node that fails when a frame comes that ends with a word: FAULT CONTROL LINK IDENTIFIER.

FAULT: ``dies``, ``hangs`` (it does nothing any more, but is there) ``mute`` (it hears nothing any more), or ``none``.
"""

from __future__ import annotations

import signal
import sys

from dcp_stack.node import Node
from dcp_stack.runtime.opening import open_node
from dcp_stack.runtime.settings import load_settings

#: The fuzzer sometimes appends it to beacons.
WORD = b"\xff\xff\xff\xff"


class Faulty(Node):
    """Our node with a fault."""

    fault = ""
    deaf = False

    def handle_frame(self, octets, *, now, wall):
        if octets.endswith(WORD):
            if self.fault == "dies":
                raise RuntimeError("a frame that it cannot stand")
            if self.fault == "hangs":
                signal.pause()
            self.deaf = self.fault == "mute"
        if not self.deaf:
            super().handle_frame(octets, now=now, wall=wall)


def main(fault: str, control: str, link: str, identifier: str) -> None:
    """Run until SIGTERM, or the fault."""
    Faulty.fault = fault
    flags = {"link": link, "control": control, "bp.beacon_period_ms": 20, "node_id": identifier or None}
    with open_node(load_settings(None, flags), Faulty) as driver:
        driver.run(lambda: None)


if __name__ == "__main__":
    main(*sys.argv[1:])
