"""Constants of the protocol family, and what each version of the specification has.

Numbers follow dcp-bp.md#subsubsec-beaconing-protocol-data-types and
dcp-vardis.md#vardis-definitions-instruction-containers; the differences between the versions were taken from
the tagged texts v1.0.0 to v1.3.0 and from the draft of 2.0. Layouts of records are in the profiles, not here.
"""

import functools
from enum import IntEnum, StrEnum
from typing import Final, Literal

import msgspec

BP_MAGIC_NO: Final = 0x497E
"""Value of BPHeaderT.magicNo, 16 bits (BP-HDR-02)."""

BP_VERSION: Final = 0x01
"""Value of BPHeaderT.version, 8 bits, the same in all versions of the specification (BP-HDR-01, X09)."""

BP_MAX_PAYLOADS: Final = 0xFF
"""Most payload blocks in a beacon: numPayloads has 8 bits (BP-TX-08)."""

BP_SEQNO_MODULUS: Final = 1 << 32
"""The BP sequence number counts modulo this (BP-HDR-08)."""

SRP_SEQNO_MODULUS: Final = 1 << 32
"""The SRP sequence number counts modulo this (SRP-TYP-01, SRP-SEQ-01)."""

IC_MAX_RECORDS: Final = 0xFF
"""Most records in an instruction container: icNumRecords has 8 bits (VD-PAY-05)."""

UWB_MIN_MTU: Final = 256
"""Least maximum packet size of a bearer in bytes, since 1.1 (UWB-03)."""

ETHERTYPE_MIN: Final = 0x0600
"""Values below are lengths, not types, in an Ethernet header (IEEE 802.3)."""


class SpecVersion(StrEnum):
    """A published version of the specification, or the draft 2.0, oldest first.

    The members compare by their numbers with <, <=, > and >=, also with a plain string such as "1.10". A string that is
    not a version raises ValueError. A new version is one line here; what it has beyond the one before it is in
    `features` and in its profile.
    """

    V1_0 = "1.0"
    V1_1 = "1.1"
    V1_2 = "1.2"
    V1_3 = "1.3"
    V2_0 = "2.0"

    def __lt__(self, other: str) -> bool:
        return _version_numbers(self) < _version_numbers(other)

    def __le__(self, other: str) -> bool:
        return _version_numbers(self) <= _version_numbers(other)

    def __gt__(self, other: str) -> bool:
        return _version_numbers(self) > _version_numbers(other)

    def __ge__(self, other: str) -> bool:
        return _version_numbers(self) >= _version_numbers(other)

    def is_within(self, since: str, until: str | None = None) -> bool:
        """Whether this version is neither before `since` nor after `until` (None: there is no last version)."""
        return since <= self and (until is None or self <= until)


@functools.cache
def _version_numbers(version: str) -> tuple[int, ...]:
    """The numbers of a version, such as (1, 3)."""
    try:
        return tuple(int(number) for number in version.split("."))
    except ValueError:
        raise ValueError(f"{version!r} is not a version of the specification; expected numbers, such as 1.3") from None


class ProtocolId(IntEnum):
    """BPProtocolIdT values with a meaning (BP-HDR-11); other values are free for other client protocols."""

    SRP = 1
    VARDIS = 2


BP_PROTID_SRP: Final = ProtocolId.SRP
BP_PROTID_VARDIS: Final = ProtocolId.VARDIS


class ICType(IntEnum):
    """Types of instruction containers, as numbered on the wire (VD-IC-02)."""

    SUMMARIES = 1
    UPDATES = 2
    REQUEST_VARUPDATES = 3
    REQUEST_VARCREATES = 4
    CREATE_VARIABLES = 5
    DELETE_VARIABLES = 6

    @property
    def label(self) -> str:
        """The specification's spelling without its prefix, such as "REQUEST-VARUPDATES"."""
        return self.name.replace("_", "-")


class QueueingMode(StrEnum):
    """BPQueueingMode, spelled as in the specification (BP-QM-06). The values never appear in beacons."""

    QUEUE = "BP_QMODE_QUEUE"
    """Queue without bound, 1.0 only."""
    QUEUE_DROPTAIL = "BP_QMODE_QUEUE_DROPTAIL"
    QUEUE_DROPHEAD = "BP_QMODE_QUEUE_DROPHEAD"
    ONCE = "BP_QMODE_ONCE"
    REPEAT = "BP_QMODE_REPEAT"

    @property
    def is_queue(self) -> bool:
        """Whether the mode keeps a queue rather than a buffer for one payload."""
        return self not in (QueueingMode.ONCE, QueueingMode.REPEAT)


def seqno_modulus(width: int) -> int:
    """Return SEQNO-MODULUS for a VarSeqnoT of `width` bytes, 2^(8 width) (VD-TYP-03).

    Raises ValueError for a width below one byte.
    """
    if width < 1:
        raise ValueError(f"VarSeqnoT has at least one byte, not {width}")
    return 1 << (8 * width)


class Features(msgspec.Struct, frozen=True, kw_only=True):
    """The features of one version of the specification, where versions differ.

    Defaults are those of the draft 2.0; sequences of octets are not described here but in the profiles.
    """

    version: SpecVersion
    network_id: bool = True
    """BPHeaderT has the field networkId (BP-HDR-04)."""
    queueing_modes: frozenset[QueueingMode] = frozenset(QueueingMode) - {QueueingMode.QUEUE}
    """The modes a client may register with (BP-QM-06)."""
    clear_buffer: bool = True
    """BP has the service BP-ClearBuffer (BP-CLR-02)."""
    allow_multiple_payloads: bool = True
    """Registrations have maxEntries and allowMultiplePayloads (BP-REG-01)."""
    own_id_in_register_confirm: bool = True
    """BP-RegisterProtocol.confirm carries the own node identifier (BP-REG-07)."""
    registration_counts_bp_header: bool = True
    """The bound on maxPayloadSize subtracts the BP header (BP-REG-04); else four bytes in its place."""
    bp_activation: bool = True
    """BP can be deactivated and activated (BP-MGT-01)."""
    vardis_activation: Literal["none", "flag", "service"] = "service"
    """VarDis has no active state, only the flag vardisActive, or also services to set it (VD-MGT-01)."""
    empty_payload_clears_buffer: bool = False
    """BP-TransmitPayload of no bytes clears a ONCE or REPEAT buffer and is not refused (BP-TXP-03)."""
    first_beacon_seqno: int = 0
    """Sequence number of the first beacon (BP-HDR-08, X03)."""
    srp_queueing_mode: QueueingMode = QueueingMode.ONCE
    """Mode with which SRP registers (SRP-INI-03)."""
    vardis_queueing_mode: QueueingMode = QueueingMode.QUEUE_DROPHEAD
    """Mode with which VarDis registers (VD-INI-02)."""
    string_format: Literal["nul-terminated", "length-prefixed"] = "length-prefixed"
    """How a StringT is serialized (DATA-07)."""
    several_containers_per_type: bool = True
    """A payload may hold several containers of one type (VD-IC-04, VD-RX-03)."""
    container_order: tuple[ICType, ...] = (
        ICType.CREATE_VARIABLES,
        ICType.DELETE_VARIABLES,
        ICType.REQUEST_VARCREATES,
        ICType.SUMMARIES,
        ICType.UPDATES,
        ICType.REQUEST_VARUPDATES,
    )
    """Order in which a payload is composed (VD-PAY-01, X18); receivers accept any order."""
    purge_when_composing: bool = False
    """Queues are purged of missing or deleted variables before composing (X17)."""
    receive_checks_too_long: bool = True
    """Received values and descriptions above the maximum are ignored (VD-PC-04, VD-PC-05, VD-PU-04)."""
    receive_checks_empty_and_repcnt: bool = True
    """Received empty values, empty descriptions and illegal repCnt are ignored as well (VD-PC-06)."""
    rerequest_unknown: bool = True
    """A request for an unknown variable makes the receiver request it, too (VD-RU-01, VD-RC-01, X29)."""
    removed_after_deletion: bool = False
    """A deleted variable leaves the database after the last VarDelete (VD-DB-02)."""
    creation_time: bool = True
    """VarSpecT has creationTime and timeout; variables time out and can be created again (VD-TYP-05)."""
    producer_set_by_vardis: bool = True
    """RTDB-Create sets prodId itself (VD-CRE-08)."""
    max_repetitions_bound: int | None = 15
    """Upper bound of VARDISPAR_MAX_REPETITIONS, None where there is none (VD-PAR-04, X25)."""


_V2_0: Final = Features(version=SpecVersion.V2_0)

_V1_3: Final = msgspec.structs.replace(
    _V2_0,
    version=SpecVersion.V1_3,
    network_id=False,
    removed_after_deletion=True,
    creation_time=False,
)

_V1_2: Final = msgspec.structs.replace(
    _V1_3,
    version=SpecVersion.V1_2,
    srp_queueing_mode=QueueingMode.REPEAT,
    purge_when_composing=True,
)

_V1_1: Final = msgspec.structs.replace(
    _V1_2,
    version=SpecVersion.V1_1,
    bp_activation=False,
    vardis_activation="flag",
    vardis_queueing_mode=QueueingMode.QUEUE_DROPTAIL,
    receive_checks_empty_and_repcnt=False,
    producer_set_by_vardis=False,
    max_repetitions_bound=None,
)

_V1_0: Final = msgspec.structs.replace(
    _V1_1,
    version=SpecVersion.V1_0,
    queueing_modes=frozenset({QueueingMode.QUEUE, QueueingMode.ONCE, QueueingMode.REPEAT}),
    clear_buffer=False,
    allow_multiple_payloads=False,
    own_id_in_register_confirm=False,
    registration_counts_bp_header=False,
    vardis_activation="none",
    empty_payload_clears_buffer=True,
    first_beacon_seqno=1,
    vardis_queueing_mode=QueueingMode.ONCE,
    string_format="nul-terminated",
    several_containers_per_type=False,
    container_order=(
        ICType.CREATE_VARIABLES,
        ICType.DELETE_VARIABLES,
        ICType.UPDATES,
        ICType.SUMMARIES,
        ICType.REQUEST_VARCREATES,
        ICType.REQUEST_VARUPDATES,
    ),
    receive_checks_too_long=False,
    rerequest_unknown=False,
    max_repetitions_bound=15,
)

#: Oldest first. A version without an entry has what the one before it has.
_FEATURES: Final = (_V1_0, _V1_1, _V1_2, _V1_3, _V2_0)


def features(version: SpecVersion | str) -> Features:
    """Return what `version` of the specification has. Raises ValueError for a version that does not exist."""
    return _features(SpecVersion(version))


@functools.cache
def _features(version: SpecVersion) -> Features:
    newest = [each for each in _FEATURES if each.version <= version][-1]
    return newest if newest.version == version else msgspec.structs.replace(newest, version=version)
