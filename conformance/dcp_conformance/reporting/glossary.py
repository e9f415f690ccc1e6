"""The terms of the report, explained on the page itself so that it can be read without the documentation.

``docs/glossary.md`` has the same definitions; a test compares them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple


class Term(NamedTuple):
    """A term with its definition."""

    name: str
    """The term."""
    text: str
    """The definition."""
    pattern: str = ""
    """Regular expression for the text of a page that needs the definition; empty: every page does."""

    @property
    def key(self) -> str:
        """Anchor on the page, without the prefix ``g-``."""
        return self.name.lower().replace(" ", "-")


_TERMS: Final = (
    Term(
        "DCP",
        "Drone Coordination Protocol. It lets the drones of a formation exchange safety data and variables by local"
        " broadcasts. It consists of BP, SRP and VarDis.",
    ),
    Term(
        "BP",
        "Beaconing Protocol. It sends and receives beacons: broadcasts that carry the payloads of its client "
        "protocols.",
    ),
    Term(
        "SRP",
        "State Reporting Protocol, a client of BP. It sends the safety data of a node (position, velocity) and "
        "maintains the neighbour table.",
    ),
    Term(
        "VarDis",
        "Variable Dissemination Protocol, a client of BP. It replicates variables to all nodes by instructions in "
        "beacons: create, update, delete, summary and request.",
    ),
    Term(
        "SUT",
        "system under test: the system that contains the implementation under test (IUT). In this kit the SUT is "
        "one node.",
        r"\bSUT\b",
    ),
    Term(
        "Upper tester",
        "the part of the test system that uses the services of the SUT at its upper interface, as an application "
        "would: register, create, read.",
        r"\bupper tester\b",
    ),
    Term(
        "Profile",
        "wire profile: a TOML file that describes the octets of one version of the specification or of one "
        "implementation.",
    ),
    Term(
        "PICS",
        "protocol implementation conformance statement: the optional features and limits that the implementer "
        "declares.",
        r"\bPICS\b",
    ),
    Term(
        "PIXIT",
        "protocol implementation extra information for testing: values that the tester needs, such as the node "
        "identifier, the beacon period and tolerances.",
        r"\bPIXIT\b|\[pixit\]",
    ),
    Term(
        "Requirement",
        "one statement of the specification that can be met or violated, with an identifier such as BP-RX-15.",
    ),
    Term(
        "Reading",
        "an interpretation of text of the specification that is contradictory or incomplete, with an identifier "
        "such as X02. Where several readings can be defended, the suite accepts each and reports which one was "
        "observed.",
        r"\b[Rr]eadings?\b",
    ),
    Term(
        "Hazard",
        "a consequence of the specification that the users of a formation should know, with an identifier such as "
        "H1. No implementation fails because of a hazard.",
        r"\b[Hh]azards?\b",
    ),
    Term(
        "Test case",
        "a test purpose with its stimulus and its expectation, and an identifier such as TC_BP_RX_BI_01: protocol, "
        "group, kind (BV valid behaviour, BI invalid behaviour, BO inopportune behaviour, TI timing) and number.",
        r"\bTC_[A-Z]",
    ),
    Term(
        "Rule",
        "a property that every recording of conforming nodes has, with an identifier such as CK_VD_ANSWER_UPDATE. "
        "dcp-conformance check tests rules.",
        r"\bCK_[A-Z]",
    ),
    Term(
        "Occasion",
        "a situation in a recording in which a rule could have been violated.",
        r"\boccasions\b",
    ),
    Term(
        "Verdict",
        "the result of a test case, a rule or a requirement. pass: the requirement is met; fail: it is violated; "
        "inconclusive: neither could be shown; info: the specification leaves it open, and the observed behaviour "
        "is reported; error: the tester has a fault; not applicable (n/a): the case does not concern this "
        "implementation; too little: a recording contains too few occasions.",
    ),
)


def terms() -> Mapping[str, Term]:
    """Return all terms by key, in the order of the glossary."""
    return {each.key: each for each in _TERMS}


def terms_of(page: str) -> Iterator[Term]:
    """Yield the terms that a page uses, and those that every page needs."""
    return (each for each in _TERMS if re.search(each.pattern, page))
