"""The codec of every profile, in succession, for tests that compile something for each."""

from __future__ import annotations

import pytest

from dcp_codec import Codec

from ..odd_profiles import PARAMETERS, codec_of


@pytest.fixture(scope="module", params=PARAMETERS)
def codec(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Codec:
    """The codec of each profile in turn."""
    return codec_of(request.param, tmp_path_factory.mktemp("profiles"))
