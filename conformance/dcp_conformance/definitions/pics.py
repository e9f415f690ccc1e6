"""PICS (capabilities that an implementation claims) and PIXIT (information for testing it) as one TOML file.

A capability has three states: claimed, denied, and not stated. Not stated is not denied: a case that needs the
capability is not applicable, and the report gives this as the reason.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
from dcp_spec.catalogue.readings import UnknownReadingError, reading

from dcp_conformance.definitions.input_files import load_file

from .node_id import node_id_octets

#: Beacon periods that every reaction is granted: what a fast implementation needs, and room for a lost frame.
REACTION_FLOOR: Final = 4.0

DEFAULT_PROFILE: Final = "dcp-2.0"
"""The wire profile if the user names none."""
UNKNOWN_PROFILE: Final = "unknown"
"""The ``pixit.profile`` that ``probe`` writes if no profile explains the received frames."""

_Positive = Annotated[float, msgspec.Meta(gt=0, le=1e9)]
_Count = Annotated[int, msgspec.Meta(ge=0)]
_Places = Annotated[int, msgspec.Meta(ge=1)]


class Capabilities(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The choices that the specification leaves to implementations; None: not declared."""

    srp: bool | None = None
    """There is a State Reporting Protocol."""
    vardis: bool | None = None
    """There is a VarDis."""
    multiple_payloads: bool | None = None
    """Several payloads of one client may share a beacon (BP-QM-08)."""
    several_containers: bool | None = None
    """Sends several containers of one type in a payload (VD-IC-04)."""
    transmit_payload_confirm: bool | None = None
    """BP-TransmitPayload is confirmed (BP-TXP-08)."""
    payload_transmitted_indication: bool | None = None
    """BP indicates the transmission of a payload to its client (BP-PTI-01)."""
    triggered_beacons: bool | None = None
    """A new payload may bring the next beacon forward (BP-TXP-07)."""
    jitter: bool | None = None
    """Beacon intervals vary on purpose (BP-TX-02)."""
    loss_estimation: bool | None = None
    """Losses are estimated from sequence numbers (BP-RX-11)."""
    neighbour_statistics: bool | None = None
    """The neighbour table has further fields or queries (SRP-NT-04)."""
    srp_seqno_filter: bool | None = None
    """State reports with an older sequence number are not taken (SRP-RX-04)."""
    runtime_parameters: bool | None = None
    """Parameters can be set while running (BP-PAR-01)."""
    parameter_feedback: bool | None = None
    """A refused parameter is reported (BP-PAR-07)."""
    describe_extra_fields: bool | None = None
    """DescribeDatabase has further fields (VD-DDB-03)."""
    empty_description: bool | None = None
    """RTDB-Create takes an empty description (VD-CRE-15, X21)."""


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Which implementation this is about."""

    name: str = ""
    version: str = ""
    vendor: str = ""
    notes: str = ""


class Testing(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Information that the tester needs (PIXIT). Missing values come from the profile or from the implementation."""

    profile: str | None = None
    """The wire profile: a built-in name or a path."""
    node_id: str | None = None
    """The implementation's node identifier, hex with or without colons; else learnt from the first beacon."""
    network_id: _Count | None = None
    beacon_period_ms: _Positive = 100.0
    """BPPAR_BEACON_PERIOD: the unit of all time windows."""
    reaction_periods: _Positive | None = None
    """How long a reaction may take to appear in a beacon; None: measured at the start, and 4.0 at least."""
    least_patience_ms: _Positive = 300.0
    """Minimum wait for any reaction, whatever the beacon period: a machine may be busy."""
    quiet_beacons: Annotated[int, msgspec.Meta(ge=1)] = 3
    """Number of beacons without an instruction after which no more are expected."""
    period_tolerance: _Positive = 0.05
    """How far the mean interval may be from the period, as a fraction of it (BP-TX-01)."""
    clock_tolerance_ms: _Positive = 1000.0
    """How far the implementation's clock may be from the tester's."""
    timer_tolerance_ms: _Positive = 300.0
    """How late a timer may be, beyond what the specification allows."""
    reset: Literal["auto", "ut", "restart", "none"] = "auto"
    """How the implementation gets back to its initial state between cases: whatever there is, UT-Reset, a restart,
    or not at all (each case then uses variables and peers of its own)."""
    max_packet_size: _Count | None = None
    max_payload_size: _Count | None = None
    max_value_length: _Count | None = None
    max_description_length: _Count | None = None
    max_repetitions: _Count | None = None
    max_summaries: _Count | None = None
    variables: _Places | None = None
    """Capacities: the most variables in the database, entries of the neighbour table, clients of BP (without SRP and
    VarDis), and payloads in the queue of a client. None: unlimited, or as in the profile. A declared one is judged."""
    neighbours: _Places | None = None
    clients: _Places | None = None
    queue_entries: _Places | None = None
    loss: Annotated[float, msgspec.Meta(gt=0, le=0.2)] | None = None
    """The share of frames that the link loses. A failure for lack of a frame must then recur."""
    neighbour_timeout_ms: _Positive | None = None
    """Default if unknown: 3000; for the next two parameters 1000 and 50."""
    scrubbing_period_ms: _Positive | None = None
    buffer_check_period_ms: _Positive | None = None
    link_down: str | None = None
    """A command that takes the implementation's link down, as when its cable is pulled; with ``link_up``."""
    link_up: str | None = None
    """The command that takes it up again."""
    var_ids: tuple[int, int] | None = None
    """First and last variable identifier that the tester may use; None for all of them."""

    def __post_init__(self) -> None:
        if self.node_id is not None:
            try:
                node_id_octets(self.node_id)
            except ValueError as error:
                raise ValueError(f"node_id: {error}") from None


class Access(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """How the tester reaches the implementation. An option of the same name on the command line replaces its value."""

    interface: str | None = None
    """Ethernet interface of the tester; or ``link``."""
    link: str | None = None
    """``udp[:GROUP[:PORT]]``."""
    ether_type: Annotated[int, msgspec.Meta(ge=0x600, le=0xFFFF)] | None = None
    """EtherType of the beacons, such as 0x4953, if not that of the profile."""
    ut: str | None = None
    """Upper tester: ``unix:PATH``, ``tcp:HOST:PORT``, ``exec:COMMAND``, ``commands:FILE``."""
    start: str | None = None
    """Command that starts the implementation."""
    stop: str | None = None
    """Command that stops it, if ending the started process is not enough."""
    restart: str | None = None
    """Command that restarts it after a crash."""
    start_timeout: _Positive | None = None
    """Seconds until the first answer after a start. None: 30, or 8 after it has opened a socket for the link."""


class Pics(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The whole file: ``[sut]``, ``[access]``, ``[pics]``, ``[readings]`` and ``[pixit]``."""

    sut: Target = Target()
    access: Access = Access()
    pics: Capabilities = Capabilities()
    readings: dict[str, str] = {}
    """The readings of disputed text that the implementation claims to follow: identifier and name of the alternative.
    A case that observes another alternative than the declared one fails."""
    pixit: Testing = Testing()

    def __post_init__(self) -> None:
        for identifier, name in self.readings.items():
            try:
                reading(identifier).alternative(name)
            except UnknownReadingError as error:
                raise ValueError(f"readings: {error.args[0]}") from None
            except ValueError as error:
                raise ValueError(f"readings.{identifier}: {error}") from None


def load_pics(path: Path) -> Pics:
    """Read a file. Raises :class:`UsageError` that names the file, the key and what would be right."""
    return load_file(path, Pics, decode=msgspec.toml.decode)
