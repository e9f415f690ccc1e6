"""Faults in the treatment of invalid containers in 1.0 and 1.1, which specify it."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_selftest.mutants.family import attributes
from dcp_stack.readings import ReceiveErrors
from dcp_stack.vardis.wire import Extractor


class OtherPolicy(Extractor):
    """Follows another policy than that of its version."""

    policy: ClassVar[ReceiveErrors]

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._policy = self.policy


other_policy = attributes(OtherPolicy, __name__)
other_policy("payload", "VD-RX-10", "drops the whole payload because of one invalid container", policy="drop-payload")
other_policy("payload", "VD-RX-11", "also drops the containers before the invalid one", policy="drop-payload")
other_policy("goes-on", "VD-RX-11", "continues with the container after an invalid one, as in 1.0",
    policy="skip-container")  # fmt: skip
