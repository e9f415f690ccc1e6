"""What lasts from case to case."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_codec.codec import Codec

from .lower import LowerTester
from .pics import Pics
from .upper import UpperTester


class Session:
    """What lasts from case to case: the way to the implementation, what is known of it, and names not used yet."""

    def __init__(
        self,
        codec: Codec,
        lower: LowerTester,
        upper: UpperTester | None,
        pics: Pics,
        *,
        timing_scale: float = 1.0,
        seed: int = 1,
    ) -> None:
        self.codec = codec
        self.lower = lower
        self.upper = upper
        self.pics = pics
        self.timing_scale = timing_scale
        self.seed = seed
        self.sut_id: bytes | None = None
        """The implementation's node identifier, once it is known."""
        self.parameters: dict[str, Any] = {}
        """Initial values of parameters, as the upper tester told them."""
        self.can_restart = False
        self.restart: Callable[[], None] | None = None
        """Starts the implementation again, from its initial state; None where that cannot be done."""
        self.next_peer = 0
        self.next_var_id = 0
        self.next_protocol = 0
        self.next_unknown = 0
        self.known: set[int] = set()
        """Variables that the implementation has sent something about that only its database can have told it."""
        self.summarised: set[int] = set()
        """Variables that the implementation has summarised, and not said to be deleted since."""
        self.leaving: dict[int, int] = {}
        """Those of them that were deleted and, up to 1.3, leave the database: the time (ns) when they will have."""
        self.creation_time = 0
