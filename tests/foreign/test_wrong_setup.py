"""The basic interconnection test against real processes: wrong settings of the tester are named."""

from __future__ import annotations

import pytest

from .rig import foreign

SANITY = "TC_DCP_SANITY_BV_01"


def test_another_ether_type_is_named():
    with foreign(link="ethernet", ether_type=0x88B5, adapter=False) as target, target.started():
        run = target.run(SANITY, start=False)
        assert run.status == 3, run.text
        assert "the tester listens to 0x4953: give --ether-type 0x88b5" in run.text
        again = target.run(SANITY, "--ether-type", "0x88b5", start=False)
        assert again.status == 0, again.text


@pytest.mark.parametrize("own_variable", [None, 7])
def test_another_network_identifier_is_named(own_variable: int | None):
    # An upper tester would tell the number.
    with foreign(network_id=3, own_variable=own_variable, adapter=False) as target, target.started():
        run = target.run("TC_BP_RX_BI_01-00", start=False)
        assert run.status == 3, run.text
        assert "its beacons carry networkId 3, the tester uses 4369: give [pixit] network_id = 3" in run.text
        assert {case["verdict"] for case in run.cases} == {"inconclusive"}
