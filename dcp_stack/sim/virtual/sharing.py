"""One decoding of a broadcast for all who receive it."""

from __future__ import annotations

import functools

from dcp_codec.codec import Codec
from dcp_codec.values import Beacon, Container, ExtendedSafetyData

#: Decoded packets kept. A beacon is decoded by all its receivers within the delay of the medium, so that few are
#: needed at a time; each is some KB.
KEPT = 2048


class SharedCodec(Codec):
    """A codec that remembers what it decoded last.

    Decoded values are immutable and a function of the octets alone, so nobody can tell whether they are shared.
    Octets that are malformed are decoded each time: errors are rare here and refer to their own context.
    """

    def __init__(self, codec: Codec) -> None:
        """``codec`` does the work."""
        super().__init__(codec.profile)
        self._envelope = functools.lru_cache(KEPT)(codec.decode_envelope)
        self._containers = functools.lru_cache(KEPT)(codec.decode_containers)
        self._report = functools.lru_cache(KEPT)(codec.decode_report)
        self.types = codec.types

    def decode_envelope(self, octets: bytes, start: int = 0) -> tuple[Beacon, int]:
        """As :meth:`Codec.decode_envelope`."""
        return self._envelope(octets, start)

    def decode_containers(self, payload: bytes) -> tuple[Container, ...]:
        """As :meth:`Codec.decode_containers`."""
        return self._containers(payload)

    def decode_report(self, payload: bytes) -> ExtendedSafetyData:
        """As :meth:`Codec.decode_report`."""
        return self._report(payload)
