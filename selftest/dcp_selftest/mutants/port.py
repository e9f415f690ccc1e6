"""The interface to BP as used by a faulty client protocol of the node."""

from __future__ import annotations

from typing import Any


class Port:
    """Forwards every call; mutants override services, with the arguments of ``BeaconingProtocol``."""

    def __init__(self, bp: Any) -> None:
        self.bp = bp

    def register(self, *args: Any, **times: int) -> Any:
        """``BP-RegisterProtocol``."""
        return self.bp.register(*args, **times)

    def deregister(self, prot_id: int) -> Any:
        """``BP-DeregisterProtocol``."""
        return self.bp.deregister(prot_id)

    def transmit_payload(self, prot_id: int, payload: bytes, *, now: int) -> Any:
        """``BP-TransmitPayload``."""
        return self.bp.transmit_payload(prot_id, payload, now=now)

    def query_number_buffered(self, prot_id: int) -> Any:
        """``BP-QueryNumberBufferedPayloads``."""
        return self.bp.query_number_buffered(prot_id)

    def next_beacon(self) -> Any:
        """The time at which BP prepares its next beacon."""
        return self.bp.next_beacon()


def registration(args: tuple[Any, ...], **changes: Any) -> list[Any]:
    """Return the arguments of ``BP-RegisterProtocol`` with some of them changed."""
    names = ("prot_id", "name", "size", "mode", "entries", "several")
    return [changes.get(name, value) for name, value in zip(names, args, strict=True)]
