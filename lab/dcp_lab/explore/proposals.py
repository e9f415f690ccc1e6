"""Proposed changes of the specification, as variants of the wire format and of VarDis for explorations.

No other part of the node knows them. The wire format of a proposal is a profile with fields that it adds to records.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import msgspec
from dcp_spec.constants import SpecVersion
from dcp_spec.profile.loading import profile_from

from dcp_codec.codec import Codec, get_codec
from dcp_codec.values import (
    OwnRecord,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSumm,
    VarUpdate,
)
from dcp_stack.bp_port import BPPort
from dcp_stack.config import NodeConfig, VardisConfig
from dcp_stack.effects import Effect, VariableChanged
from dcp_stack.vardis.compose import Composer
from dcp_stack.vardis.core import Core
from dcp_stack.vardis.database import DBEntry
from dcp_stack.vardis.entity import Vardis
from dcp_stack.vardis.receive import Receiver
from dcp_stack.vardis.state_table import Event
from dcp_stack.vardis.wire import ContainerType

#: Width of creationTime in records in octets, as in VarSpec.
_STAMP: Final = {"name": "creation", "extra": {"width": 8, "byte_order": "big"}}
_DELETED: Final = {"name": "deleted", "extra": {"width": 1}}
#: Records of a proposal with creation times; ``deleted`` only with deletions in summaries.
_STAMPED: Final[Mapping[str, list[Any]]] = {
    "VarUpdate": ["varId", "seqno", _STAMP, "value"],
    "VarSumm": ["varId", "seqno", _STAMP],
    "VarReqUpdate": ["varId", "seqno", _STAMP],
    "VarDelete": ["varId", _STAMP],
}


#: Key in ``DBEntry.own`` of a variable that its restarted producer has recovered.
REGAINED: Final = "regained"


class Proposal(msgspec.Struct, frozen=True, kw_only=True):
    """A change of the text. The flags select changes of the behaviour of a node."""

    name: str
    title: str = ""
    text: str = ""
    """The change, as a sentence for the specification."""
    creation_times: bool = False
    """VarUpdate, VarSumm, VarReqUpdate and VarDelete carry the creation time; records of other creations are not
    compared: the older creation is corrected, the newer one requested."""
    deletions: bool = False
    """Deleted variables stay in ``summaryQ``, and VarSumm has a flag for them. Requires ``creation_times``."""
    silent_requests: bool = False
    """A request for an unknown variable is ignored."""
    takes_back: bool = False
    """A producer that has restarted processes records of its own variables as others do: the VarCreate of one that it
    does not know, or has recovered with an earlier creation time, and newer values."""
    restamps: bool = False
    """A producer that hears of a later creation of its own alive variable sets its creation time to a later one."""
    first_stays: bool = False
    """A VarCreate of another producer does not replace an alive variable."""
    readings: Mapping[str, str] = {}
    max_creation_ahead_s: float | None = None
    """The setting of :class:`~dcp_stack.config.VardisConfig`."""
    more_numbers: int = 1
    """Factor of the number of sequence numbers of the space."""

    @property
    def keeps_invariants(self) -> bool:
        """Whether queues and entries fit together as in the specification."""
        return not (self.creation_times or self.takes_back)

    def settings(self, vardis: VardisConfig) -> VardisConfig:
        """Return the settings of nodes."""
        most = vardis.seqno_modulus
        return msgspec.structs.replace(
            vardis,
            max_creation_ahead_s=self.max_creation_ahead_s or vardis.max_creation_ahead_s,
            seqno_modulus=None if most is None else most * self.more_numbers,
        )

    def codec(self, profile: str) -> Codec:
        """Return the codec for a profile with the fields of the proposal.

        Raises ProfileError for an unknown profile, ValueError for a proposal with a profile before 2.0.
        """
        if self.name and get_codec(profile).profile.spec_version < SpecVersion.V2_0:
            raise ValueError("proposal: the proposals change version 2.0")
        if not self.creation_times:
            return get_codec(profile)
        records: dict[str, list[Any]] = dict(_STAMPED)
        if self.deletions:
            records["VarSumm"] = [*records["VarSumm"], _DELETED]
        name = f"{profile}, {self.name}"
        return Codec(profile_from({"extends": profile, "name": name, "vardis": {"records": records}}, name))

    def core(self, config: NodeConfig, bp: BPPort) -> Vardis:
        """Return VarDis of a node: the normal one if no flag is set."""
        if self.creation_times or self.silent_requests or self.takes_back or self.restamps or self.first_stays:
            return ProposedVardis(self, config, bp)
        return Vardis(config, bp, emit=_ignore, now=0, wall=0)


def _ignore(_effect: Effect) -> None:
    """Ignore an effect."""


class ProposedVardis(Vardis):
    """VarDis with the behaviour of a proposal."""

    def __init__(self, proposal: Proposal, config: NodeConfig, bp: BPPort) -> None:
        super().__init__(config, bp, emit=self._note if proposal.deletions else _ignore, now=0, wall=0)
        self._receiver = ProposedReceiver(self._core, proposal)
        if proposal.creation_times:
            self._composer = StampedComposer(self._core)

    def _note(self, effect: Effect) -> None:
        """Summarise a variable also after its deletion."""
        if isinstance(effect, VariableChanged) and effect.event == "deleted":
            self._database.summary_q.append(effect.var_id)


class StampedComposer(Composer):
    """A composer that sets the fields of a proposal from the entry of the variable."""

    def _take_filled(self, kind: ContainerType, var_id: int) -> VardisRecord | OwnRecord:
        entry = self._database.lookup(var_id)
        given = {} if entry is None else {"creation": entry.spec.creation_time, "deleted": int(entry.is_deleted)}
        return self._own_fields.filled(self._take(kind, var_id), given)


class ProposedReceiver(Receiver):
    """A receiver with the behaviour of a proposal."""

    def __init__(self, core: Core, proposal: Proposal) -> None:
        super().__init__(core)
        self._proposal = proposal

    def _create(self, record: VarCreate, offset: int, now: int, wall: int) -> None:
        entry = self._database.lookup(record.spec.var_id)
        own = record.spec.prod_id == self._core.own_id
        if self._proposal.takes_back and own and (entry is None or self._is_later_regained(record, entry)):
            stored = self._database.insert(record.spec, record.upd.value, record.upd.seqno, now=now, wall=wall)
            stored.own[REGAINED] = ()
            self._core.changed("created", stored)
        elif not (own and self._restamp(record.spec.creation_time, entry)) and not (
            self._proposal.first_stays
            and entry is not None
            and not entry.is_deleted
            and entry.spec.prod_id != record.spec.prod_id
        ):
            super()._create(record, offset, now, wall)

    def _delete(self, record: VarDelete, offset: int) -> None:
        if self._handled(record, offset, deleted=True):
            return
        entry = self._database.lookup(record.var_id)
        if entry is not None and not entry.is_deleted and REGAINED in entry.own:
            self._database.mark_deleted(entry)
            self._core.changed("deleted", entry)
        else:
            super()._delete(record, offset)

    def _update(self, record: VarUpdate, offset: int, now: int, wall: int) -> None:
        if self._handled(record, offset):
            return
        entry = self._database.lookup(record.var_id)
        if self._regains(entry) and entry is not None and self._update_event(record, entry) is Event.RX_UPDATE_NEWER:
            self._database.store(entry, record.value, record.seqno, now=now, wall=wall)
            self._core.changed("updated", entry)
        else:
            super()._update(record, offset, now, wall)

    def _summary(self, record: VarSumm, offset: int) -> None:
        entry = self._database.lookup(record.var_id)
        if not self._proposal.creation_times:
            self._compare(record, entry, offset)
            return
        deleted = bool(self._value(record, "deleted"))
        if self._handled(record, offset, deleted=deleted):
            return
        if not deleted and entry is not None and entry.is_deleted and self._proposal.deletions:
            self._repeat_deletion(entry)
        elif not deleted:
            self._compare(record, entry, offset)
        elif entry is not None:
            deletion: Any = record
            self._delete(deletion, offset)

    def _compare(self, record: VarSumm, entry: DBEntry | None, offset: int) -> None:
        """Compare the sequence number of a summary with that of the stored value."""
        if self._regains(entry) and entry is not None and self._core.sequence.answers(entry.seqno, record.seqno):
            self._database.req_upd_q.append(record.var_id)
        else:
            super()._summary(record, offset)

    def _request_update(self, record: VarReqUpdate, offset: int) -> None:
        if self._proposal.silent_requests and self._database.lookup(record.var_id) is None:
            return
        if not self._handled(record, offset):
            super()._request_update(record, offset)

    def _request_create(self, record: VarReqCreate, offset: int) -> None:
        entry = self._database.lookup(record.var_id)
        if self._proposal.silent_requests and entry is None:
            return
        if self._proposal.deletions and entry is not None and entry.is_deleted:
            self._repeat_deletion(entry)
        super()._request_create(record, offset)

    # -- records with a creation time ----------------------------------------------------------------------------------

    def _value(self, record: Any, name: str) -> Any:
        """Return the value of a field of the proposal, None if the record does not have it."""
        return self._own_fields.values(record).get(name)

    def _regains(self, entry: DBEntry | None) -> bool:
        """Return whether a variable is an own one, of which newer values are accepted."""
        own = entry is not None and not entry.is_deleted and entry.spec.prod_id == self._core.own_id
        return self._proposal.takes_back and own

    def _is_later_regained(self, record: VarCreate, entry: DBEntry) -> bool:
        """Return whether a VarCreate is later than a variable that was recovered and not created again since."""
        return REGAINED in entry.own and self._is_later(record, entry)

    def _restamp(self, created: int | None, entry: DBEntry | None) -> bool:
        """Set the creation time of an alive own variable after ``created``; False if it is not earlier."""
        own = entry is not None and not entry.is_deleted and entry.spec.prod_id == self._core.own_id
        if not (self._proposal.restamps and own and entry is not None and created is not None):
            return False
        if created <= (entry.spec.creation_time or 0):
            return False
        entry.spec = msgspec.structs.replace(entry.spec, creation_time=created + 1)
        self._database.arm_create(entry)
        return True

    def _handled(self, record: Any, offset: int, *, deleted: bool = False) -> bool:
        """Process a record about another creation than the stored one. False: the rules of the text apply."""
        entry = self._database.lookup(record.var_id)
        created = self._value(record, "creation") if self._proposal.creation_times else None
        if created is None or entry is None:
            return False
        stored = entry.spec.creation_time or 0
        if created < stored:
            self._correct(entry)
        elif created > stored and deleted:
            if not self._restamp(created, entry) and entry.spec.prod_id != self._core.own_id:
                entry.spec = msgspec.structs.replace(entry.spec, creation_time=created)
                if not entry.is_deleted:
                    super()._delete(record, offset)
        elif created > stored:
            self._request(record.var_id, offset)
        return bool(created != stored)

    def _correct(self, entry: DBEntry) -> None:
        """Send the stored creation to a neighbour with an earlier one."""
        if entry.is_deleted:
            self._repeat_deletion(entry)
        elif not entry.count_create:
            self._database.arm_create(entry)

    def _repeat_deletion(self, entry: DBEntry) -> None:
        """Queue the VarDelete of a deleted variable again."""
        if not entry.count_delete:
            entry.count_delete = entry.spec.rep_cnt
            self._database.delete_q.append(entry.spec.var_id)


PROPOSALS: Final[Mapping[str, Proposal]] = {
    each.name: each
    for each in (
        Proposal(
            name="creation-times",
            title="Creation times in all records about a stored variable",
            text="VarUpdateT, VarSummT, VarReqUpdateT and VarDeleteT contain the creationTime of the variable. A node "
            "that receives such a record with an earlier creationTime than the stored one ignores it and schedules the "
            "VarCreate (or VarDelete) of its own; with a later one it requests the VarCreate, also for a variable that "
            "is marked as deleted, and follows a VarDelete.",
            creation_times=True,
        ),
        Proposal(
            name="deletions",
            title="Deletions in summaries",
            text="In addition to creation-times, VarSummT has isDeleted, and a deleted variable stays in summaryQ. "
            "A node that has the variable of the same or an earlier creation deletes it. A node with the deleted "
            "variable schedules the VarDelete again when it receives a summary or a request of a node that does not "
            "know of the deletion.",
            creation_times=True,
            deletions=True,
        ),
        Proposal(
            name="silent-requests",
            title="No requests on behalf of others",
            text="A VarReqCreate or VarReqUpdate for an unknown variable is ignored, as in 1.0.",
            silent_requests=True,
        ),
        Proposal(
            name="take-back",
            title="A restarted producer takes its variable back",
            text="A VarCreate with the node itself as producer is processed if the variable is unknown, or if it is "
            "later than one that was recovered in this way, which also follows a VarDelete. Records with a newer "
            "sequence number of an own variable are processed as those of other variables.",
            takes_back=True,
        ),
        Proposal(
            name="restamp",
            title="A producer overtakes a later creation of its own variable",
            text="In addition to creation-times, a producer that receives a VarCreate of its own alive variable with a "
            "later creationTime, or another record with isDeleted, sets its creationTime to a later one and schedules "
            "the VarCreate.",
            creation_times=True,
            restamps=True,
        ),
        Proposal(
            name="first-stays",
            title="The first producer keeps the variable",
            text="A VarCreate with another producer than the stored one is ignored while the stored variable is not "
            "deleted.",
            first_stays=True,
        ),
        Proposal(
            name="producer-scrubs",
            title="Only the producer scrubs",
            text="The scrubbing process considers the variables of the node itself only.",
            readings={"X26": "producer-only"},
        ),
        Proposal(
            name="clock-bound",
            title="A bound on creation times in the future",
            text="A VarCreate whose creationTime is more than a minute ahead of the local clock is ignored.",
            max_creation_ahead_s=60.0,
        ),
        Proposal(
            name="wider-numbers",
            title="Wider sequence numbers",
            text="VarSeqnoT has more octets (in the exploration: 16 numbers in place of 4).",
            more_numbers=4,
        ),
        Proposal(
            name="all",
            title="All of these except first-stays and clock-bound",
            text="All changes above except first-stays and clock-bound.",
            creation_times=True,
            deletions=True,
            silent_requests=True,
            takes_back=True,
            restamps=True,
            readings={"X26": "producer-only"},
            more_numbers=4,
        ),
    )
}
_TEXT: Final = Proposal(name="")


def proposal(name: str) -> Proposal:
    """Return the proposal of this name, the unchanged text for an empty one. Raises ValueError for any other."""
    if not name:
        return _TEXT
    if (found := PROPOSALS.get(name)) is None:
        raise ValueError(f"proposal: unknown {name!r}; the proposals are {', '.join(PROPOSALS)}")
    return found
