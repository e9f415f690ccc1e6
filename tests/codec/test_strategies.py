"""The strategies give what they promise: valid messages of every kind, boundaries among them, and damage."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from dcp_lab.testing import strategies
from hypothesis import Phase, find, given, settings
from hypothesis import strategies as st

from dcp_codec import (
    Beacon,
    Codec,
    Container,
    DecodeError,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
    get_codec,
)

from ..chance import examples

RECORDS = {
    "SUMMARIES": VarSumm,
    "UPDATES": VarUpdate,
    "REQUEST-VARUPDATES": VarReqUpdate,
    "REQUEST-VARCREATES": VarReqCreate,
    "CREATE-VARIABLES": VarCreate,
    "DELETE-VARIABLES": VarDelete,
}

# Always the same search, so that a finding is reproducible.
_SEARCH = settings(max_examples=3000, derandomize=True, database=None, phases=[Phase.generate])


def reaches(strategy: st.SearchStrategy[Any], wanted: Callable[[Any], bool]) -> bool:
    """Whether a search finds what is wanted; raises hypothesis.errors.NoSuchExample if not."""
    return find(strategy.map(wanted), bool, settings=_SEARCH)


def test_records(codec: Codec) -> None:
    numbers = codec.profile.vardis.container_types.by_name()

    @settings(max_examples=examples(10))
    @given(st.data())
    def check(data: st.DataObject) -> None:
        for name, cls in RECORDS.items():
            record = data.draw(strategies.records(codec, name))
            assert type(record) is codec.types[cls.__name__]
            assert isinstance(record, cls)
            containers = (Container(numbers[name], (record,)),)
            if codec.profile.vardis.list_length is None:
                found = codec.decode_containers(codec.encode_containers(containers))[0]
                # As text: a NaN does not equal itself.
                assert repr(found.records) == repr((record,))

    check()


def test_payloads(codec: Codec) -> None:
    @settings(max_examples=examples(20))
    @given(strategies.payloads(codec), strategies.beacons(codec))
    def check(payload: Payload, beacon: Beacon) -> None:
        assert codec.decode(codec.encode(Beacon(beacon.bp, (payload,)))).payloads[0].protocol_id == payload.protocol_id

    check()


def test_unknown_names() -> None:
    with pytest.raises(KeyError):
        strategies.records(get_codec("dcp-2.0"), "SUMMARY")
    with pytest.raises(ValueError, match=r"sim-1\.0 cannot encode state reports"):
        strategies.reports(get_codec("sim-1.0"))


@pytest.mark.parametrize(
    "wanted",
    [
        lambda beacon: len(beacon.payloads) == 255,
        lambda beacon: any(payload.srp is not None for payload in beacon.payloads),
        lambda beacon: any(payload.data == b"" for payload in beacon.payloads),
        lambda beacon: any(payload.vardis == () for payload in beacon.payloads),
        lambda beacon: len({type(payload.content) for payload in beacon.payloads}) == 3,
        lambda beacon: beacon.bp.seqno == 2**32 - 1 and beacon.bp.network_id == 0,
    ],
)
def test_variety_of_beacons(wanted: Callable[[Beacon], bool]) -> None:
    assert reaches(strategies.beacons(get_codec("dcp-2.0")), wanted)


def _records(containers: tuple[Container, ...], cls: type) -> list[Any]:
    return [record for container in containers for record in container.records if type(record) is cls]


@pytest.mark.parametrize(
    "wanted",
    [
        lambda found: any(len(container.records) == 255 for container in found),
        lambda found: any(len(record.value) == 255 for record in _records(found, VarUpdate)),
        lambda found: any(len(record.value) == 254 for record in _records(found, VarUpdate)),
        lambda found: any(record.value == b"" for record in _records(found, VarUpdate)),
        lambda found: any(record.spec.descr == b"" for record in _records(found, VarCreate)),
        lambda found: any(record.spec.timeout == 0xFFFF for record in _records(found, VarCreate)),
        lambda found: {container.ic_type for container in found} >= {1, 2, 5},
    ],
)
def test_variety_of_containers(wanted: Callable[[tuple[Container, ...]], bool]) -> None:
    assert reaches(strategies.containers(get_codec("dcp-2.0")), wanted)


@pytest.mark.parametrize(
    "wanted",
    [
        lambda report: report.s_data.x != report.s_data.x,
        lambda report: report.s_data.x == float("inf"),
        lambda report: report.t_stamp == -(2**63),
        lambda report: report.t_stamp == 2**63 - 1,
        lambda report: report.extra[1] == b"\xff\xff",
        lambda report: report.node_id == bytes(6),
    ],
)
def test_variety_of_reports(wanted: Callable[[ExtendedSafetyData], bool]) -> None:
    assert reaches(strategies.reports(get_codec("cpp-2.0")), wanted)


VALID = bytes.fromhex("01497e0200000000bb1111000c0100000029 00020008 0103 070308030903")


def reason(octets: bytes) -> str:
    try:
        get_codec("dcp-2.0").decode(octets)
    except DecodeError as error:
        return error.problem.reason
    return ""


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    "wanted",
    [
        "truncated",
        "bad-version",
        "bad-magic",
        "zero-length",
        "zero-count",
        "beacon-overrun",
        "block-overrun",
        "count-mismatch",
        "unknown-type",
        "",
    ],
)
def test_variety_of_mutations(wanted: str) -> None:
    mutated = strategies.mutations(st.just(VALID), get_codec("dcp-2.0").dissect)
    assert reaches(mutated, lambda octets: octets != VALID and reason(octets) == wanted)


@pytest.mark.parametrize(
    "wanted",
    [
        lambda octets: octets == VALID[:1],
        lambda octets: octets == b"",
        lambda octets: octets[:-1] == VALID,
        lambda octets: len(octets) > len(VALID) and octets[:1] + octets[-4:] == VALID[:1] + VALID[-4:],
        lambda octets: len(octets) < len(VALID) and octets[:1] + octets[-4:] == VALID[:1] + VALID[-4:],
    ],
)
def test_variety_of_mutations_without_a_dissector(wanted: Callable[[bytes], bool]) -> None:
    assert reaches(strategies.mutations(st.just(VALID)), wanted)


def test_mutations_of_octets_at_another_offset() -> None:
    """Fields are found by their place in the octets, whatever their offsets are called."""
    codec = get_codec("dcp-2.0")

    @settings(max_examples=examples(50))
    @given(strategies.mutations(st.just(VALID), lambda octets: codec.dissect(octets, base=14)))
    def check(octets: bytes) -> None:
        assert len(octets) <= 2 * len(VALID) + 24

    check()
