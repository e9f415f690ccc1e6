"""Every cell of the table of states and events (section C.5 of the protocol reference), written down a second time."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
from dcp_spec.status import VardisStatus

from ..vardis_rig import (
    ME,
    OTHER,
    THIRD,
    VERSIONS,
    WALL,
    Rig,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)

R = 2
SEQ = 5
TIMEOUT_MS = 400

UNKNOWN, OWN, FOREIGN, OWN_DELETED, FOREIGN_DELETED = "U", "A,P", "A,C", "D,P", "D,C"
STATES = (UNKNOWN, OWN, FOREIGN, OWN_DELETED, FOREIGN_DELETED)


@dataclass
class Seen:
    """The state of variable 7 as seen from outside, when nothing was pending before."""

    state: str
    create: int = 0
    update: int = 0
    delete: int = 0
    asks: str = ""
    value: bytes | None = None
    seqno: int | None = None


def in_state(state: str, version: str = "2.0") -> Rig:
    """A node whose variable 7 is in this state with sequence number 5, and which has nothing to send but summaries."""
    rig = Rig(version, max_repetitions=15)
    timeout = TIMEOUT_MS if version == "2.0" else 0
    if state in (OWN, OWN_DELETED):
        assert rig.create(value=b"old", rep_cnt=R, timeout=timeout).is_ok
        for _ in range(SEQ):
            assert rig.update(value=b"old").is_ok
    if state in (FOREIGN, FOREIGN_DELETED):
        rig.receive(rig.vc(value=b"old", seqno=SEQ, rep_cnt=R, timeout=timeout))
    if state == OWN_DELETED:
        assert rig.delete().is_ok
    if state == FOREIGN_DELETED:
        rig.receive(VarDelete(7))
    if version == "2.0" or state in (OWN, FOREIGN):
        rig.drain()
    assert seen(rig).state == state
    return rig


def seen(rig: Rig) -> Seen:
    entry = rig.entry()
    asks = " ".join(name for name in ("reqCreateQ", "reqUpdQ") if 7 in rig.queue(name))
    if entry is None:
        return Seen(UNKNOWN, asks=asks)
    state = ("D" if entry.is_deleted else "A") + (",P" if entry.spec.prod_id == ME else ",C")
    return Seen(state, entry.count_create, entry.count_update, entry.count_delete, asks, entry.value, entry.seqno)


def scrub(rig: Rig) -> None:
    """Run the scrubbing process long after, with BP still holding a payload so that nothing is composed."""
    rig.bp.slot = b"payload"
    rig.vardis.handle_timeout(rig.now + 10**10, rig.wall + 10**10)


#: Event -> how to bring it about. "new" is what a value is where the event brings one.
EVENTS = {
    "app Create": lambda rig: rig.create(value=b"new", rep_cnt=R),
    "app Update": lambda rig: rig.update(value=b"new"),
    "app Delete": lambda rig: rig.delete(),
    "app Read": lambda rig: rig.read(),
    "rx VC prodId=own": lambda rig: rig.receive(rig.vc(value=b"new", prod_id=ME, created=WALL + 10**12)),
    "rx VC foreign, time > stored": lambda rig: rig.receive(rig.vc(value=b"new", created=WALL + 10**12)),
    "rx VC foreign, time = stored": lambda rig: rig.receive(
        rig.vc(value=b"new", created=rig.entry().spec.creation_time or 0)
    ),
    "rx VC foreign, time < stored": lambda rig: rig.receive(rig.vc(value=b"new", created=1)),
    "rx VD": lambda rig: rig.receive(VarDelete(7)),
    "rx VU newer": lambda rig: rig.receive(VarUpdate(7, SEQ + 1, b"new")),
    "rx VU equal": lambda rig: rig.receive(VarUpdate(7, SEQ, b"new")),
    "rx VU older": lambda rig: rig.receive(VarUpdate(7, SEQ - 1, b"new")),
    "rx VU bad value": lambda rig: rig.receive(VarUpdate(7, SEQ - 1, bytes(33))),
    "rx VS newer": lambda rig: rig.receive(VarSumm(7, SEQ + 1)),
    "rx VS equal": lambda rig: rig.receive(VarSumm(7, SEQ)),
    "rx VS older": lambda rig: rig.receive(VarSumm(7, SEQ - 1)),
    "rx RU, own strictly newer": lambda rig: rig.receive(VarReqUpdate(7, SEQ - 1)),
    "rx RU equal": lambda rig: rig.receive(VarReqUpdate(7, SEQ)),
    "rx RU ahead": lambda rig: rig.receive(VarReqUpdate(7, SEQ + 1)),
    "rx RC": lambda rig: rig.receive(VarReqCreate(7)),
    "scrub": scrub,
}

SAME = "ignore"
NEW_OWN = Seen(OWN, create=R, value=b"new", seqno=0)
NEW_FOREIGN = Seen(FOREIGN, create=R, value=b"new", seqno=0)

#: Event -> what follows in U, A P, A C, D P, D C: a status, what is seen afterwards, or nothing.
TABLE = {
    "app Create": (NEW_OWN, NEW_OWN, "VARIABLE-EXISTS", NEW_OWN, "VARIABLE-EXISTS"),
    "app Update": (
        "VARIABLE-DOES-NOT-EXIST",
        Seen(OWN, update=R, value=b"new", seqno=SEQ + 1),
        "NOT-PRODUCER",
        "VARIABLE-IS-DELETED",
        "NOT-PRODUCER",
    ),
    "app Delete": (
        "VARIABLE-DOES-NOT-EXIST",
        Seen(OWN_DELETED, delete=R, value=b"old", seqno=SEQ),
        "NOT-PRODUCER",
        "VARIABLE-IS-DELETED",
        "NOT-PRODUCER",
    ),
    "app Read": ("VARIABLE-DOES-NOT-EXIST", b"old", b"old", "VARIABLE-IS-DELETED", "VARIABLE-IS-DELETED"),
    "rx VC prodId=own": (SAME, SAME, SAME, SAME, SAME),
    "rx VC foreign, time > stored": (NEW_FOREIGN, NEW_FOREIGN, NEW_FOREIGN, NEW_FOREIGN, NEW_FOREIGN),
    "rx VC foreign, time = stored": (None, SAME, SAME, SAME, SAME),
    "rx VC foreign, time < stored": (None, SAME, SAME, SAME, SAME),
    "rx VD": (SAME, SAME, Seen(FOREIGN_DELETED, delete=R, value=b"old", seqno=SEQ), SAME, SAME),
    "rx VU newer": (
        Seen(UNKNOWN, asks="reqCreateQ"),
        SAME,
        Seen(FOREIGN, update=R, value=b"new", seqno=SEQ + 1),
        SAME,
        SAME,
    ),
    "rx VU equal": (Seen(UNKNOWN, asks="reqCreateQ"), SAME, SAME, SAME, SAME),
    "rx VU older": (
        Seen(UNKNOWN, asks="reqCreateQ"),
        SAME,
        Seen(FOREIGN, update=R, value=b"old", seqno=SEQ),
        SAME,
        SAME,
    ),
    "rx VU bad value": (Seen(UNKNOWN, asks="reqCreateQ"), SAME, SAME, SAME, SAME),
    "rx VS newer": (
        Seen(UNKNOWN, asks="reqCreateQ"),
        SAME,
        Seen(FOREIGN, asks="reqUpdQ", value=b"old", seqno=SEQ),
        SAME,
        SAME,
    ),
    "rx VS equal": (Seen(UNKNOWN, asks="reqCreateQ"), SAME, SAME, SAME, SAME),
    "rx VS older": (
        Seen(UNKNOWN, asks="reqCreateQ"),
        SAME,
        Seen(FOREIGN, update=R, value=b"old", seqno=SEQ),
        SAME,
        SAME,
    ),
    "rx RU, own strictly newer": (
        Seen(UNKNOWN, asks="reqCreateQ"),
        Seen(OWN, update=R, value=b"old", seqno=SEQ),
        Seen(FOREIGN, update=R, value=b"old", seqno=SEQ),
        SAME,
        SAME,
    ),
    "rx RU equal": (Seen(UNKNOWN, asks="reqCreateQ"), SAME, SAME, SAME, SAME),
    "rx RU ahead": (Seen(UNKNOWN, asks="reqCreateQ"), SAME, SAME, SAME, SAME),
    "rx RC": (
        Seen(UNKNOWN, asks="reqCreateQ"),
        Seen(OWN, create=R, value=b"old", seqno=SEQ),
        Seen(FOREIGN, create=R, value=b"old", seqno=SEQ),
        SAME,
        SAME,
    ),
    "scrub": (
        SAME,
        Seen(OWN_DELETED, delete=R, value=b"old", seqno=SEQ),
        Seen(FOREIGN_DELETED, delete=R, value=b"old", seqno=SEQ),
        SAME,
        SAME,
    ),
}

#: Event -> the requirements that its row decides.
ROWS = {
    "app Create": "VD-CRE-02 VD-CRE-03 VD-CRE-10",
    "app Update": "VD-UPD-02 VD-UPD-03 VD-UPD-04 VD-UPD-07 VD-UPD-08",
    "app Delete": "VD-DEL-02 VD-DEL-03 VD-DEL-04 VD-DEL-05",
    "app Read": "VD-REA-02 VD-REA-03 VD-REA-04",
    "rx VC prodId=own": "VD-PC-03",
    "rx VC foreign, time > stored": "VD-PC-01 VD-PC-02 VD-PC-07 VD-PC-09",
    "rx VC foreign, time = stored": "VD-PC-01",
    "rx VC foreign, time < stored": "VD-PC-01",
    "rx VD": "VD-PD-01 VD-PD-02 VD-PD-03 VD-PD-04",
    "rx VU newer": "VD-PU-01 VD-PU-02 VD-PU-03 VD-PU-07",
    "rx VU equal": "VD-PU-05 VD-SCP-03",
    "rx VU older": "VD-PU-06",
    "rx VU bad value": "VD-PU-04",
    "rx VS newer": "VD-PS-01 VD-PS-02 VD-PS-04",
    "rx VS equal": "VD-PS-02",
    "rx VS older": "VD-PS-03",
    "rx RU, own strictly newer": "VD-RU-01 VD-RU-02 VD-RU-04",
    "rx RU equal": "VD-RU-03",
    "rx RU ahead": "VD-RU-03",
    "rx RC": "VD-RC-01 VD-RC-02 VD-RC-03",
    "scrub": "VD-SCR-02 VD-SCR-04 VD-SCR-05",
}

CELLS = [
    pytest.param(
        event, state, expected, id=f"{event} in {state}", marks=[pytest.mark.req(i) for i in ROWS[event].split()]
    )
    for event, row in TABLE.items()
    for state, expected in zip(STATES, row, strict=True)
    if expected is not None
]


def check(rig: Rig, event: str, expected: object) -> None:
    before = seen(rig)
    result = EVENTS[event](rig)
    rig.vardis.check_invariants()
    after = seen(rig)
    if isinstance(expected, Seen):
        assert after == expected
        return
    assert after == before
    if isinstance(expected, bytes):
        assert result == expected
    elif expected != SAME:
        assert result == VardisStatus(f"VARDIS-STATUS-{expected}")


@pytest.mark.parametrize(("event", "state", "expected"), CELLS)
def test_cell(event: str, state: str, expected: object) -> None:
    check(in_state(state), event, expected)


def test_the_table_is_complete() -> None:
    assert TABLE.keys() == EVENTS.keys() == ROWS.keys()


#: Differences before 2.0: (event, state) -> result. Deleted variables are those before their last VarDelete.
BEFORE_2_0 = {
    ("app Create", OWN): "VARIABLE-EXISTS",
    ("app Create", OWN_DELETED): "VARIABLE-EXISTS",
    ("app Update", OWN_DELETED): "VARIABLE-BEING-DELETED",
    ("app Delete", OWN_DELETED): "VARIABLE-BEING-DELETED",
    ("app Read", OWN_DELETED): "VARIABLE-BEING-DELETED",
    ("app Read", FOREIGN_DELETED): "VARIABLE-BEING-DELETED",
    ("rx VC foreign, time > stored", OWN): SAME,
    ("rx VC foreign, time > stored", FOREIGN): SAME,
    ("rx VC foreign, time > stored", OWN_DELETED): SAME,
    ("rx VC foreign, time > stored", FOREIGN_DELETED): SAME,
}
IN_1_0 = {
    ("rx RU, own strictly newer", UNKNOWN): SAME,
    ("rx RU equal", UNKNOWN): SAME,
    ("rx RU ahead", UNKNOWN): SAME,
    ("rx RC", UNKNOWN): SAME,
    ("rx VU bad value", FOREIGN): Seen(FOREIGN, update=R, value=b"old", seqno=SEQ),
}
OLD_CELLS = [
    pytest.param(version, event, state, changed, id=f"{version}: {event} in {state}")
    for version in VERSIONS[:-1]
    for event, row in TABLE.items()
    if event not in ("scrub", "rx VC foreign, time = stored", "rx VC foreign, time < stored")
    for state, expected in zip(STATES, row, strict=True)
    for changed in [(IN_1_0 if version == "1.0" else {}).get((event, state), BEFORE_2_0.get((event, state), expected))]
]


@pytest.mark.parametrize(("version", "event", "state", "expected"), OLD_CELLS)
def test_cell_before_2_0(version: str, event: str, state: str, expected: object) -> None:
    check(in_state(state, version), event, expected)


@pytest.mark.req("VD-PU-06")
@pytest.mark.req("VD-PS-03")
@pytest.mark.parametrize("event", ["rx VU older", "rx VS older"])
def test_a_pending_update_is_not_restarted_for_an_outdated_neighbour(event: str) -> None:
    rig = in_state(FOREIGN)
    EVENTS["rx VU newer"](rig)
    rig.sent()
    assert rig.entry().count_update == R - 1
    EVENTS[event](rig)
    assert rig.entry().count_update == R - 1


@pytest.mark.req("VD-RU-04")
@pytest.mark.req("VD-PU-07")
def test_a_pending_update_is_restarted_by_a_request_and_a_newer_value() -> None:
    rig = in_state(FOREIGN)
    for event in ("rx RU, own strictly newer", "rx VU newer"):
        rig.receive(VarReqUpdate(7, SEQ - 1))
        rig.sent()
        assert rig.entry().count_update == R - 1
        EVENTS[event](rig)
        assert rig.entry().count_update == R
        assert rig.queue("updateQ") == [7]


@pytest.mark.req("VD-RC-03")
def test_a_pending_creation_is_restarted_by_a_request() -> None:
    rig = in_state(FOREIGN)
    rig.receive(VarReqCreate(7))
    rig.sent()
    assert rig.entry().count_create == R - 1
    rig.receive(VarReqCreate(7))
    assert (rig.entry().count_create, rig.queue("createQ")) == (R, [7])


@pytest.mark.req("VD-PS-01")
@pytest.mark.req("VD-PS-04")
@pytest.mark.req("VD-PU-01")
def test_requests_are_queued_once() -> None:
    rig = in_state(FOREIGN)
    for _ in range(2):
        rig.receive((VarSumm(7, SEQ + 1), VarSumm(9, 0)), VarUpdate(9, 1, b"x"), VarReqUpdate(9, 0), VarReqCreate(9))
    assert (rig.queue("reqUpdQ"), rig.queue("reqCreateQ")) == ([7], [9])


def test_alternatives_for_the_table() -> None:
    """X20: a description instead of the steps of RTDB-Create; X26: only producers scrub."""
    rig = Rig(readings={"X20": "by-description", "X26": "producer-only"})
    assert rig.create().is_ok
    assert rig.create() is VardisStatus.VARIABLE_EXISTS
    assert rig.delete().is_ok
    assert rig.create().is_ok
    rig.receive(rig.vc(8, timeout=100), rig.vc(9, prod_id=THIRD))
    rig.receive(VarDelete(9))
    rig.wait(5000)
    assert not rig.entry(8).is_deleted
    assert rig.create(8) is VardisStatus.VARIABLE_EXISTS
    assert rig.create(9).is_ok
    assert rig.entry(9).spec.prod_id == ME != OTHER
