"""A codec that decodes each broadcast once for all its receivers."""

from __future__ import annotations

import functools

from dcp_codec.codec import Codec
from dcp_codec.values import Beacon, Container, ExtendedSafetyData

#: Number of decoded packets kept, each of some KB. All receivers decode a beacon within the delay of the medium, so
#: few are needed at a time.
KEPT = 2048


class SharedCodec(Codec):
    """A codec that caches the most recently decoded values.

    Decoded values are immutable and depend on the octets only, so sharing has no effect on the outcome. The containers
    of payloads that were encoded here are known without decoding. Malformed octets are decoded each time: errors are
    rare here and refer to their context.
    """

    def __init__(self, codec: Codec) -> None:
        """``codec`` decodes the values that are not in the cache."""
        super().__init__(codec.profile)
        self._envelope = functools.lru_cache(KEPT)(codec.decode_envelope)
        self._codec = codec
        self._containers: dict[bytes, tuple[Container, ...]] = {}
        self._report = functools.lru_cache(KEPT)(codec.decode_report)
        self.types = codec.types

    def decode_envelope(self, octets: bytes, start: int = 0) -> tuple[Beacon, int]:
        """Decode an envelope as :meth:`Codec.decode_envelope` does."""
        return self._envelope(octets, start)

    def decode_containers(self, payload: bytes) -> tuple[Container, ...]:
        """Decode a payload as :meth:`Codec.decode_containers` does."""
        found = self._containers.get(payload)
        if found is None:
            found = self._keep(payload, self._codec.decode_containers(payload))
        return found

    def encode_containers(self, containers: tuple[Container, ...]) -> bytes:
        """Encode containers as :meth:`Codec.encode_containers` does."""
        payload = self._codec.encode_containers(containers)
        self._keep(payload, containers)
        return payload

    def _keep(self, payload: bytes, containers: tuple[Container, ...]) -> tuple[Container, ...]:
        if len(self._containers) >= KEPT:
            self._containers.clear()
        self._containers[payload] = containers
        return containers

    def decode_report(self, payload: bytes) -> ExtendedSafetyData:
        """Decode a report as :meth:`Codec.decode_report` does."""
        return self._report(payload)
