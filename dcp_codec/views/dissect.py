"""Take octets apart for people, by any plan: a tree of what is there and every problem found.

What takes many messages apart has :meth:`dcp_codec.codec.Codec.dissect`, or a dissector of its own
(:func:`dcp_codec.views.dissector.generate_dissector`).
"""

from __future__ import annotations

import functools

from dcp_codec.plan.tree import Node

from .dissector import Dissect, generate_dissector
from .fields import Dissection, Field


@functools.lru_cache(maxsize=64)
def _dissector(plan: Node) -> Dissect:
    return generate_dissector(plan, plan.name or "message")


def dissect(plan: Node, octets: bytes, *, start: int = 0, base: int = 0) -> Dissection:
    """Take ``octets[start:]`` apart by ``plan``. ``base`` is what the first octet's offset is called. Never raises."""
    return _dissector(plan)(octets, start, base)


__all__ = ["Dissection", "Field", "dissect"]
