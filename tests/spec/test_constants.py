import itertools

import pytest
from dcp_spec import constants
from dcp_spec.catalogue.requirements import requirement
from dcp_spec.constants import (
    Features,
    ICType,
    QueueingMode,
    SpecVersion,
    _version_numbers,
    features,
    seqno_modulus,
)
from dcp_spec.status import BPStatus, SRPStatus, VardisStatus

VERSIONS = list(SpecVersion)


@pytest.mark.req("BP-HDR-01")
@pytest.mark.req("BP-HDR-02")
@pytest.mark.req("BP-HDR-11")
def test_header_constants_are_those_of_a_captured_beacon():
    # First octets of a beacon of the C++ implementation, draft 2.0, and a payload header of VarDis.
    header = bytes.fromhex("01497e0200000000bb111100290100000029")
    payload_header = bytes.fromhex("00020025")
    assert header[0] == constants.BP_VERSION
    assert int.from_bytes(header[1:3], "big") == constants.BP_MAGIC_NO
    assert int.from_bytes(payload_header[:2], "big") == constants.BP_PROTID_VARDIS


def test_protocol_ids_have_the_numbers_of_the_specification():
    assert (constants.BP_PROTID_SRP, constants.BP_PROTID_VARDIS) == (1, 2)


@pytest.mark.req("VD-IC-02")
def test_container_types_have_the_numbers_and_names_of_the_specification():
    assert [(t.value, t.label) for t in ICType] == [
        (1, "SUMMARIES"),
        (2, "UPDATES"),
        (3, "REQUEST-VARUPDATES"),
        (4, "REQUEST-VARCREATES"),
        (5, "CREATE-VARIABLES"),
        (6, "DELETE-VARIABLES"),
    ]
    # The catalogue, written independently, gives the same pairs in its sentence.
    statement = requirement("VD-IC-02").statement
    assert [t for t in ICType if f"{t.value} {t.label}" not in statement] == []


def test_versions_compare_in_the_order_of_publication():
    assert VERSIONS == ["1.0", "1.1", "1.2", "1.3", "2.0"]
    assert all(a < b and not b < a for a, b in itertools.pairwise(VERSIONS))


@pytest.mark.parametrize(("older", "newer"), [("1.3", "1.10"), ("2.0", "2.1"), ("2.0", "10.0")])
def test_versions_compare_by_numbers_also_with_strings(older: str, newer: str):
    assert _version_numbers(older) < _version_numbers(newer)
    known = SpecVersion(older)
    assert known < newer
    assert known <= newer
    assert newer > known
    assert not known > newer
    assert not known >= newer


def test_a_version_without_a_last_one_is_followed_by_any():
    assert SpecVersion.V2_0.is_within("1.0")
    assert SpecVersion.V1_3.is_within("1.3", "1.3")
    assert not SpecVersion.V2_0.is_within("1.0", "1.3")
    assert not SpecVersion.V1_0.is_within("1.1")


def test_versions_cannot_be_compared_with_other_values():
    with pytest.raises(ValueError, match="'new' is not a version of the specification"):
        _ = SpecVersion.V2_0 < "new"


@pytest.mark.req("BP-QM-06")
def test_queueing_modes():
    assert features("2.0").queueing_modes == {
        "BP_QMODE_QUEUE_DROPTAIL",
        "BP_QMODE_QUEUE_DROPHEAD",
        "BP_QMODE_ONCE",
        "BP_QMODE_REPEAT",
    }
    assert features("1.0").queueing_modes == {"BP_QMODE_QUEUE", "BP_QMODE_ONCE", "BP_QMODE_REPEAT"}
    assert [mode for mode in QueueingMode if not mode.is_queue] == [QueueingMode.ONCE, QueueingMode.REPEAT]


@pytest.mark.req("VD-TYP-03")
def test_seqno_modulus():
    assert [seqno_modulus(n) for n in (1, 2, 4)] == [256, 65536, 4294967296]
    with pytest.raises(ValueError, match="at least one byte"):
        seqno_modulus(0)


def row(name):
    return [getattr(features(version), name) for version in VERSIONS]


# One row per feature, one column per version: 1.0, 1.1, 1.2, 1.3, 2.0.
YES, NO = True, False
MATRIX = [
    ("network_id", [NO, NO, NO, NO, YES]),
    ("clear_buffer", [NO, YES, YES, YES, YES]),
    ("allow_multiple_payloads", [NO, YES, YES, YES, YES]),
    ("own_id_in_register_confirm", [NO, YES, YES, YES, YES]),
    ("registration_counts_bp_header", [NO, YES, YES, YES, YES]),
    ("bp_activation", [NO, NO, YES, YES, YES]),
    ("vardis_activation", ["none", "flag", "service", "service", "service"]),
    ("empty_payload_clears_buffer", [YES, NO, NO, NO, NO]),
    ("first_beacon_seqno", [1, 0, 0, 0, 0]),
    ("srp_queueing_mode", [f"BP_QMODE_{m}" for m in ("REPEAT", "REPEAT", "REPEAT", "ONCE", "ONCE")]),
    (
        "vardis_queueing_mode",
        [f"BP_QMODE_{m}" for m in ("ONCE", "QUEUE_DROPTAIL", "QUEUE_DROPHEAD", "QUEUE_DROPHEAD", "QUEUE_DROPHEAD")],
    ),
    ("string_format", ["nul-terminated", *["length-prefixed"] * 4]),
    ("several_containers_per_type", [NO, YES, YES, YES, YES]),
    ("purge_when_composing", [YES, YES, YES, NO, NO]),
    ("receive_checks_too_long", [NO, YES, YES, YES, YES]),
    ("receive_checks_empty_and_repcnt", [NO, NO, YES, YES, YES]),
    ("rerequest_unknown", [NO, YES, YES, YES, YES]),
    ("removed_after_deletion", [YES, YES, YES, YES, NO]),
    ("creation_time", [NO, NO, NO, NO, YES]),
    ("producer_set_by_vardis", [NO, NO, YES, YES, YES]),
    ("max_repetitions_bound", [15, None, 15, 15, 15]),
]


@pytest.mark.parametrize(("name", "expected"), MATRIX, ids=[name for name, _ in MATRIX])
def test_features_by_version(name, expected):
    assert row(name) == expected


def test_the_matrix_covers_every_feature():
    elsewhere = {"version", "queueing_modes", "container_order"}
    assert {name for name, _ in MATRIX} | elsewhere == set(Features.__struct_fields__)


# Where a requirement states a feature, catalogue and matrix must agree on the versions.
@pytest.mark.parametrize(
    ("requirement_id", "name"),
    [
        ("BP-HDR-04", "network_id"),
        ("BP-CLR-02", "clear_buffer"),
        ("BP-QM-07", "allow_multiple_payloads"),
        ("BP-REG-07", "own_id_in_register_confirm"),
        ("BP-REG-04", "registration_counts_bp_header"),
        ("BP-MGT-01", "bp_activation"),
        ("DATA-08", "clear_buffer"),
        ("VD-RX-03", "several_containers_per_type"),
        ("VD-PC-06", "receive_checks_empty_and_repcnt"),
        ("VD-RU-01", "rerequest_unknown"),
        ("VD-RC-01", "rerequest_unknown"),
        ("VD-SCR-05", "creation_time"),
        ("VD-CRE-03", "creation_time"),
        ("VD-CRE-08", "producer_set_by_vardis"),
        ("VD-PAR-04", "max_repetitions_bound"),
    ],
)
def test_catalogue_and_features_agree(requirement_id, name):
    entry = requirement(requirement_id)
    assert [entry.holds_in(version) for version in VERSIONS] == [
        value is not None and bool(value) for value in row(name)
    ]


@pytest.mark.req("VD-PAY-01")
@pytest.mark.parametrize(
    ("version", "initials"),
    [("1.0", "CDUSrq"), ("1.1", "CDrSUq"), ("1.2", "CDrSUq"), ("1.3", "CDrSUq"), ("2.0", "CDrSUq")],
)
def test_container_order_by_version(version, initials):
    letters = {
        "C": ICType.CREATE_VARIABLES,
        "D": ICType.DELETE_VARIABLES,
        "S": ICType.SUMMARIES,
        "U": ICType.UPDATES,
        "r": ICType.REQUEST_VARCREATES,
        "q": ICType.REQUEST_VARUPDATES,
    }
    assert features(version).container_order == tuple(letters[letter] for letter in initials)


def test_a_version_that_does_not_exist_has_no_features():
    with pytest.raises(ValueError, match=r"1\.4"):
        features("1.4")


STATUSES = [*BPStatus, *SRPStatus, *VardisStatus]


def test_status_codes_are_spelled_after_their_member():
    for status in STATUSES:
        assert status.endswith("-STATUS-" + status.name.replace("_", "-"))
    assert all(s.startswith("BP-") for s in BPStatus)
    assert all(s.startswith("SRP-") for s in SRPStatus)
    assert all(s.startswith("VARDIS-") for s in VardisStatus)


@pytest.mark.parametrize(
    ("enumeration", "counts"),
    # Codes that occur in the texts of 1.0, 1.1, 1.2, 1.3 and the draft of 2.0.
    [(BPStatus, [6, 8, 8, 8, 8]), (SRPStatus, [2, 2, 2, 2, 2]), (VardisStatus, [10, 10, 10, 10, 10])],
)
def test_number_of_codes_by_version(enumeration, counts):
    assert [sum(s.holds_in(version) for s in enumeration) for version in VERSIONS] == counts


def test_status_meanings_are_sentences():
    assert [s for s in STATUSES if not (s.meaning[0].isupper() and s.meaning.endswith("."))] == []


def test_status_codes_parse_in_both_spellings():
    assert VardisStatus.parse("VARDIS_STATUS_NOT_PRODUCER") is VardisStatus.NOT_PRODUCER
    assert VardisStatus.parse("VARDIS-STATUS-NOT-PRODUCER") is VardisStatus.NOT_PRODUCER
    with pytest.raises(ValueError, match="BP-STATUS-OK"):
        VardisStatus.parse("BP-STATUS-OK")


def test_only_the_ok_codes_report_success():
    assert [str(s) for s in STATUSES if s.is_ok] == ["BP-STATUS-OK", "SRP-STATUS-OK", "VARDIS-STATUS-OK"]


def test_renamed_codes_have_a_counterpart_in_every_version():
    for status in VardisStatus:
        for version in VERSIONS:
            counterpart = status.in_version(version)
            assert counterpart.holds_in(version)
            assert counterpart.in_version(status.since) is status
    assert VardisStatus.EMPTY_VALUE.in_version("1.0") is VardisStatus.INVALID_VALUE
    assert VardisStatus.VARIABLE_IS_DELETED.in_version("1.2") is VardisStatus.VARIABLE_BEING_DELETED
