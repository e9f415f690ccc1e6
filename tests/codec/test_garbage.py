"""Thresholds of the garbage collector while many objects are kept."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest

from dcp_codec.common.garbage import few_collections


@pytest.fixture(autouse=True)
def thresholds() -> Iterator[None]:
    before = gc.get_threshold()
    yield
    gc.set_threshold(*before)


def test_collections_are_rare_inside_and_as_before_afterwards():
    gc.set_threshold(700, 10, 10)
    with few_collections():
        assert gc.get_threshold()[0] >= 10_000
    assert gc.get_threshold() == (700, 10, 10)


def test_an_error_restores_the_thresholds():
    gc.set_threshold(700, 10, 10)
    with pytest.raises(ValueError, match="damaged"), few_collections():
        raise ValueError("damaged")
    assert gc.get_threshold() == (700, 10, 10)


@pytest.mark.parametrize("own", [0, 1_000_000])
def test_fewer_or_disabled_collections_are_not_changed(own):
    gc.set_threshold(own, 10, 10)
    with few_collections():
        assert gc.get_threshold()[0] == own
