"""The codec of a profile: strict decoding and encoding for programs, dissection for people."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path
from typing import cast

from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import load_profile
from dcp_spec.wire.schema import Schema, build_schema

from .errors import DecodeError, Problem
from .plan.layout import ValueTypes, read_scalar, walk
from .plan.measures import least_size, member, places, record
from .plan.tree import Many, Node, Scalar, Select, lower
from .values import Beacon, Container, ExtendedSafetyData, OwnRecord, SafetyData, VarSpec
from .views.decoder import Decode, generate_decoder
from .views.dissector import Dissect, generate_dissector
from .views.encoder import Encode, generate_encoder
from .views.fields import Dissection
from .views.lint import DOUBTS, warnings
from .views.salvage import Salvaged, Salvager


class Codec:
    """Octets <-> values for one profile.

    Everything is built from the construct schema of the profile when it is first used: ``beacon_plan`` (the layout as
    a tree), the compiled decoder and encoder, and the dissector. Instances are immutable to their users and can be
    shared between threads.
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
        """The construct schemas of the profile."""
        return build_schema(self.profile)

    @functools.cached_property
    def beacon_plan(self) -> Node:
        """The layout of a whole beacon."""
        return lower(self.schema.beacon)

    @functools.cached_property
    def envelope_plan(self) -> Node:
        """The layout of a beacon whose client payloads stay octets."""
        return lower(self.schema.envelope)

    @functools.cached_property
    def containers_plan(self) -> Node:
        """The layout of a VarDis payload."""
        return lower(self.schema.containers)

    @functools.cached_property
    def srp_plan(self) -> Node | None:
        """The layout of an SRP payload; None if it is octets of any number."""
        return None if self.schema.srp is None else lower(self.schema.srp)

    @property
    def report_plan(self) -> Node | None:
        """The layout of a state report; None if what the profile sends over SRP is none."""
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
        """By type of container: a decoder of its records up to the end of the octets."""
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
            raise ValueError(f"profile {self.profile.name} has no octets for a state report (srp.record is empty)")
        return self.srp_plan

    @property
    def safety_data_type(self) -> type[SafetyData]:
        """The class of ``ExtendedSafetyData.s_data``, with the fields that the profile lists."""
        return self.types.safety_data

    @property
    def var_spec_type(self) -> type[VarSpec]:
        """The class of a VarSpec: with ``extra``, of neutral values by default, if the profile adds fields to it."""
        return cast("type[VarSpec]", self.types["VarSpec"])

    # -- beacons ----------------------------------------------------------------------------------------------

    def decode(self, octets: bytes) -> Beacon:
        """Decode a bearer payload; octets behind the beacon are bearer padding and ignored (BP-RX-14).

        Raises :class:`~dcp_codec.errors.DecodeError`, and nothing else, for octets that are no beacon.
        """
        beacon: Beacon = self._decode_beacon(octets, 0, len(octets))[0]
        return beacon

    def decode_from(self, octets: bytes, start: int = 0) -> tuple[Beacon, int]:
        """Decode the beacon at ``octets[start:]``; also returns the offset behind it. Error offsets are absolute."""
        beacon, end = self._decode_beacon(octets, start, len(octets))
        return beacon, end

    def decode_envelope(self, octets: bytes, start: int = 0) -> tuple[Beacon, int]:
        """As :meth:`decode_from` with every client payload left as octets: what BP itself has to understand."""
        beacon, end = self._decode_envelope(octets, start, len(octets))
        return beacon, end

    def salvage(self, octets: bytes) -> Salvaged:
        """What can be read of a bearer payload, and everything that is wrong with it. Never raises.

        For octets that :meth:`decode` accepts this is its result. Otherwise payloads and containers that are sound in
        themselves are read, and the header as far as its rules are only broken in value; see
        :mod:`dcp_codec.views.salvage`
        for where it stops.
        """
        try:
            beacon, end = self._decode_beacon(octets, 0, len(octets))
            return Salvaged(beacon, end=end)
        except DecodeError:
            return self._salvager.salvage(octets)

    def salvage_envelope(self, octets: bytes) -> Salvaged:
        """As :meth:`salvage` with every client payload left as octets, damaged or not."""
        try:
            beacon, end = self._decode_envelope(octets, 0, len(octets))
            return Salvaged(beacon, end=end)
        except DecodeError:
            return self._salvager.salvage(octets, envelope=True)

    def salvage_tree(self, octets: bytes, found: Salvaged) -> Dissection:
        """The fields behind what :meth:`salvage` has ``found`` in these octets; offsets count from their first.

        Unlike :meth:`dissect` it follows the reading of the block list that was chosen. Layouts are nodes of
        ``beacon_plan``.
        """
        return self._salvager.tree(octets, found.reading)

    def encode(self, beacon: Beacon) -> bytes:
        """The bearer payload of ``beacon``. Raises :class:`~dcp_codec.errors.EncodeError` naming the field at fault."""
        return self._encode_beacon(beacon)

    def encode_envelope(self, beacon: Beacon) -> bytes:
        """As :meth:`encode` for a beacon whose client payloads are all octets."""
        return self._encode_envelope(beacon)

    def dissect(self, octets: bytes, *, start: int = 0, base: int = 0) -> Dissection:
        """Take the bearer payload ``octets[start:]`` apart. Never raises.

        ``base`` is what the offset of its first octet is called: 14 to count from the start of an Ethernet frame.
        """
        found = self._dissect_beacon(bytes(octets), start, base)
        if found.doubtful:
            found.problems.extend(warnings(found))
        return found

    # -- client payloads --------------------------------------------------------------------------------------

    def decode_report(self, payload: bytes) -> ExtendedSafetyData:
        """Decode an SRP payload, which must be exactly one state report (SRP-RX-01).

        Raises DecodeError, and ValueError for a profile whose SRP payloads are no state reports.
        """
        report = self.decode_srp(payload)
        if not isinstance(report, ExtendedSafetyData):
            raise ValueError(f"profile {self.profile.name} has no state reports (srp.record has no standard field)")
        return report

    def decode_srp(self, payload: bytes) -> ExtendedSafetyData | OwnRecord:
        """Decode an SRP payload: a state report, or what the profile sends in its place.

        Raises DecodeError, and ValueError for a profile whose SRP payloads are octets of any number.
        """
        report: ExtendedSafetyData | OwnRecord
        report, end = self._decode_report(payload, 0, len(payload))
        if end != len(payload):
            # Only a report without a fixed size can end early.
            raise DecodeError(Problem("leftover", "", end, 0, len(payload) - end, "SRP-RX-01"), report)
        return report

    def encode_report(self, report: ExtendedSafetyData | OwnRecord) -> bytes:
        """The SRP payload of a state report, or of what the profile sends in its place. Raises EncodeError."""
        return self._encode_report(report)

    def decode_containers(self, payload: bytes) -> tuple[Container, ...]:
        """Decode a VarDis payload up to its last octet. ``DecodeError.partial``: those before the fault."""
        containers: tuple[Container, ...] = self._decode_containers(payload, 0, len(payload))[0]
        return containers

    def decode_leading_records(self, payload: bytes, start: int, most: int) -> Container | None:
        """The container at ``payload[start:]`` with its first sound records only, at most ``most`` of them.

        Its ``extra`` is left empty. None if its header is cut off or its type is unknown.
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
        """The VarDis payload of ``containers``. Raises EncodeError."""
        return self._encode_containers(containers)


@functools.lru_cache(maxsize=32)
def get_codec(name: str) -> Codec:
    """The codec of a built-in profile or profile file; later calls return the same one."""
    return Codec(name)
