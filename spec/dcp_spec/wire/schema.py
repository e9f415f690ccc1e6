"""The construct schemas of a profile, put together."""

from __future__ import annotations

from typing import Any, NamedTuple

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS
from dcp_spec.profile.definition import Profile

from . import bp, srp, vardis


class Schema(NamedTuple):
    """The wire formats of a profile as construct objects that parse and build.

    ``beacon`` is a bearer payload with its client payloads taken apart, ``envelope`` the same with client payloads
    left as octets (what BP itself knows), ``srp`` an SRP payload (None where it is octets of any number),
    ``containers`` a VarDis payload.
    """

    profile: Profile
    beacon: Any
    envelope: Any
    srp: Any | None
    containers: Any


def build_schema(profile: Profile) -> Schema:
    """Build the schemas of ``profile``."""
    report = srp.report(profile)
    containers = vardis.payload(profile)
    clients: dict[int, tuple[str, Any]] = {BP_PROTID_VARDIS: ("vardis", containers)}
    if report is not None:
        clients[BP_PROTID_SRP] = ("srp", report)
    return Schema(
        profile=profile,
        beacon=bp.beacon(profile, clients),
        envelope=bp.beacon(profile, {}),
        srp=report,
        containers=containers,
    )
