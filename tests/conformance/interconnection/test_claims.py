"""Claims of PICS and PIXIT that contradict beacons or reported parameters are printed before any test."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.target import say_contradictions
from dcp_conformance.reference.inprocess import InProcess, reference_config
from dcp_conformance.test_system.bench import Session

from ..rig import codec_of

OWN_VARIABLE = {"varId": 3, "repCnt": 5, "descr": "d" * 16, "value": "55" * 25}


def said(pixit: Testing, *, upper: bool) -> list[str]:
    """Return the messages about a reference node with beacons every 100 ms in network 4369."""
    sut = InProcess(reference_config(codec_of("dcp-2.0")))
    assert sut.upper_tester().call("RTDB-Create", OWN_VARIABLE).ok
    session = Session(codec_of("dcp-2.0"), sut.lower_tester(), sut.upper_tester() if upper else None, Pics(pixit=pixit))
    runner = Runner(session, sut)
    # Without a reset, which deletes the variable and with it all beacons.
    if pixit.node_id is not None:
        session.sut_id = bytes.fromhex(pixit.node_id.replace(":", ""))
    if upper:
        runner.session.parameters.update(session.upper.call("BP-GetParameters", {}).result["parameters"])
        runner.session.parameters.update(session.upper.call("VD-GetParameters", {}).result["parameters"])
    found: list[str] = []
    say_contradictions(runner, found.append)
    return found


@pytest.mark.parametrize("upper", [True, False])
def test_right_claims_are_not_contradicted(upper: bool) -> None:
    pixit = Testing(node_id="02:00:00:00:00:01", network_id=0x1111, max_packet_size=1500, beacon_period_ms=100)
    assert said(pixit, upper=upper) == []
    assert said(Testing(), upper=upper) == []


@pytest.mark.parametrize(
    ("pixit", "reported", "heard"),
    [
        (
            Testing(node_id="02:00:00:00:00:77"),
            "pixit.node_id is 02:00:00:00:00:77, but UT-Hello reports 02:00:00:00:00:01",
            "pixit.node_id is 02:00:00:00:00:77, but only beacons of 02:00:00:00:00:01 are heard",
        ),
        (
            Testing(beacon_period_ms=400),
            "BPPAR_BEACON_PERIOD is reported as 100",
            "the beacon period is 400 ms for the tester, but beacons are heard every 1",
        ),
        (
            Testing(network_id=7),
            "pixit.network_id is 7, but BPPAR_NETWORK_ID is reported as 4369",
            "pixit.network_id is 7, but beacons carry networkId 4369",
        ),
        (
            Testing(max_packet_size=40),
            "pixit.max_packet_size is 40, but BPPAR_MAXIMUM_PACKET_SIZE is reported as",
            "pixit.max_packet_size is 40, but a beacon of",
        ),
        (
            Testing(max_payload_size=20),
            "pixit.max_payload_size is 20, but VARDISPAR_MAX_PAYLOAD_SIZE is reported as",
            "pixit.max_payload_size is 20, but a payload of VarDis of",
        ),
        (
            Testing(max_value_length=9),
            "pixit.max_value_length is 9, but VARDISPAR_MAX_VALUE_LENGTH is reported as",
            "",
        ),
    ],
)
def test_a_wrong_claim_is_printed(pixit: Testing, reported: str, heard: str) -> None:
    for upper, expected in ((True, reported), (False, heard)):
        found = said(pixit, upper=upper)
        assert bool(expected) == any(expected in each for each in found) or not expected, found
        assert len(found) == len(set(found))
        if not expected:
            assert found == []
