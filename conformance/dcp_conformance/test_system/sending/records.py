"""Records that the tester sends: values and time stamps that the implementation accepts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypedDict, Unpack

from dcp_codec.codec import Codec
from dcp_codec.values import (
    ExtendedSafetyData,
    VarCreate,
    VarDelete,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)
from dcp_conformance.frames.sampling import sampler
from dcp_conformance.test_system.identifiers.allocation import Identifiers
from dcp_conformance.test_system.judgement.verdicts import Verdicts
from dcp_conformance.test_system.steps import Clock
from dcp_conformance.test_system.sut_properties import SutProperties


class LastTimeStamp(Protocol):
    """The last time stamp that a run has used, in ticks of the profile's clock."""

    creation_time: int


class CreationFields(TypedDict, total=False):
    """Fields of a VarCreate that have a default value, see :meth:`Records.sample`."""

    value: bytes
    seqno: int
    rep_cnt: int
    descr: bytes
    creation_time: int | None
    timeout: int
    exact: bool


@dataclass(eq=False)
class Records:
    """Makes the records of one case."""

    _codec: Codec
    _clock: Clock
    _run: LastTimeStamp
    _sut: SutProperties
    _identifiers: Identifiers
    _verdicts: Verdicts

    def __post_init__(self) -> None:
        self._made = sampler(self._codec)
        self._short: dict[int, dict[bytes, bytes]] = {}
        """By maximum length: the shortened octets for each wanted text."""

    def creation_time(self) -> int:
        """Return a time stamp for a record: the current time, and later than any returned before."""
        self._run.creation_time = max(self._run.creation_time + 1, self.current_time())
        return self._run.creation_time

    def current_time(self, hours: int = 0) -> int:
        """Return the current time, or that many hours later, in ticks of the profile's clock; at least 0."""
        stamp = self._sut.profile.types.timestamp
        since = self._clock.now() if stamp.epoch_ns is None else self._clock.wall() - stamp.epoch_ns
        return max((since + hours * 3_600_000_000_000) * stamp.per_second // 1_000_000_000, 0)

    def value(self, wanted: bytes) -> bytes:
        """Return ``wanted``, or shorter octets if the maximum is smaller; different values remain different."""
        return self._shortened(wanted, self._sut.parameter("VARDISPAR_MAX_VALUE_LENGTH"))

    def descr(self, wanted: bytes) -> bytes:
        """As :meth:`value`, for a description in UTF-8."""
        return self._shortened(wanted, self._sut.longest_description)

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

    def require_timeout(self, timeout: int) -> None:
        """Stop the case as not applicable if the profile cannot express a timeout (ms)."""
        longest = self._sut.longest_timeout
        if timeout > longest:
            self._verdicts.not_applicable(f"VarTimeoutT holds at most {longest} ms, and the case needs {timeout} ms")

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
        self.require_timeout(timeout)
        if creation_time is None and self._made.stamped:
            creation_time = self.creation_time()
        descr = descr if exact else self.descr(descr)
        return self._made.spec(var_id, producer, rep_cnt, descr, creation_time or 0, timeout)

    def create(self, var_id: int, producer: bytes, **fields: Unpack[CreationFields]) -> VarCreate:
        """Return a VarCreate like :meth:`sample`. From now on the implementation may know the variable."""
        made = self.sample(var_id, producer, **fields)
        self._identifiers.offered(var_id, made.spec.creation_time)
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
        """Return a VarCreate that is measured but not sent. ``creation_time`` and ``producer`` are new by default.

        Value and description are truncated to the implementation's maximum (:meth:`value`, :meth:`descr`) unless
        ``exact``.
        """
        producer = self._identifiers.node_id() if producer is None else producer
        spec = self.spec(
            var_id,
            producer,
            rep_cnt=rep_cnt,
            descr=descr,
            creation_time=creation_time,
            timeout=timeout,
            exact=exact,
        )
        return self._made.create(spec, seqno, value if exact else self.value(value))

    def update(self, var_id: int, seqno: int, value: bytes = b"newer", *, exact: bool = False) -> VarUpdate:
        """Return a VarUpdate; the value is truncated to the implementation's maximum unless ``exact``."""
        return self._made.filled(VarUpdate(var_id, seqno, value if exact else self.value(value)))

    def delete(self, var_id: int) -> VarDelete:
        """Return a VarDelete."""
        return self._made.filled(VarDelete(var_id))

    def summary(self, var_id: int, seqno: int) -> VarSumm:
        """Return a VarSumm."""
        return self._made.filled(VarSumm(var_id, seqno))

    def request_update(self, var_id: int, seqno: int) -> VarReqUpdate:
        """Return a VarReqUpdate; ``seqno`` is the sequence number that the sender claims to have."""
        return self._made.filled(VarReqUpdate(var_id, seqno))

    def request_create(self, var_id: int) -> VarReqCreate:
        """Return a VarReqCreate."""
        return self._made.filled(VarReqCreate(var_id))

    def report(self, node_id: bytes, seqno: int, *, t_stamp: int | None = None, **fields: float) -> ExtendedSafetyData:
        """Return a state report; fields of the safety data that are not given are zero."""
        return self._made.report(node_id, self.creation_time() if t_stamp is None else t_stamp, seqno, fields)
