"""Dissection of octets by any plan for display: a tree of fields and every problem found.

To dissect many messages use :meth:`dcp_codec.codec.Codec.dissect`, or generate a dissector
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
    """Dissect ``octets[start:]`` by ``plan``. ``base`` is the offset of the first octet in the result. Never raises."""
    return _dissector(plan)(octets, start, base)


__all__ = ["Dissection", "Field", "dissect"]
