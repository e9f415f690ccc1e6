"""JSON Schemas of structs, the same with every version of Python."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any

import msgspec


def schema_components(types: Iterable[Any]) -> tuple[tuple[dict[str, Any], ...], dict[str, Any]]:
    """Return the schemas of types, and the definitions that they refer to (``#/$defs/NAME``).

    Descriptions are docstrings without their indentation, which Python removes itself from 3.13 on.
    """
    schemas, definitions = msgspec.json.schema_components(types, ref_template="#/$defs/{name}")
    for each in definitions.values():
        if "description" in each:
            each["description"] = inspect.cleandoc(each["description"])
    return schemas, definitions
