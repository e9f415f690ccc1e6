"""Where a recording was made, as far as it says so: by a node, or on a simulated medium.

A recording of the medium has each transmission once, whoever received it. The sequence numbers in it have no gaps,
whatever the receivers lost, so nothing about losses follows from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dcp_codec.capture import CaptureError, open_capture

MEDIUM: Final = "medium"
"""``vantage`` in the metadata record ``dcp.recording`` of a recording of all transmissions; otherwise a node."""

NO_LOSSES: Final = "each transmission once, as it was sent: what receivers lost is not in this recording"
"""What to say instead of a number of losses."""


def records_transmissions(metadata: Mapping[str, Mapping[str, str]]) -> bool:
    """Whether the metadata of a capture say that it has each transmission once, and no receptions."""
    return metadata.get("dcp.recording", {}).get("vantage") == MEDIUM


def is_of_medium(path: str) -> bool:
    """As :func:`records_transmissions` for a file; False for one that cannot be read."""
    try:
        with open_capture(path) as capture:
            # Metadata stand before the first frame.
            next(iter(capture), None)
            return records_transmissions(getattr(capture, "metadata", {}))
    except (CaptureError, OSError):
        return False
