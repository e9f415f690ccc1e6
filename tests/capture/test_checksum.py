"""The checksum of MCAP files is zlib's, whoever computes it."""

from __future__ import annotations

import sys
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec.capture.checksum import crc32, fastest


@given(st.binary(max_size=300), st.binary(max_size=300))
def test_checksums_equal_those_of_zlib(first, second):
    assert crc32(first) == zlib.crc32(first)
    assert crc32(second, crc32(first)) == zlib.crc32(first + second)


def test_without_fastcrc(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "fastcrc.crc32", None)
    assert fastest() is zlib.crc32
