"""The wire vectors with pytest: ``DCP_VECTORS=folder/dcp-2.0 pytest test_wire.py``.

With a decoder and encoder of your own, replace :func:`decode` and :func:`encode`.
"""

import json
import os
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from dcp_codec import Codec, DecodeError
from dcp_codec.jsonform import beacon_from_json, beacon_json, problem_json

FOLDER = Path(os.environ.get("DCP_VECTORS", "."))


@cache
def codec() -> Codec:
    return Codec(FOLDER.name)


def decode(octets: bytes) -> Any:
    """The values and the number of octets, or the first problem."""
    try:
        _, used = codec().decode_from(octets)
    except DecodeError as error:
        found = problem_json(error.problem)
        return {"field": found.pop("path"), **found}
    return beacon_json(codec(), codec().dissect(octets).root), used


def encode(values: Any) -> bytes:
    return codec().encode(beacon_from_json(codec(), values))


TESTS = [
    test
    for group in json.loads((FOLDER / "wire.json").read_text(encoding="utf-8"))["testGroups"]
    for test in group["tests"]
]


@pytest.mark.parametrize("test", TESTS, ids=[test["tcId"] for test in TESTS])
def test_wire(test: dict[str, Any]) -> None:
    octets = bytes.fromhex(test["octets"])
    if test["result"] == "invalid":
        assert decode(octets) == test["problem"]
        return
    assert decode(octets) == (test["values"], test["used"])
    if test.get("direction", "both") == "both":
        assert encode(test["values"]) == octets
