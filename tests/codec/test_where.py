"""Conditions of ``dcp-codec filter``: what they select, and that nothing of them is executed."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dcp_codec import get_codec
from dcp_codec.analysis.conditions import Where, WhereError, field_names
from dcp_codec.capture import open_capture
from dcp_codec.framing.frames import DissectedFrame, FrameDissector

CODEC = get_codec("cpp-2.0")
CAPTURES = Path(__file__).resolve().parents[2] / "captures"


def where(text: str) -> Where:
    return Where(text, CODEC.profile, CODEC.beacon_plan)


@pytest.fixture(scope="module")
def frames() -> list[DissectedFrame]:
    dissector = FrameDissector(CODEC)
    with open_capture(CAPTURES / "b_crud.mcap") as reader:
        found = [dissector.dissect(frame) for frame in reader]
    return [each for each in found if isinstance(each, DissectedFrame)]


def kinds(frame: DissectedFrame) -> set[int]:
    return {field.value for field in frame.dissection.root.walk() if field.name == "icType"}


def held(frame: DissectedFrame, ending: str) -> set[Any]:
    """Values of the fields whose paths end so; descriptions as text."""
    found = {each.value for each in frame.dissection.root.walk() if each.path.endswith(f".{ending}")}
    return {each.decode() if isinstance(each, bytes) else each for each in found}


def seqno(frame: DissectedFrame) -> int:
    header = frame.header
    assert header is not None
    field = header.child("seqno")
    assert field is not None
    return int(field.value)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("vardis.icType == 6", lambda f: 6 in kinds(f)),
        ("dcp.payloads.vardis.icType == 6", lambda f: 6 in kinds(f)),
        ("icType == 'DELETE-VARIABLES'", lambda f: 6 in kinds(f)),
        ("vardis.icType != 6", lambda f: 6 not in kinds(f)),
        ("vardis.icType in (5, 6)", lambda f: bool(kinds(f) & {5, 6})),
        ("vardis.icType not in (5, 6)", lambda f: not kinds(f) & {5, 6}),
        ("!(vardis.icType == 6) && bp.seqno < 50", lambda f: 6 not in kinds(f) and seqno(f) < 50),
        ("10 <= bp.seqno <= 20", lambda f: 10 <= seqno(f) <= 20),
        ("bp.senderId == 02:00:00:00:00:02", lambda f: f.sender == "02:00:00:00:00:02"),
        ("bp.senderId == '020000000002' || bp.seqno == 0", lambda f: f.sender[-1] == "2" or seqno(f) == 0),
        ("records.spec.descr", lambda f: 5 in kinds(f)),
        ("descr", lambda f: 5 in kinds(f)),
        ('descr == "rep15"', lambda f: "rep15" in held(f, "descr")),
        ("varId == 15", lambda f: 15 in held(f, "varId")),
        ("varId != 15", lambda f: 15 not in held(f, "varId")),
        ("spec.varId == 33", lambda f: 33 in held(f, "spec.varId")),
        ("frame.number > 100 and not errors.reason", lambda f: f.frame.number > 100),
        ("eth.src == 02:00:00:00:00:03", lambda f: f.framing.src[-1] == 3),
    ],
)
def test_conditions_select(text: str, wanted, frames: list[DissectedFrame]) -> None:
    condition = where(text)
    found = [frame.frame.number for frame in frames if condition(frame)]
    assert found == [frame.frame.number for frame in frames if wanted(frame)]
    assert 0 < len(found) < len(frames)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("srp.foo == 1", "'srp.foo' is not the name of a field; did you mean"),
        ("__import__('os').system('true')", "use comparisons, names, and, or, not"),
        ("(lambda: 1)()", "use comparisons"),
        ("bp.seqno == (1).__class__", "compare with a number"),
        ("bp.seqno == f'{1}'", "compare with a number"),
        ("bp.seqno + 1 == 2", "a comparison needs the name of a field"),
        ("bp.seqno in 5", "in needs a list"),
        ("bp.seqno ==", "is not a condition"),
        ("", "is not a condition"),
        ("not " * 200 + "padding", "nested too deeply"),
        ("padding " * 2000, "more than 4096"),
        ("bp.seqno is 5", "compare with =="),
    ],
)
def test_invalid_conditions_are_refused(text: str, message: str) -> None:
    with pytest.raises(WhereError) as caught:
        where(text)
    assert message in str(caught.value)


@given(st.text(st.sampled_from("bp.seqno=<>!&|() 01:\"'[]{}lambda,not in\\\n"), max_size=40))
def test_any_text_is_a_condition_or_refused(text: str) -> None:
    with contextlib.suppress(WhereError):
        where(text)


def test_every_name_can_be_used() -> None:
    names = field_names(CODEC.beacon_plan)
    assert {"bp.senderId", "payloads.srp.sData.x", "payloads.vardis.records.upd.value"} <= set(names)
    for name in names:
        where(name)
        where(f"dcp.{name} == 1")
