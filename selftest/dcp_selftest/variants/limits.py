"""Variants with the smallest permitted limits, and with small capacities; the node reports its parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec
from dcp_conformance.definitions.pics import Testing
from dcp_conformance.reference.surroundings import Setup
from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.definition import Profile
from dcp_spec.status import BPStatus

from dcp_selftest.mutants.family import around
from dcp_stack.bp.entity import BeaconingProtocol
from dcp_stack.bp.services import RegisterConfirm
from dcp_stack.config import BPConfig, VardisConfig
from dcp_stack.srp.neighbour_table import NeighbourTable

from .variant import Variant, derived, has_srp, setup


def _vardis(**limits: int) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, vardis=VardisConfig(**limits))


def _bp(limit: int, **vardis: int) -> Callable[[str], Setup]:
    return lambda profile: setup(profile, bp=BPConfig(max_packet_size=limit), vardis=VardisConfig(**vardis))


def _small(name: str, what: str, requirement: str, **limits: int) -> Variant:
    return Variant(f"V-LIM-{name}", what, requirement, _vardis(**limits))


#: The specification does not limit capacities; a profile can.
_ROOM = "the memory of a node is finite: max_variables and max_neighbours of the profile"


def _room(**limits: int) -> Callable[[str], Setup]:
    def change(profile: Profile) -> Profile:
        return msgspec.structs.replace(profile, limits=msgspec.structs.replace(profile.limits, **limits))

    return lambda name: setup(derived(name, change))


def _example(profile: Profile) -> Profile:
    """The example of docs/profile-reference.md."""
    limits = msgspec.structs.replace(profile.limits, max_variables=16, max_value_length=8)
    return msgspec.structs.replace(profile, limits=limits)


class FewClients(BeaconingProtocol):
    """Registers eight clients beside SRP and VarDis."""

    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        others = [each for each in self._clients if each.protocol_id not in _OWN and each.protocol_id != prot_id]
        if len(others) >= _CLIENTS and prot_id not in _OWN:
            return RegisterConfirm(BPStatus.PROTOCOL_ALREADY_REGISTERED, self._config.node_id)
        return super().register(prot_id, *rest, now=now, wall=wall)


class FewPlaces(BeaconingProtocol):
    """Registers queues of at most five places."""

    def register(self, prot_id: int, *rest: Any, now: int, wall: int) -> RegisterConfirm:
        mode, entries = rest[2], rest[3]
        known = prot_id in _OWN or prot_id in self._clients
        if not known and isinstance(entries, int) and entries > _PLACES and "QUEUE" in str(mode):
            return RegisterConfirm(BPStatus.ILLEGAL_DROPPING_QUEUE_SIZE, self._config.node_id)
        return super().register(prot_id, *rest, now=now, wall=wall)


_FORTY: Final = around(NeighbourTable, NeighbourTable.record).part(
    lambda self, proceed, report, sender_id, *, now, wall: (
        "full" if report.node_id not in self and len(self) >= 40 else proceed(report, sender_id, now=now, wall=wall)
    )
)
_OWN: Final = (BP_PROTID_SRP, BP_PROTID_VARDIS)
_CLIENTS, _PLACES = 8, 5


def _all_small(profile: str) -> Setup:
    limits: dict[str, Any] = {
        "max_value_length": 10, "max_description_length": 10, "max_payload_size": 90, "max_summaries": 5,
        "max_repetitions": 2,
    }  # fmt: skip
    return setup(profile, vardis=VardisConfig(**limits))


VARIANTS = (
    _small("value-1", "has values of one octet only", "VD-PAR-02", max_value_length=1),
    _small("value-4", "has values of at most 4 octets", "VD-PAR-02", max_value_length=4),
    _small("value-8", "has values of at most 8 octets", "VD-PAR-02", max_value_length=8),
    _small("value-12", "has values of at most 12 octets", "VD-PAR-02", max_value_length=12),
    _small("description-2", "has descriptions of at most 2 octets (1 and a NUL in 1.0)", "VD-PAR-03",
        max_description_length=2),
    _small("description-5", "has descriptions of at most 5 octets", "VD-PAR-03", max_description_length=5),
    _small("description-12", "has descriptions of at most 12 octets", "VD-PAR-03", max_description_length=12),
    _small("payload-60", "has VarDis payloads of at most 60 octets", "VD-PAR-05", max_payload_size=60,
        max_value_length=10, max_description_length=10, max_summaries=10),
    _small("value-description-1", "has values of one octet and the shortest descriptions", "VD-PAR-02, VD-PAR-03",
        max_value_length=1, max_description_length=2),
    Variant("V-LIM-all-small", "has small limits throughout", "VD-PAR-02 to VD-PAR-06", _all_small),
    Variant(
        "V-LIM-packet-200",
        "has beacons of at most 200 octets",
        "BP-PAR-04",
        _bp(200, max_payload_size=140),
        # No client can register for payloads of 255, 256 or 258 octets.
        explains=(r"^TC_BP_((RXP|TXP)_BV_01-25[56]|HDR_BV_13): .*ILLEGAL-MAX-PAYLOAD-SIZE",),
    ),
    Variant("V-LIM-queue-5", "registers VarDis with room for 5 payloads", "VD-INI-02", _vardis(bp_queue_entries=5)),
    Variant("V-LIM-queue-20", "registers VarDis with room for 20 payloads", "VD-INI-02", _vardis(bp_queue_entries=20)),
    Variant("V-LIM-variables-64", "has room for 64 variables", _ROOM, _room(max_variables=64)),
    Variant("V-LIM-variables-200", "has room for 200 variables", _ROOM, _room(max_variables=200)),
    Variant("V-LIM-neighbours-50", "has room for 50 neighbours", _ROOM, _room(max_neighbours=50), where=has_srp),
    Variant("V-LIM-variables-16", "has room for 16 variables with values of 8 octets", _ROOM,
        lambda name: setup(derived(name, _example))),
    Variant("V-LIM-variables-40", "has room for 40 variables, as the PIXIT says", _ROOM,
        lambda name: setup(name, vardis=VardisConfig(max_variables=40), pixit=Testing(variables=40))),
    Variant("V-LIM-neighbours-40", "has room for 40 neighbours, as the PIXIT says, and stores no further ones", _ROOM,
        lambda name: setup(name, part=_FORTY, pixit=Testing(neighbours=40)), where=has_srp),
    Variant("V-LIM-clients-8", "has room for eight clients of BP, as the PIXIT says", _ROOM,
        lambda name: setup(name, part=FewClients, pixit=Testing(clients=8))),
    Variant("V-LIM-places-5", "has room for five payloads in the queue of a client, as the PIXIT says", _ROOM,
        lambda name: setup(name, part=FewPlaces, pixit=Testing(queue_entries=5))),
    Variant("V-LIM-neighbours-10", "has room for 10 neighbours", _ROOM, _room(max_neighbours=10), where=has_srp),
)  # fmt: skip
