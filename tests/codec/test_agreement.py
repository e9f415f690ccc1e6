"""The views of a layout agree: compiled decoder and encoder, construct, and the dissector, on good and on bad octets.

Every property runs over every built-in profile and the odd ones of conftest.py, for whole beacons, envelopes, state
reports and VarDis payloads.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import construct as cs
import msgspec
import pytest
from dcp_lab.testing import strategies
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.reasons import REASONS, WARNINGS
from hypothesis import given, settings
from hypothesis import strategies as st

from dcp_codec import Codec, DecodeError, Dissection, EncodeError, Problem, VarSumm
from dcp_codec.plan.tree import Exact, Group, Many, Node, Region, Select
from dcp_codec.views.dissect import dissect
from dcp_codec.views.dissector import Doubt, generate_dissector
from dcp_codec.views.lint import DOUBTS, warnings

from ..chance import examples

PARTS = ("beacon", "envelope", "containers", "report")


@dataclass(frozen=True)
class View:
    """One layout of a codec with everything that reads or writes it."""

    codec: Codec
    plan: Node
    schema: Any
    decode: Callable[[bytes], tuple[Any, int]]
    encode: Callable[[Any], bytes]
    values: st.SearchStrategy[Any]
    # A state report without a fixed size ends where it ends; what follows it is the business of who asked.
    open_ended: bool = False

    def dissect(self, octets: bytes) -> Dissection:
        return dissect(self.plan, octets)


def view_of(codec: Codec, part: str) -> View:
    schema = codec.schema
    match part:
        case "beacon":
            return View(
                codec, codec.beacon_plan, schema.beacon, codec.decode_from, codec.encode, strategies.beacons(codec)
            )
        case "envelope":
            return View(
                codec,
                codec.envelope_plan,
                schema.envelope,
                codec.decode_envelope,
                codec.encode_envelope,
                strategies.envelopes(codec),
            )
        case "containers":
            return View(
                codec,
                codec.containers_plan,
                schema.containers,
                lambda octets: (codec.decode_containers(octets), len(octets)),
                codec.encode_containers,
                strategies.containers(codec),
            )
        case _:
            if codec.report_plan is None:
                pytest.skip("the profile has no octets for a state report")
            return View(
                codec,
                codec.report_plan,
                schema.srp,
                lambda octets: (codec.decode_report(octets), len(octets)),
                codec.encode_report,
                strategies.reports(codec),
                open_ended=isinstance(codec.report_plan, Group),
            )


@pytest.fixture(scope="session", params=PARTS)
def view(request: pytest.FixtureRequest, codec: Codec) -> View:
    return view_of(codec, request.param)


def plain(value: Any) -> Any:
    """Nested tuples that compare as octets do: every NaN equals itself, -0.0 is not 0.0."""
    if isinstance(value, msgspec.Struct):
        return (type(value).__name__, *(plain(getattr(value, name)) for name in value.__struct_fields__))
    if isinstance(value, tuple | list):
        return tuple(plain(item) for item in value)
    return struct.pack(">d", value) if isinstance(value, float) else value


def from_construct(view: View, node: Node, parsed: Any, siblings: Any = None) -> Any:
    """Convert the result of construct to values of the codec."""
    types = view.codec.types
    match node:
        case Group() | Exact():
            group = node.content if isinstance(node, Exact) else node
            names, foreign = types.slots(group)
            found = {
                attribute: from_construct(view, member, parsed[member.name], parsed)
                for member in group.members
                if (attribute := types.attribute(group, member)) is not None
            }
            if foreign:
                found["extra"] = tuple(parsed[member.name] for member in foreign)
            if "bp" in names:
                found.setdefault("bp", None)
            return types[group.type_name](**found)
        case Many():
            return tuple(from_construct(view, node.element, item) for item in parsed)
        case Region():
            return from_construct(view, node.content, parsed, siblings)
        case Select():
            case = node.cases.get(siblings[node.key], node.default)
            assert case is not None
            return from_construct(view, case, parsed)
        case _:
            return parsed


def to_construct(view: View, node: Node, value: Any, siblings: Any = None) -> Any:
    """A value of the codec as the dictionaries that construct builds; derived members are left out."""
    types = view.codec.types
    match node:
        case Group() | Exact():
            group = node.content if isinstance(node, Exact) else node
            foreign = types.slots(group)[1]
            found: dict[str, Any] = dict(zip((m.name for m in foreign), getattr(value, "extra", ()), strict=False))
            for member in group.members:
                attribute = types.attribute(group, member)
                if attribute is not None:
                    found[member.name] = to_construct(view, member, getattr(value, attribute), found)
            return found
        case Many():
            return [to_construct(view, node.element, item) for item in value]
        case Region():
            return to_construct(view, node.content, value, siblings)
        case Select():
            case = node.cases.get(siblings[node.key], node.default)
            assert case is not None
            return to_construct(view, case, value)
        case _:
            return value


def decoded(view: View, octets: bytes) -> tuple[Any, int] | Problem:
    try:
        return view.decode(octets)
    except DecodeError as error:
        return error.problem


def parsed(view: View, octets: bytes) -> Any:
    """Parse ``octets`` with construct and return a value of the codec; None if construct refuses them."""
    try:
        return from_construct(view, view.plan, view.schema.parse(octets))
    except cs.ConstructError:
        return None


def check_agreement(view: View, octets: bytes) -> None:
    """Decoder, dissector and construct say the same about any octets."""
    found, seen = decoded(view, octets), view.dissect(octets)
    for problem in seen.problems:
        assert problem.reason in REASONS
        assert problem.requirement is None or problem.requirement in requirements()
        assert str(problem)
    if view.open_ended and not seen.errors and seen.padding:
        assert found == Problem("leftover", "", seen.end, 0, len(seen.padding), "SRP-RX-01")
        return
    if isinstance(found, Problem):
        assert found == seen.errors[0]
        assert parsed(view, octets) is None
        return
    value, end = found
    assert seen.errors == []
    assert (end, octets[end:]) == (seen.end, seen.padding)
    by_construct = parsed(view, octets)
    assert by_construct is not None
    assert plain(by_construct) == plain(value)
    # Padding and the order of things inside lengths are all that two octet strings of one value may differ in.
    again = view.encode(value)
    assert plain(view.decode(again)[0]) == plain(value)
    assert len(again) == end


@pytest.mark.req("BP-FMT-01", "DATA-02", "BP-HDR-10")
def test_round_trip(view: View) -> None:
    @settings(max_examples=examples(25))
    @given(view.values)
    def check(value: Any) -> None:
        octets = view.encode(value)
        back, end = view.decode(octets)
        assert plain(back) == plain(value)
        assert end == len(octets)
        assert view.encode(back) == octets
        assert view.schema.build(to_construct(view, view.plan, value)) == octets
        check_agreement(view, octets)

    check()


@pytest.mark.req("BP-RX-16", "VD-RX-07", "SRP-RX-01")
def test_damaged(view: View) -> None:
    @settings(max_examples=examples(40))
    @given(strategies.mutations(view.values.map(view.encode), view.dissect))
    def check(octets: bytes) -> None:
        check_agreement(view, octets)

    check()


@pytest.mark.req("BP-RX-16", "VD-ROB-01")
def test_arbitrary(view: View) -> None:
    @settings(max_examples=examples(25))
    @given(st.binary(max_size=64))
    def check(octets: bytes) -> None:
        check_agreement(view, octets)

    check()


@pytest.mark.req("BP-RX-16")
def test_cut_off_anywhere(view: View) -> None:
    @settings(max_examples=examples(3))
    @given(view.values.map(view.encode).filter(lambda octets: len(octets) < 4096))
    def check(octets: bytes) -> None:
        for size in range(min(len(octets), 300)):
            check_agreement(view, octets[:size])

    check()


@pytest.mark.req("BP-RX-14")
def test_padding_is_ignored(codec: Codec) -> None:
    if not codec.profile.bp.header:
        pytest.skip("without a header nothing says where the payloads end")

    @settings(max_examples=examples(15))
    @given(strategies.beacons(codec), st.binary(max_size=46))
    def check(beacon: Any, padding: bytes) -> None:
        octets = codec.encode(beacon)
        back, end = codec.decode_from(octets + padding)
        assert plain(back) == plain(beacon)
        assert end == len(octets)
        assert plain(codec.decode(octets + padding)) == plain(beacon)
        found = codec.dissect(octets + padding)
        assert found.errors == []
        assert (found.end, found.padding) == (len(octets), padding)

    check()


def test_lint_only_warns(codec: Codec) -> None:
    """Rules beyond the layout never turn into errors and never raise, whatever the octets are."""

    @settings(max_examples=examples(25))
    @given(strategies.mutations(strategies.beacons(codec).map(codec.encode), codec.dissect))
    def check(octets: bytes) -> None:
        found = codec.dissect(octets)
        assert found.errors == dissect(codec.beacon_plan, octets).problems
        assert {warning.reason for warning in found.warnings} <= set(WARNINGS)
        assert all(warning.requirement in requirements() and str(warning) for warning in found.warnings)
        assert all(repr(field) for field in found.root.walk())

    check()


def test_every_record_that_breaks_a_rule_is_doubtful(codec: Codec) -> None:
    """Looking at all records finds no more warnings than looking at the doubtful ones."""
    every = {name: Doubt((), lambda: True) for name in DOUBTS}
    dissect_all = generate_dissector(codec.beacon_plan, "with every record in doubt", every)

    @settings(max_examples=examples(25))
    @given(strategies.mutations(strategies.beacons(codec).map(codec.encode), codec.dissect))
    def check(octets: bytes) -> None:
        assert codec.dissect(octets).warnings == warnings(dissect_all(octets, 0, 0))

    check()


def test_fields_have_the_offsets_that_they_state(view: View) -> None:
    """The parts of a dissection are octets of the message, in order, without holes in records."""

    @settings(max_examples=examples(15))
    @given(view.values.map(view.encode), st.integers(0, 99))
    def check(octets: bytes, base: int) -> None:
        found = dissect(view.plan, b"\xaa\xbb" + octets, start=2, base=base)
        assert found.root.raw == octets
        assert found.end == base + len(octets)
        paths = [field.path for field in found.root.walk()]
        for field in found.root.walk():
            start = field.offset - base
            assert field.raw == octets[start : start + field.length]
            if field.children:
                assert field.children[0].offset == field.offset
                assert sum(child.length for child in field.children) == field.length
        for path in {paths[0], paths[len(paths) // 2], paths[-1]}:
            assert getattr(found.root.find(path), "path", None) == path

    check()


def test_extra_octets_default_to_zeros(codec: Codec) -> None:
    @settings(max_examples=examples(15))
    @given(strategies.beacons(codec))
    def check(beacon: Any) -> None:
        bare = msgspec.structs.replace(
            beacon, payloads=tuple(msgspec.structs.replace(block, extra=()) for block in beacon.payloads)
        )
        octets = codec.encode(bare)
        for block, zeroed in zip(beacon.payloads, codec.decode(octets).payloads, strict=True):
            assert [type(entry) for entry in zeroed.extra] == [type(entry) for entry in block.extra]
            assert not any(any(entry) if isinstance(entry, bytes) else entry for entry in zeroed.extra)
            assert plain(zeroed.content) == plain(block.content)

    check()


# -- values that cannot be encoded --------------------------------------------------------------------------------

_WRONG = st.sampled_from(
    (
        None,
        "text",
        "12:34:56:78:9a:bc",
        5,
        5.5,
        -1,
        1 << 64,
        -(1 << 63) - 1,
        b"",
        b"\0",
        b"seven77",
        bytes(70_000),
        bytearray(b"\0a"),
        (),
        [],
        (1, 2),
        {},
        {0: 1},
        {"a": 1},
        object,
        VarSumm(1, 2),
        (VarSumm(1, 2),),
        (VarSumm(1, 2),) * 256,
        (None,),
    )
)


def encoded(view: View, value: Any) -> tuple[bytes, EncodeError | None]:
    try:
        return view.encode(value), None
    except EncodeError as error:
        return b"", error


def places(view: View, node: Node, value: Any, path: str = "", steps: tuple[Any, ...] = ()) -> Iterator[Any]:
    """(path, steps) of every stored member of a value; ``steps`` are attribute names and indices."""
    types = view.codec.types
    match node:
        case Group() | Exact():
            group = node.content if isinstance(node, Exact) else node
            keys = {}
            for member in group.members:
                attribute = types.attribute(group, member)
                if attribute is None:
                    continue
                below = getattr(value, attribute)
                keys[member.name] = below
                content = member.content if isinstance(member, Region) else member
                name = content.name
                if isinstance(content, Select):
                    chosen = content.cases.get(keys[content.key], content.default)
                    assert chosen is not None
                    content, name = chosen, chosen.name
                here = f"{path}.{name}".lstrip(".")
                yield here, (*steps, attribute)
                yield from places(view, content, below, here, (*steps, attribute))
            if types.slots(group)[1]:
                yield f"{path}.extra".lstrip("."), (*steps, "extra")
                for index, member in enumerate(types.slots(group)[1]):
                    yield f"{path}.{member.name}".lstrip("."), (*steps, "extra", index)
        case Many():
            for index, item in enumerate(value[:6]):
                yield f"{path}[{index}]", (*steps, index)
                yield from places(view, node.element, item, f"{path}[{index}]", (*steps, index))
        case _:
            pass


def put(value: Any, steps: tuple[Any, ...], new: Any) -> Any:
    """``value`` with ``new`` where ``steps`` lead."""
    if not steps:
        return new
    step, *rest = steps
    if isinstance(step, int):
        return (*value[:step], put(value[step], tuple(rest), new), *value[step + 1 :])
    return msgspec.structs.replace(value, **{step: put(getattr(value, step), tuple(rest), new)})


def test_wrong_values_name_the_field(view: View) -> None:
    """One member of a good value replaced by anything: encoded, or an EncodeError with the path of that member."""

    @settings(max_examples=examples(60))
    @given(view.values, st.data(), _WRONG)
    def check(value: Any, data: st.DataObject, wrong: Any) -> None:
        found = list(places(view, view.plan, value))
        if not found:
            return
        path, steps = data.draw(st.sampled_from(found))
        octets, error = encoded(view, put(value, steps, wrong))
        if error is None:
            again = view.decode(octets)[0]
            assert view.encode(again) == octets
            return
        # A part too large may only be too large for the length around it; what a key chooses, what extra holds
        # and what is left of an area have paths of their own beside the member that was replaced.
        beside = steps[-1] in ("protocol_id", "ic_type", "content", "extra")
        place = path.rpartition(".")[0] if beside else path
        assert error.path
        # A member that may have another length leaves an area with another rest, which is then what does not fit.
        area = error.path.removesuffix("area") if error.path.endswith("].area") else error.path
        assert error.path.startswith(place) or path.startswith(area), (path, error.path)
        assert error.why
        assert str(error).startswith(error.path)

    check()


@pytest.mark.parametrize("wrong", [None, 5, b"octets", "text", VarSumm(1, 2), object(), [], {}])
def test_no_message_at_all(codec: Codec, wrong: Any) -> None:
    encoders = [codec.encode, codec.encode_envelope]
    encoders += [codec.encode_report] if codec.report_plan is not None else []
    encoders += [codec.encode_containers] if wrong != [] else []
    for encode in encoders:
        with pytest.raises(EncodeError):
            encode(wrong)
