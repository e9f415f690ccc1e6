"""Find the parts of a profile that a node and the test suite cannot use.

The codec reads and writes whatever a profile describes. Programs that take part in a network also have to give a
meaning to each field: what they should send in a field of the implementation's own, and what follows when they receive
it, no profile says. Octets without a meaning (``opaque``) are sent as zeros and ignored.

A field that the profile adds to VarSpec or to a record is not an obstacle: nodes store and forward it with the record.
The node that makes the record sends the value of the application, that of a rule, or zero (``dcp_stack.own_fields``).
Only a block of octets in a record is refused, because nodes compute the sizes of payloads from those of their records.
Container types of the profile's own are not an obstacle either: a node ignores those that it has no instruction for.
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
    bp, vardis = profile.bp, profile.vardis
    meaning = "nothing says what to send there"
    if own := own_fields(bp.header):
        yield "bp.header", f"has {_names(own)}; {meaning}"
    if own := [each for each in own_fields(bp.payload_header) if each.opaque is None]:
        yield "bp.payload_header", f"has {_names(own)}; {meaning}"
    for name, members in profile.own_fields().items():
        if name != "VarSpec" and (own := [each for each in members if each.block is not None]):
            key = "srp.record" if name == "ExtendedSafetyData" else f"vardis.records.{name}"
            yield key, f"has {_names(own)}; a node needs a fixed number of octets"
    if own := [each for each in vardis.container_extra if each.extra is None]:
        yield "vardis.container_extra", f"has {_names(own)}; only integers can be sent, as zeros"


def _names(own: list[OwnField]) -> str:
    return ", ".join(each.name for each in own)
