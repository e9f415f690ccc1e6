"""The services of VarDis for applications (dcp-vardis.md#vardis-application-service-interface)."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Any

from dcp_spec.constants import BP_PROTID_VARDIS
from dcp_spec.status import VardisStatus

from dcp_codec.values import VarCreate, VarSpec, VarUpdate
from dcp_stack.bp_port import BPPort
from dcp_stack.own_fields import NO_VALUES

from .confirms import (
    Confirm,
    DescribeDatabaseConfirm,
    DescribedVariable,
    DescribeVariableConfirm,
    NoResponseError,
    ReadConfirm,
)
from .core import Core
from .database import DBEntry
from .state_table import Action, Event


class VariableServices:
    """Services for applications: one method per request, which returns the confirm.

    Under reading X30 ``no-response`` each raises :class:`NoResponseError` while VarDis is not registered with BP.
    """

    def __init__(self, core: Core, bp: BPPort) -> None:
        self._core = core
        self._bp = bp
        self._own_fields = core.config.own_fields
        self.registered = False
        """Whether the last registration with BP succeeded. Another client of BP may have deregistered VarDis since."""
        self._silent = core.readings.unregistered_vardis == "no-response"
        self._steady = core.readings.vardis_clock == "steady-clock"
        """Whether ages and creation times are unaffected by steps of the system time."""
        self._refuses_empty_description = core.readings.empty_description == "refuse-locally"

    ##= VD-CRE-13 DATA-11
    def create(
        self,
        var_id: int,
        prod_id: bytes | None,
        rep_cnt: int,
        descr: bytes,
        value: bytes,
        timeout_ms: int = 0,
        *,
        own_fields: Mapping[str, Any] = NO_VALUES,
        now: int,
        wall: int,
    ) -> Confirm:
        """``RTDB-Create``. ``prod_id`` None is this node. ``descr``: UTF-8. ``timeout_ms``: 0 means without timeout.

        Versions before 2.0 have no timeout. ``own_fields``: values of fields that the profile adds to the
        VarCreate, by name; omitted ones have the value of their rule (``dcp_stack.own_fields``) or zero.

        Beyond the specification, the confirm has VALUE-TOO-LONG if the VarCreate does not fit into a payload,
        DESCRIPTION-TOO-LONG if it would not fit with the shortest value either, and INACTIVE, as a temporary refusal,
        if the database is full. Raises ValueError for arguments that the fields of a VarSpec cannot express.
        """
        self._check_expressible(var_id, prod_id, descr, timeout_ms)
        ##= VD-CRE-01
        if not self._serving():
            return self._confirm(VardisStatus.INACTIVE)
        entry = self._core.database.lookup(var_id)
        cell = self._core.cell(Event.APP_CREATE, entry)
        if cell.status is not None:
            return self._confirm(cell.status)
        ##= VD-CRE-04 DATA-08
        if len(descr) > self._core.parameters.longest_description:
            return self._confirm(VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG)
        ##= VD-CRE-15
        if not descr and self._refuses_empty_description:
            return self._confirm(VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG)
        if status := self._refused_value(value):
            return self._confirm(status)
        ##= VD-CRE-07
        if not 1 <= rep_cnt <= min(self._core.parameters.max_repetitions, self._core.sizes.highest_rep_cnt):
            return self._confirm(VardisStatus.ILLEGAL_REPCOUNT)
        creation_time = self._later_than_received(var_id, self._creation_time(entry, wall))
        ##= VD-TYP-05
        spec = VarSpec(
            var_id=var_id,
            ##= VD-CRE-08
            prod_id=self._producer(prod_id),
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=creation_time,
            ##= VD-TYP-04
            timeout=timeout_ms if self._core.features.creation_time else None,
        )
        record = self._own_fields.replaced(VarCreate(spec, VarUpdate(var_id, 0, value)), own_fields)
        spec = record.spec
        ##= VD-CRE-04 | exception: a description is also too long if the VarCreate does not fit into a payload (X42)
        ##= VD-CRE-05 | exception: a value is also too long if the VarCreate does not fit into a payload (X42)
        if status := self._refused_size(spec, value):
            return self._confirm(status)
        ##= VD-CRE-01 | exception: INACTIVE if the database is full (X43)
        if entry is None and len(self._core.database) >= self._core.max_variables:
            return self._confirm(VardisStatus.INACTIVE)
        if creation_time is not None and creation_time > self._core.sizes.highest_stamp:
            # creationTime would exceed its field: the stored variable already has the highest value.
            return self._confirm(VardisStatus.VARIABLE_EXISTS)
        self._core.delivery.created(var_id)
        stored = self._core.database.insert(spec, value, 0, now=now, wall=wall)
        self._own_fields.keep(stored.own, record)
        self._core.changed("created", stored)
        ##= VD-CRE-14
        return self._confirm(VardisStatus.OK)

    ##= VD-UPD-11
    def update(self, var_id: int, value: bytes, *, now: int, wall: int) -> Confirm:
        """``RTDB-Update``: store a new value of a variable of this node, with the next sequence number."""
        ##= VD-UPD-01
        if not self._serving():
            return self._confirm(VardisStatus.INACTIVE)
        entry = self._core.database.lookup(var_id)
        cell = self._core.cell(Event.APP_UPDATE, entry)
        ##= VD-UPD-02
        if cell.status is not None or entry is None:
            return self._confirm(cell.status or VardisStatus.VARIABLE_DOES_NOT_EXIST)
        status = self._refused_value(value)
        ##= VD-UPD-05 | exception: a value is also too long if its VarUpdate no longer fits into a payload (X42)
        if status is None and self._core.sizes.update(value) > self._room():
            status = VardisStatus.VALUE_TOO_LONG
        if status is not None:
            return self._confirm(status)
        ##= VD-UPD-07
        self._core.database.store(entry, value, self._core.sequence.after(entry.seqno), now=now, wall=wall)
        self._note_fields(entry, NO_VALUES)
        self._core.delivery.updated(var_id, entry.seqno, now)
        self._core.changed("updated", entry)
        return self._confirm(VardisStatus.OK)

    def update_with_fields(
        self, var_id: int, value: bytes, own_fields: Mapping[str, Any], *, now: int, wall: int
    ) -> Confirm:
        """As :meth:`update`, with values of fields that the profile adds to VarUpdate.

        Raises ValueError, and changes nothing, for a field or value that the profile cannot express.
        """
        self._own_fields.replaced(VarUpdate(var_id, 0, value), own_fields)
        confirm = self.update(var_id, value, now=now, wall=wall)
        if confirm.status.is_ok:
            self._note_fields(self._core.database.entries[var_id], own_fields)
        return confirm

    def _note_fields(self, entry: DBEntry, given: Mapping[str, Any]) -> None:
        """Store the values of added fields for the VarUpdate of a variable of this node."""
        record = VarUpdate(entry.spec.var_id, entry.seqno, entry.value)
        self._own_fields.keep(entry.own, self._own_fields.replaced(record, given))

    ##= VD-DEL-07
    def delete(self, var_id: int, *, now: int, wall: int) -> Confirm:  # noqa: ARG002 - every service takes the time
        """``RTDB-Delete``: delete a variable of this node."""
        ##= VD-DEL-01
        if not self._serving():
            return self._confirm(VardisStatus.INACTIVE)
        entry = self._core.database.lookup(var_id)
        cell = self._core.cell(Event.APP_DELETE, entry)
        ##= VD-DEL-02
        if cell.status is not None or entry is None:
            return self._confirm(cell.status or VardisStatus.VARIABLE_DOES_NOT_EXIST)
        ##= VD-DEL-05
        self._core.database.mark_deleted(entry)
        self._core.changed("deleted", entry)
        return self._confirm(VardisStatus.OK)

    ##= VD-REA-05
    def read(self, var_id: int) -> ReadConfirm:
        """``RTDB-Read``: return the value of a variable, and when it was last created or updated."""
        ##= VD-REA-01
        if not self._serving():
            return ReadConfirm(VardisStatus.INACTIVE)
        entry = self._core.database.lookup(var_id)
        cell = self._core.cell(Event.APP_READ, entry)
        ##= VD-REA-02
        if cell.action is not Action.READ or entry is None:
            return ReadConfirm(self._confirm(cell.status or VardisStatus.VARIABLE_DOES_NOT_EXIST).status)
        ##= VD-REA-04
        return ReadConfirm(VardisStatus.OK, entry.value, entry.t_stamp)

    def describe_database(self) -> DescribeDatabaseConfirm:
        """``RTDB-DescribeDatabase``: describe all variables, including deleted ones."""
        ##= VD-DDB-01
        if not self._serving():
            return DescribeDatabaseConfirm(VardisStatus.INACTIVE)
        entries = self._core.database.entries.values()
        ##= VD-DDB-02 VD-DDB-03
        listed = tuple(DescribedVariable(entry.spec, entry.is_deleted, entry.t_stamp) for entry in entries)
        return DescribeDatabaseConfirm(VardisStatus.OK, listed)

    def describe_variable(self, var_id: int) -> DescribeVariableConfirm:
        """``RTDB-DescribeVariable``: return a copy of the entry of a variable, even if it is deleted."""
        ##= VD-DVA-01
        if not self._serving():
            return DescribeVariableConfirm(VardisStatus.INACTIVE)
        entry = self._core.database.lookup(var_id)
        ##= VD-DVA-02
        if entry is None:
            return DescribeVariableConfirm(VardisStatus.VARIABLE_DOES_NOT_EXIST)
        ##= VD-DVA-03
        return DescribeVariableConfirm(VardisStatus.OK, copy(entry))

    def _serving(self) -> bool:
        """Return whether requests are executed; otherwise they are confirmed with INACTIVE.

        Raises NoResponseError while VarDis is not registered, under reading X30 ``no-response``.
        """
        ##= VD-SRV-01 VD-MGT-04
        # BP is queried because another of its clients may have deregistered VarDis.
        if self.registered and self._bp.query_number_buffered(BP_PROTID_VARDIS).status.is_ok:
            return self._core.active
        if self._silent:
            raise NoResponseError("VarDis does not answer while it is not registered with BP (reading X30)")
        return False

    def _confirm(self, status: VardisStatus) -> Confirm:
        """Return a confirm with the status code of the profile's version, in which two codes have other names."""
        ##= VD-DEL-09 VD-UPD-12 VD-REA-06 VD-SRV-02 VD-SRV-03 DATA-10
        # The confirm is the return value, so concurrent requests of several applications cannot be mixed up.
        return Confirm(status.in_version(self._core.config.profile.spec_version))

    def _check_expressible(self, var_id: int, prod_id: bytes | None, descr: bytes, timeout_ms: int) -> None:
        """Raises ValueError for arguments that the fields of a VarSpec cannot express."""
        sizes = self._core.sizes
        ##= VD-TYP-01
        if not 0 <= var_id <= sizes.highest_var_id:
            raise ValueError(f"a variable identifier is 0 to {sizes.highest_var_id}, not {var_id}")
        if prod_id is not None and sizes.node_id_width not in (None, len(prod_id)):
            raise ValueError(f"a node identifier has {sizes.node_id_width} octets, not {len(prod_id)}")
        if sizes.nul_terminated and b"\0" in descr:
            raise ValueError("a description of this profile ends with NUL and cannot contain it")
        if not 0 <= timeout_ms <= sizes.highest_timeout:
            raise ValueError(f"a timeout is 0 to {sizes.highest_timeout} ms, not {timeout_ms}")

    def _refused_value(self, value: bytes) -> VardisStatus | None:
        """Return the status for a value that is too long or empty, None for a valid one."""
        ##= VD-CRE-05 VD-UPD-05
        if len(value) > self._core.parameters.max_value_length:
            return VardisStatus.VALUE_TOO_LONG
        ##= VD-CRE-06 VD-UPD-06
        return None if value else VardisStatus.EMPTY_VALUE

    def _refused_size(self, spec: VarSpec, value: bytes) -> VardisStatus | None:
        """Return the status for a variable whose VarCreate does not fit into a payload, None if it fits (X23, X42).

        The parameters allow a description and a value that together exceed the payload size.
        """
        longest, room = self._core.sizes.longest_description, self._room()
        if (longest is not None and len(spec.descr) > longest) or self._core.sizes.create(spec, b"\0") > room:
            return VardisStatus.VARIABLE_DESCRIPTION_TOO_LONG
        return VardisStatus.VALUE_TOO_LONG if self._core.sizes.create(spec, value) > room else None

    def _room(self) -> int:
        """Return the octets that the largest payload has for the records of one container."""
        return self._core.parameters.max_payload_size - self._core.sizes.ic_header

    def _producer(self, given: bytes | None) -> bytes:
        """Return the producer of a new variable: this node, or up to 1.1 the identifier given by the application."""
        if given is None or self._core.features.producer_set_by_vardis:
            return self._core.own_id
        return given

    def _creation_time(self, entry: DBEntry | None, wall: int) -> int | None:
        """Return the creation time for a new variable, in the profile's units; None before 2.0.

        It is the current time, but later than that of the stored variable (X38). Other nodes ignore a creation that
        is not later, so a second one within one unit, or after the clock was set back, gets the next stamp.
        """
        if not self._core.features.creation_time:
            return None
        ##= VD-CRE-09
        stamp = self._core.clock.stamp(wall)
        known = entry.spec.creation_time if entry is not None else None
        ##= VD-CRE-09 | exception: later than the stored creation, if the system time is not (X38)
        return max(stamp, known + 1) if known is not None and self._steady else stamp

    def _later_than_received(self, var_id: int, creation_time: int | None) -> int | None:
        """Return a creation time later than those that neighbours still send with this node as producer (X38).

        After a restart of this node with a slow clock they still have its earlier variable, and would ignore a
        creation that is not later.
        """
        heard = self._core.delivery.latest_creation(var_id)
        if creation_time is None or heard is None or not self._steady:
            return creation_time
        ##= VD-CRE-09 | exception: later than the received creations, if the system time is not (X38)
        return max(creation_time, heard + 1)
