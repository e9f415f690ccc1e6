"""Faults in the treatment of bad containers where the version says what to do: 1.0 and 1.1."""

from __future__ import annotations

from typing import Any, ClassVar

from dcp_stack.vardis_wire import Extractor

from .mutant import mutant


class OtherPolicy(Extractor):
    """Follows another policy than that of its version."""

    policy: ClassVar[str]

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._policy = self.policy


@mutant("payload", "VD-RX-10", "drops the whole payload because of one container")
class DropsPayload(OtherPolicy):
    policy = "drop-payload"


@mutant("payload", "VD-RX-11", "drops what came before the bad container, too")
class DropsAll(OtherPolicy):
    policy = "drop-payload"


@mutant("goes-on", "VD-RX-11", "goes on with the container after a bad one, as in 1.0")
class GoesOn(OtherPolicy):
    policy = "skip-container"
