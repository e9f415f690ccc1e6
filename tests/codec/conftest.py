"""Codecs that the tests of this folder run over: every built-in profile, and profiles as odd as they may be."""

from __future__ import annotations

import pytest

from dcp_codec import Codec

from ..odd_profiles import PARAMETERS, codec_of


@pytest.fixture(scope="session", params=PARAMETERS)
def codec(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Codec:
    """The codec of each profile in turn."""
    return codec_of(request.param, tmp_path_factory.mktemp("profiles"))
