"""Packets made by hand: stacking, what is worked out, what is put on the wire although it is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from dcp_spec.profile.loading import ProfileError, profile_names
from scapy.config import conf
from scapy.fields import RawVal
from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Dot1Q, Ether
from scapy.packet import Packet, Padding, Raw, fuzz
from scapy.volatile import RandInt

from dcp_codec import Codec, DecodeError, get_codec
from dcp_codec.scapy import layers as scapy_layers
from dcp_codec.scapy.layers import (
    DCPBeacon,
    DCPPayload,
    Octets,
    SafetyData,
    SRPReport,
    VarCreate,
    VarDelete,
    VardisContainer,
    VardisPayload,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
    export_script,
    use_profile,
)

NODE = "02:00:00:00:00:01"
# The test vector of the project (docs: CREATE of variable 7, then SUMMARIES of 7 and 9), sent by 02:00:00:00:00:bb.
VECTORS = {
    "dcp-1.0": ("497e0200000000bb010100000029 0002001b 050107020000000001 02 706f7300 0703 04 41424344 0102 0703 0900"),
    "sim-1.0": "497e0200000000bb010100000029 0002001c 0501070200000000010204706f730007030441424344010207030900",
    "dcp-1.1": "01497e0200000000bb0100000029 0002001b 0501070200000000010203706f7307030441424344010207030900",
    "dcp-1.3": "01497e0200000000bb001f0100000029 0002001b 0501070200000000010203706f7307030441424344010207030900",
    "cpp-2.0": (
        "01497e0200000000bb111100290100000029 00020025"
        "0501070200000000010215cd853dfe9c9717138803706f7307030441424344010207030900"
    ),
    "dcp-2.0": (
        "01497e0200000000bb111100290100000029 00020025"
        "0501070200000000010217979cfe3d85cd15138803706f7307030441424344010207030900"
    ),
}


def vector(name: str) -> Packet:
    newer = {"creationTime": 1_700_000_000_123_456_789, "timeout": 5000} if name.endswith("2.0") else {}
    spec = VarSpec(varId=7, prodId=NODE, repCnt=2, descr="pos", **newer)
    return (
        DCPBeacon(senderId="02:00:00:00:00:bb", seqno=41)
        / VarCreate(spec=spec, upd=VarUpdate(varId=7, seqno=3, value=b"ABCD"))
        / VarSumm(varId=7, seqno=3)
        / VarSumm(varId=9)
    )


@pytest.mark.parametrize("name", VECTORS)
def test_test_vectors(name: str) -> None:
    use_profile(name)
    assert bytes(vector(name)) == bytes.fromhex(VECTORS[name])


@pytest.mark.parametrize("name", profile_names())
def test_all_records_in_every_profile(name: str) -> None:
    codec = use_profile(name)
    beacon = DCPBeacon(seqno=41) if codec.profile.bp.header else DCPBeacon()
    for record in (
        VarCreate(spec=VarSpec(varId=1, descr="d"), upd=VarUpdate(varId=1, value=b"v")),
        VarDelete(varId=2),
        VarReqCreate(varId=3),
        VarReqCreate(varId=4),
        VarSumm(varId=5, seqno=6),
        VarUpdate(varId=7, seqno=8, value=b"value"),
        VarReqUpdate(varId=9, seqno=10),
    ):
        beacon = beacon / record
    beacon = beacon / DCPPayload(protocolId=77, data=b"others")
    if codec.report_plan is not None:
        beacon = beacon / SRPReport(seqno=11)
    decoded = beacon.decode()
    assert decoded == codec.decode(bytes(beacon))
    containers = decoded.payloads[0].vardis
    assert containers is not None
    assert [len(container.records) for container in containers] == [1, 1, 2, 1, 1, 1]
    assert len({container.ic_type for container in containers}) == 6
    assert decoded.payloads[1].data == b"others"
    assert DCPBeacon(bytes(beacon)).command() != beacon.command()
    assert bytes(DCPBeacon(bytes(beacon))) == bytes(beacon)


def test_stacking_fills_the_lists() -> None:
    beacon = DCPBeacon() / SRPReport() / VarSumm(varId=1) / VarSumm(varId=2) / VarDelete(varId=3)
    assert beacon.payloads[0].srp.seqno == 0
    assert [len(container.records) for container in beacon.payloads[1].vardis] == [2, 1]
    assert beacon.payloads[1].vardis[0].parent is beacon.payloads[1]
    same = DCPBeacon() / (SRPReport() / (VarSumm(varId=1) / VarSumm(varId=2)) / VarDelete(varId=3))
    assert same == beacon
    explicit = DCPBeacon(
        payloads=[
            DCPPayload(srp=SRPReport()),
            DCPPayload(
                vardis=[
                    VardisContainer(records=[VarSumm(varId=1), VarSumm(varId=2)]),
                    VardisContainer(records=(VarDelete(varId=3),)),
                ]
            ),
        ]
    )
    assert explicit == beacon
    block = VardisPayload() / VarSumm(varId=1) / VarSumm(varId=2) / VarDelete(varId=3)
    assert DCPBeacon() / SRPReport() / block == beacon
    assert DCPBeacon() / DCPPayload(srp=SRPReport()) / block == beacon
    assert (DCPPayload() / VardisContainer() / VarSumm()).vardis[0].records == [VarSumm()]


def test_octets_after_a_beacon_stay_after_it() -> None:
    beacon = DCPBeacon() / VarSumm()
    assert bytes(beacon / b"rest") == bytes(beacon) + b"rest"
    assert bytes(beacon / Padding(b"pad")) == bytes(beacon) + b"pad"
    # Stacked on the report first, the octets belong to the report.
    inside = DCPBeacon() / (SRPReport() / b"tail")
    assert inside.problems[0].reason == "wrong-length"


def test_single_fields_can_be_edited() -> None:
    packet = Ether(bytes(Ether(src=NODE) / vector("dcp-2.0")))
    beacon = packet[DCPBeacon]
    beacon.seqno = 7
    beacon.payloads[0].vardis[1].records[1].seqno = 99
    beacon.payloads[0].vardis[0].records[0].spec.descr = "way"
    beacon.senderId = b"\x02\0\0\0\0\x05"
    again = get_codec("dcp-2.0").decode(bytes(packet)[14:])
    assert again.bp is not None
    assert (again.bp.seqno, again.bp.sender_id.hex()) == (7, "020000000005")
    containers = again.payloads[0].vardis
    assert containers is not None
    assert containers[1].records[1].seqno == 99
    assert containers[0].records[0].spec.descr == b"way"


def test_lengths_and_counts_are_computed_if_none() -> None:
    beacon = DCPBeacon(bytes(vector("dcp-2.0")))
    beacon.payloads[0].vardis[1].records.append(VarSumm(varId=11, seqno=1))
    # As it says, the beacon still ends where it did before.
    assert len(beacon.decode().payloads[0].vardis[1].records) == 2
    del beacon.length
    del beacon.payloads[0].length
    beacon.payloads[0].vardis[1].icNumRecords = None
    assert beacon.problems == []
    assert len(beacon.decode().payloads[0].vardis[1].records) == 3
    beacon = DCPBeacon(bytes(vector("dcp-2.0")))
    beacon.payloads[0].vardis[0].records[0].upd.value = b"a longer value"
    beacon.clear_derived()
    assert beacon.problems == []


@pytest.mark.parametrize(
    ("lie", "octets"),
    [
        (
            lambda: DCPBeacon(version=9, magicNo=1, length=2, numPayloads=3),
            "09 0001 000000000000 1111 0002 03 00000000",
        ),
        (lambda: DCPBeacon(senderId=RawVal(b"abc"), seqno=RawVal(b"")), "01 497e 616263 1111 0000 00"),
        (lambda: DCPPayload(protocolId=1, length=200, data=b"x"), "0001 00c8 78"),
        (
            lambda: DCPPayload(protocolId=7, vardis=[VardisContainer(records=[VarDelete(varId=1)])]),
            "0007 0003 06 01 01",
        ),
        (lambda: VardisContainer(icType=9, icNumRecords=0, records=[VarSumm(varId=1)]), "09 00 01 00"),
        (lambda: VardisContainer(icType="UPDATES", records=[]), "02 00"),
        (lambda: VardisContainer(icType=1, records=[VarDelete(varId=1), b"\xff", Raw(b"\xee")]), "01 03 01 ff ee"),
        (lambda: VarUpdate(valueLength=255, value=b"ab"), "00 00 ff 6162"),
        (lambda: VarUpdate(value=RawVal(b"ab")), "00 00 02 6162"),
        (lambda: VarSpec(descrLength=0, descr="pos"), "00 000000000000 00 0000000000000000 0000 00 706f73"),
        (lambda: SRPReport(sData=SafetyData(x=RawVal(b"!"))), "21" + "00" * 34),
    ],
)
def test_wrong_values_are_built_unchanged(lie: Callable[[], Packet], octets: str) -> None:
    assert bytes(lie()) == bytes.fromhex(octets)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: bytes(DCPBeacon(seqno=1 << 32)), r"seqno: 4294967296 does not fit \(not in 0\.\.4294967295\)"),
        (lambda: bytes(DCPBeacon(seqno=-1)), "seqno"),
        (lambda: bytes(DCPBeacon(seqno="many")), "seqno"),
        (lambda: bytes(DCPBeacon(senderId="02:00")), "senderId"),
        (lambda: bytes(DCPBeacon(senderId="me")), "senderId"),
        (lambda: bytes(DCPBeacon(payloads=[DCPPayload()] * 300)), "numPayloads"),
        (lambda: bytes(VarUpdate(value=7)), "value"),
        (lambda: bytes(VarUpdate(value=bytes(256))), "valueLength"),
        (lambda: VardisContainer(icType="UPDATE"), "SUMMARIES, UPDATES"),
        (lambda: DCPPayload(srp=SRPReport(), data=b"x"), "srp and data exclude each other"),
    ],
)
def test_values_that_do_not_fit_are_named(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_one_content_replaces_another() -> None:
    block = DCPPayload(bytes(DCPPayload(data=b"abc", protocolId=9)))
    block.vardis = [VardisContainer(records=[VarDelete(varId=1)])]
    assert block.data is None
    del block.length
    assert bytes(block) == bytes.fromhex("0009 0003 060101")
    block.srp = SRPReport()
    assert block.vardis == []
    assert DCPPayload().vardis == []
    block.srp = None
    block.data = b"abc"
    assert bytes(block) == bytes.fromhex("0009 0003 616263")


def test_cut_off_fields_are_octets() -> None:
    octets = bytes(vector("dcp-2.0"))
    beacon = DCPBeacon(octets[:-1])
    cut = beacon.payloads[0].vardis[1].records[1]
    assert cut.varId == 9
    assert cut.seqno == Octets(b"")
    assert not cut.seqno > 3
    assert not cut.seqno <= 3
    assert "Octets(b'')" in beacon.show(dump=True)
    assert bytes(eval(beacon.command())) == octets[:-1]
    assert DCPBeacon(octets[:5]).senderId == Octets(b"\x02\0")
    assert "(beacon-overrun)" in beacon.summary()


def test_octets_without_a_place_are_raw() -> None:
    octets = bytes(DCPBeacon() / DCPPayload(srp=SRPReport() / Raw(b"more")))
    assert DCPBeacon(octets).payloads[0].srp[Raw].load == b"more"
    unknown = DCPBeacon(bytes(DCPBeacon() / VardisContainer(icType=99, icNumRecords=1, records=[Raw(b"what")])))
    assert unknown.payloads[0].vardis[0].records == [Raw(b"what")]
    assert unknown.summary().endswith("VarDis [type 99 1] (unknown-type)")


def test_summaries() -> None:
    packet = Ether() / DCPBeacon(senderId=NODE, seqno=41) / SRPReport(nodeId=NODE) / VarSumm() / VarSumm()
    expected = "Ether / DCP 02:00:00:00:00:01 seqno 41: SRP, VarDis [SUMMARIES 2]"
    assert packet.summary() == expected
    assert Ether(bytes(packet)).summary() == expected
    assert Ether(bytes(packet) + bytes(9)).summary() == f"{expected} / Padding"
    other = DCPBeacon(senderId=NODE) / DCPPayload(protocolId=9, data=b"abc")
    assert other.summary() == "DCP 02:00:00:00:00:01 seqno 0: protocol 9 (3 octets)"


def test_layers_are_found_inside() -> None:
    packet = Ether() / vector("dcp-2.0")
    assert VarSumm in packet
    assert packet[VarSumm:2].varId == 9
    assert SRPReport not in packet
    assert packet.getlayer(DCPBeacon, senderId="02:00:00:00:00:bb") is not None
    assert packet.getlayer(DCPBeacon, senderId=NODE) is None


def test_lists_of_values_are_lists_of_packets() -> None:
    packets = list(DCPBeacon(seqno=[1, 5, 9]) / VarSumm())
    assert [DCPBeacon(bytes(packet)).seqno for packet in packets] == [1, 5, 9]


def test_random_values_agree_with_their_lengths() -> None:
    fuzzed = fuzz(DCPBeacon(version=1, magicNo=0x497E) / VarUpdate() / VarSumm() / VarDelete())
    found = set()
    for _ in range(20):
        octets = bytes(fuzzed)
        assert [problem for problem in DCPBeacon(octets).problems if problem.severity == "error"] == []
        found.add(octets)
    assert len(found) == 20
    beacon = DCPBeacon(seqno=RandInt()) / VarSumm()
    assert bytes(beacon) != bytes(beacon)


def test_the_codec_is_accessible() -> None:
    beacon = vector("dcp-2.0")
    assert beacon.decode() == get_codec("dcp-2.0").decode(bytes(beacon))
    with pytest.raises(DecodeError):
        (beacon / VarSumm() / DCPPayload(length=99)).decode()


def test_names_reserved_by_scapy(tmp_path: Path) -> None:
    path = tmp_path / "taken.toml"
    fields = ", ".join(f'{{ name = "{name}", type = "u8" }}' for name in ("time", "payload", "shape", "x"))
    path.write_text(f'extends = "dcp-2.0"\nname = "taken"\n[srp]\nsafety_data = [{fields}]\n')
    use_profile(path)
    assert bytes(SafetyData(time_=1, payload_=2, shape_=3, x=4)) == b"\1\2\3\4"
    assert SafetyData(b"\1\2\3\4").time_ == 1


# -- profiles -----------------------------------------------------------------------------------------------------


def test_profiles_are_bound_where_their_beacons_are() -> None:
    assert DCPBeacon in Ether(bytes(Ether() / DCPBeacon()))
    assert bytes(Ether(src=NODE) / DCPBeacon())[:14].hex() == "ffffffffffff" + "020000000001" + "4953"
    tagged = Ether(bytes(Ether(src=NODE) / Dot1Q(vlan=5) / DCPBeacon()))
    assert tagged.dst == "ff:ff:ff:ff:ff:ff"
    assert DCPBeacon in tagged
    use_profile("sim-2.0")
    assert bytes(Ether(src=NODE) / DCPBeacon())[12:14].hex() == "8999"
    assert DCPBeacon not in Ether(bytes(Ether(src=NODE, type=0x4953) / DCPBeacon()))
    use_profile("student-2024")
    assert DCPBeacon not in Ether(bytes(Ether(src=NODE, type=0x8999) / Raw(bytes(30))))
    datagram = IP(dst="255.255.255.255") / UDP() / DCPBeacon() / VarSumm(varId=1)
    assert (datagram[UDP].sport, datagram[UDP].dport) == (5950, 5950)
    octets = bytes(datagram)
    again = IP(octets)
    assert again[DCPBeacon].payloads[0].vardis[0].records[0].varId == 1
    assert len(again[DCPBeacon]) == 1012
    use_profile("dcp-2.0")
    assert DCPBeacon not in IP(octets)
    assert len([upper for fields, upper in Ether.payload_guess if upper is DCPBeacon]) == 1


def test_layers_stay_the_same_objects() -> None:
    before = DCPBeacon
    use_profile("cpp-1.3")
    assert scapy_layers.DCPBeacon is before
    assert "networkId" not in DCPBeacon().fieldtype
    assert [field.name for field in VarSpec.fields_desc] == ["varId", "prodId", "repCnt", "descrLength", "descr"]
    assert "networkId" not in str(DCPBeacon.__signature__)


def test_packets_of_another_profile_are_not_built() -> None:
    beacon = vector("dcp-2.0")
    use_profile("cpp-1.3")
    with pytest.raises(RuntimeError, match="another profile"):
        bytes(beacon)
    assert beacon.seqno == 41


def test_a_profile_without_a_record_for_state_reports() -> None:
    use_profile("sim-1.0")
    assert bytes(SRPReport(data=b"abc")) == b"abc"
    with pytest.raises(ValueError, match=r"sim-1\.0 cannot encode state reports"):
        DCPBeacon() / SRPReport()


def test_unknown_profiles() -> None:
    with pytest.raises(ProfileError, match=r"cpp-2\.0"):
        use_profile("cpp-2.1")
    assert DCPBeacon in Ether(bytes(Ether() / DCPBeacon()))
    with pytest.raises(ProfileError):
        export_script("cpp-2.1")


def test_the_network_of_the_profile_is_the_default() -> None:
    assert DCPBeacon().networkId == 0x1111
    codec: Codec = use_profile("sim-2.0")
    assert DCPBeacon().networkId == (codec.profile.bp.network_id or 0)


def test_layers_are_registered() -> None:
    assert {layer.__name__ for layer in conf.layers} >= {"DCPBeacon", "DCPPayload", "VardisContainer", "VarSumm"}
    assert "PlanPacket" not in {layer.__name__ for layer in conf.layers}
