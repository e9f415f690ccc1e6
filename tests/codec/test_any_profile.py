"""The codec works for any profile: profiles themselves are drawn, and every view of them has to agree."""

from __future__ import annotations

from typing import Any

import construct as cs
import msgspec
from dcp_lab.testing import strategies
from dcp_spec.profile.definition import (
    RECORD_MEMBERS,
    BPLayout,
    ContainerTypes,
    IntType,
    NodeIdType,
    OwnContainer,
    OwnField,
    Profile,
    RealType,
    RecordLayouts,
    SafetyField,
    SRPLayout,
    TextType,
    TimestampType,
    Types,
    VardisLayout,
    standard_fields,
)
from dcp_spec.profile.loading import load_profile
from dcp_spec.profile.rules import contradictions
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec import Codec, DecodeError
from dcp_codec.jsonform import beacon_from_json, value_json

from ..chance import examples

_ORDERS = st.sampled_from(["big", "little"])
_FLOATS_OR_INTS = st.sampled_from(["f64", "f32", "i8", "i16", "i32", "i64", "u8", "u16", "u32", "u64"])


def integers(low: int = 1, *, length: bool = False) -> st.SearchStrategy[IntType]:
    signed = st.just(False) if length else st.booleans()
    return st.builds(IntType, width=st.integers(low, 8), byte_order=_ORDERS, signed=signed)


@st.composite
def own_fields(draw: st.DrawFn) -> OwnField:
    """A field of the implementation's own, of any kind."""
    name = draw(st.sampled_from(["own1", "ownTwo", "own_3"]))
    match draw(st.sampled_from(["opaque", "extra", "real", "block", "text"])):
        case "opaque":
            return OwnField(name=name, opaque=draw(st.integers(1, 9)))
        case "extra":
            return OwnField(name=name, extra=draw(integers()))
        case "real":
            return OwnField(name=name, real=RealType(width=draw(st.sampled_from([4, 8])), byte_order=draw(_ORDERS)))
        case kind:
            lengths = tuple(draw(st.lists(integers(length=True), max_size=2)))
            ended = not lengths or draw(st.booleans())
            return OwnField(name=name, block=TextType(lengths=lengths, terminated=ended), text=kind == "text")


@st.composite
def profiles(draw: st.DrawFn) -> Profile:
    """Profiles without contradictions, far beyond what anyone has built."""
    base = load_profile(draw(st.sampled_from(["dcp-1.1", "dcp-1.3", "dcp-2.0"])))
    lengths = st.lists(integers(length=True), min_size=1, max_size=3).map(tuple)
    headless = draw(st.integers(0, 4)) == 0
    node_id = st.builds(NodeIdType, width=st.integers(1, 20), representation=st.just("hex"))
    if headless:
        text = st.builds(
            NodeIdType,
            width=st.just(0),
            representation=st.sampled_from(["text", "hex"]),
            length=integers(length=True),
        )
        node_id = st.one_of(node_id, text)
    types = Types(
        node_id=draw(node_id),
        timestamp=draw(st.builds(TimestampType, width=st.integers(1, 8), byte_order=_ORDERS, signed=st.booleans())),
        magic_no=draw(integers(2)),
        protocol_id=draw(integers()),
        bp_length=draw(integers(length=True)),
        network_id=draw(integers(2)),
        bp_seqno=draw(integers()),
        srp_seqno=draw(integers()),
        var_id=draw(integers()),
        var_rep_cnt=draw(integers()),
        var_seqno=draw(integers()),
        var_timeout=draw(integers()),
        string=draw(
            st.one_of(
                st.builds(TextType, lengths=lengths, terminated=st.booleans()),
                st.just(TextType(lengths=(), terminated=True)),
            )
        ),
        value=draw(st.builds(TextType, lengths=lengths, terminated=st.booleans())),
    )
    names = iter(draw(st.permutations(["alpha", "beta", "gammaRay", "delta_4", "x9", "Y", "z_", "n0ne"])))
    opaque = OwnField(opaque=draw(st.integers(1, 9)), name=next(names))
    block: list[Any] = ["protocolId", "length", *([opaque] if draw(st.booleans()) else [])]
    bp = BPLayout(
        header=() if headless else tuple(draw(st.permutations(base.bp.header))),
        payload_header=tuple(draw(st.permutations(block))),
        length_means=draw(st.sampled_from(["blocks", "header-size"])) if "length" in base.bp.header else "blocks",
        payload_area=draw(st.sampled_from([0, 0, 1, 90, 300])),
    )
    data = [
        SafetyField(name=f"d{number}", type=kind, byte_order=draw(_ORDERS))
        for number, kind in enumerate(draw(st.lists(_FLOATS_OR_INTS, min_size=1, max_size=5)))
    ]
    data.append(SafetyField(name="hidden", type="opaque", octets=draw(st.integers(1, 9))))
    record: list[Any] = ["sData", "nodeId", "tStamp", "seqno"]
    record += [OwnField(opaque=draw(st.integers(1, 9)), name=next(names)) for _ in range(draw(st.integers(0, 2)))]
    numbers = draw(st.lists(st.integers(0, 255), min_size=8, max_size=8, unique=True))

    def with_own(*standard: str) -> tuple[Any, ...]:
        own = draw(st.lists(own_fields(), max_size=2, unique_by=lambda field: field.name))
        return tuple(draw(st.permutations([*standard, *own])))

    containers = [
        OwnContainer(name=name, number=number, record=listed)
        for name, number in zip(("GEO-FENCE", "x1"), numbers[6:], strict=True)
        if (listed := with_own(*draw(st.sampled_from([(), ("varId",), ("seqno", "value", "descr")]))))
    ]
    extra = draw(st.lists(integers(), max_size=2))
    return msgspec.structs.replace(
        base,
        name="drawn",
        types=types,
        bp=bp,
        srp=SRPLayout(
            record=tuple(draw(st.permutations(record))) if draw(st.integers(0, 3)) else with_own(),
            safety_data=tuple(data),
        ),
        vardis=VardisLayout(
            var_spec=with_own(*standard_fields(base.vardis.var_spec)),
            records=RecordLayouts(*(with_own(*members) for members in RECORD_MEMBERS.values())),
            own_containers=tuple(containers),
            container_types=ContainerTypes(*numbers[:6]),
            container_extra=tuple(OwnField(extra=each, name=next(names)) for each in extra),
            list_length=draw(st.one_of(st.none(), integers(length=True))),
        ),
        limits=msgspec.structs.replace(base.limits, max_value_length=1, max_description_length=1),
    )


def plain(value: Any) -> Any:
    """``repr`` is the same for every NaN and tells -0.0 from 0.0."""
    return repr(value)


@settings(max_examples=examples(120))
@given(profiles().filter(lambda profile: not list(contradictions(profile))), st.data())
def test_any_profile(profile: Profile, data: st.DataObject) -> None:
    codec = Codec(profile)
    beacon = data.draw(strategies.beacons(codec))
    octets = codec.encode(beacon)
    assert codec.decode_from(octets)[1] == len(octets)
    assert plain(codec.decode(octets)) == plain(beacon)
    assert plain(beacon_from_json(codec, value_json(codec, beacon))) == plain(beacon)
    damaged = data.draw(strategies.mutations(st.just(octets), codec.dissect))
    for candidate in (octets, damaged, octets[: len(octets) // 2]):
        found = codec.dissect(candidate)
        assert accepted_by_construct(codec, candidate) == (not found.errors)
        try:
            value, end = codec.decode_from(candidate)
        except DecodeError as error:
            problem = error.problem
        else:
            assert found.errors == []
            assert (end, candidate[end:]) == (found.end, found.padding)
            assert plain(codec.decode(codec.encode(value))) == plain(value)
            continue
        assert problem == found.errors[0]


def accepted_by_construct(codec: Codec, octets: bytes) -> bool:
    try:
        codec.schema.beacon.parse(octets)
    except cs.ConstructError:
        return False
    return True
