"""Infer which node hears which other node in a recording, and which reactions to received records are missing."""

from .following import Kind
from .links import Link
from .reactions import Reception, Shortage, reception_of

__all__ = ["Kind", "Link", "Reception", "Shortage", "reception_of"]
