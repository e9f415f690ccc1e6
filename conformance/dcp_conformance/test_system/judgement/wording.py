"""The words in which matchers state what was received, and the evidence in it."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

import msgspec

from dcp_codec.values import RECORD_CLASSES
from dcp_conformance.definitions.results import Mark
from dcp_conformance.frames.received import Instruction, ReceivedBeacon

Evidence = ReceivedBeacon | Instruction | Mark

#: Maximum number of values in an observation, and of octets of a value.
_VALUES: Final = 8
_OCTETS: Final = 64
#: Octets in the text of a record, as Python writes them.
_LITERAL: Final = re.compile(r"""b'(?:[^'\\]|\\.)*'|b"(?:[^"\\]|\\.)*\"""")


def content(value: object) -> str:
    """Return a received value for a message: octets in hexadecimal, and the record of an instruction."""
    if isinstance(value, bytes):
        return value.hex() if len(value) <= _OCTETS else f"{len(value)} octets, {value[:_OCTETS].hex()}..."
    if isinstance(value, Instruction):
        return content(value.record)
    if isinstance(value, ReceivedBeacon):
        return f"{value.problem or 'a beacon'}"
    if isinstance(value, tuple) and type(value).__str__ is object.__str__:
        return f"({', '.join(map(content, value))})"
    if isinstance(value, msgspec.Struct):
        # Records have numbers, octets and other records only, so that these are literals.
        return _LITERAL.sub(lambda found: content(ast.literal_eval(found[0])), f"{value}")
    return f"{value}"


def described(found: Any) -> str:
    """Return what was received for a message: numbers of beacons and records of each kind, or the values."""
    if not isinstance(found, Collection) or isinstance(found, str | bytes | Mapping):
        return content(found)
    records = Counter(RECORD_CLASSES[each.kind].__name__ for each in found if isinstance(each, Instruction))
    beacons = sum(isinstance(each, ReceivedBeacon) for each in found)
    values = [content(each) for each in found if not isinstance(each, Instruction | ReceivedBeacon)]
    texts = [_counted(number, name) for name, number in records.items()]
    texts += [_counted(beacons, "beacon")] * (beacons > 0)
    texts += values[:_VALUES] + ["..."] * (len(values) > _VALUES)
    return ", ".join(texts) or "none"


def evidence_in(found: Any) -> list[Evidence]:
    """Return the frames and records among received things."""
    if not isinstance(found, Iterable):
        return [found] if isinstance(found, Evidence) else []
    return [each for each in found if isinstance(each, Evidence)]


def _counted(number: int, name: str) -> str:
    return f"{number} {name}{'s' if number != 1 else ''}"


def beacons_of(found: Iterable[Instruction]) -> str:
    return _counted(len({id(each.heard) for each in found}), "beacon")
