"""Wrong settings of the tester: named as such by a run, found by ``probe`` by trying, and no requirement is blamed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from dcp_conformance.definitions.case import SANITY, all_cases
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.interconnection.findings import Findings
from dcp_conformance.interconnection.probe import draft
from dcp_conformance.interconnection.settings import network_ids
from dcp_conformance.reference.inprocess import InProcess, VirtualLowerTester
from dcp_spec.profile.loading import profile_names

from dcp_codec import Codec

from ..suite.test_sanity import deaf, failed, node, runner_for, sanity

CANDIDATES = [Codec(name) for name in profile_names()]


def silent_with(**about: Any) -> Any:
    """The sanity case against a silent implementation whose upper tester says this of itself."""
    runner = runner_for(node(make=deaf), upper=True)
    upper = runner.session.upper
    assert upper is not None
    # Its upper tester answers, but no requested change has an effect on its beacons.
    upper.methods = frozenset({"UT-Hello", "BP-GetParameters"})
    upper.about = {**upper.about, **about}
    result = runner.run(all_cases()[SANITY])
    return result, Findings.of(runner.session).contact


def test_networks_to_try() -> None:
    assert 3 in network_ids(Codec("dcp-2.0"), 1)
    assert 1 not in network_ids(Codec("dcp-2.0"), 1)
    assert network_ids(Codec("dcp-1.3"), None) == []


def test_profile_version_and_network_are_the_first_suspects_if_only_the_upper_tester_answers() -> None:
    result, contact = silent_with()
    assert result.verdict is Verdict.INCONCLUSIVE
    assert not failed(result)
    text = contact.suspicion
    suspects = ("wire profile is dcp-2.0", "specification is 2.0", "network identifier is", "its link")
    places = [text.index(each) for each in suspects]
    assert places == sorted(places)
    assert "it says dcp-2.0" in text
    assert "probe" in text


def test_a_reported_version_leads_to_the_profiles_of_that_version() -> None:
    result, contact = silent_with(profile="", specVersion="1.3")
    assert (result.verdict, contact.mistaken) == (Verdict.INCONCLUSIVE, True)
    assert not failed(result)
    assert "reports specification 1.3, the tester's profile dcp-2.0 is of 2.0" in contact.suspicion
    assert "dcp-1.3" in contact.suspicion
    assert "cpp-1.3" in contact.suspicion


@pytest.mark.parametrize("told", ["2.0", "2.0-draft", "", None, 7])
def test_a_matching_or_unknown_version_is_not_suspected(told: Any) -> None:
    _, contact = silent_with(profile="", specVersion=told)
    assert "try --profile" not in contact.suspicion


@pytest.mark.parametrize("network_id", [1, 3, 0x1234])
def test_probe_finds_the_network_of_a_silent_node_by_trying(network_id: int) -> None:
    sut = node(network_id=network_id)
    pics, remarks = draft(sut.lower_tester(), None, CANDIDATES, 10)
    assert pics.pixit.network_id == network_id
    assert pics.pixit.profile == "dcp-2.0"
    assert any("answered a question in another one" in each for each in remarks)


def test_a_node_in_the_usual_network_is_asked_in_no_other() -> None:
    sut, asked = node(), []

    class Watched(VirtualLowerTester):
        def send(self, octets: bytes, source: bytes) -> bytes:
            asked.append(octets)
            return super().send(octets, source)

    codec = Codec("dcp-2.0")
    draft(Watched(sut), None, [codec], 4)
    networks = {beacon.bp.network_id for beacon in map(codec.decode, asked) if beacon.bp is not None}
    assert networks == {codec.profile.bp.network_id}


class OnAnotherType(VirtualLowerTester):
    """A link on which the implementation uses another EtherType."""

    ether_type = 0x4953

    def __init__(self, sut: InProcess) -> None:
        super().__init__(sut)
        self.asked: list[bytes] = []

    def exchange_all_types(self, asked: Iterable[bytes], duration: int) -> list[bytes]:
        self.asked += asked
        return [frame for frame in self.asked if frame[12:14] == b"\x88\xb5"]


def test_probe_finds_the_ether_type() -> None:
    lower = OnAnotherType(node(make=deaf))
    _, remarks = draft(lower, None, CANDIDATES, 2)
    assert remarks[-1].startswith("nothing was heard on")
    assert remarks[-1].endswith("give --ether-type 0x88b5")
    assert lower.asked


def test_a_passive_probe_tries_no_ether_type() -> None:
    lower = OnAnotherType(node(make=deaf))
    _, remarks = draft(lower, None, CANDIDATES, 2, ask=False)
    assert "--ether-type" not in remarks[-1]
    assert not lower.asked


def test_a_run_against_a_node_of_another_network_blames_no_requirement() -> None:
    result, contact = sanity(node(network_id=3), upper=True)
    assert not failed(result)
    assert result.verdict in (Verdict.INCONCLUSIVE, Verdict.PASS)
    assert contact is not None
