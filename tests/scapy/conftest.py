"""Profiles that the layers are tested with. The layers of a process have one profile, so every test sets its own."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("scapy", reason="scapy is not installed (pip install 'dcp-conformance-kit[scapy]')")

from dcp_spec.profile_loading import BUILTIN_PROFILES

from dcp_codec import Codec, scapy_layers

ODD_PROFILES: dict[str, str] = runpy.run_path(str(Path(__file__).parent.parent / "codec" / "conftest.py"))[
    "ODD_PROFILES"
]


@pytest.fixture(autouse=True)
def _default_profile() -> Iterator[None]:
    yield
    scapy_layers.use_profile("dcp-2.0")


@pytest.fixture(params=[*BUILTIN_PROFILES, *ODD_PROFILES])
def codec(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Codec:
    """The codec of each profile in turn, which the layers use, too."""
    if request.param not in ODD_PROFILES:
        return scapy_layers.use_profile(request.param)
    path = tmp_path_factory.mktemp("profiles") / f"{request.param}.toml"
    path.write_text(ODD_PROFILES[request.param], encoding="utf-8")
    return scapy_layers.use_profile(path)
