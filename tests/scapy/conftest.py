"""Profiles that the layers are tested with. The layers of a process have one profile, so every test sets its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")

from dcp_codec import Codec
from dcp_codec.scapy import layers as scapy_layers

from ..odd_profiles import ODD_PROFILES, PARAMETERS, write_profile


@pytest.fixture(autouse=True)
def _default_profile() -> Iterator[None]:
    yield
    scapy_layers.use_profile("dcp-2.0")


@pytest.fixture(params=PARAMETERS)
def codec(request: pytest.FixtureRequest, tmp_path: Path) -> Codec:
    """The codec of each profile in turn, which the layers use, too."""
    odd = request.param in ODD_PROFILES
    return scapy_layers.use_profile(write_profile(request.param, tmp_path) if odd else request.param)
