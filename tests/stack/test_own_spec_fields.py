"""Fields that a profile adds to VarSpec: the values that applications give."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from dcp_codec import Codec
from dcp_stack.cli.var import _field
from dcp_stack.own_fields import OwnSpecFields

PROFILE = """
extends = "dcp-2.0"
name = "own"

[vardis]
var_spec = [
    "varId", "prodId", "repCnt", "creationTime", "timeout", "descr",
    { name = "priority", extra = { width = 1 } },
    { name = "key", opaque = 2 },
]
"""


@pytest.fixture
def codec(tmp_path: Path) -> Codec:
    (tmp_path / "own.toml").write_text(PROFILE, encoding="utf-8")
    return Codec(tmp_path / "own.toml")


def test_values_are_neutral_until_they_are_given(codec: Codec) -> None:
    fields, spec = OwnSpecFields(codec), codec.var_spec_type(1, bytes(6), 1, b"x", 1, 0)
    assert fields.values(spec) == {"priority": 0, "key": b"\0\0"}
    given = fields.replaced(spec, fields.parsed({"key": "0102"}))
    assert fields.shown(given) == {"priority": 0, "key": "0102"}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"colour": 1}, r"no field 'colour' of its own \(it has: priority, key\)"),
        ({"priority": 256}, "256 is not in 0..255"),
        ({"key": b"\1"}, "spec.key"),
    ],
)
def test_values_that_cannot_be_encoded_are_refused(codec: Codec, given: dict[str, int | bytes], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OwnSpecFields(codec).replaced(codec.var_spec_type(1, bytes(6), 1, b"x", 1, 0), given)


def test_wrong_hexadecimal_digits_are_refused(codec: Codec) -> None:
    with pytest.raises(ValueError, match="field 'key': octets are given as hexadecimal digits, not 'zz'"):
        OwnSpecFields(codec).parsed({"key": "zz"})


def test_fields_on_the_command_line() -> None:
    assert [_field(each) for each in ("a=3", "b=1.5", "c=0x0a")] == [("a", 3), ("b", 1.5), ("c", "0a")]
    for wrong in ("a", "=3", "a=x"):
        with pytest.raises(click.BadParameter):
            _field(wrong)
