"""Impairment of links: decide which frames a bad link loses, delays, duplicates, reorders or corrupts.

The package does no I/O and reads no clock. It is part of ``dcp_codec`` because simulation and tester need the same
decisions, and the tester must not import the node. Like ``dcp_codec.capture`` it does not depend on DCP.
"""

from .channel import Channel, Copy, Fate
from .counters import Counters
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
    "Outage",
    "impairment_of",
    "parse_impairment",
    "text_of",
]
