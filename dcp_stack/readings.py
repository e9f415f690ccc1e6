"""The readings of disputed text that the node obeys, one field for each; docs/readings.md describes the alternatives.

Each type lists the alternatives of the catalogue, so that mypy reports a comparison with a misspelt one.
"""

from __future__ import annotations

from typing import Literal

from msgspec import Struct, field

HalfRange = Literal["half-range-neither", "half-range-answered", "half-range-older"]
ReceiveErrors = Literal["keep-prefix", "drop-payload", "skip-container"]


class Readings(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The selected alternative of each reading. A field is encoded under the id of the reading in the catalogue."""

    # -- BP
    beacon_end: Literal["length-field", "frame-size"] = field(default="length-field", name="X02")
    """X02: the end of a beacon with a length field."""
    first_seqno: Literal["write-then-increment", "increment-then-write"] = field(
        default="write-then-increment", name="X03"
    )
    """X03: the sequence number of the first beacon."""
    packet_size: Literal["with-header", "blocks-only"] = field(default="with-header", name="X04")
    """X04: what the maximum packet size counts."""
    smallest_packet: Literal["literal-minimum", "usable-minimum"] = field(default="literal-minimum", name="X05")
    """X05: the lower bound of the maximum packet size."""
    unknown_queueing_mode: Literal["refuse-at-registration", "refuse-at-clear"] = field(
        default="refuse-at-registration", name="X06"
    )
    """X06: the service that refuses an unknown queueing mode."""
    transmitted_indication: Literal["per-payload", "per-beacon"] = field(default="per-payload", name="X44")
    """X44: indications for several payloads of a client in one beacon."""
    beacon_filling: Literal["while-space-lasts", "fewer-than-fit"] = field(default="while-space-lasts", name="X45")
    """X45: the number of payloads in a beacon."""
    empty_block: Literal["deliver-empty", "ignore-empty"] = field(default="deliver-empty", name="X46")
    """X46: a received block of length 0."""
    beacon_end_without_length: Literal["counted-blocks", "whole-frame"] = field(default="counted-blocks", name="X47")
    """X47: the end of a beacon before 1.2, without a length field."""
    miscounted_blocks: Literal["deliver-blocks", "discard-beacon"] = field(default="deliver-blocks", name="X48")
    """X48: a received number of blocks that is not numPayloads."""
    oversized_payload: Literal["deliver-larger", "discard-larger"] = field(default="deliver-larger", name="X49")
    """X49: a received payload that is larger than the client has registered."""

    # -- SRP
    uninitialized_srp: Literal["confirm-inactive", "no-response"] = field(default="confirm-inactive", name="X10")
    """X10: the answer of SRP before its initialization."""
    neighbour_age: Literal["steady-age", "system-time"] = field(default="steady-age", name="X50")
    """X50: the clock of the neighbour table."""

    # -- VarDis
    mismatched_ids: Literal["drop-mismatch", "ignore-update-id"] = field(default="drop-mismatch", name="X14")
    """X14: two different identifiers in a VarCreate."""
    summary_purge: Literal["no-purge", "purge-first"] = field(default="no-purge", name="X17")
    """X17: purging of summaryQ before a payload is composed."""
    repeated_create: Literal["by-steps", "by-description"] = field(default="by-steps", name="X20")
    """X20: RTDB-Create for an identifier that is taken."""
    empty_description: Literal["accept-locally", "refuse-locally"] = field(default="accept-locally", name="X21")
    """X21: RTDB-Create with an empty description."""
    value_length_bound: Literal["literal-bound", "record-bound"] = field(default="literal-bound", name="X23")
    """X23: the upper bound of the maximum value length."""
    scrubbing: Literal["every-node", "producer-only"] = field(default="every-node", name="X26")
    """X26: the nodes that scrub a variable."""
    exact_timeout: Literal["strictly-greater", "at-least"] = field(default="strictly-greater", name="X27")
    """X27: scrubbing of a variable exactly at its timeout."""
    half_range: HalfRange = field(default="half-range-neither", name="X28")
    """X28: the order of sequence numbers that are half of the range apart."""
    unregistered_vardis: Literal["answer-inactive", "no-response"] = field(default="answer-inactive", name="X30")
    """X30: the answer of VarDis while it is not registered with BP."""
    receive_errors: ReceiveErrors = field(default="keep-prefix", name="X34")
    """X34: errors in a received payload."""
    inactive_scrubbing: Literal["goes-on", "pauses-while-inactive"] = field(default="goes-on", name="X36")
    """X36: scrubbing while VarDis is inactive."""
    pending_at_deactivation: Literal["stay-queued", "are-dropped"] = field(default="stay-queued", name="X37")
    """X37: pending repetitions and requests when VarDis is deactivated."""
    vardis_clock: Literal["steady-clock", "system-clock"] = field(default="steady-clock", name="X38")
    """X38: ages and creation times when the system time is set."""
    value_out_of_bounds: Literal["refuse-value", "nearest-value"] = field(default="refuse-value", name="X39")
    """X39: a parameter value that violates a bound."""
    raised_payload_size: Literal["register-anew", "registered-size"] = field(default="register-anew", name="X41")
    """X41: a maximum payload size that is raised after the registration with BP."""
    composition_time: Literal["before-the-beacon", "after-the-beacon"] = field(default="before-the-beacon", name="X54")
    """X54: when the next payload is composed."""

    # -- SRP and VarDis
    registered_version: Literal["own-version", "as-written"] = field(default="own-version", name="X31")
    """X31: the version in the names under which SRP and VarDis register."""
