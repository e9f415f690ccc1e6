"""Infer which node hears which other node in a recording, and which reactions to received records are missing."""

from .following import Kind
from .links import Link
from .reactions import Proved, Reception, Shortage, reception_of

__all__ = ["Kind", "Link", "Proved", "Reception", "Shortage", "reception_of"]
