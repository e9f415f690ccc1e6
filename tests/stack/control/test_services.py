"""Every method of the control interface on a node, and the receivers of its notifications."""

from __future__ import annotations

import random

import pytest
from dcp_spec.profile.loading import profile_names

from dcp_codec import Codec
from dcp_codec.values import Beacon, BPHeader, Payload
from dcp_stack.config import NodeConfig, SRPConfig
from dcp_stack.control.methods import METHODS
from dcp_stack.effects import SendBeacon
from dcp_stack.node import Node

from ..control_rig import MS, WALL, Rig

OTHER = bytes.fromhex("020000000002")
OK = {"BP": {"status": "BP-STATUS-OK"}, "SRP": {"status": "SRP-STATUS-OK"}, "VD": {"status": "VARDIS-STATUS-OK"}}


@pytest.fixture
def rig():
    return Rig()


def register(client, prot_id=0x1234, mode="BP_QMODE_ONCE", **more):
    params = {"protId": prot_id, "name": "test", "maxPayloadSize": 8, "queueingMode": mode, "maxEntries": 2, **more}
    return client.call("BP-RegisterProtocol", **params)


def beacon(codec, prot_id=0x1234, payload=b"hi", seqno=0):
    header = BPHeader(OTHER, seqno, network_id=codec.profile.bp.network_id)
    return codec.encode(Beacon(header, (Payload(prot_id, payload),)))


class Peer:
    """A second node, whose beacons the first one hears."""

    def __init__(self, rig):
        self.rig = rig
        config = NodeConfig(node_id=OTHER, codec=rig.codec, srp=SRPConfig(safety_data={"x": 3.0, "y": 4.0, "z": 0.0}))
        self.node = Node(config, rng=random.Random(2), now=0, wall=WALL)
        self.node.start(0, WALL)

    def speak(self):
        self.rig.now = max(self.rig.now, self.node.bp.poll_timeout())
        self.node.handle_timeout(self.rig.now, self.rig.wall)
        for effect in self.node.take_effects():
            if isinstance(effect, SendBeacon):
                self.rig.hear(effect.octets)


def test_hello(rig):
    hello = rig.client().call("UT-Hello")
    assert hello["status"] == "UT-STATUS-OK"
    assert hello["name"] == "dcp-node"
    assert hello["nodeId"] == "02:00:00:00:00:01"
    assert hello["specVersion"] == "2.0"
    assert hello["profile"] == "dcp-2.0"
    assert hello["methods"] == [*METHODS]


@pytest.mark.parametrize("profile", [name for name in profile_names() if name != "student-2024"])
def test_all_methods_answer_in_every_profile(profile):
    rig = Rig(profile)
    client = rig.client()
    supported = client.call("UT-Hello")["methods"]
    params = {
        "BP-RegisterProtocol": {"protId": 5, "name": "", "maxPayloadSize": 9, "queueingMode": "BP_QMODE_ONCE"},
        "BP-TransmitPayload": {"protId": 5, "payload": "00"},
        "BP-SetParameter": {"name": "BPPAR_BEACON_PERIOD", "value": 100},
        "SRP-SetParameter": {"name": "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", "value": 3000},
        "VD-SetParameter": {"name": "VARDISPAR_MAX_SUMMARIES", "value": 1},
        "RTDB-Create": {"varId": 1, "repCnt": 1, "descr": "x", "value": "00"},
        "RTDB-Update": {"varId": 1, "value": "00"},
        "SRP-UpdateSafetyData": {"sData": {field.name: 0 for field in rig.codec.profile.srp.safety_data}},
    }
    for name, method in METHODS.items():
        fields = method.params.__struct_encode_fields__
        given = params.get(name, {"protId": 5} if "protId" in fields else {"varId": 1} if "varId" in fields else {})
        answer = client.ask(name, **given)
        if name in supported:
            assert "result" in answer, (name, answer)
            assert "-STATUS-" in answer["result"]["status"]
        else:
            assert answer["error"]["code"] == -32601, (name, answer)


def test_the_methods_of_missing_protocols_are_missing():
    client = Rig(srp=None, vardis=None).client()
    assert all(name.startswith(("UT-", "BP-")) for name in client.call("UT-Hello")["methods"])
    assert client.error("RTDB-Read", varId=1)["code"] == -32601
    assert client.error("SRP-NeighbourTable")["code"] == -32601
    assert client.call("UT-Status")["node"].keys() == {"bp"}


def test_variables(rig):
    client = rig.client()
    create = {"varId": 7, "repCnt": 3, "descr": "Höhe", "value": "01FF", "timeout": 5000}
    assert client.call("RTDB-Create", **create) == OK["VD"]
    assert client.call("RTDB-Update", varId=7, value="02") == OK["VD"]
    assert client.call("RTDB-Read", varId=7) == {**OK["VD"], "value": "02", "tStamp": WALL}
    spec = {
        "varId": 7,
        "prodId": "02:00:00:00:00:01",
        "repCnt": 3,
        "descr": "Höhe",
        "creationTime": WALL,
        "timeout": 5000,
    }
    listed = {**OK["VD"], "variables": [{**spec, "isDeleted": False, "tStamp": WALL}]}
    assert client.call("RTDB-DescribeDatabase") == listed
    counts = {"countUpdate": 3, "countCreate": 3, "countDelete": 0}
    entry = {**spec, "isDeleted": False, "tStamp": WALL, "value": "02", "seqno": 1, **counts}
    assert client.call("RTDB-DescribeVariable", varId=7) == {**OK["VD"], "variable": entry}
    assert client.call("RTDB-Delete", varId=7) == OK["VD"]
    assert client.call("RTDB-Delete", varId=7) == {"status": "VARDIS-STATUS-VARIABLE-IS-DELETED"}
    assert client.call("RTDB-Read", varId=7) == {"status": "VARDIS-STATUS-VARIABLE-IS-DELETED"}
    assert client.call("RTDB-DescribeVariable", varId=8) == {"status": "VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST"}
    assert client.call("RTDB-Create", varId=8, repCnt=99, descr="", value="00")["status"].endswith("ILLEGAL-REPCOUNT")


def test_a_description_that_is_not_text_is_hex(rig):
    rig.node.vardis.create(1, None, 1, b"\xff\xfe", b"x", now=0, wall=WALL)
    (shown,) = rig.client().call("RTDB-DescribeDatabase")["variables"]
    assert shown["descrHex"] == "fffe"
    assert "descr" not in shown


def test_vardis_management_and_parameters(rig):
    client = rig.client()
    assert client.call("VD-MGMT-Deactivate") == OK["VD"]
    assert client.call("RTDB-DescribeDatabase") == {"status": "VARDIS-STATUS-INACTIVE", "variables": []}
    assert client.call("RTDB-Read", varId=1) == {"status": "VARDIS-STATUS-INACTIVE"}
    assert client.call("VD-MGMT-Activate") == OK["VD"]
    assert client.call("RTDB-Read", varId=1)["status"].endswith("DOES-NOT-EXIST")
    assert client.call("VD-SetParameter", name="VARDISPAR_MAX_SUMMARIES", value=3) == OK["VD"]
    assert client.call("VD-GetParameters")["parameters"]["VARDISPAR_MAX_SUMMARIES"] == 3
    refused = client.error("VD-SetParameter", name="VARDISPAR_SCRUBBING_PERIOD", value=65001)
    assert refused["code"] == -32001
    assert refused["data"] == {
        "parameter": "VARDISPAR_SCRUBBING_PERIOD",
        "value": 65001,
        "bound": "at most 65000",
        "requirement": "VD-PAR-07",
    }


def test_bp_services(rig):
    client = rig.client()
    assert register(client) == {**OK["BP"], "ownNodeIdentifier": "02:00:00:00:00:01"}
    again = register(client)
    assert again["status"] == "BP-STATUS-PROTOCOL-ALREADY-REGISTERED"
    assert client.call("BP-TransmitPayload", protId=0x1234, payload="0011") == OK["BP"]
    assert client.call("BP-QueryNumberBufferedPayloads", protId=0x1234) == {**OK["BP"], "number": 1}
    listed = {each["protocolId"]: each for each in client.call("BP-ListRegisteredProtocols")["protocols"]}
    assert [*listed] == [1, 2, 0x1234]
    assert listed[0x1234] == {
        "protocolId": 0x1234,
        "protocolName": "test",
        "maxPayloadSize": 8,
        "queueMode": "BP_QMODE_ONCE",
        "timeStampRegistration": WALL,
        "maxEntries": 2,
        "allowMultiplePayloads": False,
        "buffered": 1,
    }
    assert client.call("BP-ClearBuffer", protId=0x1234) == OK["BP"]
    assert client.call("BP-QueryNumberBufferedPayloads", protId=0x1234)["number"] == 0
    assert client.call("BP-TransmitPayload", protId=0x1234, payload="")["status"] == "BP-STATUS-EMPTY-PAYLOAD"
    assert client.call("BP-TransmitPayload", protId=0x1234, payload="00" * 9)["status"] == "BP-STATUS-PAYLOAD-TOO-LARGE"
    assert client.call("BP-DeregisterProtocol", protId=0x1234) == OK["BP"]
    for method in ("BP-DeregisterProtocol", "BP-ClearBuffer", "BP-QueryNumberBufferedPayloads"):
        assert client.call(method, protId=0x1234) == {"status": "BP-STATUS-UNKNOWN-PROTOCOL"}
    assert register(client, mode="BP_QMODE_STACK")["status"] == "BP-STATUS-UNKNOWN-QUEUEING-MODE"
    assert register(client, maxPayloadSize=-1)["status"] == "BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE"


def test_bp_management_and_parameters(rig):
    client = rig.client()
    assert client.call("BP-MGMT-Deactivate") == OK["BP"]
    assert rig.node.bp.poll_timeout() is None
    assert client.call("BP-MGMT-Activate") == OK["BP"]
    assert client.call("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=50.5) == OK["BP"]
    parameters = client.call("BP-GetParameters")["parameters"]
    assert parameters["BPPAR_BEACON_PERIOD"] == 50.5
    assert parameters["ownNodeIdentifier"] == "02:00:00:00:00:01"
    assert client.error("BP-SetParameter", name="ownNodeIdentifier", value=1)["code"] == -32001


def test_state_reports_and_the_neighbour_table(rig):
    client = rig.client()
    assert client.call("SRP-UpdateSafetyData", sData={"x": 0, "y": 0, "z": 0.0}) == OK["SRP"]
    Peer(rig).speak()
    rig.now += 40 * MS
    (neighbour,) = client.call("SRP-NeighbourTable")["neighbours"]
    assert neighbour["nodeId"] == neighbour["senderId"] == "02:00:00:00:00:02"
    assert neighbour["sData"] == {"x": 3.0, "y": 4.0, "z": 0.0}
    assert neighbour["age"] == pytest.approx(40)
    assert neighbour["distance"] == 5.0
    assert (neighbour["seqno"], neighbour["received"], neighbour["lost"]) == (0, 1, 0)
    assert client.call("SRP-NeighbourTable", nodeId="020000000002")["neighbours"] == [neighbour]
    assert client.call("SRP-NeighbourTable", nodeId="02:00:00:00:00:09")["neighbours"] == []
    assert client.call("SRP-SetParameter", name="SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", value=500) == OK["SRP"]
    assert client.call("SRP-GetParameters")["parameters"] == {"SRPPAR_NEIGHBOUR_TABLE_TIMEOUT": 500}
    rig.run(1200)
    assert client.call("SRP-NeighbourTable") == {**OK["SRP"], "neighbours": []}


def test_numbers_that_json_does_not_have(rig):
    client = rig.client()
    assert client.call("SRP-UpdateSafetyData", sData={"x": "NaN", "y": "Infinity", "z": "-Infinity"}) == OK["SRP"]
    assert client.call("UT-Status")["node"]["srp"]["safety_data"] == {"x": "NaN", "y": "Infinity", "z": "-Infinity"}


def test_opaque_safety_data_is_hex():
    rig = Rig("sim-2.0")
    fields = rig.codec.profile.srp.safety_data
    values = {each.name: "00" * each.octets if each.type == "opaque" else 1 for each in fields}
    assert rig.client().call("SRP-UpdateSafetyData", sData=values) == OK["SRP"]


def test_srp_that_is_not_registered_is_inactive(rig):
    client = rig.client()
    rig.node.srp.shutdown()
    assert client.call("SRP-UpdateSafetyData", sData={"x": 0, "y": 0, "z": 0}) == {"status": "SRP-STATUS-INACTIVE"}
    assert client.call("SRP-NeighbourTable") == {"status": "SRP-STATUS-INACTIVE", "neighbours": []}


def test_indications_go_to_the_registered_client(rig):
    owner, other, watcher = rig.client(), rig.client(), rig.client()
    register(owner)
    watcher.call("UT-Subscribe", protIds=[0x1234])
    rig.hear(beacon(rig.codec, payload=b"\x00\xff"))
    told = {
        "jsonrpc": "2.0",
        "method": "BP-ReceivePayload.indication",
        "params": {"protId": 0x1234, "length": 2, "payload": "00ff", "senderId": "02:00:00:00:00:02"},
    }
    assert owner.notifications() == [told]
    assert watcher.notifications() == [told]
    assert other.notifications() == []
    # Any client may send under a registered protocol; the owner gets the indication.
    assert other.call("BP-TransmitPayload", protId=0x1234, payload="01") == OK["BP"]
    rig.run(200)
    (sent,) = owner.notifications()
    assert sent["method"] == "BP-PayloadTransmitted.indication"
    epoch = sent["params"]["nextBeaconGenerationEpoch"]
    assert WALL < epoch <= WALL + 400 * MS
    watcher.notifications()
    watcher.call("UT-Subscribe")
    assert other.call("BP-DeregisterProtocol", protId=0x1234) == OK["BP"]
    rig.hear(beacon(rig.codec, seqno=1))
    assert owner.notifications() == other.notifications() == watcher.notifications() == []


def test_a_registered_subscriber_gets_one_notification(rig):
    client = rig.client()
    register(client)
    client.call("UT-Subscribe", protIds=[0x1234, 0x1234])
    rig.hear(beacon(rig.codec))
    assert len(client.notifications()) == 1


def test_a_registration_outlives_its_client(rig):
    gone, watcher = rig.client(), rig.client()
    register(gone, mode="BP_QMODE_REPEAT")
    gone.call("BP-TransmitPayload", protId=0x1234, payload="01")
    gone.session.close()
    gone.session.close()
    assert len(rig.server.sessions) == 1
    rig.run(500)
    assert any(b"\x12\x34" in octets for octets in rig.sent)
    rig.hear(beacon(rig.codec))
    assert gone.session.output == b""
    assert not rig.server.listening
    watcher.call("UT-Subscribe", protIds=[0x1234])
    assert rig.server.listening
    rig.hear(beacon(rig.codec, seqno=1))
    assert [each["method"] for each in watcher.notifications()] == ["BP-ReceivePayload.indication"]
    assert register(watcher)["status"] == "BP-STATUS-PROTOCOL-ALREADY-REGISTERED"
    watcher.call("BP-DeregisterProtocol", protId=0x1234)
    assert register(watcher)["status"] == "BP-STATUS-OK"


def test_watching_variables(rig):
    watcher, maker = rig.client(), rig.client()
    watcher.call("UT-Subscribe", variables=True)
    maker.call("RTDB-Create", varId=3, repCnt=1, descr="", value="0a")
    maker.call("RTDB-Update", varId=3, value="0b")
    maker.call("RTDB-Delete", varId=3)
    common = {"varId": 3, "prodId": "02:00:00:00:00:01"}
    assert [each["params"] for each in watcher.notifications()] == [
        {"event": "created", **common, "seqno": 0, "value": "0a"},
        {"event": "updated", **common, "seqno": 1, "value": "0b"},
        {"event": "deleted", **common, "seqno": 1},
    ]
    assert maker.notifications() == []


def test_watching_neighbours(rig):
    watcher = rig.client()
    watcher.call("UT-Subscribe", neighbours=True)
    Peer(rig).speak()
    rig.run(4000)
    assert [(each["method"], each["params"]) for each in watcher.notifications()] == [
        ("UT-NeighbourSeen", {"nodeId": "02:00:00:00:00:02", "new": True}),
        ("UT-NeighbourExpired", {"nodeId": "02:00:00:00:00:02"}),
    ]


def test_each_confirm_goes_to_the_requesting_client(rig):
    first, second = rig.client(), rig.client()
    line = b'{"jsonrpc":"2.0","id":"%s","method":"UT-Hello"}'
    half = line % b"a"
    assert first.feed(half[:20]) == []
    (answer,) = second.feed(line % b"b" + b"\n")
    assert answer["id"] == "b"
    (answer,) = first.feed(half[20:] + b"\n")
    assert answer["id"] == "a"


def test_reset(rig):
    client, watcher = rig.client(), rig.client()
    before = client.call("UT-Status")["node"]
    watcher.call("UT-Subscribe", variables=True)
    register(client)
    client.call("RTDB-Create", varId=3, repCnt=1, descr="", value="0a")
    client.call("BP-SetParameter", name="BPPAR_BEACON_PERIOD", value=50)
    client.call("VD-MGMT-Deactivate")
    Peer(rig).speak()
    rig.hear(b"nonsense")
    assert client.call("UT-Status")["drops"]
    assert client.call("UT-Reset") == {"status": "UT-STATUS-OK"}
    after = client.call("UT-Status")
    assert after["drops"] == {}
    assert rig.node.bp.active
    for state in (before, after["node"]):
        # These three say when it was.
        del state["bp"]["next_beacon"]
        for each in state["bp"]["clients"]:
            del each["timeStampRegistration"]
    assert after["node"] == before
    watcher.notifications()
    client.call("RTDB-Create", varId=3, repCnt=1, descr="", value="0a")
    assert len(watcher.notifications()) == 1
    rig.hear(beacon(rig.codec))
    assert client.notifications() == []


def test_status_counts_what_is_ignored(rig):
    client = rig.client()
    rig.hear(b"")
    rig.hear(Codec("dcp-2.0").encode(Beacon(BPHeader(OTHER, 0, network_id=7), (Payload(9, b"x"),))))
    status = client.call("UT-Status")
    assert status["drops"]["bp/foreign-network"] == 1
    assert sum(status["drops"].values()) == 2
    assert status["runtime"] == {"sessions": 1}
    assert status["nodeId"] == "02:00:00:00:00:01"


@pytest.mark.req("VD-SRV-01")
@pytest.mark.parametrize("reading", ["answer-inactive", "no-response"])
def test_vardis_without_a_registration(reading):
    client = Rig(readings={"X30": reading}).client()
    assert client.call("BP-DeregisterProtocol", protId=2)["status"] == "BP-STATUS-OK"
    requests = {
        "RTDB-Create": {"varId": 7, "repCnt": 1, "descr": "d", "value": "01"},
        "RTDB-Update": {"varId": 7, "value": "01"},
        "RTDB-Delete": {"varId": 7},
        "RTDB-Read": {"varId": 7},
        "RTDB-DescribeVariable": {"varId": 7},
        "RTDB-DescribeDatabase": {},
    }
    for method, params in requests.items():
        if reading == "no-response":
            error = client.error(method, **params)
            assert error["code"] == -32002
            assert "X30" in error["message"]
        else:
            assert client.call(method, **params)["status"] == "VARDIS-STATUS-INACTIVE"
