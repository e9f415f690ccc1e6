"""Links by the names they have on a command line; nothing here needs a privilege."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_spec.profile.definition import Link as Framing

from dcp_codec.codec import Codec
from dcp_stack.config import NodeConfig
from dcp_stack.links.base import LinkError
from dcp_stack.links.opening import FORMS, open_link
from dcp_stack.links.replay import ReplayLink
from dcp_stack.links.udp import DEFAULT_PORT, UDPLink, open_udp

CAPTURES = Path(__file__).resolve().parents[3] / "captures"
NODE = bytes.fromhex("020000000001")


@pytest.fixture(scope="module")
def config() -> NodeConfig:
    return NodeConfig(node_id=NODE, codec=Codec("cpp-2.0"))


def test_replay(config, tmp_path):
    link = open_link(f"replay:{CAPTURES}/a_bus3.mcap,speed=inf,source=node", config)
    assert isinstance(link, ReplayLink)
    heard = []
    while not link.finished:
        heard += link.receive()
    # Frames of the node itself are left out.
    assert {each.source for each in heard} == {bytes.fromhex("020000000002"), bytes.fromhex("020000000003")}
    # A comma is fine in the name of a file.
    odd = tmp_path / "a,b=c.mcap"
    odd.write_bytes((CAPTURES / "a_bus3.mcap").read_bytes())
    open_link(f"replay:{odd},speed=2", config).close()
    open_link(f"replay:{odd},source=02-00-00-00-00-0A", config).close()


def test_udp(config):
    for spec, port, size in [
        ("udp", DEFAULT_PORT, None),
        ("udp:239.73.126.9:20001,size=900,ttl=0", 20001, 900),
        ("udp::20002,interface=127.0.0.1", 20002, None),
    ]:
        link = open_link(spec, config)
        assert isinstance(link, UDPLink)
        assert link.name.endswith(f":{port}")
        assert size is None or link.max_packet_size == size
        link.close()


def test_the_port_of_a_profile_is_used():
    config = NodeConfig(node_id=b"drone-1", codec=Codec("student-2024"))
    assert config.profile.link == Framing(transport="udp", udp_port=5950)
    link = open_link("udp:127.255.255.255", config)
    assert link.name == "udp:127.255.255.255:5950"
    link.close()
    with pytest.raises(LinkError, match="defines no EtherType"):
        open_link("eth:lo", config)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("", "eth:IF"),
        ("carrier-pigeon:7", r"'carrier-pigeon:7' is not a link"),
        ("eth", "eth: interface missing"),
        ("eth:no-such-if", r"no such interface; there are .*lo"),
        ("eth:no-such-if,speed=2", "no option 'speed'; known options are size, source, type"),
        ("udp,ttl=1,ttl=2", "ttl is given twice"),
        ("eth:no-such-if,type=0x45", "0x0600"),
        ("eth:no-such-if,type=fish", "fish"),
        ("eth:no-such-if,source=01", "neither 'node' nor an address"),
        ("udp:fish", "not an IPv4 address"),
        ("udp:239.1.1.1:0", r"1\.\.65535"),
        ("udp:239.1.1.1:fish", "fish"),
        ("udp:1.2.3.4", "neither a multicast group nor a broadcast address"),
        ("udp:239.1.1.1,interface=203.0.113.99", "no interface has the address 203.0.113.99"),
        ("udp:239.1.1.1,ttl=256", "ttl 256"),
        ("replay:", "replay: file missing"),
        ("replay:/nowhere.mcap", "No such file"),
        ("replay:/nowhere.mcap,speed=0", "speed 0"),
        ("replay:/nowhere.mcap,speed=fast", "fast"),
    ],
)
def test_errors_are_reported(config, spec, message):
    with pytest.raises(LinkError, match=message):
        open_link(spec, config)


def test_all_forms_are_known(config):
    for form in FORMS:
        assert form.split(":")[0].split("[")[0] in {"eth", "udp", "replay"}
    with pytest.raises(ValueError, match="ttl"):
        open_udp(ttl=-1)
