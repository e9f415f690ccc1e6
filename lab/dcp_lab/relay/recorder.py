"""Recordings of a relay: one MCAP file per port with the frames that its station sent and received."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

from dcp_codec.capture import MAX_TIME_NS, CaptureError, CaptureWriter, Frame, create_capture

#: Time in ns after which written frames are flushed to the system.
_FLUSH: Final = 1_000_000_000


class PortRecorder:
    """Writes the frames of one port. A write error ends the recording; ``problem`` has its text."""

    def __init__(self, path: Path, port: int, interface: str, profile: str = "") -> None:
        """Create the file. Raises ``CaptureError`` if that fails, ``ProfileError`` for an unknown profile."""
        self.frames = 0
        self.problem = ""
        self._flushed = 0
        about = {"port": str(port), "interface": interface}
        metadata = {"dcp.recording": about}
        if profile:
            # Imported only if needed: loading a profile takes longer than the start of the relay.
            from dcp_codec.codec import Codec
            from dcp_codec.foxglove.channels import capture_metadata

            metadata = capture_metadata(Codec(profile), about)
        # Uncompressed, because compressing a chunk would delay frames that are due.
        self._writer: CaptureWriter | None = create_capture(path, format="mcap", metadata=metadata, compression="none")

    def saw(self, frame: bytes, wall: int) -> None:
        """Write a frame that the station sent or received at ``wall`` (ns since 1970)."""
        if self._writer is None:
            return
        try:
            self._writer.write(Frame(self.frames + 1, min(max(wall, 0), MAX_TIME_NS), frame, len(frame)))
            self.frames += 1
            if wall - self._flushed >= _FLUSH:
                self._flushed = wall
                self._writer.flush()
        except CaptureError as error:
            self._stop(error)

    def close(self) -> None:
        """Finish the file; may be called twice."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except CaptureError as error:
                self.problem = str(error)

    def _stop(self, error: CaptureError) -> None:
        """End the recording after a write error."""
        writer, self._writer = self._writer, None
        self.problem = str(error)
        if writer is not None:
            with contextlib.suppress(CaptureError):
                writer.close()
