"""The real-time database of VarDis and its six queues (dcp-vardis.md, "Real-Time Database" and "Queues").

Whether a variable is in a queue follows from its entry. The same functions therefore change both, and
:meth:`Database.check_invariants` compares them.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import msgspec

from dcp_codec.values import Extra, VarSpec


class IdQueue(OrderedDict[int, None]):
    """A FIFO queue that holds each variable identifier at most once.

    Membership, appending, removing and rotating take constant time. The specification allows for unique entries: each
    of its steps checks or removes an identifier before it appends it.
    """

    def __repr__(self) -> str:
        return f"IdQueue({list(self)})"

    def append(self, var_id: int) -> None:
        """Append an identifier at the tail; one that is already queued keeps its position."""
        ##= DATA-12
        self[var_id] = None

    def remove(self, var_id: int) -> None:
        """Remove an identifier, if it is queued."""
        self.pop(var_id, None)

    def rotate(self, var_id: int) -> None:
        """Move an identifier to the tail. Raises KeyError if it is not queued."""
        self.move_to_end(var_id)


class DBEntry(msgspec.Struct, gc=False):
    """``DBEntry``: the state of one variable at a node.

    ``t_stamp``: local wall time (ns since 1970) of the last accepted creation or update. ``refreshed``: the same
    moment in monotonic ns. The age is computed from ``refreshed``, so a step of the wall clock neither deletes a
    variable too early nor keeps it too long. Counters: payloads in which a record is still to be repeated. ``own``:
    values of fields that the profile adds to records other than VarSpec, by the name of the record.
    """

    ##= VD-DB-01
    spec: VarSpec
    value: bytes
    seqno: int
    t_stamp: int
    refreshed: int
    count_update: int = 0
    count_create: int = 0
    count_delete: int = 0
    is_deleted: bool = False
    own: dict[str, Extra] = msgspec.field(default_factory=dict)


#: Entries as tuples of the fields of :class:`DBEntry`, and the identifiers in each queue.
DatabaseState = tuple[tuple[tuple[Any, ...], ...], tuple[tuple[int, ...], ...]]


class Database:
    """Entries by variable identifier, and the queues of records to be sent about them.

    ``remove_deleted``: remove an entry after its last VarDelete, as up to 1.3. Since 2.0 the entry stays and is marked
    as deleted.
    """

    def __init__(self, *, remove_deleted: bool) -> None:
        self.remove_deleted = remove_deleted
        self.entries: dict[int, DBEntry] = {}
        ##= VD-Q-01
        self.create_q = IdQueue()
        self.delete_q = IdQueue()
        self.update_q = IdQueue()
        self.summary_q = IdQueue()
        self.req_upd_q = IdQueue()
        self.req_create_q = IdQueue()
        self.queues = {
            "createQ": self.create_q,
            "deleteQ": self.delete_q,
            "updateQ": self.update_q,
            "summaryQ": self.summary_q,
            "reqUpdQ": self.req_upd_q,
            "reqCreateQ": self.req_create_q,
        }
        """All queues: the six of the specification by its names, then those of the profile's additional containers."""

    def __len__(self) -> int:
        return len(self.entries)

    def lookup(self, var_id: int) -> DBEntry | None:
        """Return the entry of a variable, None if it is unknown (``RTDB.lookup``)."""
        return self.entries.get(var_id)

    def clear(self) -> None:
        """Remove all variables, and clear all queues."""
        self.entries.clear()
        for queue in self.queues.values():
            queue.clear()

    # -- changes of a variable ----------------------------------------------------------------------------------

    def insert(self, spec: VarSpec, value: bytes, seqno: int, *, now: int, wall: int) -> DBEntry:
        """Store a variable that was created or created again; returns its entry.

        Its VarCreate is repeated and it is summarised. Records of an earlier creation leave all queues.
        """
        var_id = spec.var_id
        ##= VD-CRE-10 VD-PC-07
        entry = DBEntry(spec=spec, value=value, seqno=seqno, t_stamp=wall, refreshed=now)
        ##= VD-CRE-11
        ##= VD-CRE-11 | exception: also in 1.0, which lacks this step and would continue to request its own variable
        ##= VD-PC-08
        self._remove_from_queues(var_id)
        self.entries[var_id] = entry
        ##= VD-CRE-12 VD-PC-09
        self.arm_create(entry)
        ##= VD-TYP-08
        self.summary_q.append(var_id)
        return entry

    def store(self, entry: DBEntry, value: bytes, seqno: int, *, now: int, wall: int) -> None:
        """Store a newer value, and repeat its VarUpdate. The VarSpec, with the producer, is unchanged."""
        ##= VD-TYP-09 VD-UPD-08 VD-PU-07
        entry.value = value
        entry.seqno = seqno
        ##= VD-DB-03
        entry.t_stamp = wall
        ##= VD-SCR-06
        entry.refreshed = now
        self.arm_update(entry)

    def mark_deleted(self, entry: DBEntry) -> None:
        """Mark a variable as deleted, and repeat its VarDelete. All other records about it leave their queues."""
        var_id = entry.spec.var_id
        ##= VD-DEL-05 VD-PD-04 VD-SCR-04 VD-CMP-05
        self._remove_from_queues(var_id)
        ##= VD-DB-02
        entry.is_deleted = True
        entry.count_create = 0
        entry.count_update = 0
        entry.count_delete = entry.spec.rep_cnt
        if entry.count_delete:
            self.delete_q.append(var_id)
        else:
            self.after_last_delete(var_id)

    def after_last_delete(self, var_id: int) -> None:
        """Remove the entry after the last repetition of its VarDelete, if deleted variables are not kept."""
        ##= VD-DEL-06 VD-DEL-08
        if self.remove_deleted:
            del self.entries[var_id]

    def arm_create(self, entry: DBEntry) -> None:
        """Queue the VarCreate for the next ``repCnt`` payloads."""
        # Up to 1.1 receivers accept variables with a repetition count of 0; their records are not sent.
        entry.count_create = entry.spec.rep_cnt
        if entry.count_create:
            self.create_q.append(entry.spec.var_id)

    def arm_update(self, entry: DBEntry) -> None:
        """Queue the VarUpdate for the next ``repCnt`` payloads."""
        entry.count_update = entry.spec.rep_cnt
        if entry.count_update:
            ##= VD-UPD-09
            self.update_q.append(entry.spec.var_id)

    def drop_pending(self) -> None:
        """Cancel all outstanding repetitions and requests; summaries stay (X37)."""
        for entry in list(self.entries.values()):
            entry.count_create = entry.count_update = entry.count_delete = 0
            if entry.is_deleted and self.remove_deleted:
                del self.entries[entry.spec.var_id]
        for queue in self.queues.values():
            if queue is not self.summary_q:
                queue.clear()

    def purge(self) -> None:
        """Remove unknown and deleted variables from the queues (up to 1.2); deleted ones stay in ``deleteQ``.

        ``reqCreateQ`` is not changed: its variables are unknown.
        """
        for queue in (self.create_q, self.update_q, self.summary_q, self.req_upd_q):
            for var_id in list(queue):
                entry = self.entries.get(var_id)
                if entry is None or entry.is_deleted:
                    queue.remove(var_id)
        for var_id in list(self.delete_q):
            if var_id not in self.entries:
                self.delete_q.remove(var_id)

    def _remove_from_queues(self, var_id: int) -> None:
        """Remove a variable from all queues, those of additional containers included."""
        for queue in self.queues.values():
            queue.remove(var_id)

    # -- saving -------------------------------------------------------------------------------------------------

    def save(self) -> DatabaseState:
        """Return entries and queues as a value, in their order."""
        return (
            tuple((*msgspec.structs.astuple(entry)[:-1], tuple(entry.own.items())) for entry in self.entries.values()),
            tuple(map(tuple, self.queues.values())),
        )

    def restore(self, state: DatabaseState) -> None:
        """Replace entries and queues by saved ones."""
        entries, queues = state
        self.entries.clear()
        for fields in entries:
            entry = DBEntry(*(*fields[:-1], dict(fields[-1])))
            self.entries[entry.spec.var_id] = entry
        for queue, saved in zip(self.queues.values(), queues, strict=True):
            queue.clear()
            queue.update(dict.fromkeys(saved))

    # -- inspection ---------------------------------------------------------------------------------------------

    def check_invariants(self) -> None:
        """Raises AssertionError with the variable if queues and entries contradict each other (C.5)."""
        for var_id, entry in self.entries.items():
            alive, rep_cnt = not entry.is_deleted, entry.spec.rep_cnt
            claims = {
                "is stored under its own identifier": entry.spec.var_id == var_id,
                "is in createQ iff countCreate > 0": (var_id in self.create_q) == (entry.count_create > 0),
                "is in updateQ iff countUpdate > 0": (var_id in self.update_q) == (entry.count_update > 0),
                "is in deleteQ iff countDelete > 0": (var_id in self.delete_q) == (entry.count_delete > 0),
                "is in summaryQ iff alive": (var_id in self.summary_q) == alive,
                "is in reqUpdQ only if alive": alive or var_id not in self.req_upd_q,
                "is in reqCreateQ only if unknown": var_id not in self.req_create_q,
                "repeats creations and updates only if alive": alive or not (entry.count_create or entry.count_update),
                "repeats its deletion only if deleted": not alive or not entry.count_delete,
                "leaves the database after its deletion": alive or not self.remove_deleted or entry.count_delete > 0,
                "counts down from repCnt": 0 <= entry.count_create <= rep_cnt
                and 0 <= entry.count_update <= rep_cnt
                and 0 <= entry.count_delete <= rep_cnt,
            }
            for claim, holds in claims.items():
                assert holds, f"variable {var_id} {claim}: {entry}, {self.queues}"
        for name, queue in self.queues.items():
            unknown = [var_id for var_id in queue if var_id not in self.entries]
            assert name == "reqCreateQ" or not unknown, f"{name} holds unknown variables {unknown}"

    def snapshot(self) -> dict[str, Any]:
        """Return entries and queues as plain data: octets in hexadecimal, descriptions as text."""
        return {
            "variables": {var_id: _plain(entry) for var_id, entry in self.entries.items()},
            "queues": {name: list(queue) for name, queue in self.queues.items()},
        }


def _plain(entry: DBEntry) -> dict[str, Any]:
    """Return an entry as plain data, by the specification's names."""
    return {
        "prodId": entry.spec.prod_id.hex(":"),
        "repCnt": entry.spec.rep_cnt,
        "creationTime": entry.spec.creation_time,
        "timeout": entry.spec.timeout,
        "descr": entry.spec.descr.decode("utf-8", "backslashreplace"),
        "value": entry.value.hex(),
        "seqno": entry.seqno,
        "tStamp": entry.t_stamp,
        "countUpdate": entry.count_update,
        "countCreate": entry.count_create,
        "countDelete": entry.count_delete,
        "isDeleted": entry.is_deleted,
    }
