"""The fault dictionary: which cases fail for which fault."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Final

import msgspec

FILE: Final = "fault-dictionary.json"


class Fault(msgspec.Struct, frozen=True, kw_only=True):
    """A fault with its signature: the cases whose verdicts it changes."""

    id: str
    """The identifier of the mutant with this fault."""
    requirements: tuple[str, ...]
    """The requirement that the fault violates, and those that a failed check may name instead."""
    what: str
    """The wrong behaviour of a node with this fault: a sentence without its subject."""
    fails: frozenset[str]
    """Identifiers of the cases that fail with this fault."""
    undecided: frozenset[str]
    """Identifiers of the cases that become inconclusive with this fault."""
    observed: frozenset[tuple[str, str]] = frozenset()
    """Pairs of a case that fails and the digest of a check that fails in it (:mod:`.observation`)."""

    @property
    def crashes(self) -> bool:
        """Whether a node with this fault ends by itself. The sentence of such a fault begins with this word."""
        return self.what.startswith("crashes")


class Dictionary(msgspec.Struct, frozen=True):
    """The fault dictionary: all faults whose signatures are known."""

    faults: tuple[Fault, ...]


class _Entry(msgspec.Struct, frozen=True, array_like=True):
    """A fault in the file. ``fails`` and ``undecided`` are indices into the file's list of cases.

    ``observed`` has a text for each member of ``fails``: the digests of its failed checks, separated by spaces.
    """

    id: str
    requirements: list[str]
    what: str
    fails: list[int]
    undecided: list[int]
    observed: list[str]


class _Stored(msgspec.Struct, frozen=True):
    about: str
    cases: list[str]
    faults: list[_Entry]


_ABOUT: Final = "Made by `dcp-selftest dictionary`; do not edit."


def encode(dictionary: Dictionary) -> bytes:
    """Encode the dictionary as its JSON file, one fault on each line. The same faults give the same octets."""
    cases = sorted({case for fault in dictionary.faults for case in fault.fails | fault.undecided})
    place = {case: number for number, case in enumerate(cases)}
    observed: dict[tuple[str, str], list[str]] = {}
    for fault in dictionary.faults:
        for case, digest in sorted(fault.observed):
            observed.setdefault((fault.id, case), []).append(digest)
    faults = [
        msgspec.json.encode(
            _Entry(
                fault.id,
                list(fault.requirements),
                fault.what,
                sorted(place[case] for case in fault.fails),
                sorted(place[case] for case in fault.undecided),
                [" ".join(observed.get((fault.id, case), ())) for case in sorted(fault.fails)],
            )
        ).decode()
        for fault in sorted(dictionary.faults, key=lambda fault: fault.id)
    ]
    head = msgspec.json.encode({"about": _ABOUT, "cases": cases}).decode()
    return f'{head[:-1]},\n"faults": [\n{",".join(f"{each}{chr(10)}" for each in faults)}]}}\n'.encode()


def decode(octets: bytes) -> Dictionary:
    """Decode the JSON file of a dictionary.

    Raises ``msgspec.DecodeError`` for octets that are not JSON, ``msgspec.ValidationError`` for JSON of another form.
    """
    stored = msgspec.json.decode(octets, type=_Stored)
    return Dictionary(
        tuple(
            Fault(
                id=each.id,
                requirements=tuple(each.requirements),
                what=each.what,
                fails=frozenset(stored.cases[place] for place in each.fails),
                undecided=frozenset(stored.cases[place] for place in each.undecided),
                observed=frozenset(
                    (stored.cases[place], digest)
                    for place, digests in zip(each.fails, each.observed, strict=True)
                    for digest in digests.split()
                ),
            )
            for each in stored.faults
        )
    )


@cache
def load() -> Dictionary:
    """Return the dictionary of this version of the test kit."""
    return decode(files("dcp_conformance").joinpath("data", FILE).read_bytes())
