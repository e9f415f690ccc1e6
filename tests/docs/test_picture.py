"""The picture of the README is of this version."""

from __future__ import annotations

from dcp_spec.version import __version__

from tools.picture import PICTURE, version_of


def test_the_picture_is_of_this_version() -> None:
    assert version_of(PICTURE.read_bytes()) == __version__, "make picture"
