"""Who hears whom in a recording, and what nodes do about what they hear."""

from .following import Kind
from .links import Link
from .reactions import Reception, Shortage, reception_of

__all__ = ["Kind", "Link", "Reception", "Shortage", "reception_of"]
