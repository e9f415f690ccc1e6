"""Recordings of a relay: for each port an MCAP file of the frames that its station sent and got."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

from dcp_codec.capture import MAX_TIME_NS, CaptureError, CaptureWriter, Frame, create_capture

#: ns after which frames are handed to the system.
_FLUSH: Final = 1_000_000_000


class PortRecorder:
    """Writes the frames of one port. What cannot be written ends the recording and is kept in ``problem``."""

    def __init__(self, path: Path, port: int, interface: str, profile: str = "") -> None:
        """Raises ``CaptureError`` if the file cannot be created, and ``ProfileError`` for a profile that is unknown."""
        self.frames = 0
        self.problem = ""
        self._flushed = 0
        about = {"port": str(port), "interface": interface}
        metadata = {"dcp.recording": about}
        if profile:
            # Only here: reading a profile takes longer than starting the relay.
            from dcp_codec.codec import Codec
            from dcp_codec.foxglove.channels import capture_metadata

            metadata = capture_metadata(Codec(profile), about)
        # Uncompressed: compressing a chunk would hold up the frames that are due meanwhile.
        self._writer: CaptureWriter | None = create_capture(path, format="mcap", metadata=metadata, compression="none")

    def saw(self, frame: bytes, wall: int) -> None:
        """Write a frame that the station sent or got at ``wall`` (ns since 1970)."""
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
        writer, self._writer = self._writer, None
        self.problem = str(error)
        if writer is not None:
            with contextlib.suppress(CaptureError):
                writer.close()
