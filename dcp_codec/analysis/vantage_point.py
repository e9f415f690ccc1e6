"""The vantage point of a recording, as far as its metadata state it: a node, or a simulated medium.

A recording of the medium has each transmission once, whatever nodes received it. Its sequence numbers have no gaps even
if receivers lost frames, so it contains no information about losses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dcp_codec.capture import CaptureError, open_capture

MEDIUM: Final = "medium"
"""``vantage`` in the metadata record ``dcp.recording`` of a recording of all transmissions; otherwise a node."""

NO_LOSSES: Final = "this recording has each transmission once, as sent; losses of receivers are not in it"
"""The text in place of the number of losses."""


def records_transmissions(metadata: Mapping[str, Mapping[str, str]]) -> bool:
    """Return whether the metadata of a capture state that it has each transmission once, and no receptions."""
    return metadata.get("dcp.recording", {}).get("vantage") == MEDIUM


def is_of_medium(path: str) -> bool:
    """Evaluate :func:`records_transmissions` for a file; False if the file cannot be read."""
    try:
        with open_capture(path) as capture:
            # Metadata precede the first frame.
            next(iter(capture), None)
            return records_transmissions(getattr(capture, "metadata", {}))
    except (CaptureError, OSError):
        return False
