"""Damage to elements and counts that the Hypothesis strategies reach."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from dcp_lab.testing import strategies
from hypothesis import Phase, find, settings
from hypothesis import strategies as st

from dcp_codec import Codec
from dcp_codec.values import Beacon, BPHeader, Container, Payload, VarDelete, VarSumm

from ..parts import also, every

CODEC = Codec("dcp-2.0")
_SEARCH = settings(max_examples=3000, derandomize=True, database=None, phases=[Phase.generate])


def beacon(*containers: Container) -> bytes:
    return CODEC.encode(Beacon(BPHeader(b"\2\0\0\0\0\2", 7, 0x1111), (Payload(2, containers),)))


VALID = beacon(Container(1, (VarSumm(1, 2), VarSumm(3, 4))), Container(6, (VarDelete(5),)))
OTHER = beacon(Container(1, (VarSumm(8, 9),)))


@pytest.mark.part("suite")
@pytest.mark.parametrize("base", [14, *also("suite", 0)])
@pytest.mark.parametrize(
    "wanted",
    every(
        2,
        [
            lambda octets: (
                octets == beacon(Container(1, (VarSumm(3, 4), VarSumm(1, 2))), Container(6, (VarDelete(5),)))
            ),
            lambda octets: (
                octets == beacon(Container(6, (VarDelete(5),)), Container(1, (VarSumm(1, 2), VarSumm(3, 4))))
            ),
            lambda octets: (
                octets == beacon(Container(1, (VarSumm(8, 9), VarSumm(3, 4))), Container(6, (VarDelete(5),)))
            ),
            lambda octets: len(octets) == len(VALID) and octets.count(b"\xff") >= 6,
            lambda octets: octets == VALID.replace(b"\6\1\5", b"\0\1\5"),
        ],
    ),
)
def test_elements_and_counts_are_falsified(wanted: Callable[[bytes], bool], base: int) -> None:
    drawn = st.sampled_from((VALID, OTHER))
    damaged = strategies.mutations(drawn, lambda octets: CODEC.dissect(octets, base=base))
    assert find(damaged.map(wanted), bool, settings=_SEARCH)
