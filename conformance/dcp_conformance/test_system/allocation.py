"""Known properties of the implementation, and unused identifiers and values for a case."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, NoReturn

from dcp_spec.parameters import parameter

from dcp_codec.plan.tree import snake
from dcp_codec.values import ExtendedSafetyData, VarCreate, VarSpec, VarUpdate
from dcp_conformance.errors import NamesUsedUp
from dcp_conformance.model.case import Case
from dcp_conformance.model.verdict import Verdict

from .checks import Checks
from .session import FLOOR, Session

#: Maximum number of identifiers in a message.
_NAMES = 8
#: Names of parameters in the PIXIT.
_PIXIT = {
    "BPPAR_MAXIMUM_PACKET_SIZE": "max_packet_size",
    "VARDISPAR_MAX_VALUE_LENGTH": "max_value_length",
    "VARDISPAR_MAX_DESCRIPTION_LENGTH": "max_description_length",
    "VARDISPAR_MAX_REPETITIONS": "max_repetitions",
    "VARDISPAR_MAX_PAYLOAD_SIZE": "max_payload_size",
    "VARDISPAR_MAX_SUMMARIES": "max_summaries",
    "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT": "neighbour_timeout_ms",
    "VARDISPAR_SCRUBBING_PERIOD": "scrubbing_period_ms",
    "VARDISPAR_BUFFER_CHECK_PERIOD": "buffer_check_period_ms",
}


class Allocation(Checks):
    """Supplies a case with identifiers, time stamps and records."""

    def __init__(self, session: Session, case: Case) -> None:
        super().__init__(session, case)
        self.created: set[int] = set()
        """Identifiers that this case has chosen for variables, or has made a VarCreate for."""
        self._short: dict[int, dict[bytes, bytes]] = {}
        self.called_unknown: set[int] = set()
        """Identifiers that this case got for variables that remain unknown."""
        self.produced: set[int] = set()
        """Identifiers of the variables that the implementation's application has created."""

    @property
    def made(self) -> Collection[int]:
        """The variables that the case has created or is about to create."""
        return self.created

    # -- what is known -------------------------------------------------------------------------------------------------

    @property
    def reaction(self) -> float:
        """Maximum number of beacon periods until the reaction to a stimulus sent now or before.

        As given in the PIXIT, otherwise as measured at the start (:mod:`dcp_conformance.interconnection.reaction`). An
        implementation that processes payloads one at a time has more time while some are pending.
        """
        session = self.session
        waiting = max(0, session.busy_until - self.now()) / self.period
        if self.pixit.reaction_periods is not None:
            return self.pixit.reaction_periods + waiting
        return (FLOOR if session.reaction is None else session.reaction.periods) + waiting

    @property
    def slowness(self) -> float:
        """Factor by which this implementation may take longer than usual; at least 1."""
        told, measured = self.pixit.reaction_periods, self.session.reaction
        return max(1.0, (told if told is not None else FLOOR if measured is None else measured.periods) / FLOOR)

    @property
    def ahead(self) -> int:
        """Number of beacons that may be sent before one shows a reaction: payloads are composed in advance."""
        measured = self.session.reaction
        return max(2, math.ceil(max(measured.samples))) if measured is not None and measured.samples else 2

    @property
    def one_by_one(self) -> bool:
        """Whether the implementation was measured to process payloads one at a time (it may answer in between)."""
        return self.session.reaction is not None and self.session.reaction.per_payload > 0

    @property
    def sut_id(self) -> bytes:
        """The implementation's node identifier; inconclusive if it is not known yet."""
        if self.session.sut_id is None:
            self.inconclusive("the node identifier of the implementation", "no beacon received so far")
        return self.session.sut_id

    def parameter(self, name: str) -> int:
        """Return the value of a parameter: as the implementation reports it, otherwise from PIXIT or profile.

        Names are those of the specification (``VARDISPAR_MAX_SUMMARIES``), periods in ms.
        """
        if name in self.session.parameters:
            return int(self.session.parameters[name])
        limits, pixit = self.profile.limits, self.pixit
        known: dict[str, float | int | None] = {
            "BPPAR_BEACON_PERIOD": pixit.beacon_period_ms,
            "BPPAR_NETWORK_ID": pixit.network_id if pixit.network_id is not None else self.profile.bp.network_id,
            "BPPAR_MAXIMUM_PACKET_SIZE": pixit.max_packet_size or limits.max_beacon_size,
            "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT": pixit.neighbour_timeout_ms or 3000,
            "VARDISPAR_MAX_VALUE_LENGTH": pixit.max_value_length or limits.max_value_length,
            "VARDISPAR_MAX_DESCRIPTION_LENGTH": pixit.max_description_length or limits.max_description_length,
            "VARDISPAR_MAX_REPETITIONS": pixit.max_repetitions or limits.max_repetitions,
            "VARDISPAR_MAX_PAYLOAD_SIZE": pixit.max_payload_size or limits.max_vardis_payload,
            "VARDISPAR_MAX_SUMMARIES": limits.max_summaries if pixit.max_summaries is None else pixit.max_summaries,
            "VARDISPAR_SCRUBBING_PERIOD": pixit.scrubbing_period_ms or 1000,
            "VARDISPAR_BUFFER_CHECK_PERIOD": pixit.buffer_check_period_ms or 50,
        }
        parameter(name)
        value = known[name]
        return int(value or 0)

    def bound(self, name: str, *, missing: bool = False) -> int:
        """As :meth:`parameter`, for a verdict that depends on the value: an assumed value does not lead to a failure.

        ``missing``: with another value only expected records would be missing; wrong records still fail.
        """
        if untold := self._untold(name):
            (self.doubts if missing else self.assumptions)[name] = untold
        return self.parameter(name)

    def _untold(self, name: str) -> str:
        """Return a text that a parameter was assumed; empty if its value is known."""
        pixit = _PIXIT[name]
        if name in self.session.parameters or getattr(self.pixit, pixit) is not None:
            return ""
        return f"{name} was taken to be {self.parameter(name)}, as {_usual(name)}: state its value (pixit.{pixit})"

    def not_learnt(self, missing: Collection[int]) -> NoReturn:
        """Stop the case as inconclusive: it needs variables that the implementation has not learnt."""
        # Their payloads were as large as the implementation's maximum.
        self.bound("VARDISPAR_MAX_PAYLOAD_SIZE")
        names = ", ".join(map(str, sorted(missing)[:_NAMES]))
        more = f" and {len(missing) - _NAMES} more" if len(missing) > _NAMES else ""
        self.inconclusive("forwarded VarCreates of all variables, which this case needs", f"none of {names}{more}")

    def rep_cnt(self, wanted: int) -> int:
        """Return a repetition count that the implementation accepts: the wanted one, or the maximum.

        If the maximum is unknown, a count above 1 may be too large: then missing records are not a failure.
        """
        name = "VARDISPAR_MAX_REPETITIONS"
        if wanted > 1 and (untold := self._untold(name)):
            self.doubts[name] = untold
        return max(1, min(wanted, self.parameter(name) or wanted))

    def lacks_room(self, variables: int) -> str:
        """Return why the implementation cannot store ``variables`` variables, according to the profile; empty
        otherwise.
        """
        room = self.profile.limits.max_variables
        return (
            f"according to the profile, the implementation stores at most {room} variables"
            if room and room < variables
            else ""
        )

    # -- names ---------------------------------------------------------------------------------------------------------

    def node_id(self) -> bytes:
        """Return the identifier of a node that does not exist: a distant producer, or a neighbour of another node."""
        return self._node_id(self.next_node())

    def next_node(self) -> int:
        """Return the number of a node that this run has not used and that is not the implementation's.

        Raises ``NamesUsedUp`` if identifiers are so short that none is left.
        """
        layout = self.profile.types.node_id
        while True:
            self.session.next_peer += 1
            if layout.representation != "text" and self.session.next_peer >= 1 << (8 * min(layout.width, 3)):
                self.used_up("a node identifier that this run has not used", 0, self.session.next_peer)
            if self._node_id(self.session.next_peer) != self.session.sut_id:
                return self.session.next_peer

    def _node_id(self, number: int) -> bytes:
        layout = self.profile.types.node_id
        octets = address_of(number)
        if layout.representation == "text":
            return octets.hex(":").encode()
        return octets[-layout.width :].rjust(layout.width, b"\x02")

    def var_id(self) -> int:
        """Return an identifier for a variable of a peer: a VarCreate sent now creates it, whatever was there before.

        From 2.0 on it may have been used by peers in earlier cases: a case that needs an unknown variable uses
        :meth:`unknown_id`. Raises ``NamesUsedUp``.
        """
        session = self.session
        # Up to 1.3 one range serves both: an identifier used as unknown must not become a variable of the case.
        for without in (self.created | self.called_unknown, self.created):
            number = session.identifiers.for_peer(
                self.now(), session.creation_time + 1, without, reuse=not session.renewable
            )
            if number is not None:
                break
        if number is None:
            self._no_variables_left("an identifier for a variable of a peer")
        self.created.add(number)
        return number

    def var_ids(self, count: int) -> list[int]:
        """Return several identifiers for variables of peers, ascending unless the range ends in between."""
        return [self.var_id() for _ in range(count)]

    def unknown_ids(self, count: int) -> list[int]:
        """Return identifiers that are not in the implementation's database, descending from the top of the range.

        They may have been used before: a variable that is requested but never answered remains unknown. Raises
        ``NamesUsedUp``.
        """
        found = self.session.identifiers.unknown(count, self.now(), self.created)
        if len(found) < count:
            self._no_variables_left(f"{count} identifiers of variables that the implementation does not know")
        self.called_unknown.update(found)
        return found

    def is_applications(self, var_id: int) -> bool:
        """Return whether the PIXIT leaves an identifier to applications on the node."""
        identifiers = self.session.identifiers
        return not identifiers.first <= var_id < identifiers.first + identifiers.size

    def has_unknown_ids(self, count: int = 1) -> bool:
        """Return whether ``count`` identifiers are left that are not in the implementation's database."""
        return self.session.identifiers.left(self.now(), self.created) >= count

    def unknown_id(self) -> int:
        """Return one of :meth:`unknown_ids`."""
        return self.unknown_ids(1)[0]

    def own_var_id(self) -> int:
        """Return an identifier for one of the node's own variables that was never used before (X20).

        Raises ``NamesUsedUp`` if no more are left than the probes of other cases need.
        """
        for without in (self.created | self.called_unknown, self.created):
            number = self.session.identifiers.for_own(self.now(), without)
            if number is not None:
                break
        if number is None:
            self._no_variables_left("an identifier never used before, for one of the node's own variables")
        self.created.add(number)
        return number

    def boundary_id(self, name: str) -> int:
        """Return a boundary value (:attr:`Session.boundaries`) as the identifier of an unknown variable.

        Raises ``NamesUsedUp`` if the implementation may know it.
        """
        number = self.session.boundaries[name]
        identifiers = self.session.identifiers
        taken = number in self.created or number in identifiers.in_use()
        if taken or not identifiers.is_unknown(number, self.now()):
            self._no_variables_left(f"the identifier {number}, never used before")
        self.created.add(number)
        return number

    def departure(self) -> int:
        """Return the time in ns by which, up to 1.3, a variable deleted now is removed from the database."""
        return self.now() + (self.parameter("VARDISPAR_MAX_REPETITIONS") + 4) * self.period

    def _no_variables_left(self, expected: str) -> NoReturn:
        identifiers = self.session.identifiers
        self.used_up(expected, identifiers.left(self.now(), self.created), identifiers.size)

    def used_up(self, expected: str, left: int, size: int) -> NoReturn:
        """Stop the case as inconclusive: too many identifiers were used since the last reset."""
        observed = (
            f"identifiers used up: {left} of {size} are left that the implementation cannot know from earlier cases. "
            "A reset frees them: provide UT-Reset, or a command to start it (--start, --restart), or set "
            'reset = "restart" in [pixit]'
        )
        self._add(Verdict.INCONCLUSIVE, expected, observed, (), ())
        raise NamesUsedUp

    # -- values --------------------------------------------------------------------------------------------------------

    def creation_time(self) -> int:
        """Return a time stamp for a record: the current time, and later than any returned before."""
        stamp = self.profile.types.timestamp
        since = self.lower.now() if stamp.epoch_ns is None else self.lower.wall() - stamp.epoch_ns
        ticks = since * stamp.per_second // 1_000_000_000
        self.session.creation_time = max(self.session.creation_time + 1, ticks)
        return self.session.creation_time

    def value(self, wanted: bytes) -> bytes:
        """Return ``wanted``, or shorter octets if the maximum is smaller; different values remain different."""
        return self._shortened(wanted, self.parameter("VARDISPAR_MAX_VALUE_LENGTH"))

    def descr(self, wanted: bytes) -> bytes:
        """As :meth:`value`, for a description in UTF-8."""
        return self._shortened(wanted, self.longest_description)

    @property
    def longest_description(self) -> int:
        """Maximum length of a description in octets; in 1.0 the parameter counts the NUL at its end (VD-CRE-04)."""
        name = "VARDISPAR_MAX_DESCRIPTION_LENGTH"
        told = name in self.session.parameters and self.features.string_format == "nul-terminated"
        return self.parameter(name) - (1 if told else 0)

    def _shortened(self, wanted: bytes, most: int) -> bytes:
        """Return octets of at most this length, at least one, different for each ``wanted`` of this case."""
        if len(wanted) <= most or most < 1:
            return wanted
        taken = self._short.setdefault(most, {})
        if wanted not in taken:
            # Printable, so that it is also valid in a description.
            others = (wanted[: most - 1] + bytes((each,)) for each in (wanted[most - 1] & 0x7F, *range(0x21, 0x7F)))
            free = (each for each in others if each not in taken.values())
            taken[wanted] = next(free, wanted[:most])
        return taken[wanted]

    @property
    def longest_timeout(self) -> int:
        """The longest timeout in ms that the profile's VarTimeoutT can hold."""
        return int((1 << 8 * self.profile.types.var_timeout.width) - 1)

    def require_timeout(self, timeout: int) -> None:
        """Stop the case as not applicable if the profile cannot express a timeout (ms)."""
        if timeout > self.longest_timeout:
            self.not_applicable(f"VarTimeoutT holds at most {self.longest_timeout} ms, and the case needs {timeout} ms")

    def spec(
        self,
        var_id: int,
        producer: bytes,
        *,
        rep_cnt: int = 1,
        descr: bytes = b"tester",
        creation_time: int | None = None,
        timeout: int = 0,
        exact: bool = False,
    ) -> VarSpec:
        """Return a VarSpec with the fields of the profile's layout; ``creation_time`` is new by default.

        ``exact``: use the description as given, otherwise as :meth:`descr` returns it. Stops the case as not applicable
        if the profile cannot express ``timeout`` (in ms).
        """
        names = self.profile.vardis.var_spec
        self.require_timeout(timeout)
        return self.codec.var_spec_type(
            var_id,
            producer,
            rep_cnt,
            descr if exact else self.descr(descr),
            (self.creation_time() if creation_time is None else creation_time) if "creationTime" in names else None,
            timeout if "timeout" in names else None,
        )

    def create(
        self,
        var_id: int,
        producer: bytes,
        *,
        value: bytes = b"value",
        seqno: int = 0,
        rep_cnt: int = 1,
        descr: bytes = b"tester",
        creation_time: int | None = None,
        timeout: int = 0,
        exact: bool = False,
    ) -> VarCreate:
        """Return a VarCreate like :meth:`sample`. From now on the implementation may know the variable."""
        made = self.sample(
            var_id,
            producer,
            value=value,
            seqno=seqno,
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=creation_time,
            timeout=timeout,
            exact=exact,
        )
        self.created.add(var_id)
        self.session.identifiers.offered(var_id, made.spec.creation_time)
        return made

    def sample(
        self,
        var_id: int = 0,
        producer: bytes | None = None,
        *,
        value: bytes = b"value",
        seqno: int = 0,
        rep_cnt: int = 1,
        descr: bytes = b"tester",
        creation_time: int | None = None,
        timeout: int = 0,
        exact: bool = False,
    ) -> VarCreate:
        """Return a VarCreate that is measured but not sent.

        Value and description are truncated to the implementation's maximum (:meth:`value`, :meth:`descr`) unless
        ``exact``.
        """
        producer = self.node_id() if producer is None else producer
        spec = self.spec(
            var_id,
            producer,
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=creation_time,
            timeout=timeout,
            exact=exact,
        )
        return VarCreate(spec, VarUpdate(var_id, seqno, value if exact else self.value(value)))

    def report(self, node_id: bytes, seqno: int, *, t_stamp: int | None = None, **fields: float) -> ExtendedSafetyData:
        """Return a state report; fields of the safety data that are not given are zero."""
        kind = self.codec.safety_data_type
        zeros: dict[str, Any] = {
            each.name: b"\0" * each.octets if each.type == "opaque" else 0.0 if each.type.startswith("f") else 0
            for each in self.profile.srp.safety_data
        }
        data = kind(**{_attribute(kind, name): value for name, value in {**zeros, **fields}.items()})
        return ExtendedSafetyData(data, node_id, self.creation_time() if t_stamp is None else t_stamp, seqno)


def _usual(name: str) -> str:
    """Return the origin of the assumed value of a parameter: limits are in profiles, periods in the specification."""
    return "usual" if name.endswith(("_PERIOD", "_TIMEOUT")) else "in the profile"


def address_of(number: int) -> bytes:
    """Return a locally administered address of the tester: 02:dc:9n:..."""
    return bytes((0x02, 0xDC, 0x90)) + number.to_bytes(3, "big")


def _attribute(kind: type[Any], name: str) -> str:
    """Return the attribute of a safety data class for a field's name."""
    return snake(name) if snake(name) in kind.__struct_fields__ else name
