"""What is known of an implementation, and names and values that nobody else uses."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any, NoReturn

from dcp_spec.parameters import parameter

from dcp_codec.plan import snake
from dcp_codec.values import ExtendedSafetyData, VarCreate, VarSpec, VarUpdate

from .case import Case
from .errors import NamesUsedUp
from .findings import Findings
from .session import FLOOR, Session
from .verdict import Verdict

#: Identifiers that a message names.
_NAMES = 8
#: Under which name a PICS tells a parameter.
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


class Naming(Findings):
    """One case's supply of identifiers, time stamps and records."""

    def __init__(self, session: Session, case: Case) -> None:
        super().__init__(session, case)
        self.created: set[int] = set()
        """Identifiers that this case has chosen for variables, or has made a VarCreate for."""
        self._short: dict[int, dict[bytes, bytes]] = {}
        self.called_unknown: set[int] = set()
        """Identifiers that this case was given for variables that stay unknown."""
        self.produced: set[int] = set()
        """Those of the variables that the implementation's application has created."""

    @property
    def made(self) -> Collection[int]:
        """The variables that the case has created, or is about to."""
        return self.created

    # -- what is known -------------------------------------------------------------------------------------------------

    @property
    def reaction(self) -> float:
        """Beacon periods within which a reaction to what is sent now, or was sent before, must show.

        As the PIXIT says, or else as measured at the start (:mod:`dcp_conformance.reaction`). An implementation that
        takes received payloads one at a time has more time while some are waiting.
        """
        session = self.session
        waiting = max(0, session.busy_until - self.now()) / self.period
        if self.pixit.reaction_periods is not None:
            return self.pixit.reaction_periods + waiting
        return (FLOOR if session.reaction is None else session.reaction.periods) + waiting

    @property
    def slowness(self) -> float:
        """How much longer than usual this implementation may take for anything: at least 1."""
        told, measured = self.pixit.reaction_periods, self.session.reaction
        return max(1.0, (told if told is not None else FLOOR if measured is None else measured.periods) / FLOOR)

    @property
    def ahead(self) -> int:
        """How many beacons may leave before one can show a reaction: payloads are composed in advance."""
        measured = self.session.reaction
        return max(2, math.ceil(max(measured.samples))) if measured is not None and measured.samples else 2

    @property
    def one_by_one(self) -> bool:
        """Whether it was measured to take received payloads one at a time, so that it may answer in between."""
        return self.session.reaction is not None and self.session.reaction.per_payload > 0

    @property
    def sut_id(self) -> bytes:
        """The implementation's node identifier. Stops the case as inconclusive if it is not known yet."""
        if self.session.sut_id is None:
            self.inconclusive("the node identifier of the implementation", "no beacon of it was heard so far")
        return self.session.sut_id

    def parameter(self, name: str) -> int:
        """The value of a parameter of the implementation: as it said itself, else from PIXIT or profile.

        Names are the specification's (``VARDISPAR_MAX_SUMMARIES``), periods in ms.
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
        """As :meth:`parameter`, where the verdict hangs on it: if nobody has told it, nobody fails for it.

        ``missing``: with another value something that the case waits for would not come, and nothing wrong would:
        what is received and wrong still fails.
        """
        if untold := self._untold(name):
            (self.doubts if missing else self.assumptions)[name] = untold
        return self.parameter(name)

    def _untold(self, name: str) -> str:
        """That a parameter was assumed, in words; empty if somebody has told it."""
        pixit = _PIXIT[name]
        if name in self.session.parameters or getattr(self.pixit, pixit) is not None:
            return ""
        return f"{name} was taken to be {self.parameter(name)}, as {_usual(name)}: say what it is (pixit.{pixit})"

    def not_learnt(self, missing: Collection[int]) -> NoReturn:
        """Stop the case as inconclusive: it needs variables that the implementation has not taken."""
        # They came in payloads as long as its own may be.
        self.bound("VARDISPAR_MAX_PAYLOAD_SIZE")
        names = ", ".join(map(str, sorted(missing)[:_NAMES]))
        more = f" and {len(missing) - _NAMES} more" if len(missing) > _NAMES else ""
        self.inconclusive("the implementation learns variables, which this case needs", f"not {names}{more}")

    def rep_cnt(self, wanted: int) -> int:
        """A repetition count that the implementation accepts: the wanted one, or the largest.

        If nobody has told the largest, more than 1 may be too many: then nothing that is missing counts as a failure.
        """
        name = "VARDISPAR_MAX_REPETITIONS"
        if wanted > 1 and (untold := self._untold(name)):
            self.doubts[name] = untold
        return max(1, min(wanted, self.parameter(name) or wanted))

    def lacks_room(self, variables: int) -> str:
        """Why so many variables are too many, if the profile says that the implementation keeps fewer; else empty."""
        room = self.profile.limits.max_variables
        return f"the profile says that there is room for {room} variables" if room and room < variables else ""

    # -- names ---------------------------------------------------------------------------------------------------------

    def node_id(self) -> bytes:
        """The identifier of a node that does not exist: a producer far away, or a neighbour of somebody else."""
        return self._node_id(self.next_node())

    def next_node(self) -> int:
        """The number of a node that this run has not used, and whose identifier is not the implementation's.

        Raises ``NamesUsedUp`` where identifiers are so short that there are no more.
        """
        layout = self.profile.types.node_id
        while True:
            self.session.next_peer += 1
            if layout.representation != "text" and self.session.next_peer >= 1 << (8 * min(layout.width, 3)):
                self.used_up("an identifier of a node that this run has not used", 0, self.session.next_peer)
            if self._node_id(self.session.next_peer) != self.session.sut_id:
                return self.session.next_peer

    def _node_id(self, number: int) -> bytes:
        layout = self.profile.types.node_id
        octets = address_of(number)
        if layout.representation == "text":
            return octets.hex(":").encode()
        return octets[-layout.width :].rjust(layout.width, b"\x02")

    def var_id(self) -> int:
        """An identifier for a variable of a peer's, which a VarCreate of now creates whatever was there before.

        Since 2.0 it may be one that peers have created in earlier cases: a case that needs an unknown one takes
        :meth:`unknown_id`. Raises ``NamesUsedUp``.
        """
        session = self.session
        # Up to 1.3 one range serves both: what the case calls unknown must not become a variable of it.
        for without in (self.created | self.called_unknown, self.created):
            number = session.identifiers.for_peer(
                self.now(), session.creation_time + 1, without, reuse=not session.renewable
            )
            if number is not None:
                break
        if number is None:
            self._no_variables_left("an identifier that a peer can create a variable with")
        self.created.add(number)
        return number

    def var_ids(self, count: int) -> list[int]:
        """Several of them, ascending unless the range ends in between."""
        return [self.var_id() for _ in range(count)]

    def unknown_ids(self, count: int) -> list[int]:
        """Identifiers that the implementation's database cannot hold, descending from the top of the range.

        They may have been used before: what is requested and never answered stays unknown. Raises ``NamesUsedUp``.
        """
        found = self.session.identifiers.unknown(count, self.now(), self.created)
        if len(found) < count:
            self._no_variables_left(f"{count} identifiers of variables that the implementation does not know")
        self.called_unknown.update(found)
        return found

    def is_applications(self, var_id: int) -> bool:
        """Whether the variable is none of the tester's: the PIXIT leaves its identifier to applications on the node."""
        identifiers = self.session.identifiers
        return not identifiers.first <= var_id < identifiers.first + identifiers.size

    def has_unknown_ids(self, count: int = 1) -> bool:
        """Whether so many identifiers are left that the implementation's database cannot hold."""
        return self.session.identifiers.left(self.now(), self.created) >= count

    def unknown_id(self) -> int:
        """One of :meth:`unknown_ids`."""
        return self.unknown_ids(1)[0]

    def own_var_id(self) -> int:
        """An identifier for a variable of the implementation's application: one that nobody ever had (X20).

        Raises ``NamesUsedUp`` when no more are left than the probes of other cases need.
        """
        for without in (self.created | self.called_unknown, self.created):
            number = self.session.identifiers.for_own(self.now(), without)
            if number is not None:
                break
        if number is None:
            self._no_variables_left("an identifier that no variable has had, for one of the implementation's own")
        self.created.add(number)
        return number

    def boundary_id(self, name: str) -> int:
        """A boundary value (:attr:`Session.boundaries`) as the identifier of an unknown variable.

        Raises ``NamesUsedUp`` if the implementation may know it.
        """
        number = self.session.boundaries[name]
        identifiers = self.session.identifiers
        taken = number in self.created or number in identifiers.in_use()
        if taken or not identifiers.is_unknown(number, self.now()):
            self._no_variables_left(f"the identifier {number}, which no variable has had")
        self.created.add(number)
        return number

    def departure(self) -> int:
        """The time in ns by which, up to 1.3, a variable that is deleted now has left the database."""
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
        """A time stamp as on the air: now, and later than any that was handed out before."""
        stamp = self.profile.types.timestamp
        since = self.lower.now() if stamp.epoch_ns is None else self.lower.wall() - stamp.epoch_ns
        ticks = since * stamp.per_second // 1_000_000_000
        self.session.creation_time = max(self.session.creation_time + 1, ticks)
        return self.session.creation_time

    def value(self, wanted: bytes) -> bytes:
        """``wanted``, or shorter octets in its place if values are limited to less; two that are cut stay different."""
        return self._shortened(wanted, self.parameter("VARDISPAR_MAX_VALUE_LENGTH"))

    def descr(self, wanted: bytes) -> bytes:
        """As :meth:`value`, for a description in UTF-8."""
        return self._shortened(wanted, self.longest_description)

    @property
    def longest_description(self) -> int:
        """The octets that a description may have; in 1.0 the parameter counts the NUL at its end (VD-CRE-04)."""
        name = "VARDISPAR_MAX_DESCRIPTION_LENGTH"
        told = name in self.session.parameters and self.features.string_format == "nul-terminated"
        return self.parameter(name) - (1 if told else 0)

    def _shortened(self, wanted: bytes, most: int) -> bytes:
        """Octets of at most this length, at least one, that no other ``wanted`` of this case has."""
        if len(wanted) <= most or most < 1:
            return wanted
        taken = self._short.setdefault(most, {})
        if wanted not in taken:
            # Printable, so that it may be a description, too.
            others = (wanted[: most - 1] + bytes((each,)) for each in (wanted[most - 1] & 0x7F, *range(0x21, 0x7F)))
            free = (each for each in others if each not in taken.values())
            taken[wanted] = next(free, wanted[:most])
        return taken[wanted]

    @property
    def longest_timeout(self) -> int:
        """The longest timeout in ms that the profile's VarTimeoutT expresses."""
        return int((1 << 8 * self.profile.types.var_timeout.width) - 1)

    def require_timeout(self, timeout: int) -> None:
        """Stop the case as not applicable if the profile cannot express a timeout of so many ms."""
        if timeout > self.longest_timeout:
            self.not_applicable(f"VarTimeoutT expresses at most {self.longest_timeout} ms, this takes {timeout} ms")

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
        """A VarSpec with what the profile's layout has; ``creation_time`` is a fresh one unless given.

        ``exact``: the description is as given, otherwise as :meth:`descr` makes it.

        Stops the case as not applicable if the profile cannot express ``timeout`` (in ms).
        """
        names = self.profile.vardis.var_spec
        self.require_timeout(timeout)
        return VarSpec(
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
        """A VarCreate record, as :meth:`sample` makes it. From now on the implementation may know the variable."""
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
        """A VarCreate record that is measured and not sent.

        Value and description are cut to what the implementation takes (:meth:`value`, :meth:`descr`), unless ``exact``.
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
        """A state report; the fields of the safety data that are not given are zero."""
        kind = self.codec.safety_data_type
        zeros: dict[str, Any] = {
            each.name: b"\0" * each.octets if each.type == "opaque" else 0.0 if each.type.startswith("f") else 0
            for each in self.profile.srp.safety_data
        }
        data = kind(**{_attribute(kind, name): value for name, value in {**zeros, **fields}.items()})
        return ExtendedSafetyData(data, node_id, self.creation_time() if t_stamp is None else t_stamp, seqno)


def _usual(name: str) -> str:
    """Where the assumed value of a parameter comes from: profiles have limits, the specification has periods."""
    return "usual" if name.endswith(("_PERIOD", "_TIMEOUT")) else "in the profile"


def address_of(number: int) -> bytes:
    """A locally administered address that says whose it is: 02:dc:9n:..."""
    return bytes((0x02, 0xDC, 0x90)) + number.to_bytes(3, "big")


def _attribute(kind: type[Any], name: str) -> str:
    """The attribute of a safety data class for a field's name."""
    return snake(name) if snake(name) in kind.__struct_fields__ else name
