"""Status codes of the confirms of BP, SRP and VarDis, in the spelling of the specification.

Version 1.0 writes most VarDis codes with underscores; `parse` accepts both spellings.
"""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Final, Self, cast

from .constants import SpecVersion

_V = SpecVersion


class StatusCode(StrEnum):
    """Base of the three enumerations: a string that also knows its history.

    since: first version of the specification that has the code
    until: last version that has it, None if the draft 2.0 has it
    meaning: when the code is returned
    """

    since: SpecVersion
    until: SpecVersion | None
    meaning: str

    def __new__(
        cls,
        spelling: str,
        meaning: str,
        since: SpecVersion = _V.V1_0,
        until: SpecVersion | None = None,
    ) -> Self:
        member = str.__new__(cls, spelling)
        member._value_ = spelling
        member.since = since
        member.until = until
        member.meaning = meaning
        return member

    @property
    def is_ok(self) -> bool:
        """Whether the code reports success."""
        return self.endswith("-STATUS-OK")

    def holds_in(self, version: SpecVersion | str) -> bool:
        """Whether `version` has the code. Raises ValueError for a version that does not exist."""
        return SpecVersion(version).is_within(self.since, self.until)

    @classmethod
    def parse(cls, text: str) -> Self:
        """The code with this spelling, hyphens and underscores being equal. Raises ValueError for others."""
        member = cls._value2member_map_.get(text.replace("_", "-"))
        if member is None:
            raise ValueError(f"{cls.__name__} has no code {text!r}")
        return cast("Self", member)


class BPStatus(StatusCode):
    """Status codes of BP (dcp-bp.md: Service Interface)."""

    OK = ("BP-STATUS-OK", "The request was carried out.")
    PROTOCOL_ALREADY_REGISTERED = (
        "BP-STATUS-PROTOCOL-ALREADY-REGISTERED",
        "A client protocol is registered under this identifier.",
    )
    ILLEGAL_MAX_PAYLOAD_SIZE = (
        "BP-STATUS-ILLEGAL-MAX-PAYLOAD-SIZE",
        "The maximum payload size of a registration is not positive or fits into no beacon.",
    )
    UNKNOWN_PROTOCOL = ("BP-STATUS-UNKNOWN-PROTOCOL", "No client protocol is registered under this identifier.")
    PAYLOAD_TOO_LARGE = (
        "BP-STATUS-PAYLOAD-TOO-LARGE",
        "The payload is longer than the maximum of its registration.",
    )
    EMPTY_PAYLOAD = ("BP-STATUS-EMPTY-PAYLOAD", "The payload has no bytes.")
    ILLEGAL_DROPPING_QUEUE_SIZE = (
        "BP-STATUS-ILLEGAL-DROPPING-QUEUE-SIZE",
        "The registration asks for a queue without places.",
        _V.V1_1,
    )
    UNKNOWN_QUEUEING_MODE = (
        "BP-STATUS-UNKNOWN-QUEUEING-MODE",
        "The queueing mode is not one of the defined modes.",
        _V.V1_1,
    )


class SRPStatus(StatusCode):
    """Status codes of SRP (dcp-srp.md: Service Interface)."""

    OK = ("SRP-STATUS-OK", "The safety data were accepted for transmission.")
    INACTIVE = ("SRP-STATUS-INACTIVE", "SRP is not registered with BP.")


class VardisStatus(StatusCode):
    """Status codes of VarDis (dcp-vardis.md#vardis-application-service-interface)."""

    OK = ("VARDIS-STATUS-OK", "The request was carried out on this node.")
    VARIABLE_EXISTS = (
        "VARDIS-STATUS-VARIABLE-EXISTS",
        "The database has a variable with this identifier (since 2.0: of another producer).",
    )
    VARIABLE_DESCRIPTION_TOO_LONG = (
        "VARDIS-STATUS-VARIABLE-DESCRIPTION-TOO-LONG",
        "The description is longer than VARDISPAR_MAX_DESCRIPTION_LENGTH.",
    )
    VALUE_TOO_LONG = ("VARDIS-STATUS-VALUE-TOO-LONG", "The value is longer than VARDISPAR_MAX_VALUE_LENGTH.")
    EMPTY_VALUE = ("VARDIS-STATUS-EMPTY-VALUE", "The value has no bytes.", _V.V1_1)
    INVALID_VALUE = (
        "VARDIS-STATUS-INVALID-VALUE",
        "The value has no bytes; named EMPTY-VALUE since 1.1.",
        _V.V1_0,
        _V.V1_0,
    )
    ILLEGAL_REPCOUNT = (
        "VARDIS-STATUS-ILLEGAL-REPCOUNT",
        "The repetition count is 0 or above VARDISPAR_MAX_REPETITIONS.",
    )
    VARIABLE_DOES_NOT_EXIST = (
        "VARDIS-STATUS-VARIABLE-DOES-NOT-EXIST",
        "The database has no variable with this identifier.",
    )
    NOT_PRODUCER = (
        "VARDIS-STATUS-NOT-PRODUCER",
        "The variable has another producer, which alone may change it.",
    )
    VARIABLE_IS_DELETED = ("VARDIS-STATUS-VARIABLE-IS-DELETED", "The variable is marked as deleted.", _V.V2_0)
    VARIABLE_BEING_DELETED = (
        "VARDIS-STATUS-VARIABLE-BEING-DELETED",
        "The variable is marked for deletion and leaves the database later; named IS-DELETED since 2.0.",
        _V.V1_0,
        _V.V1_3,
    )
    INACTIVE = ("VARDIS-STATUS-INACTIVE", "VarDis is not active, or not registered with BP.")

    def in_version(self, version: SpecVersion | str) -> "VardisStatus":
        """The code that `version` returns in the same situation: two codes were renamed over time."""
        if self.holds_in(version):
            return self
        # Each renamed code has exactly one counterpart, and at any version one of the two exists.
        return _RENAMED[self]


_RENAMED: Final[Mapping[VardisStatus, VardisStatus]] = MappingProxyType(
    {
        VardisStatus.EMPTY_VALUE: VardisStatus.INVALID_VALUE,
        VardisStatus.INVALID_VALUE: VardisStatus.EMPTY_VALUE,
        VardisStatus.VARIABLE_IS_DELETED: VardisStatus.VARIABLE_BEING_DELETED,
        VardisStatus.VARIABLE_BEING_DELETED: VardisStatus.VARIABLE_IS_DELETED,
    }
)
