"""Known properties of the implementation under test: its profile, parameters and reaction time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, Literal, Protocol

from dcp_spec.constants import Features, features
from dcp_spec.parameters import parameter
from dcp_spec.profile.definition import Profile

from dcp_codec.codec import Codec
from dcp_conformance.definitions.pics import REACTION_FLOOR, Pics, Testing

from .assumptions import Assumptions
from .known import Known
from .steps import Clock

#: ns in a millisecond.
MS: Final = 1_000_000
#: Shortest time limit for a reaction, in beacon periods.
FLOOR: Final = REACTION_FLOOR
#: Names of parameters in the PIXIT.
PIXIT: Final = {
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


Capacity = Literal["variables", "neighbours", "clients", "queue_entries"]
"""Keys of the PIXIT about the memory of the implementation."""
_CAPACITIES: Final[Mapping[Capacity, str]] = {
    "variables": "variables",
    "neighbours": "neighbours",
    "clients": "clients",
    "queue_entries": "payloads in a queue",
}


def capacity(pixit: Testing, profile: Profile, what: Capacity) -> int | None:
    """Return a capacity as declared in the PIXIT or, otherwise, in the profile; None: unlimited."""
    limits = {"variables": profile.limits.max_variables, "neighbours": profile.limits.max_neighbours}
    declared: int | None = getattr(pixit, what)
    return declared if declared is not None else limits.get(what)


class PeriodOverride(Protocol):
    """A beacon period that the tester has set instead of the configured one."""

    @property
    def milliseconds(self) -> int:
        """The period in ms."""
        ...

    def renew(self) -> bool:
        """Set the period again, after a reset. Return whether the implementation has accepted it."""
        ...

    def forget(self) -> None:
        """Record that the implementation uses the configured period again, after a restart."""
        ...


class KnownFacts(Protocol):
    """The facts about the implementation that a run has collected so far; they may change while a case is executed."""

    codec: Codec
    pics: Pics
    timing_scale: float
    parameters: dict[str, Any]
    known: Known
    short_period: PeriodOverride | None
    busy_until: int


class SutProperties:
    """The properties of the implementation: as it reports them, as measured, or from PICS and PIXIT.

    A value that is only assumed is recorded in the ``assumptions`` of the case.
    """

    def __init__(self, facts: KnownFacts, clock: Clock, assumptions: Assumptions) -> None:
        self._facts = facts
        self._clock = clock
        self._assumptions = assumptions
        self.pics = facts.pics.pics
        self.pixit = facts.pics.pixit
        self.profile: Profile = facts.codec.profile
        self.features: Features = features(self.profile.spec_version)
        """Features of the profile's version of the specification."""

    # -- times ---------------------------------------------------------------------------------------------------------

    @property
    def period(self) -> int:
        """The beacon period in ns; with ``--timing-scale``, longer for every time window."""
        short = self._facts.short_period
        milliseconds = self.pixit.beacon_period_ms if short is None else short.milliseconds
        return round(milliseconds * MS * self._facts.timing_scale)

    @property
    def reaction(self) -> float:
        """Maximum number of beacon periods until the reaction to a stimulus sent now or before.

        As given in the PIXIT, otherwise as measured at the start (:mod:`dcp_conformance.interconnection`). An
        implementation that processes payloads one at a time has more time while some are pending.
        """
        pending = max(0, self._facts.busy_until - self._clock.now()) / self.period
        return self._reaction_periods + pending

    @property
    def _reaction_periods(self) -> float:
        if self.pixit.reaction_periods is not None:
            return self.pixit.reaction_periods
        return self._facts.known.reaction.periods

    @property
    def slowness(self) -> float:
        """Factor by which this implementation may take longer than usual; at least 1."""
        return max(1.0, self._reaction_periods / FLOOR)

    @property
    def ahead(self) -> int:
        """Number of beacons that may be sent before one shows a reaction: payloads are composed in advance."""
        return max(2, math.ceil(max(self._facts.known.reaction.samples, default=0)))

    @property
    def one_by_one(self) -> bool:
        """Whether the implementation was measured to process payloads one at a time (it may answer in between)."""
        return self._facts.known.reaction.per_payload > 0

    @property
    def busy_until(self) -> int:
        """Time in ns until which the implementation may process the payloads that it was sent."""
        return self._facts.busy_until

    def load(self, payloads: int) -> None:
        """Record that the implementation was just sent this number of payloads to process."""
        if self.one_by_one:
            busy = round(payloads * self._facts.known.reaction.per_payload * self.period)
            self._facts.busy_until = max(self._facts.busy_until, self._clock.now()) + busy

    # -- parameters ----------------------------------------------------------------------------------------------------

    def parameter(self, name: str) -> int:
        """Return the value of a parameter: as the implementation reports it, otherwise from PIXIT or profile.

        Names are those of the specification (``VARDISPAR_MAX_SUMMARIES``), periods in ms. Raises ``KeyError`` for an
        unknown name.
        """
        if name in self._facts.parameters:
            return int(self._facts.parameters[name])
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

    def initial(self, name: str) -> Any:
        """Return the value of a parameter before the case; None if it is unknown."""
        if name in self._facts.parameters:
            return self._facts.parameters[name]
        try:
            value = self.parameter(name)
        except KeyError:
            return None
        # Only the number of summaries may be 0; for others 0 means that the value is unknown.
        return value if value or name == "VARDISPAR_MAX_SUMMARIES" else None

    def bound(self, name: str, *, missing: bool = False) -> int:
        """As :meth:`parameter`, for a verdict that depends on the value: an assumed value does not lead to a failure.

        ``missing``: with another value only expected records would be missing; wrong records still fail.
        """
        if text := self._assumed(name):
            assumptions = self._assumptions
            (assumptions.stimuli if missing else assumptions.expectations)[name] = text
        return self.parameter(name)

    def _assumed(self, name: str) -> str:
        """Return a text that a parameter was assumed; empty if its value is known."""
        pixit = PIXIT[name]
        if name in self._facts.parameters or getattr(self.pixit, pixit) is not None:
            return ""
        return f"{name} was taken to be {self.parameter(name)}, as {_usual(name)}: state its value (pixit.{pixit})"

    def is_assumed(self, name: str) -> bool:
        """Return whether neither the implementation nor the PIXIT has the value of a parameter."""
        return bool(self._assumed(name))

    def rep_cnt(self, wanted: int) -> int:
        """Return a repetition count that the implementation accepts: the wanted one, or the maximum.

        If the maximum is unknown, a count above 1 may be too large: then missing records are not a failure.
        """
        name = "VARDISPAR_MAX_REPETITIONS"
        if wanted > 1:
            self.bound(name, missing=True)
        return max(1, min(wanted, self.parameter(name) or wanted))

    def capacity(self, what: Capacity) -> int | None:
        """Return a capacity of the implementation as declared in the PIXIT or, otherwise, in the profile."""
        return capacity(self.pixit, self.profile, what)

    def lacks(self, what: Capacity, wanted: int) -> str:
        """Return why the implementation has no room for ``wanted`` entries; empty if there is room."""
        room = self.capacity(what)
        name = _CAPACITIES[what]
        return f"the implementation has room for {room} {name}, as declared" if room and room < wanted else ""

    @property
    def longest_description(self) -> int:
        """Maximum length of a description in octets; in 1.0 the parameter counts the NUL at its end (VD-CRE-04)."""
        name = "VARDISPAR_MAX_DESCRIPTION_LENGTH"
        with_nul = name in self._facts.parameters and self.features.string_format == "nul-terminated"
        return self.parameter(name) - (1 if with_nul else 0)

    @property
    def longest_timeout(self) -> int:
        """The longest timeout in ms that the profile's VarTimeoutT can hold."""
        return int((1 << 8 * self.profile.types.var_timeout.width) - 1)


def _usual(name: str) -> str:
    """Return the origin of the assumed value of a parameter: limits are in profiles, periods in the specification."""
    return "usual" if name.endswith(("_PERIOD", "_TIMEOUT")) else "in the profile"
