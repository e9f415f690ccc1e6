"""Impairment of links: which frames a bad link loses, delays, repeats, reorders or corrupts. No I/O, no clock.

This package is in ``dcp_codec`` because simulation and tester need the same decisions, and the tester must not import
the node. Like ``dcp_codec.capture`` it knows nothing of DCP.
"""

from .channel import Channel, Copy, Fate
from .counters import Counters
from .network import Network, Transit
from .parameters import PERFECT, Impairment, ImpairmentError, Outage
from .text import impairment_of, parse_impairment, text_of

__all__ = [
    "PERFECT",
    "Channel",
    "Copy",
    "Counters",
    "Fate",
    "Impairment",
    "ImpairmentError",
    "Network",
    "Outage",
    "Transit",
    "impairment_of",
    "parse_impairment",
    "text_of",
]
