"""Recordings of a relay: one MCAP file per port with the frames that its station sent and received."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dcp_codec.capture import create_capture
from dcp_stack.links.recording import FrameFile

#: Time in ns after which written frames are flushed to the system.
_FLUSH: Final = 1_000_000_000


class PortRecorder(FrameFile):
    """Writes the frames of one port."""

    def __init__(self, path: Path, port: int, interface: str, profile: str = "") -> None:
        """Create the file. Raises ``CaptureError`` if that fails, ``ProfileError`` for an unknown profile."""
        self._flushed = 0
        about = {"port": str(port), "interface": interface}
        metadata = {"dcp.recording": about}
        if profile:
            # Imported only if needed: loading a profile takes longer than the start of the relay.
            from dcp_codec.codec import Codec
            from dcp_codec.foxglove.channels import capture_metadata

            metadata = capture_metadata(Codec(profile), about)
        # Uncompressed, because compressing a chunk would delay frames that are due.
        super().__init__(create_capture(path, format="mcap", metadata=metadata, compression="none"))

    def saw(self, frame: bytes, wall: int) -> None:
        """Write a frame that the station sent or received at ``wall`` (ns since 1970)."""
        self.add(frame, wall)
        if wall - self._flushed >= _FLUSH:
            self._flushed = wall
            self.flush()
