"""Why octets are not a message: the closed list of reasons that errors and drop reports use."""

from __future__ import annotations

from typing import Final

#: reason -> what it means. ``needed`` and ``available`` of a problem are octets, but for :data:`COMPARISONS`.
REASONS: Final[dict[str, str]] = {
    "truncated": "the field needs more octets than its region has left",
    "bad-version": "the version octet is not the protocol's",
    "bad-magic": "the magic number is not the protocol's",
    "bad-length": "a length field that has one fixed value holds another",
    "zero-length": "a length that must not be zero is zero",
    "zero-count": "a count that must be at least one is zero",
    "beacon-overrun": "the header announces more octets than the frame holds",
    "block-overrun": "a payload block announces more octets than the beacon has left",
    "list-overrun": "an instruction list announces more octets than the payload has left",
    "area-overrun": "a payload is longer than the fixed area that should hold it",
    "wrong-length": "a payload of fixed size has another size",
    "leftover": "octets are left inside a region after its content",
    "count-mismatch": "a count does not agree with what is there",
    "unknown-type": "the type number has no meaning in this profile",
    "length-mismatch": "two length fields of one value differ",
    "bad-terminator": "a string does not end with its only NUL octet",
}

#: Well-formed octets that a receiver must ignore or a sender must not send.
WARNINGS: Final[dict[str, str]] = {
    "empty-payload": "a payload block without octets; no sender is allowed to submit one",
    "empty-value": "a variable value without octets; receivers ignore the record",
    "empty-description": "a variable without description; receivers of 1.2 and later ignore the record",
    "zero-repetitions": "a repetition count of zero; receivers of 1.2 and later ignore the record",
    "id-mismatch": "the two variable identifiers of one VarCreate differ",
    "foreign-node-id": "a state report names another node than the sender of the beacon",
    "duplicate-variable": "one variable appears twice in one container",
    "invalid-utf8": "the description is not valid UTF-8",
}

#: Reasons whose ``needed`` and ``available`` are the number that should be there and the one that was found.
COMPARISONS: Final = frozenset(
    {
        "bad-version",
        "bad-magic",
        "bad-length",
        "zero-length",
        "zero-count",
        "count-mismatch",
        "unknown-type",
        "length-mismatch",
        "zero-repetitions",
        "id-mismatch",
        "duplicate-variable",
    }
)


def quantity(reason: str, needed: int | None, available: int | None) -> str:
    """Return the needed and the available octets in words; empty if the problem has no numbers."""
    if reason in COMPARISONS:
        expected = f"expected {needed}, " if needed is not None else ""
        return f"{expected}found {available}" if available is not None else expected.removesuffix(", ")
    if reason == "leftover":
        return f"{available} octets too many"
    if needed is None and available is None:
        return ""
    return f"needs {needed} octets, {available} there"
