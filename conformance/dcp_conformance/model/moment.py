"""The moment at which something was done, as results say it."""

from __future__ import annotations

import time


def timestamp() -> str:
    """Now, ISO 8601 in UTC, to the second."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
