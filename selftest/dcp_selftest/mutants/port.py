"""The interface to BP as used by a faulty client protocol of the node."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

_ARGUMENTS = ("prot_id", "name", "size", "mode", "entries", "several")


class Port:
    """Forwards every call; mutants override services, with the arguments of ``BeaconingProtocol``.

    ``registered`` are changed arguments of the registration, whose size is multiplied by ``factor``; ``payload``
    changes the octets that are submitted.
    """

    def __init__(
        self, bp: Any, registered: Mapping[str, Any], *, payload: Callable[[bytes], bytes] = bytes, factor: int = 1
    ) -> None:
        self.bp = bp
        self._registered = registered
        self._payload = payload
        self._factor = factor

    def register(self, *args: Any, **times: int) -> Any:
        """``BP-RegisterProtocol``."""
        given = dict(zip(_ARGUMENTS, args, strict=True))
        changed = {**given, "size": self._factor * given["size"], **self._registered}
        return self.bp.register(*changed.values(), **times)

    def deregister(self, prot_id: int) -> Any:
        """``BP-DeregisterProtocol``."""
        return self.bp.deregister(prot_id)

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> Any:
        """``BP-TransmitPayload``."""
        return self.bp.transmit_payload(prot_id, self._payload(payload), now=now)

    def query_number_buffered(self, prot_id: int) -> Any:
        """``BP-QueryNumberBufferedPayloads``."""
        return self.bp.query_number_buffered(prot_id)

    def next_beacon(self) -> Any:
        """The time at which BP prepares its next beacon."""
        return self.bp.next_beacon()
