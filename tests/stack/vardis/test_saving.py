"""A VarDis that was saved and restored behaves as one that was not."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from ..vardis_rig import OTHER, THIRD, WALL, Rig, VarDelete, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate

IDS = st.integers(1, 3)
NUMBERS = st.integers(0, 255)
STEPS = st.one_of(
    st.tuples(st.just("create"), IDS, st.integers(0, 1500)),
    st.tuples(st.sampled_from(["update", "delete", "deactivate", "activate"]), IDS, st.just(0)),
    st.tuples(st.just("wait"), st.just(0), st.integers(1, 2000)),
    st.tuples(st.just("send"), st.just(0), st.just(0)),
    st.tuples(st.sampled_from(["vc", "vc-own", "vu", "vs", "vd", "ru", "rc"]), IDS, NUMBERS),
)


def act(rig: Rig, kind: str, var_id: int, number: int):
    """Execute a step; returns what can be observed of it from outside."""
    rig.vardis.hears((OTHER, THIRD)[number % 2])
    match kind:
        case "create":
            return rig.create(var_id, timeout=number)
        case "update":
            return rig.update(var_id)
        case "delete":
            return rig.delete(var_id)
        case "activate" | "deactivate":
            return getattr(rig.vardis, kind)().status
        case "wait":
            return rig.wait(number)
        case "send":
            return rig.sent()
        case "vc" | "vc-own":
            producer = rig.config.node_id if kind == "vc-own" else OTHER
            record = rig.vc(var_id, prod_id=producer, created=WALL + number, seqno=number, timeout=number)
        case "vu":
            record = VarUpdate(var_id, number, b"new")
        case "vs":
            record = VarSumm(var_id, number)
        case "ru":
            record = VarReqUpdate(var_id, number)
        case "rc":
            record = VarReqCreate(var_id)
        case _:
            record = VarDelete(var_id)
    return rig.receive(record)


@given(st.sampled_from(["1.0", "1.3", "2.0"]), st.lists(STEPS, max_size=25), st.lists(STEPS, min_size=1, max_size=25))
@settings(max_examples=150)
def test_a_restored_node_behaves_as_the_saved_one(version, before, after):
    saved, restored = Rig(version), Rig(version)
    for step in before:
        if not (step[0] == "create" and version != "2.0" and step[2]):
            act(saved, *step)
    state = saved.vardis.save()
    # A content of another node does not remain.
    restored.create(2)
    restored.receive(VarSumm(3, 5))
    restored.vardis.restore(state)
    restored.now = saved.now
    restored.bp.slot = saved.bp.slot
    assert restored.vardis.save() == state
    assert hash(restored.vardis.save()) == hash(state)
    for step in after:
        if not (step[0] == "create" and version != "2.0" and step[2]):
            assert act(restored, *step) == act(saved, *step), step
    assert restored.vardis.save() == saved.vardis.save()
    assert restored.vardis.obstacles(restored.now) == saved.vardis.obstacles(saved.now)
    assert restored.vardis.poll_timeout() == saved.vardis.poll_timeout()


def test_a_saved_content_does_not_change_with_the_node():
    rig = Rig()
    rig.create()
    state = rig.vardis.save()
    rig.update()
    rig.delete()
    assert state != rig.vardis.save()
    rig.vardis.restore(state)
    assert rig.read() == b"ABCD"
