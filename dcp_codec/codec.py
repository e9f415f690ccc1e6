"""The codec of a profile: strict decoding and encoding for programs, dissection for display."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import load_profile
from dcp_spec.wire.schema import Schema, build_schema

from .errors import DecodeError, Problem
from .plan.layout import ValueTypes, read_scalar, walk
from .plan.measures import least_size, member, places, record
from .plan.tree import Many, Node, Scalar, Select, lower
from .values import Beacon, Container, ExtendedSafetyData, OwnRecord, SafetyData
from .views.decoder import Decode, generate_decoder
from .views.dissector import Dissect, generate_dissector
from .views.encoder import Encode, generate_encoder
from .views.fields import Dissection
from .views.lint import DOUBTS, warnings
from .views.salvage import Salvaged, Salvager


class Codec:
    """Decodes and encodes the messages of one profile.

    Everything is built on first use from the construct schema of the profile: ``beacon_plan`` (the layout as a tree),
    the compiled decoder and encoder, and the dissector. Instances are immutable for their users and can be shared
    between threads.
    """

    def __init__(self, profile: Profile | str | Path) -> None:
        """``profile`` is a loaded profile, the name of a built-in one, or the path of a TOML file.

        Raises ``dcp_spec.profile.loading.ProfileError`` if there is no such profile or it contradicts itself.
        """
        self.profile = profile if isinstance(profile, Profile) else load_profile(profile)
        self.types = ValueTypes(self.profile)

    def __repr__(self) -> str:
        return f"Codec({self.profile.name!r})"

    @functools.cached_property
    def schema(self) -> Schema:
        """Return the construct schemas of the profile."""
        return build_schema(self.profile)

    @functools.cached_property
    def beacon_plan(self) -> Node:
        """Return the layout of a whole beacon."""
        return lower(self.schema.beacon)

    @functools.cached_property
    def envelope_plan(self) -> Node:
        """Return the layout of a beacon whose client payloads are not decoded."""
        return lower(self.schema.envelope)

    @functools.cached_property
    def containers_plan(self) -> Node:
        """Return the layout of a VarDis payload."""
        return lower(self.schema.containers)

    @functools.cached_property
    def srp_plan(self) -> Node | None:
        """Return the layout of an SRP payload; None if the profile defines no structure for it."""
        return None if self.schema.srp is None else lower(self.schema.srp)

    @property
    def report_plan(self) -> Node | None:
        """Return the layout of a state report; None if the profile's SRP payloads are not state reports."""
        return self.srp_plan if self.profile.srp.is_report else None

    @functools.cached_property
    def _decode_beacon(self) -> Decode:
        return generate_decoder(self.beacon_plan, self.types, f"{self.profile.name} beacon")

    @functools.cached_property
    def _decode_envelope(self) -> Decode:
        return generate_decoder(self.envelope_plan, self.types, f"{self.profile.name} envelope")

    @functools.cached_property
    def _decode_containers(self) -> Decode:
        return generate_decoder(self.containers_plan, self.types, f"{self.profile.name} containers")

    @functools.cached_property
    def _decode_records(self) -> dict[int, Decode]:
        """Decoders of records up to the end of the octets, by container type."""
        plan, types = self.containers_plan, self.types
        select = next(node for node in walk(plan) if isinstance(node, Select) and node.key == "icType")
        lists = {number: replace(case, count=None) for number, case in select.cases.items() if isinstance(case, Many)}
        return {number: generate_decoder(each, types, f"{self.profile.name} records") for number, each in lists.items()}

    @functools.cached_property
    def _decode_report(self) -> Decode:
        return generate_decoder(self._needed_srp_plan(), self.types, f"{self.profile.name} SRP payload")

    @functools.cached_property
    def _encode_beacon(self) -> Encode:
        return generate_encoder(self.beacon_plan, self.types, f"{self.profile.name} beacon")

    @functools.cached_property
    def _encode_envelope(self) -> Encode:
        return generate_encoder(self.envelope_plan, self.types, f"{self.profile.name} envelope")

    @functools.cached_property
    def _encode_containers(self) -> Encode:
        return generate_encoder(self.containers_plan, self.types, f"{self.profile.name} containers")

    @functools.cached_property
    def _encode_report(self) -> Encode:
        return generate_encoder(self._needed_srp_plan(), self.types, f"{self.profile.name} SRP payload")

    @functools.cached_property
    def _dissect_beacon(self) -> Dissect:
        return generate_dissector(self.beacon_plan, f"{self.profile.name} beacon", DOUBTS)

    @functools.cached_property
    def _salvager(self) -> Salvager:
        return Salvager(self)

    def _needed_srp_plan(self) -> Node:
        if self.srp_plan is None:
            raise ValueError(f"profile {self.profile.name} cannot encode state reports (srp.record is empty)")
        return self.srp_plan

    @property
    def safety_data_type(self) -> type[SafetyData]:
        """Return the class of ``ExtendedSafetyData.s_data``, with the fields that the profile lists."""
        return self.types.safety_data

    # -- beacons ----------------------------------------------------------------------------------------------

    def decode(self, octets: bytes) -> Beacon:
        """Decode a bearer payload; octets after the beacon are bearer padding and ignored (BP-RX-14).

        Raises only :class:`~dcp_codec.errors.DecodeError`, if the octets are not a beacon.
        """
        beacon: Beacon = self._decode_beacon(octets, 0, len(octets))[0]
        return beacon

    def decode_from(self, octets: bytes, start: int = 0) -> tuple[Beacon, int]:
        """Decode the beacon at ``octets[start:]``; also return the offset of its end. Error offsets are absolute."""
        beacon, end = self._decode_beacon(octets, start, len(octets))
        return beacon, end

    def decode_envelope(self, octets: bytes, start: int = 0) -> tuple[Beacon, int]:
        """Decode like :meth:`decode_from`, but leave every client payload as octets; this is what BP itself needs."""
        beacon, end = self._decode_envelope(octets, start, len(octets))
        return beacon, end

    def salvage(self, octets: bytes) -> Salvaged:
        """Read what can be read of a bearer payload, and report every problem. Never raises.

        If :meth:`decode` accepts the octets, its result is returned. Otherwise the payloads and containers without a
        fault are returned, and the header unless its structure is damaged; :mod:`dcp_codec.views.salvage` describes
        where reading stops.
        """
        try:
            beacon, end = self._decode_beacon(octets, 0, len(octets))
            return Salvaged(beacon, end=end)
        except DecodeError:
            return self._salvager.salvage(octets)

    def salvage_envelope(self, octets: bytes) -> Salvaged:
        """Salvage like :meth:`salvage`, but leave every client payload as octets, damaged or not."""
        try:
            beacon, end = self._decode_envelope(octets, 0, len(octets))
            return Salvaged(beacon, end=end)
        except DecodeError:
            return self._salvager.salvage(octets, envelope=True)

    def salvage_tree(self, octets: bytes, found: Salvaged) -> Dissection:
        """Return the fields that belong to ``found``, the result of :meth:`salvage` for these octets.

        Offsets count from the first octet. Unlike :meth:`dissect` this method follows the chosen reading of the block
        list. Layouts are nodes of ``beacon_plan``.
        """
        return self._salvager.tree(octets, found.reading)

    def encode(self, beacon: Beacon) -> bytes:
        """Encode ``beacon`` as a bearer payload. Raises :class:`~dcp_codec.errors.EncodeError` naming the field at
        fault.
        """
        return self._encode_beacon(beacon)

    def encode_envelope(self, beacon: Beacon) -> bytes:
        """Encode like :meth:`encode` a beacon whose client payloads are all octets."""
        return self._encode_envelope(beacon)

    def dissect(self, octets: bytes, *, start: int = 0, base: int = 0) -> Dissection:
        """Dissect the bearer payload ``octets[start:]``. Never raises.

        ``base`` is the offset of its first octet in the result: 14 to count from the start of an Ethernet frame.
        """
        found = self._dissect_beacon(bytes(octets), start, base)
        if found.doubtful:
            found.problems.extend(warnings(found))
        return found

    # -- client payloads --------------------------------------------------------------------------------------

    def decode_report(self, payload: bytes) -> ExtendedSafetyData:
        """Decode an SRP payload, which must be exactly one state report (SRP-RX-01).

        Raises DecodeError, or ValueError if the profile's SRP payloads are not state reports.
        """
        report = self.decode_srp(payload)
        if not isinstance(report, ExtendedSafetyData):
            raise ValueError(f"profile {self.profile.name} has no state reports (srp.record has no standard field)")
        return report

    def decode_srp(self, payload: bytes) -> ExtendedSafetyData | OwnRecord:
        """Decode an SRP payload: a state report, or the record that the profile sends instead.

        Raises DecodeError, or ValueError if the profile defines no structure for SRP payloads.
        """
        report: ExtendedSafetyData | OwnRecord
        report, end = self._decode_report(payload, 0, len(payload))
        if end != len(payload):
            # Only a report of variable size can end before the payload does.
            raise DecodeError(Problem("leftover", "", end, 0, len(payload) - end, "SRP-RX-01"), report)
        return report

    def encode_report(self, report: ExtendedSafetyData | OwnRecord) -> bytes:
        """Encode a state report, or the record sent instead of it, as an SRP payload. Raises EncodeError."""
        return self._encode_report(report)

    def decode_containers(self, payload: bytes) -> tuple[Container, ...]:
        """Decode a VarDis payload up to its last octet. ``DecodeError.partial``: the containers before the fault."""
        containers: tuple[Container, ...] = self._decode_containers(payload, 0, len(payload))[0]
        return containers

    def decode_leading_records(self, payload: bytes, start: int, most: int) -> Container | None:
        """Decode the container at ``payload[start:]`` up to its first damaged record, at most ``most`` records.

        Its ``extra`` is empty. Returns None if the header is cut off or the type is unknown.
        """
        layout = record(self.containers_plan, "Container")
        assert layout is not None
        header, ic_type = least_size(layout), places(layout)["icType"]
        number = member(layout, "icType")
        assert isinstance(number, Scalar)
        if start + header > len(payload):
            return None
        kind = read_scalar(number, payload[start + ic_type.start : start + ic_type.stop])
        decode = self._decode_records.get(kind)
        if decode is None:
            return None
        try:
            found = decode(payload, start + header, len(payload))[0]
        except DecodeError as error:
            found = error.partial or ()
        return Container(ic_type=kind, records=found[:most])

    def encode_containers(self, containers: tuple[Container, ...]) -> bytes:
        """Encode ``containers`` as a VarDis payload. Raises EncodeError."""
        return self._encode_containers(containers)


@functools.lru_cache(maxsize=32)
def get_codec(name: str) -> Codec:
    """Return the codec of a built-in profile or a profile file; later calls return the same object."""
    return Codec(name)
