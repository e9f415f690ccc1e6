"""Find the parts of a profile that a node and the test suite cannot use.

The codec reads and writes whatever a profile describes. Programs that take part in a network also have to give a
meaning to each field: what they should send in a field of the implementation's own, and what follows when they receive
it, no profile says. Octets without a meaning (``opaque``) are sent as zeros and ignored.

A field that the profile adds to VarSpec is not an obstacle: it belongs to the variable, so nodes store and forward it.
The application that creates the variable gives its value; it is zero by default. Container types of the profile's
own are not an obstacle either: a node ignores those that it has no instruction for.
"""

from __future__ import annotations

from collections.abc import Iterator

from .definition import OwnField, Profile, own_fields


def unusable_keys(profile: Profile) -> dict[str, str]:
    """The keys of ``profile`` that keep a node and the suite from using it, each with the reason; usually empty."""
    return dict(_unusable(profile))


def refusal(profile: Profile) -> str | None:
    """One sentence that says why a node and the suite cannot use ``profile``; None if they can."""
    found = unusable_keys(profile)
    if not found:
        return None
    reasons = "; ".join(f"{key}: {reason}" for key, reason in found.items())
    return (
        f"profile {profile.name} describes octets that only the tools for recordings can use ({reasons}). "
        "Use it with dcp-codec, and a profile without these keys with a node or the test suite"
    )


def _unusable(profile: Profile) -> Iterator[tuple[str, str]]:
    bp, srp, vardis = profile.bp, profile.srp, profile.vardis
    meaning = "nothing says what to send there"
    if own := own_fields(bp.header):
        yield "bp.header", f"has {_names(own)}; {meaning}"
    for key, members in (("bp.payload_header", bp.payload_header), ("srp.record", srp.record if srp.is_report else ())):
        if own := [each for each in own_fields(members) if each.opaque is None]:
            yield key, f"has {_names(own)}; {meaning}"
    for name, members in vardis.records.by_name().items():
        if own := own_fields(members):
            yield f"vardis.records.{name}", f"has {_names(own)}; {meaning}, and a node could not forward it"
    if own := [each for each in vardis.container_extra if each.extra is None]:
        yield "vardis.container_extra", f"has {_names(own)}; only integers can be sent, as zeros"


def _names(own: list[OwnField]) -> str:
    return ", ".join(each.name for each in own)
